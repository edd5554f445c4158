"""Plan-view maps: a page with a map on it, and river networks drawn at true width.

matplotlib is imported when a map is drawn, not before, and its global state (``pyplot``) is never touched.
"""

from __future__ import annotations

import contextlib
import itertools
import pathlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from warpriver.io.files import beside
from warpriver.viz.bands import Window, band_outlines, meets_window, refine_lines, select_inside

__all__ = ["draw_network"]

WATER = "#3d7ea6"
BANK = "#1d4560"
GROUND = "#cfcbb4"
INK = "#2b2f2c"
FAINT = "#77796f"
FLOW_RAMP = ((0.0, "#8fc1d4"), (0.5, "#3d7ea6"), (1.0, "#12304e"))

# Largest ratio of the sides of a map that is fitted to its river; narrower ones get more ground beside it.
MAX_ASPECT = 9.0


# ---- network map


def draw_network(
    network: Any,
    path: Any = None,
    *,
    color: str = "water",
    background: Any = None,
    extent: Sequence[float] | None = None,
    window: Sequence[float] | None = None,
    title: str | None = None,
    flow_arrow: bool = True,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
) -> Any:
    """Draw the plan map of a network: every channel at its true width, north up, axes in kilometres.

    Args:
        network: RiverNetwork.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        color: "water", or "discharge" (m3/s) or "width" (m) for shades of blue with a colour bar.
        background: Image under the channels, row 0 at the north edge: (rows, columns) greys, which are
            stretched from their least to their greatest value, or (rows, columns, 3 or 4) colours.
        extent: (west, south, east, north) of ``background`` in m.
        window: (west, south, east, north) to show, in m; by default the background, or all channels and a
            margin.
        title: Title at the upper left, or None.
        flow_arrow: Put an arrow beside the longest channel, in the direction of flow, where there is room.
        size: Width and height of the picture in pixels; by default fitted to the window.
        dpi: Pixels per inch.

    Returns:
        matplotlib.figure.Figure.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: An unknown ``color``, a window that shows no channel, a background that is no image or has
            no extent, or a file name with an unknown suffix.
        OSError: The file cannot be written.
    """
    need_matplotlib()
    choices = {"water": None, "discharge": network.channel_discharge, "width": network.channel_width}
    if color not in choices:
        raise ValueError(f"color is {color!r}; use one of {', '.join(choices)}")
    if (background is None) != (extent is None):
        raise ValueError("give background and extent, (west, south, east, north) in m, together")
    window = extent if window is None else window
    view = checked_window(window, network.bounds(), 2.0 * float(np.max(network.channel_width)))
    sheet = Sheet(view, size=size, dpi=dpi, title=title or "", legend=True, ticks=True)
    sheet.axes.set_facecolor(GROUND)
    if background is not None and extent is not None:
        _add_background(sheet, background, extent)
    paths, index = channel_paths(sheet, network)
    values = choices[color]
    if values is None or not paths:
        add_water(sheet, paths, network.channel_width[index], WATER, bank=0.9)
    else:
        shown = np.asarray(values, np.float64)[index]
        order = np.argsort(shown, kind="stable")
        norm, unit = _norm(shown), {"discharge": "m³/s", "width": "m"}[color]
        colors = color_ramp(FLOW_RAMP, norm(shown[order]))
        add_water(sheet, [paths[k] for k in order], network.channel_width[index[order]], colors, bank=0.4)
        _add_value_bar(sheet, norm, f"bankfull {color}, {unit}")
    sheet.add_km_ticks()
    sheet.add_scale_bar()
    if flow_arrow:
        _add_flow_arrow(sheet, network)
    if path is not None:
        sheet.save(path)
    return sheet.figure


