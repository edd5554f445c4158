"""Pictures: plan maps and movies by matplotlib, 3-D previews by pyvista; both are imported when they draw."""

from . import gl
from .maps import draw_belt, draw_network
from .movie import movie
from .scene import render_scene

__all__ = ["draw_belt", "draw_network", "gl", "movie", "render_scene"]
