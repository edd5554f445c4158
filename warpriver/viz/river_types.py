"""Pictures of the types of rivers and of the beds that they have.

matplotlib is imported when something is drawn, not before, and its global state (``pyplot``) is never touched.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from warpriver.errors import InputError
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.riverscape.rosgen import RiverTypes
from warpriver.riverscape.scene import Riverscape
from warpriver.riverscape.stations import TYPES
from warpriver.terrain import Terrain
from warpriver.validate import finite_numbers
from warpriver.viz.maps import add_channels, finished, map_window
from warpriver.viz.relief import relief_picture
from warpriver.viz.sheet import GROUND, INK, Sheet, check_drawing, make_sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["TYPE_COLORS", "draw_bed", "draw_river_types"]


# By type: steep ones warm, gentle single ones blue, those of several threads green, entrenched ones violet.
TYPE_COLORS = {
    "A+": "#a11d20", "A": "#dd5a2b", "B": "#e8a33d", "C": "#1f6fb4", "D": "#1b8a5a", "DA": "#7bbf6a", "E": "#35b3d4",
    "F": "#6a4fa3", "G": "#b565a7",
}  # fmt: skip
# Ground, wet bed at the edge and where it is deep; the depth at which little of the bed is seen, m.
DRY, SHALLOW, DEEP = (np.array(c) for c in ((0.76, 0.71, 0.60), (0.42, 0.55, 0.52), (0.05, 0.17, 0.27)))
CLEAR = 0.45
# Direction of the light, towards it; how much of the shade is that of a level place.
LIGHT = np.array([-0.55, 0.6, 0.58])
SHADES = 0.42
# Places of a row of pixels that are evaluated at a time.
ROWS = 64


@public
def draw_river_types(
    types: RiverTypes,
    network: RiverNetwork,
    path: str | os.PathLike[str] | None = None,
    *,
    terrain: Terrain | None = None,
    window: Sequence[float] | None = None,
    title: str | None = None,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Draw rivers by their Rosgen types, with the length of each.

    Args:
        types: From :func:`warpriver.riverscape.classify_rivers`.
        network: The rivers.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        terrain: Terrain to draw under them.
        window: (west, south, east, north) to show, m; by default all rivers.
        title: Title at the upper left, or None.
        size: Width and height of the picture in pixels.
        dpi: Pixels per inch.
        ax: Axes of your own to draw on.

    Returns:
        The figure, whose first axes are the map, in m; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: Types of other rivers, an unknown suffix, or a window without a river or terrain.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    if len(types) != network.channel_count:
        raise InputError(f"types are those of {len(types)} channels; the network has {network.channel_count}")
    view = map_window(window, network.bounds(), 0.05, terrain, network.crs)
    sheet = make_sheet(view, ax=ax, size=size, dpi=dpi, title=title or "", ticks=True, crs=network.crs)
    sheet.axes.set_facecolor(GROUND)
    if terrain is not None:
        relief = relief_picture(terrain, sheet.window, sheet.shape, strength=0.8)
        # Pale, so that colours of types are told apart on it.
        pixels = np.empty((*sheet.shape, 4), np.uint8)
        pixels[..., :3] = np.clip(0.55 * relief.color + 0.45 * 245.0, 0.0, 255.0)
        pixels[..., 3] = np.where(relief.known, 255, 0)
        sheet.lay(pixels)
    colors = np.array([_rgb(TYPE_COLORS[TYPES[k]]) for k in types.index])
    add_channels(sheet, network, colors, bank=0.0, rank=network.channel_width)
    _add_legend(sheet, types, network)
    return finished(sheet, path, ax)


def _rgb(word: str) -> tuple[float, ...]:
    return tuple(int(word[k : k + 2], 16) / 255.0 for k in (1, 3, 5))


def _add_legend(sheet: Sheet, types: RiverTypes, network: RiverNetwork) -> None:
    from matplotlib.lines import Line2D

    found = types.lengths(network)
    handles = [
        Line2D([], [], color=TYPE_COLORS[name], lw=3.0, label=f"{name}  {km:,.3g} km") for name, km in found.items()
    ]
    legend = sheet.axes.legend(
        handles=handles,
        loc="best",
        fontsize=8,
        framealpha=0.85,
        edgecolor="none",
        title="Rosgen type",
        title_fontsize=8,
    )
    legend.get_title().set_color(INK)
    legend.set_zorder(9)


@public
def draw_bed(
    scene: Riverscape,
    path: str | os.PathLike[str] | None = None,
    *,
    bounds: Sequence[float] | None = None,
    water: bool = True,
    title: str | None = None,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Draw the bed of a riverscape from above, lit from the north-west, under clear water of its depth.

    Args:
        scene: The riverscape.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        bounds: (west, south, east, north) to show, m; by default all courses.
        water: False: the dry bed.
        title: Title at the upper left, or None.
        size: Width and height of the picture in pixels.
        dpi: Pixels per inch.
        ax: Axes of your own to draw on.

    Returns:
        The figure, whose first axes are the map, in m; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: A window that is none, or an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    if bounds is None:
        low, high = scene.stations.xy.min(axis=0), scene.stations.xy.max(axis=0)
        margin = 2.0 * float(scene.stations.width.max())
        bounds = (low[0] - margin, low[1] - margin, high[0] + margin, high[1] + margin)
    west, south, east, north = finite_numbers(bounds, 4, "bounds")
    if not (west < east and south < north):
        raise InputError(
            f"bounds ({west:g}, {south:g}, {east:g}, {north:g}) hold nothing; give (west, south, east, north)"
        )
    view = (west, south, east, north)
    sheet = make_sheet(view, ax=ax, size=size, dpi=dpi, title=title or "", ticks=True, crs=scene.terrain.crs)
    sheet.axes.set_facecolor(GROUND)
    sheet.lay(_bed_pixels(scene, sheet, water))
    return finished(sheet, path, ax)


def _bed_pixels(scene: Riverscape, sheet: Sheet, water: bool) -> NDArray[np.uint8]:
    """Colours of the bed, row by row: slopes by the light, and water over it."""
    (west, _, east, north), (rows, columns) = sheet.window, sheet.shape
    step = (east - west) / columns
    x = west + (np.arange(columns) + 0.5) * step
    pixels = np.zeros((rows, columns, 4), np.uint8)
    light = LIGHT / np.linalg.norm(LIGHT)
    for first in range(0, rows, ROWS):
        last = min(first + ROWS, rows)
        y = north - (np.arange(first - 1, last + 1) + 0.5) * step
        xy = np.stack(np.meshgrid(x, y), axis=-1)
        bed = scene.bed_at(xy.reshape(-1, 2))
        height = bed.elevation.reshape(len(y), columns)
        up, across = np.gradient(height, step)
        inner = slice(1, len(y) - 1)
        normal = np.stack([-across[inner], up[inner], np.ones_like(across[inner])], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        shade = SHADES + (1.0 - SHADES) * np.clip(normal @ light, 0.0, None) / light[2]
        depth = bed.depth.reshape(len(y), columns)[inner]
        color = DRY * shade[..., None]
        if water:
            wet = np.clip(depth / 0.02, 0.0, 1.0)[..., None]
            seen = np.exp(-depth / CLEAR)[..., None]
            below = seen * SHALLOW * (0.35 + 0.65 * shade[..., None]) + (1.0 - seen) * DEEP
            color = (1.0 - wet) * color + wet * below
        block = pixels[first:last]
        block[..., :3] = np.nan_to_num(255.0 * np.clip(color, 0.0, 1.0))
        block[..., 3] = np.where(np.isfinite(height[inner]), 255, 0)
    return pixels
