"""Pictures: plan maps and movies by matplotlib, 3-D previews by pyvista; both are imported when they draw."""

from warpriver.viz import gl
from warpriver.viz.belt import draw_before_after, draw_belt
from warpriver.viz.calibration import draw_fit, draw_fit_map, draw_hindcast
from warpriver.viz.erosion import draw_drainage, draw_elevation, draw_ordered_network, erosion_movie
from warpriver.viz.landscape import draw_landscape
from warpriver.viz.maps import draw_network
from warpriver.viz.movie import movie
from warpriver.viz.relief import hillshade
from warpriver.viz.river_types import draw_bed, draw_river_types
from warpriver.viz.riverscape_block import render_riverscape
from warpriver.viz.riverscapes import Camera, draw_riverscape, riverscape_movie
from warpriver.viz.scene import render_scene
from warpriver.viz.valleys import draw_valley, draw_valley_sections

__all__ = [
    "Camera",
    "draw_bed",
    "draw_before_after",
    "draw_belt",
    "draw_drainage",
    "draw_elevation",
    "draw_fit",
    "draw_fit_map",
    "draw_hindcast",
    "draw_landscape",
    "draw_network",
    "draw_ordered_network",
    "draw_river_types",
    "draw_riverscape",
    "draw_valley",
    "draw_valley_sections",
    "erosion_movie",
    "gl",
    "hillshade",
    "movie",
    "render_riverscape",
    "render_scene",
    "riverscape_movie",
]