def _add_background(sheet: Sheet, image: Any, extent: Sequence[float]) -> None:
    """Lay an image with row 0 at its north edge under the channels; ``extent`` as in `draw_network`."""
    pixels = np.asarray(image)
    if not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] in (3, 4))):
        raise ValueError(f"background has shape {pixels.shape}; give (rows, columns) or (rows, columns, 3 or 4)")
    west, south, east, north = (float(v) for v in extent)
    sheet.axes.imshow(pixels, cmap="gray", extent=(west, east, south, north), origin="upper", aspect="auto", zorder=1)
    sheet.axes.set_xlim(sheet.window[0], sheet.window[2])
    sheet.axes.set_ylim(sheet.window[1], sheet.window[3])


def _norm(values: np.ndarray) -> Any:
    """Return the scale for colouring by ``values``: logarithmic where they span more than a decade."""
    from matplotlib.colors import LogNorm, Normalize

    low, high = float(values.min()), float(values.max())
    if high <= low:
        return Normalize(0.5 * low, 1.5 * high)
    return LogNorm(low, high) if high > 10.0 * low > 0.0 else Normalize(low, high)


def _add_value_bar(sheet: Sheet, norm: Any, label: str) -> None:
    """Draw the colour bar of a value at the right of the strip."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, LogNorm
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

    scale = ScalarMappable(norm, LinearSegmentedColormap.from_list("flow", FLOW_RAMP))
    width = sheet.legend_width
    box = sheet.strip(-width, 0.42, width, 0.13)
    bar = sheet.figure.colorbar(scale, cax=box, orientation="horizontal")
    if isinstance(norm, LogNorm):
        bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:,.10g}"))
        bar.ax.xaxis.set_minor_formatter(NullFormatter())
    else:
        bar.ax.xaxis.set_major_locator(MaxNLocator(nbins=max(2, round(1.6 * width))))
    style_bar(bar.ax)
    bar.ax.set_title(label, fontsize=8.5, color=INK, loc="right", pad=4)


def _add_flow_arrow(sheet: Sheet, network: Any) -> None:
    """Put an arrow beside the longest channel, where most room is, along the general direction of flow."""
    from matplotlib import patheffects

    length = 0.45 * sheet.dpi * sheet.metres_per_pixel
    lines, widths = select_inside(network.polylines(), network.point_widths(), sheet.window)
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
    """Return the middle (2,) and direction (2,) of an arrow beside the longest line; None where there is no room."""
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
    for part in np.linspace(0.08, 0.92, 15):
        k = round(part * (len(longest) - 1))
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
            room = float(tree.query(samples)[0].min()) - half
            if room < 0.3 * length:
                continue
            # Close to the channel is best, once there is room for the arrow and its label.
            score = min(room, 0.5 * length) - 0.1 * away * length
            if best is None or score > best[0]:
                best = score, middle, along
    return None if best is None else best[1:]


# ---- page


class Sheet:
    """A page with one map whose pixels are square and known, a title above it and a strip below it.

    Attributes:
        figure: The matplotlib figure.
        canvas: Its Agg canvas.
        axes: The map; its units are m.
        window: (west, south, east, north) shown, m.
        shape: (rows, columns) of the map in pixels.
        metres_per_pixel: Ground size of a pixel, m.
        dpi: Pixels per inch.
        note: The text at the upper right.
    """

    def __init__(
        self,
        window: Window,
        *,
        size: tuple[int, int] | None,
        dpi: float,
        title: str,
        legend: bool,
        ticks: bool = False,
    ):
        """Lay out the page.

        Args:
            window: (west, south, east, north) in m; it grows until it fills the map.
            size: Width and height of the whole picture in pixels, or None: fitted to the window.
            dpi: Pixels per inch: sets the size of letters.
            title: Title, or "" for none.
            legend: Leave a strip below the map.
            ticks: Leave room for tick labels.

        Raises:
            ValueError: A size too small to hold a map.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        left, right = round((0.62 if ticks else 0.3) * dpi), round(0.3 * dpi)
        top = round((0.55 if title else 0.3) * dpi)
        bottom = round(((0.92 if legend else 0.3) + (0.3 if ticks else 0.0)) * dpi)
        if size is None:
            width, height = _fitted_size(window)
            if legend:
                width = max(width, 6.0)
            columns, rows = round(width * dpi), round(height * dpi)
        else:
            columns, rows = int(size[0]) - left - right, int(size[1]) - top - bottom
            if columns < 64 or rows < 64:
                raise ValueError(
                    f"size is {tuple(size)} pixels, too small for a map at {dpi:g} dpi; give at least "
                    f"({64 + left + right}, {64 + top + bottom}), or a smaller dpi"
                )
        page = (columns + left + right, rows + top + bottom)
        self.window = grow_to_aspect(window, columns / rows)
        self.shape = (rows, columns)
        self.metres_per_pixel = (self.window[2] - self.window[0]) / columns
        self.figure = Figure(figsize=(page[0] / dpi, page[1] / dpi), dpi=dpi, facecolor="white")
        self.canvas = FigureCanvasAgg(self.figure)
        self._page, self._left, self._right = page, left, page[0] - right
        self.axes = self.figure.add_axes(self._box(left, bottom, columns, rows))
        self.axes.set_xlim(self.window[0], self.window[2])
        self.axes.set_ylim(self.window[1], self.window[3])
        for spine in self.axes.spines.values():
            spine.set(linewidth=0.6, color=FAINT)
        self.axes.set(xticks=[], yticks=[])
        y = (bottom + rows + 0.16 * dpi) / page[1]
        self.figure.text(left / page[0], y, title, fontsize=13, color=INK, weight="bold")
        self.note = self.figure.text((page[0] - right) / page[0], y, "", fontsize=10, color=FAINT, ha="right")
        self.dpi = dpi

    def _box(self, x: float, y: float, width: float, height: float) -> tuple[float, float, float, float]:
        """Turn a rectangle in pixels from the lower left into parts of the page."""
        return x / self._page[0], y / self._page[1], width / self._page[0], height / self._page[1]

    @property
    def legend_width(self) -> float:
        """Width of the colour bar in the strip, inches."""
        return float(np.clip(0.38 * self.shape[1] / self.dpi, 1.0, 2.5))

    def strip(self, x: float, y: float, width: float, height: float) -> Any:
        """Add axes in the strip, in inches, with ``x`` from the map's left or, below 0, from its right."""
        dpi = self.dpi
        edge = self._left + x * dpi if x >= 0.0 else self._right + x * dpi
        return self.figure.add_axes(self._box(edge, y * dpi, width * dpi, height * dpi))

    def add_scale_bar(self, flow: np.ndarray | None = None) -> None:
        """Draw a north arrow, a scale bar and, where ``flow`` (2,) is given, the direction of flow."""
        from matplotlib.patches import Rectangle

        across = self.shape[1] / self.dpi
        free = across - self.legend_width - 1.0 - 0.8 - (0.75 if flow is not None else 0.0)
        if flow is not None and free < 0.8:
            flow, free = None, free + 0.75
        room = float(np.clip(free, 0.4, 2.0)) * self.dpi * self.metres_per_pixel
        power = 10.0 ** np.floor(np.log10(room))
        length = next(k * power for k in (5.0, 2.0, 1.0) if k * power <= room)
        width = length / self.metres_per_pixel / self.dpi
        span = width + 1.6
        box = self.strip(0.0, 0.3, span, 0.5)
        box.set(xlim=(0.0, span), ylim=(0.0, 0.5))
        box.axis("off")
        for k, shade in enumerate((INK, "white")):
            corner, part = (0.36 + 0.5 * k * width, 0.16), 0.5 * width
            box.add_patch(Rectangle(corner, part, 0.055, facecolor=shade, edgecolor=INK, linewidth=0.7))
        label = f"{length / 1e3:g} km" if length >= 1000.0 else f"{length:g} m"
        for x, text in ((0.36, "0"), (0.36 + width, label)):
            box.text(x, 0.3, text, fontsize=8.5, color=INK, ha="center")
        arrow = {"arrowstyle": "-|>,head_width=0.22", "lw": 1.0, "shrinkA": 0.0, "shrinkB": 0.0}
        box.annotate("", (0.09, 0.48), (0.09, 0.2), arrowprops={**arrow, "color": INK})
        box.text(0.09, 0.02, "N", fontsize=8.5, color=INK, ha="center")
        if flow is not None and np.hypot(*flow) > 0.0:
            half = 0.16 * flow / np.hypot(*flow)
            middle = np.array([0.36 + width + 0.75, 0.34])
            box.annotate("", middle + half, middle - half, arrowprops={**arrow, "color": WATER, "lw": 1.4})
            box.text(middle[0], 0.02, "flow", fontsize=8.5, color=INK, ha="center")

    def add_km_ticks(self) -> None:
        """Put ticks with kilometres around the map."""
        from matplotlib.ticker import FuncFormatter, MaxNLocator

        rows, columns = self.shape
        for axis, pixels in ((self.axes.xaxis, columns), (self.axes.yaxis, rows)):
            axis.set_major_locator(MaxNLocator(max(2, min(9, int(pixels / self.dpi / 1.1))), steps=[1, 2, 5, 10]))
            axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v / 1e3:.10g}"))
        self.axes.tick_params(labelsize=8, colors=FAINT, labelcolor=INK, width=0.6, length=3, pad=2)
        for label in self.axes.get_yticklabels():
            label.set(rotation=90, va="center")
        self.axes.set_xlabel("easting, km", fontsize=8, color=FAINT, labelpad=2)
        self.axes.set_ylabel("northing, km", fontsize=8, color=FAINT, labelpad=2)

    def save(self, path: Any) -> None:
        """Write the figure; the format follows the suffix."""
        with replacing(path, (".png", ".jpg", ".pdf", ".svg")) as temporary:
            self.figure.savefig(temporary, dpi=self.dpi)


