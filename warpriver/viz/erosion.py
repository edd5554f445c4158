"""Pictures of eroded terrain: by elevation, by the water that cells drain, and a movie of the network that grows.

Every cell is a block of the picture: nothing is smoothed. Where cells are smaller than pixels, rivers are as wide as
those, so that none is lost. matplotlib is imported when something is drawn, not before.
"""

from __future__ import annotations

import math
import os
import pathlib
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from warpriver.erosion.eroded import ErodedTerrain
from warpriver.errors import InputError
from warpriver.hydrology.orders import strahler_order
from warpriver.hydrology.routing import Flow, host_areas
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain, surface_of
from warpriver.validate import positive
from warpriver.viz.maps import add_value_bar, draw_network, finished
from warpriver.viz.movie import write_frames
from warpriver.viz.relief import hillshade
from warpriver.viz.sheet import GROUND, INK, Sheet, check_drawing, color_ramp, make_sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_drainage", "draw_elevation", "draw_ordered_network", "erosion_movie"]

# Canyon floors to summits; and from the smallest river to the largest, on pale ground.
ELEVATION_RAMP = (
    (0.0, "#16324f"),
    (0.2, "#2f6f73"),
    (0.4, "#6fa064"),
    (0.6, "#c9c27c"),
    (0.8, "#b98a56"),
    (0.93, "#a0715c"),
    (1.0, "#f1ece6"),
)
RIVER_RAMP = ((0.0, "#9fc6d6"), (0.35, "#4f92b8"), (0.7, "#1f568a"), (1.0, "#0a1f44"))
# Few cells are lowest: colours begin at this percentile. How dark shadows are.
LOWEST_PERCENTILE, SHADE = 0.5, 0.45
# Under rivers the ground is this much white: canyon floors are as dark as they are.
PALE = 0.45
# Height that steepens slopes for shading, as a fraction of the map's shorter side per range of heights.
SHADED_RELIEF = 0.25


