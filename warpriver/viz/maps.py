"""Plan-view maps: a page with a map on it, and river networks drawn at true width.

matplotlib is imported when a map is drawn, not before, and its global state (``pyplot``) is never touched.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain
from warpriver.validate import shown
from warpriver.viz.bands import Window, band_outlines, meet_window, refine_lines, select_inside
from warpriver.viz.relief import check_ground, relief_picture
from warpriver.viz.sheet import (
    BANK,
    GROUND,
    INK,
    WATER,
    Sheet,
    check_drawing,
    checked_window,
    color_ramp,
    make_sheet,
    style_bar,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["add_channels", "add_value_bar", "channel_values", "draw_network", "finished", "value_colors", "value_norm"]

FLOW_RAMP = ((0.0, "#8fc1d4"), (0.5, "#3d7ea6"), (1.0, "#12304e"))
# On a relief, whose own shades are as dark, even the smallest flow is a strong blue.
RELIEF_RAMP = ((0.0, "#3f9cc4"), (0.45, "#1f6c9e"), (0.8, "#124377"), (1.0, "#0d2450"))

VALUE_LABELS = {
    "discharge": "bankfull discharge, m³/s",
    "width": "bankfull width, m",
    "area": "drainage area, km²",
    "order": "stream order",
}

# Minimum width of a line that stands for a channel, in points: for the narrowest channel, and what the widest adds.
MIN_LINE, MIN_GROWTH = 0.45, 0.65


# ---- network map


@public
def draw_network(
    network: RiverNetwork,
    path: str | os.PathLike[str] | None = None,
    *,
    terrain: Terrain | None = None,
    color: str = "water",
    order: ArrayLike | None = None,
    background: ArrayLike | Raster | None = None,
    extent: Sequence[float] | None = None,
    window: Sequence[float] | None = None,
    title: str | None = None,
    flow_arrow: bool = True,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
    frame: bool = True,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Draw the plan map of a network: every channel at its true width, north up, axes in kilometres.

    Channels too narrow to be seen at their width are drawn as lines, 0.45 points wide for the narrowest of the network
    and up to 1.1 points for wider ones.

    Args:
        network: What to draw.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        terrain: Terrain to draw under the channels, as shaded relief; plain ground shows where it has no data.
        color: "water"; or "discharge" (m3/s), "width" (m), "area" (drainage area, km2; where the network has it) or
            "order" (where ``order`` is given) for shades of blue with a colour bar.
        order: (C,) whole number of each channel, as its Strahler order.
        background: Image under the channels instead of a terrain, row 0 at the north edge: (rows, columns) greys,
            which are stretched from their lowest to their highest value, or (rows, columns, 3 or 4) colours; or a
            Raster, whose values are greys.
        extent: (west, south, east, north) of ``background`` in m; a Raster has its own.
        window: (west, south, east, north) to show, in m; by default the background, or all channels and a
            margin, which ends where a terrain does.
        title: Title at the upper left, or None.
        flow_arrow: Put an arrow beside the longest channel, in the direction of flow, where there is room.
        size: Width and height of the picture in pixels; by default fitted to the window.
        dpi: Pixels per inch.
        frame: False for the map alone, which is exactly the window (by default the terrain, the background, or the
            channels) and nothing else: it lies on a raster of that window pixel by pixel, and beside a .png or .jpg go
            a world file and an .aux.xml by which GDAL and QGIS place it.
        ax: Axes of your own to draw on, without bars and scale.

    Returns:
        The figure, whose first axes are the map, in m; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: An unknown ``color``, a window that shows no channel, a background that is no image or has
            no extent, a terrain or raster elsewhere or in another CRS, or a file name with an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    values = channel_values(network, color, order)
    cell = None if terrain is None else terrain.cell_size
    if isinstance(background, Raster):
        if extent is not None:
            raise InputError("a Raster has its own extent; leave extent= out")
        check_ground(background, network.bounds(), network.crs)
        extent, background = background.bounds, background.numpy()
    if (background is None) != (extent is None):
        raise InputError("give background and extent, (west, south, east, north) in m, together")
    if terrain is not None and background is not None:
        raise InputError("give a terrain or a background, not both")
    if background is not None and extent is not None and window is None:
        cell = (extent[2] - extent[0]) / max(np.shape(background)[1:2] or (1,))
    if window is None and extent is None and terrain is not None and not frame:
        extent = terrain.bounds
    view = map_window(
        extent if window is None else window,
        network.bounds(),
        2.0 * float(np.max(network.channel_width)),
        terrain,
        network.crs if terrain is not None else None,
    )
    sheet = make_sheet(
        view, ax=ax, frame=frame, size=size, dpi=dpi, title=title or "", ticks=True, cell=cell, crs=network.crs
    )
    sheet.axes.set_facecolor(GROUND)
    if terrain is not None:
        _add_relief(sheet, terrain)
    elif background is not None and extent is not None:
        _add_background(sheet, background, extent)
    if values is None:
        add_channels(sheet, network, WATER if terrain is None else RELIEF_RAMP[1][1], bank=0.9)
    else:
        ramp = FLOW_RAMP if terrain is None else RELIEF_RAMP
        _add_valued_channels(sheet, network, values, color, ramp)
    if flow_arrow and sheet.is_page:
        _add_flow_arrow(sheet, network)
    return finished(sheet, path, ax)


def finished(sheet: Sheet, path: str | os.PathLike[str] | None, ax: Axes | None) -> Figure | Axes:
    """Add ticks and scale to a page, write the file, and return the axes that were given, else the figure."""
    sheet.add_ticks()
    sheet.add_scale_bar()
    if path is not None:
        sheet.save(path)
    return sheet.figure if ax is None else ax  # type: ignore[return-value]


def channel_values(network: RiverNetwork, color: str, order: ArrayLike | None) -> np.ndarray | None:
    """Return the value of each channel that sets its colour, None for one colour.

    Raises:
        ValueError: The network does not have it, or ``order`` is not one number a channel.
    """
    choices: dict[str, Any] = {
        "water": None,
        "discharge": network.channel_discharge,
        "width": network.channel_width,
    }
    area = getattr(network, "channel_drainage_area", None)
    if area is not None:
        choices["area"] = area / 1e6
    if order is not None:
        order = np.asarray(order)
        if order.shape != (len(network.channel_width),) or not (np.isfinite(order).all() and (order >= 1).all()):
            raise InputError(
                f"order has shape {order.shape}; give a number of 1 or more for each of the "
                f"{len(network.channel_width)} channels"
            )
        choices["order"] = order
    if color not in choices:
        hint = {"order": "; order= is missing", "area": "; the drainage area is not known"}.get(color, "")
        raise InputError(f"color is {shown(color)}; use one of {', '.join(choices)}{hint}")
    return None if choices[color] is None else np.asarray(choices[color], np.float64)


def map_window(
    window: Sequence[float] | None, bounds: Window, margin: float, terrain: Terrain | None, crs: str | None
) -> Window:
    """Return the window in m as `checked_window` does; a margin around the channels ends where the terrain does.

    Raises:
        ValueError: As there; or the terrain is in another CRS or not in the window.
    """
    view = checked_window(window, bounds, margin)
    if terrain is None:
        return view
    check_ground(terrain, view, crs)
    if window is not None:
        return view
    west, south, east, north = terrain.bounds
    return (
        max(view[0], min(west, bounds[0])),
        max(view[1], min(south, bounds[1])),
        min(view[2], max(east, bounds[2])),
        min(view[3], max(north, bounds[3])),
    )


def _add_relief(sheet: Sheet, terrain: Terrain) -> None:
    """Lay the relief of a terrain under the channels, clear where there is no data."""
    relief = relief_picture(terrain, sheet.window, sheet.shape)
    pixels = np.empty((*sheet.shape, 4), np.uint8)
    pixels[..., :3] = np.clip(relief.color, 0.0, 255.0)
    pixels[..., 3] = np.where(relief.known, 255, 0)
    sheet.lay(pixels)


def _add_valued_channels(sheet: Sheet, network: RiverNetwork, values: np.ndarray, name: str, ramp: Any) -> None:
    """Draw channels coloured by a value, the greatest on top, with a colour bar."""
    lines = network.polylines(close=True)
    widths = network.point_widths(close=True)
    inside = meet_window(lines, widths, sheet.window)
    if not inside.any():
        return
    norm = value_norm(values[inside], whole=name == "order")
    add_channels(sheet, network, value_colors(values, norm, ramp), bank=0.4, rank=values)
    add_value_bar(sheet, norm, VALUE_LABELS[name], ramp)


def value_colors(values: np.ndarray, norm: Any, ramp: Any) -> np.ndarray:
    """Colours of values on the scale of :func:`value_norm`, (C, 3)."""
    fraction = np.asarray(norm(values), np.float64)
    if hasattr(norm, "boundaries"):
        fraction = (values - norm.boundaries[0] - 0.5) / max(len(norm.boundaries) - 2, 1)
    return color_ramp(ramp, np.clip(fraction, 0.0, 1.0))


def _add_background(sheet: Sheet, image: Any, extent: Sequence[float]) -> None:
    """Lay an image with row 0 at its north edge under the channels; ``extent`` as in `draw_network`."""
    pixels = np.asarray(image)
    if not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] in (3, 4))):
        raise InputError(f"background has shape {pixels.shape}; give (rows, columns) or (rows, columns, 3 or 4)")
    sheet.lay(pixels, [float(v) for v in extent], cmap="gray", interpolation=None)


def value_norm(values: np.ndarray, whole: bool = False) -> Any:
    """Return the scale for colouring by ``values``: logarithmic where they span more than a decade; or of steps."""
    from matplotlib.colors import BoundaryNorm, LogNorm, Normalize

    low, high = float(values.min()), float(values.max())
    if whole:
        return BoundaryNorm(np.arange(np.floor(low), np.floor(high) + 2.0) - 0.5, 256)
    if high <= low:
        return Normalize(0.5 * low, 1.5 * high)
    return LogNorm(low, high) if high > 10.0 * low > 0.0 else Normalize(low, high)


def add_value_bar(sheet: Sheet, norm: Any, label: str, ramp: Any, right: float = 0.0) -> None:
    """Draw the colour bar of a value at the right of the strip of a page, or so many inches off it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm, LinearSegmentedColormap, LogNorm
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

    if not sheet.is_page:
        return
    scale = ScalarMappable(norm, LinearSegmentedColormap.from_list("flow", ramp))
    width = sheet.legend_width
    box = sheet.strip(-width - right, 0.42, width, 0.13)
    bar = sheet.figure.colorbar(scale, cax=box, orientation="horizontal")
    if isinstance(norm, BoundaryNorm):
        steps = norm.boundaries
        bar.set_ticks(0.5 * (steps[1:] + steps[:-1])[:: -(-len(steps) // 12)])
        bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:.0f}"))
        bar.ax.minorticks_off()
    elif isinstance(norm, LogNorm):
        bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:,.10g}"))
        bar.ax.xaxis.set_minor_formatter(NullFormatter())
    else:
        bar.ax.xaxis.set_major_locator(MaxNLocator(nbins=max(2, round(1.6 * width))))
    style_bar(bar.ax)
    bar.ax.set_title(label, fontsize=8.5, color=INK, loc="right", pad=4)


def _add_flow_arrow(sheet: Sheet, network: RiverNetwork) -> None:
    """Put an arrow beside the longest channel, where most space is, along the general direction of flow."""
    from matplotlib import patheffects

    length = 0.45 * sheet.dpi * sheet.metres_per_pixel
    lines, widths = select_inside(network.polylines(close=True), network.point_widths(close=True), sheet.window)
    place = _arrow_place(lines, widths, sheet.window, length)
    if place is None:
        return
    middle, along = place
    head, tail = middle + 0.5 * length * along, middle - 0.5 * length * along
    style = {
        "arrowstyle": "-|>,head_width=0.25,head_length=0.5",
        "lw": 1.5,
        "color": BANK,
        "path_effects": [patheffects.withStroke(linewidth=3.0, foreground="white", alpha=0.6)],
    }
    sheet.axes.annotate("", tuple(head), tuple(tail), arrowprops=style, zorder=8)


def _arrow_place(
    lines: Sequence[np.ndarray], widths: Sequence[np.ndarray], window: Window, length: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the middle (2,) and direction (2,) of an arrow beside the longest line; None where there is no space."""
    with IMPORTING:
        from scipy.spatial import cKDTree

    west, south, east, north = window
    inside = [xy[((xy > (west, south)) & (xy < (east, north))).all(axis=1)] for xy in lines]
    longest = max(inside, key=len, default=np.empty((0, 2)))
    if len(longest) < 2:
        return None
    half = 0.5 * max(float(np.max(width)) for width in widths)
    tree = cKDTree(np.concatenate(refine_lines(lines, widths, step=0.3 * length)[0]))
    margin = 0.7 * length
    best: tuple[float, np.ndarray, np.ndarray] | None = None
    for fraction in np.linspace(0.08, 0.92, 15):
        k = round(fraction * (len(longest) - 1))
        reach = max(1, len(longest) // 12)
        chord = longest[min(k + reach, len(longest) - 1)] - longest[max(k - reach, 0)]
        if not np.hypot(*chord) > 0.0:
            continue
        along = chord / np.hypot(*chord)
        for side, away in itertools.product((-1.0, 1.0), (0.6, 0.9, 1.3, 1.8)):
            middle = longest[k] + side * (half + away * length) * np.array([-along[1], along[0]])
            if not (west + margin < middle[0] < east - margin and south + margin < middle[1] < north - margin):
                continue
            samples = middle + along * length * np.linspace(-0.6, 0.6, 7)[:, None]
            space = float(tree.query(samples)[0].min()) - half
            if space < 0.3 * length:
                continue
            # Close to the channel is best, once there is space for the arrow and its label.
            score = min(space, 0.5 * length) - 0.1 * away * length
            if best is None or score > best[0]:
                best = score, middle, along
    return None if best is None else best[1:]


# ---- channels


def add_channels(
    sheet: Sheet,
    network: RiverNetwork,
    colors: Any,
    *,
    bank: float,
    rank: np.ndarray | None = None,
    axes: Axes | None = None,
) -> list[Any]:
    """Draw a network's channels: bands with thin bank lines where their width can be seen, lines where it cannot.

    All banks are drawn before all water, so that junctions stay open. Bank lines thin out where a channel is only a
    few pixels wide.

    Args:
        sheet: The page; channels outside its window are left out.
        network: What to draw.
        colors: One colour, or (C, 3) one a channel.
        bank: Greatest width of the bank lines in points.
        rank: (C,) numbers: the channels are drawn in their order; by default wide ones last.
        axes: Map to draw on, by default the sheet's first.

    Returns:
        What was added, to be removed again.
    """
    from matplotlib.collections import LineCollection, PathCollection
    from matplotlib.path import Path

    axes = sheet.axes if axes is None else axes
    lines, widths = network.polylines(close=True), network.point_widths(close=True)
    drawn = meet_window(lines, widths, sheet.window)
    width = np.asarray(network.channel_width, np.float64)
    index = np.argsort(width if rank is None else rank, kind="stable")
    index = index[drawn[index]]
    if not len(index):
        return []
    points = width / sheet.metres_per_pixel * 72.0 / sheet.dpi
    minimum = _least_lines(width)
    shades = None if isinstance(colors, str) else np.asarray(colors)
    added: list[Any] = []
    narrow = index[points[index] < minimum[index]]
    if len(narrow):
        thin = [_thin_out(lines[c], 0.5 * sheet.metres_per_pixel) for c in narrow]
        style = {"capstyle": "round", "joinstyle": "round"}
        rim = np.minimum(0.35, bank)
        added.append(LineCollection(thin, colors=BANK, alpha=0.35, linewidths=minimum[narrow] + rim, zorder=5, **style))
        color = colors if shades is None else shades[narrow]
        added.append(LineCollection(thin, colors=color, linewidths=minimum[narrow], zorder=6, **style))
    wide = index[points[index] >= minimum[index]]
    if len(wide):
        step = 4.0 * sheet.metres_per_pixel
        vertices, codes, offset = band_outlines(
            *refine_lines([lines[c] for c in wide], [widths[c] for c in wide], step)
        )
        cuts = offset[1:-1]
        pieces = zip(np.split(vertices, cuts), np.split(codes, cuts), strict=True)
        paths = [Path(v, c, readonly=True) for v, c in pieces]
        edge = np.clip(0.4 * (points[wide] - 0.8), 0.0, bank)
        hair = np.maximum(0.15, 0.6 - points[wide])
        color = colors if shades is None else shades[wide]
        banks = PathCollection(paths, facecolors=BANK, edgecolors=BANK, linewidths=edge, joinstyle="round", zorder=5)
        added += [banks, PathCollection(paths, facecolors=color, edgecolors=color, linewidths=hair, zorder=6)]
    for collection in added:
        axes.add_collection(collection, autolim=False)
    return added


def _least_lines(width: np.ndarray) -> np.ndarray:
    """Return the minimum width of the line that stands for each channel, points."""
    low, high = float(width.min()), float(width.max())
    fraction = np.log(width / low) / np.log(high / low) if high > 1.01 * low else np.zeros_like(width)
    return MIN_LINE + MIN_GROWTH * fraction


def _thin_out(xy: np.ndarray, step: float) -> np.ndarray:
    """Leave out points of a line that stand much closer than ``step`` m; the ends stay."""
    length = np.hypot(*np.diff(xy, axis=0).T).sum()
    stride = max(1, int(step * (len(xy) - 1) / max(length, 1e-9)))
    return xy if stride == 1 else np.concatenate([xy[:-1:stride], xy[-1:]])