def _fitted_size(window: Window) -> tuple[float, float]:
    """Return width and height of a map of a window, inches."""
    aspect = (window[2] - window[0]) / (window[3] - window[1])
    aspect = float(np.clip(aspect, 1.0 / MAX_ASPECT, MAX_ASPECT))
    # Long rivers get a longer page, square ones a page of moderate area.
    width = 12.0 + 4.0 * np.log(aspect) / np.log(MAX_ASPECT) if aspect > 1.0 else 12.0 * aspect
    height = width / aspect
    shrink = max(9.0 / max(width, height), 0.7) if aspect < 1.6 else 1.0
    return width * shrink, height * shrink


def style_bar(box: Any) -> None:
    """Give a colour bar thin, small ticks."""
    box.tick_params(labelsize=8, length=2.5, width=0.6, colors=FAINT, labelcolor=INK, pad=2)
    for spine in box.spines.values():
        spine.set(linewidth=0.6, color=FAINT)


def checked_window(window: Sequence[float] | None, bounds: Window, margin: float) -> Window:
    """Return the window in m: the one that was asked for, or ``bounds`` with a margin.

    Args:
        window: (west, south, east, north) in m, or None.
        bounds: What there is to show, in m.
        margin: Least margin around it, m.

    Raises:
        ValueError: The window is not four finite numbers, is empty, or shows none of ``bounds``.
    """
    if window is None:
        west, south, east, north = bounds
        pad = max(margin, 0.035 * max(east - west, north - south))
        return west - pad, south - pad, east + pad, north + pad
    values = [float(v) for v in window]
    if len(values) != 4 or not np.isfinite(values).all() or values[0] >= values[2] or values[1] >= values[3]:
        raise ValueError(f"window is {tuple(window)}; give (west, south, east, north) in m, west < east, south < north")
    west, south, east, north = values
    if west > bounds[2] or east < bounds[0] or south > bounds[3] or north < bounds[1]:
        raise ValueError(
            f"window ({west:g}, {south:g}, {east:g}, {north:g}) m shows nothing: the channels lie in "
            f"({bounds[0]:g}, {bounds[1]:g}, {bounds[2]:g}, {bounds[3]:g}) m"
        )
    return west, south, east, north