@public
def draw_elevation(
    terrain: Terrain | Raster,
    path: str | os.PathLike[str] | None = None,
    *,
    title: str | None = None,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
    frame: bool = True,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Draw a terrain coloured by elevation, with faint shades under light from the north-west.

    Args:
        terrain: Terrain, or a Raster of heights in m.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        title: Title at the upper left, or None.
        size: Width and height of the picture in pixels; by default fitted to the terrain.
        dpi: Pixels per inch.
        frame: False for the map alone, exactly the terrain and nothing else, pixel by pixel, with the files beside it
            by which GDAL and QGIS place it; see :func:`draw_network`.
        ax: Axes of your own to draw on, without bars and scale.

    Returns:
        The figure, whose first axes are the map, in m; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: A file name with an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    from matplotlib.colors import Normalize

    terrain = surface_of(terrain)
    low, high = _height_span(terrain)
    sheet = _page(terrain, title, size, dpi, frame, ax)
    _lay(sheet, terrain, _elevation_picture(terrain, low, high))
    add_value_bar(sheet, Normalize(low, high), "elevation, m", ELEVATION_RAMP)
    return finished(sheet, path, ax)


@public
def draw_drainage(
    flow: Flow,
    path: str | os.PathLike[str] | None = None,
    *,
    min_drainage_area: float | None = None,
    title: str | None = None,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
    frame: bool = True,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Draw the cells that drain enough ground, darker the more they drain.

    Args:
        flow: From :func:`warpriver.hydrology.route`, or ``ErodedTerrain.flow()``.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        min_drainage_area: Minimum drainage area of a river cell, m2; by default ten cells.
        title: Title at the upper left, or None.
        size: Width and height of the picture in pixels; by default fitted to the terrain.
        dpi: Pixels per inch.
        frame: False for the map alone, exactly the terrain and nothing else, pixel by pixel, with the files beside it
            by which GDAL and QGIS place it; see :func:`draw_network`.
        ax: Axes of your own to draw on, without bars and scale.

    Returns:
        The figure, whose first axes are the map, in m; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: A threshold that is not positive or leaves no cell, or a file name with an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    from matplotlib.colors import LogNorm

    area, minimum = _areas(flow, min_drainage_area)
    sheet = _page(flow.terrain, title, size, dpi, frame, ax)
    factor, largest = _cells_per_pixel(sheet, flow.terrain), float(np.nanmax(area))
    known = np.isfinite(area)
    ground = np.where(known[..., None], color_ramp(((0.0, GROUND),), np.zeros(area.shape)), 1.0)
    _lay(sheet, flow.terrain, _with_rivers(ground, area, minimum, largest, factor), factor)
    # In cells where cells are counted, in km2 on a real map.
    unit, label = (1e6, "drainage area, km²") if largest > 1e6 else (1.0, "drainage area, m²")
    add_value_bar(sheet, LogNorm(minimum / unit, max(largest, 1.01 * minimum) / unit), label, RIVER_RAMP)
    return finished(sheet, path, ax)


@public
def draw_ordered_network(
    terrain: Terrain,
    network: RiverNetwork,
    path: str | os.PathLike[str] | None = None,
    *,
    title: str | None = None,
    dpi: float = 200.0,
    frame: bool = True,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Draw the channels of a network by Strahler order over a terrain in pale colours of elevation.

    Args:
        terrain: Terrain; its canyons may be steeper than the relief of :func:`draw_network` can show.
        network: RiverNetwork; what lies beyond the terrain is left out.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        title: Title at the upper left, or None.
        dpi: Pixels per inch.
        frame: False for the map alone, exactly the terrain and nothing else, pixel by pixel, with the files beside it
            by which GDAL and QGIS place it; see :func:`draw_network`.
        ax: Axes of your own to draw on, without bars and scale.

    Returns:
        The figure, whose first axes are the map, in m; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: A file name with an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    order = strahler_order(network.channel_from, network.channel_to)
    picture = PALE + (1.0 - PALE) * _elevation_picture(terrain, *_height_span(terrain))
    return draw_network(
        network,
        path,
        color="order",
        order=order,
        background=picture,
        extent=terrain.bounds,
        title=title,
        flow_arrow=False,
        dpi=dpi,
        frame=frame,
        ax=ax,
    )


@public
def erosion_movie(
    eroded: ErodedTerrain,
    path: str | os.PathLike[str],
    *,
    min_drainage_area: float | None = None,
    fps: float = 10.0,
    size: tuple[int, int] = (960, 720),
    title: str | None = None,
    dpi: float = 100.0,
    hold: float = 2.0,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a movie of the network growing: the snapshots of an eroded terrain by elevation, and the rivers on them.

    The colours of all frames are those of the last.

    Args:
        eroded: ErodedTerrain with snapshots: ``erode(..., record_every=...)``.
        path: File to write: .gif, or .mp4, which needs ``warpriver[movie]``.
        min_drainage_area: Minimum drainage area of a river cell, m2; by default ten cells.
        fps: Frames a second, above 0 and at most 60.
        size: Width and height in pixels; both even for .mp4.
        title: Title at the upper left, or None.
        dpi: Pixels per inch: sets the size of letters.
        hold: Time in s for which the last frame stays.
        progress: Called after each frame with the number of frames done and their total.

    Raises:
        ImportError: matplotlib is missing, or, for .mp4, imageio-ffmpeg.
        ValueError: Less than two snapshots, a rate or size out of range, or an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing()
    if not 0.0 < fps <= 60.0:
        raise InputError(f"fps is {fps:g}; give more than 0 and at most 60 frames a second")
    if len(eroded.snapshots) < 2:
        raise InputError("there are no snapshots to make a movie of; erode with record_every=")
    if pathlib.Path(path).suffix.lower() == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise InputError(f"size is {tuple(size)} pixels; .mp4 needs even numbers")
    minimum = _areas(eroded.flow(), min_drainage_area)[1]
    pages: list[Any] = [eroded.snapshots, minimum, title, size, dpi]
    frames = _frames(*pages, progress=progress)
    write_frames(path, frames, fps=fps, hold=hold, ramps=(ELEVATION_RAMP, RIVER_RAMP))


def _frames(
    snapshots: Sequence[ErodedTerrain],
    minimum: float,
    title: str | None,
    size: tuple[int, int],
    dpi: float,
    *,
    progress: Callable[[int, int], None] | None,
) -> Iterator[np.ndarray]:
    """Yield the picture of each snapshot, (rows, columns, 3) uint8."""
    from matplotlib.colors import Normalize

    low, high = _height_span(snapshots[-1])
    largest = float(np.nanmax(host_areas(snapshots[-1].flow())))
    sheet = _page(snapshots[-1], title, size, dpi)
    add_value_bar(sheet, Normalize(low, high), "elevation, m", ELEVATION_RAMP)
    sheet.add_scale_bar()
    shown, factor = None, _cells_per_pixel(sheet, snapshots[-1])
    for done, snapshot in enumerate(snapshots, start=1):
        ground = _elevation_picture(snapshot, low, high)
        ground = PALE + (1.0 - PALE) * ground
        picture = _with_rivers(ground, host_areas(snapshot.flow()), minimum, largest, factor)
        if shown is None:
            shown = _lay(sheet, snapshot, picture, factor)
        shown.set_data(picture)
        sheet.note.set_text(f"{snapshot.events:,} events")
        sheet.canvas.draw()
        yield np.ascontiguousarray(np.asarray(sheet.canvas.buffer_rgba())[..., :3])
        if progress is not None:
            progress(done, len(snapshots))


def _height_span(terrain: Terrain) -> tuple[float, float]:
    """Heights between which the colours run, m."""
    height = terrain.to_numpy()
    low, high = float(np.nanpercentile(height, LOWEST_PERCENTILE)), float(np.nanmax(height))
    return low, max(high, low + 1e-9)


def _elevation_picture(terrain: Terrain, low: float, high: float) -> np.ndarray:
    """Colours of elevation with shades, (rows, columns, 3) in 0..1; white without data."""
    height = terrain.to_numpy()
    fraction = np.clip((np.nan_to_num(height, nan=high) - low) / (high - low), 0.0, 1.0)
    color = color_ramp(ELEVATION_RAMP, fraction)
    steepen = SHADED_RELIEF * min(terrain.shape) * terrain.cell_size / (high - low)
    light = hillshade(terrain, exaggeration=steepen) / np.sin(np.radians(45.0))
    shade = np.clip(1.0 + SHADE * (np.nan_to_num(light, nan=1.0) - 1.0), 0.0, 1.15)
    return np.where(np.isnan(height)[..., None], 1.0, np.clip(color * shade[..., None], 0.0, 1.0))


def _with_rivers(ground: np.ndarray, area: np.ndarray, minimum: float, largest: float, factor: int) -> np.ndarray:
    """Ground with the cells that drain enough in the colour of what they drain, (rows, columns, 3).

    Blocks of ``factor`` cells a side become one, of the ground's mean colour and the cells' largest area.
    """
    rows, columns = (-(-n // factor) for n in area.shape)
    below, aside = rows * factor - area.shape[0], columns * factor - area.shape[1]
    picture: np.ndarray = np.pad(ground, ((0, below), (0, aside), (0, 0)), mode="edge")
    drained = np.pad(np.nan_to_num(area, nan=0.0), ((0, below), (0, aside)))
    picture = picture.reshape(rows, factor, columns, factor, 3).mean(axis=(1, 3))
    drained = drained.reshape(rows, factor, columns, factor).max(axis=(1, 3))
    river = drained >= minimum * (1.0 - 1e-9)
    span = np.log(max(largest, 1.01 * minimum) / minimum)
    picture[river] = color_ramp(RIVER_RAMP, np.clip(np.log(drained[river] / minimum) / span, 0.0, 1.0))
    return picture


def _cells_per_pixel(sheet: Sheet, terrain: Terrain) -> int:
    """Cells a side that share a pixel of the map, 1 or more."""
    return max(1, math.ceil(sheet.metres_per_pixel / float(terrain.cell_size) - 1e-9))


def _areas(flow: Flow, minimum: float | None) -> tuple[np.ndarray, float]:
    """Drainage areas and the minimum of a river cell, m2."""
    area = host_areas(flow)
    threshold = positive(10.0 * flow.terrain.cell_size**2 if minimum is None else minimum, "min_drainage_area", "m2")
    if threshold > np.nanmax(area):
        raise InputError(
            f"no cell drains {threshold:g} m2 (min_drainage_area); the largest area is {np.nanmax(area):g}"
        )
    return area, threshold


def _page(
    terrain: Terrain,
    title: str | None,
    size: tuple[int, int] | None,
    dpi: float,
    frame: bool = True,
    ax: Axes | None = None,
) -> Sheet:
    """Sheet for a map of the whole terrain."""
    sheet = make_sheet(
        terrain.bounds,
        ax=ax,
        frame=frame,
        size=size,
        dpi=dpi,
        title=title or "",
        ticks=True,
        cell=terrain.cell_size,
        crs=terrain.crs,
    )
    sheet.axes.set_facecolor("white")
    sheet.note.set_color(INK)
    return sheet


def _lay(sheet: Sheet, terrain: Terrain, picture: np.ndarray, factor: int = 1) -> Any:
    """Lay a picture of the terrain's cells on the map; a pixel of it is so many cells wide."""
    west, _, _, north = terrain.bounds
    rows, columns = (n * factor * terrain.cell_size for n in picture.shape[:2])
    return sheet.lay(picture, (west, north - rows, west + columns, north))