def grow_to_aspect(window: Window, aspect: float) -> Window:
    """Widen a window (m) about its centre until its width is ``aspect`` times its height."""
    west, south, east, north = window
    width, height = max(east - west, aspect * (north - south)), max(north - south, (east - west) / aspect)
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    return x - 0.5 * width, y - 0.5 * height, x + 0.5 * width, y + 0.5 * height


def need_matplotlib() -> None:
    """Raise ``ImportError`` that says what to install when matplotlib is missing."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise ImportError('maps are drawn with matplotlib: pip install "warpriver[viz]"') from error


@contextlib.contextmanager
def replacing(path: Any, suffixes: Sequence[str]) -> Iterator[str]:
    """Yield a temporary name for ``path``, which it replaces when the block ends without an error.

    Args:
        path: File to write.
        suffixes: Suffixes allowed, with their dots.

    Raises:
        ValueError: Another suffix.
        OSError: The folder does not exist or cannot be written.
    """
    target = pathlib.Path(path)
    if target.suffix.lower() not in suffixes:
        raise ValueError(f"cannot write {target}: the name must end in {', '.join(suffixes)}")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"cannot write {target}: the folder {target.parent} does not exist")
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {target}: it is a folder")
    with beside(target) as temporary:
        yield str(temporary)


# ---- channels and colours


def channel_paths(sheet: Sheet, network: Any) -> tuple[list[Any], np.ndarray]:
    """Outline a network's channels for a sheet.

    Args:
        sheet: The page; channels outside its window are left out.
        network: RiverNetwork.

    Returns:
        One matplotlib path per channel drawn, and the index of each of them in the network.
    """
    from matplotlib.path import Path

    lines, widths = network.polylines(), network.point_widths()
    index = np.flatnonzero([meets_window(xy, w, sheet.window) for xy, w in zip(lines, widths, strict=True)])
    if not len(index):
        return [], index
    lines, widths = refine_lines(
        [lines[c] for c in index], [widths[c] for c in index], step=4.0 * sheet.metres_per_pixel
    )
    vertices, codes, offset = band_outlines(lines, widths)
    cuts = offset[1:-1]
    pieces = zip(np.split(vertices, cuts), np.split(codes, cuts), strict=True)
    return [Path(v, c, readonly=True) for v, c in pieces], index


def add_water(sheet: Sheet, paths: list[Any], channel_width: np.ndarray, colors: Any, bank: float) -> list[Any]:
    """Draw channels with thin bank lines: all banks first, then all water, so that junctions stay open.

    Bank lines thin out where the channel is only a few pixels wide, and a hairline keeps what is narrower in
    sight.

    Args:
        sheet: The page.
        paths: Channel outlines.
        channel_width: Width of each in m.
        colors: One colour, or one a path.
        bank: Greatest width of the bank lines in points.

    Returns:
        The two collections; none where there are no paths.
    """
    from matplotlib.collections import PathCollection

    if not paths:
        return []
    points = np.asarray(channel_width) / sheet.metres_per_pixel * 72.0 / sheet.dpi
    lines = np.clip(0.4 * (points - 0.8), 0.0, bank)
    hairs = np.maximum(0.15, 0.6 - points)
    banks = PathCollection(paths, facecolors=BANK, edgecolors=BANK, linewidths=lines, joinstyle="round", zorder=5)
    water = PathCollection(paths, facecolors=colors, edgecolors=colors, linewidths=hairs, zorder=6)
    for collection in (banks, water):
        sheet.axes.add_collection(collection, autolim=False)
    return [banks, water]


def color_ramp(stops: Sequence[tuple[float, str]], values: Any) -> np.ndarray:
    """Interpolate a ramp of (position, "#rrggbb") stops at ``values`` in 0..1: (..., 3) floats in 0..1."""
    at = [p for p, _ in stops]
    rgb = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for _, c in stops]) / 255.0
    return np.stack([np.interp(values, at, rgb[:, k]) for k in range(3)], axis=-1)
