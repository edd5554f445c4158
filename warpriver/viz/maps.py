"""Plan-view maps: river networks at true width, and the channel belt that a history of them leaves behind.

matplotlib is imported when a map is drawn, not before, and its global state (``pyplot``) is never touched.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

__all__ = ["draw_belt", "draw_network"]

Window = tuple[float, float, float, float]

# Colours. Deposits run from bare sand through grass and willow to closed forest, lakes from open water
# to swamp.
WATER = "#3d7ea6"
BANK = "#1d4560"
GROUND = "#cfcbb4"
INK = "#2b2f2c"
FAINT = "#77796f"
DEPOSIT_RAMP = ((0.0, "#f3e7c6"), (0.1, "#e3d3a1"), (0.28, "#bcb877"), (0.55, "#83935a"), (1.0, "#496843"))
OXBOW_RAMP = ((0.0, "#5c98b8"), (0.12, "#86aeae"), (0.3, "#85a08a"), (0.6, "#607f5c"), (1.0, "#3f5c40"))
FLOW_RAMP = ((0.0, "#8fc1d4"), (0.5, "#3d7ea6"), (1.0, "#12304e"))

# A disc of this many sides stands at channel ends, sharp corners and where a bank folds.
DISC_SIDES = 24
# Strength of the faint banding in time that the shades of age carry, so that scroll bars read as arcs.
SCROLL_STRENGTH = 0.075
# Largest ratio of the sides of a map that is fitted to its river; narrower ones get more ground beside it.
MAX_ASPECT = 9.0


# ---- geometry of bands


def refine_lines(
    lines: Sequence[np.ndarray], widths: Sequence[np.ndarray], step: float
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Add points along Catmull-Rom curves until they stand about ``step`` m apart, at most eightfold.

    Args:
        lines: (n, 2) points of each channel, m.
        widths: (n,) width at each point, m.
        step: Wanted spacing, m.

    Returns:
        The lines and widths, unchanged where they are dense enough.
    """
    counts = np.array([len(xy) for xy in lines])
    xy, width = np.concatenate(lines), np.concatenate(widths)
    start = np.concatenate([[0], np.cumsum(counts)])
    first = np.arange(len(xy))
    segment = np.delete(first, start[1:] - 1)
    spacing = np.median(np.hypot(*(xy[segment + 1] - xy[segment]).T))
    parts = int(np.clip(np.ceil(spacing / step), 1, 8))
    if parts == 1:
        return list(lines), list(widths)
    owner = np.repeat(np.arange(len(counts)), counts)[segment]
    b, c = xy[segment], xy[segment + 1]
    at_head, at_tail = segment == start[owner], segment + 2 == start[owner + 1]
    a = np.where(at_head[:, None], 2.0 * b - c, xy[segment - 1])
    d = np.where(at_tail[:, None], 2.0 * c - b, xy[np.minimum(segment + 2, len(xy) - 1)])
    t = (np.arange(parts) / parts)[None, :, None]
    a, b, c, d = (p[:, None, :] for p in (a, b, c, d))
    curve = 0.5 * (
        2.0 * b + t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
    )
    blend = width[segment, None] + t[..., 0] * (width[segment + 1] - width[segment])[:, None]
    new_counts = (counts - 1) * parts + 1
    new_start = np.concatenate([[0], np.cumsum(new_counts)])
    slot = (new_start[owner] + (segment - start[owner]) * parts)[:, None] + np.arange(parts)
    new_xy, new_width = np.empty((new_start[-1], 2)), np.empty(new_start[-1])
    new_xy[slot], new_width[slot] = curve, blend
    new_xy[new_start[1:] - 1], new_width[new_start[1:] - 1] = xy[start[1:] - 1], width[start[1:] - 1]
    return np.split(new_xy, new_start[1:-1]), np.split(new_width, new_start[1:-1])


def bank_lines(
    lines: Sequence[np.ndarray], widths: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset all lines by half their width to either side, along mitred normals.

    Args:
        lines: (n, 2) points of each channel, m.
        widths: (n,) width at each point, m.

    Returns:
        The left and the right bank, each (P, 2) in m for the packed points, and a (P,) mask of the points
        where a round joint is needed: channel ends, sharp corners, and bends tighter than the half width.
    """
    counts = np.array([len(xy) for xy in lines])
    last = np.cumsum(counts) - 1
    first = last - counts + 1
    xy, half = np.concatenate(lines), 0.5 * np.concatenate(widths)
    ahead = np.empty_like(xy)
    ahead[:-1] = np.diff(xy, axis=0)
    ahead[last] = ahead[last - 1]
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-12)[:, None]
    behind = np.roll(ahead, 1, axis=0)
    behind[first] = ahead[first]
    along = ahead + behind
    size = np.hypot(*along.T)
    along = np.where((size > 1e-6)[:, None], along / np.maximum(size, 1e-6)[:, None], ahead)
    cosine = np.sum(along * ahead, axis=1)
    sharp = cosine < 0.9
    reach = (half / np.where(sharp, 1.0, cosine))[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1)
    left, right = xy + reach, xy - reach
    forward = np.minimum(
        np.sum(np.diff(left, axis=0) * ahead[:-1], axis=1),
        np.sum(np.diff(right, axis=0) * ahead[:-1], axis=1),
    )
    folded = forward <= 0.0
    folded[last[:-1]] = False
    round_joint = sharp
    round_joint[:-1] |= folded
    round_joint[1:] |= folded
    round_joint[first] = True
    round_joint[last] = True
    return left, right, round_joint


def band_outlines(
    lines: Sequence[np.ndarray], widths: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outline every channel at its width, as paths to be filled by the non-zero winding rule.

    The outline of a channel is its two banks and a disc at either end. Where a corner is sharp, or the inner
    bank of a tight bend folds over itself, discs and boxes keep the winding number positive, so that the
    filled shape is the true buffer of the line.

    Args:
        lines: (n, 2) points of each channel, m.
        widths: (n,) width at each point, m.

    Returns:
        Vertices (V, 2) in m, matplotlib path codes (V,), and the offsets (C + 1,) that cut both by channel.
    """
    left, right, joint = bank_lines(lines, widths)
    xy, half = np.concatenate(lines), 0.5 * np.concatenate(widths)
    counts = np.array([len(line) for line in lines])
    start = np.concatenate([[0], np.cumsum(counts)])
    owner = np.repeat(np.arange(len(counts)), counts)
    joints = np.flatnonzero(joint)
    inner = np.setdiff1d(joints, np.concatenate([start[:-1], start[1:] - 1]))
    boxed = np.union1d(inner - 1, inner)

    angle = 2.0 * np.pi * np.arange(DISC_SIDES) / DISC_SIDES
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    discs = xy[joints, None] + half[joints, None, None] * circle
    boxes = _segment_boxes(xy, half, boxed)
    pieces = np.concatenate([owner[joints], owner[boxed]])
    sides = np.concatenate([np.full(len(joints), DISC_SIDES), np.full(len(boxed), 4)]) + 1
    extra = np.bincount(pieces, weights=sides, minlength=len(counts)).astype(np.int64)
    offset = np.concatenate([[0], np.cumsum(2 * counts + 1 + extra)])

    vertices = np.zeros((offset[-1], 2))
    codes = np.full(offset[-1], 2, np.uint8)
    inside = np.arange(len(owner)) - start[owner]
    vertices[offset[owner] + inside] = right
    vertices[offset[owner] + 2 * counts[owner] - 1 - inside] = left
    close = offset[:-1] + 2 * counts
    codes[offset[:-1]], codes[close] = 1, 79
    # The pieces of each channel follow its outline, one after the other.
    order = np.argsort(pieces, kind="stable")
    before = np.cumsum(sides[order]) - sides[order]
    before -= (np.cumsum(extra) - extra)[pieces[order]]
    first = np.empty(len(pieces), np.int64)
    first[order] = close[pieces[order]] + 1 + before
    for begin, shapes in ((first[: len(joints)], discs), (first[len(joints) :], boxes)):
        corners = shapes.shape[1]
        vertices[begin[:, None] + np.arange(corners)] = shapes
        codes[begin], codes[begin + corners] = 1, 79
    return vertices, codes, offset


def _segment_boxes(xy: np.ndarray, half: np.ndarray, segment: np.ndarray) -> np.ndarray:
    """Return the corners (n, 4, 2) of the bands of single segments, counter-clockwise."""
    step = xy[segment + 1] - xy[segment]
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.maximum(np.hypot(*step.T), 1e-12)[:, None]
    a, b = half[segment, None] * normal, half[segment + 1, None] * normal
    return np.stack([xy[segment] - a, xy[segment + 1] - b, xy[segment + 1] + b, xy[segment] + a], axis=1)


def taper_ends(xy: np.ndarray, width: float) -> np.ndarray:
    """Return the width along an abandoned loop in m; it closes over the last 1.5 widths, where plugs form."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    to_end = np.minimum(s, s[-1] - s) / (1.5 * width)
    return width * (0.15 + 0.85 * np.sqrt(np.clip(to_end, 0.0, 1.0)))


def select_inside(
    lines: Sequence[np.ndarray], widths: Sequence[np.ndarray], window: Window
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Keep the channels whose bounding box meets the window (m)."""
    kept = []
    for xy, width in zip(lines, widths, strict=True):
        reach = 0.5 * float(np.max(width))
        low, high = xy.min(axis=0) - reach, xy.max(axis=0) + reach
        if low[0] <= window[2] and high[0] >= window[0] and low[1] <= window[3] and high[1] >= window[1]:
            kept.append((xy, np.asarray(width)))
    return [xy for xy, _ in kept], [width for _, width in kept]


def grow_to_aspect(window: Window, aspect: float) -> Window:
    """Widen a window (m) about its centre until its width is ``aspect`` times its height."""
    west, south, east, north = window
    width, height = max(east - west, aspect * (north - south)), max(north - south, (east - west) / aspect)
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    return x - 0.5 * width, y - 0.5 * height, x + 0.5 * width, y + 0.5 * height


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
        raise ValueError(
            f"window is {tuple(window)}; give (west, south, east, north) in m, west < east, south < north"
        )
    west, south, east, north = values
    if west > bounds[2] or east < bounds[0] or south > bounds[3] or north < bounds[1]:
        raise ValueError(
            f"window ({west:g}, {south:g}, {east:g}, {north:g}) m shows nothing: the channels lie in "
            f"({bounds[0]:g}, {bounds[1]:g}, {bounds[2]:g}, {bounds[3]:g}) m"
        )
    return west, south, east, north


# ---- files and figures


@contextlib.contextmanager
def replacing(path: Any, suffixes: Sequence[str]) -> Iterator[str]:
    """Yield a temporary name beside ``path``, which it replaces when the block ends without an error.

    Args:
        path: File to write.
        suffixes: Suffixes allowed, with their dots.

    Raises:
        ValueError: Another suffix.
        OSError: The folder does not exist or cannot be written.
    """
    target = pathlib.Path(path)
    suffix = target.suffix.lower()
    if suffix not in suffixes:
        raise ValueError(f"cannot write {target}: the name must end in {', '.join(suffixes)}")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"cannot write {target}: the folder {target.parent} does not exist")
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {target}: it is a folder")
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.part{suffix}")
    try:
        temporary.touch()
    except OSError as error:
        raise OSError(f"cannot write {target}: {error.strerror or error}") from error
    try:
        yield str(temporary)
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def need_matplotlib() -> None:
    """Raise ``ImportError`` that says what to install when matplotlib is missing."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise ImportError('maps are drawn with matplotlib: pip install "warpriver[viz]"') from error


def new_canvas(figure: Any) -> Any:
    """Give a figure an Agg canvas and return it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    return FigureCanvasAgg(figure)


def color_ramp(stops: Sequence[tuple[float, str]], values: Any) -> np.ndarray:
    """Interpolate a ramp of (position, "#rrggbb") stops at ``values`` in 0..1: (..., 3) floats in 0..1."""
    at = [p for p, _ in stops]
    rgb = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for _, c in stops]) / 255.0
    return np.stack([np.interp(values, at, rgb[:, k]) for k in range(3)], axis=-1)


class Sheet:
    """A page with one map whose pixels are square and known, a title above it and a strip below it.

    Attributes:
        figure: The matplotlib figure.
        axes: The map; its units are m.
        window: (west, south, east, north) shown, m.
        shape: (rows, columns) of the map in pixels.
        metres_per_pixel: Ground size of a pixel, m.
        dpi: Pixels per inch.
        title: The text at the upper left.
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
        from matplotlib.figure import Figure

        left, right = (round(w * dpi) for w in ((0.62, 0.3) if ticks else (0.3, 0.3)))
        top = round((0.55 if title else 0.3) * dpi)
        bottom = round(((0.92 if legend else 0.3) + (0.3 if ticks else 0.0)) * dpi)
        if size is None:
            aspect = (window[2] - window[0]) / (window[3] - window[1])
            aspect = float(np.clip(aspect, 1.0 / MAX_ASPECT, MAX_ASPECT))
            # Long rivers get a longer page, square ones a page of moderate area.
            longest = 12.0 + 4.0 * min(1.0, abs(np.log(aspect)) / np.log(MAX_ASPECT)) if aspect > 1 else 12.0
            width = longest if aspect >= 1.0 else longest * aspect
            height = width / aspect
            if aspect < 1.6:
                shrink = max(9.0 / max(width, height), 0.7)
                width, height = width * shrink, height * shrink
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
        new_canvas(self.figure)
        self._page, self._left, self._right = page, left, page[0] - right
        self.axes = self.figure.add_axes(self._box(left, bottom, columns, rows))
        self.axes.set_xlim(self.window[0], self.window[2])
        self.axes.set_ylim(self.window[1], self.window[3])
        for spine in self.axes.spines.values():
            spine.set(linewidth=0.6, color=FAINT)
        self.axes.set(xticks=[], yticks=[])
        y = (bottom + rows + 0.16 * dpi) / page[1]
        self.title = self.figure.text(left / page[0], y, title, fontsize=13, color=INK, weight="bold")
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
            box.add_patch(_rectangle(0.36 + 0.5 * k * width, 0.16, 0.5 * width, 0.055, shade))
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
            axis.set_major_locator(
                MaxNLocator(max(2, min(9, int(pixels / self.dpi / 1.1))), steps=[1, 2, 5, 10])
            )
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


def _rectangle(x: float, y: float, width: float, height: float, color: Any) -> Any:
    """Return a box of the scale bar."""
    from matplotlib.patches import Rectangle

    return Rectangle((x, y), width, height, facecolor=color, edgecolor=INK, linewidth=0.7)


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
    inside = [len(select_inside([xy], [w], sheet.window)[0]) > 0 for xy, w in zip(lines, widths, strict=True)]
    index = np.flatnonzero(inside)
    if not len(index):
        return [], index
    lines, widths = refine_lines(
        [lines[c] for c in index], [widths[c] for c in index], step=4.0 * sheet.metres_per_pixel
    )
    vertices, codes, offset = band_outlines(lines, widths)
    cuts = offset[1:-1]
    pieces = zip(np.split(vertices, cuts), np.split(codes, cuts), strict=True)
    return [Path(v, c, readonly=True) for v, c in pieces], index


def add_water(
    sheet: Sheet, paths: list[Any], channel_width: np.ndarray, colors: Any, bank: float
) -> list[Any]:
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
        The two collections.
    """
    from matplotlib.collections import PathCollection

    points = np.asarray(channel_width) / sheet.metres_per_pixel * 72.0 / sheet.dpi
    lines = np.clip(0.4 * (points - 0.8), 0.0, bank)
    hairs = np.maximum(0.15, 0.6 - points)
    banks = PathCollection(
        paths, facecolors=BANK, edgecolors=BANK, linewidths=lines, joinstyle="round", zorder=5
    )
    water = PathCollection(paths, facecolors=colors, edgecolors=colors, linewidths=hairs, zorder=6)
    for collection in (banks, water):
        sheet.axes.add_collection(collection, autolim=False)
    return [banks, water]


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
    bounds = network.bounds()
    if window is None and extent is not None:
        window = extent
    view = checked_window(window, bounds, 2.0 * float(np.max(network.channel_width)))
    sheet = Sheet(view, size=size, dpi=dpi, title=title or "", legend=True, ticks=True)
    sheet.axes.set_facecolor(GROUND)
    if background is not None and extent is not None:
        _add_background(sheet, background, extent)
    paths, index = channel_paths(sheet, network)
    values = choices[color]
    if values is None:
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
        raise ValueError(
            f"background has shape {pixels.shape}; give (rows, columns) or (rows, columns, 3 or 4)"
        )
    west, south, east, north = (float(v) for v in extent)
    sheet.axes.imshow(
        pixels, cmap="gray", extent=(west, east, south, north), origin="upper", aspect="auto", zorder=1
    )
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

    stops = [(p, c) for p, c in FLOW_RAMP]
    scale = ScalarMappable(norm, LinearSegmentedColormap.from_list("flow", stops))
    width = sheet.legend_width
    box = sheet.strip(-width, 0.42, width, 0.13)
    bar = sheet.figure.colorbar(scale, cax=box, orientation="horizontal")
    if isinstance(norm, LogNorm):
        bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:,.10g}"))
        bar.ax.xaxis.set_minor_formatter(NullFormatter())
    else:
        bar.ax.xaxis.set_major_locator(MaxNLocator(nbins=max(2, round(1.6 * width))))
    _style_bar(bar.ax)
    bar.ax.set_title(label, fontsize=8.5, color=INK, loc="right", pad=4)


def _style_bar(box: Any) -> None:
    """Give a colour bar thin, small ticks."""
    box.tick_params(labelsize=8, length=2.5, width=0.6, colors=FAINT, labelcolor=INK, pad=2)
    for spine in box.spines.values():
        spine.set(linewidth=0.6, color=FAINT)


def _add_flow_arrow(sheet: Sheet, network: Any) -> None:
    """Put an arrow beside the longest channel, where most room is, along the general direction of flow."""
    from matplotlib import patheffects
    from scipy.spatial import cKDTree

    west, south, east, north = sheet.window
    length = 0.45 * sheet.dpi * sheet.metres_per_pixel
    lines, widths = select_inside(network.polylines(), network.point_widths(), sheet.window)
    inside = [xy[((xy > (west, south)) & (xy < (east, north))).all(axis=1)] for xy in lines]
    longest = max(inside, key=len, default=np.empty((0, 2)))
    if len(longest) < 2:
        return
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
        for side in (-1.0, 1.0):
            for away in (0.6, 0.9, 1.3, 1.8):
                middle = longest[k] + side * (half + away * length) * np.array([-along[1], along[0]])
                if not (
                    west + margin < middle[0] < east - margin and south + margin < middle[1] < north - margin
                ):
                    continue
                samples = middle + along * length * np.linspace(-0.6, 0.6, 7)[:, None]
                room = float(tree.query(samples)[0].min()) - half
                if room < 0.3 * length:
                    continue
                # Close to the channel is best, once there is room for the arrow and its label.
                score = min(room, 0.5 * length) - 0.1 * away * length
                if best is None or score > best[0]:
                    best = score, middle, along
    if best is None:
        return
    _, middle, along = best
    head, tail = middle + 0.5 * length * along, middle - 0.5 * length * along
    halo = [patheffects.withStroke(linewidth=3.0, foreground="white", alpha=0.6)]
    style = {
        "arrowstyle": "-|>,head_width=0.25,head_length=0.5",
        "lw": 1.5,
        "color": BANK,
        "path_effects": halo,
    }
    sheet.axes.annotate("", tuple(head), tuple(tail), arrowprops=style, zorder=8)


# ---- channel belt


class BeltPainter:
    """Paints which course or oxbow lake covered each pixel last, and colours the pixels by its age.

    A course costs one filled path and a picture one look-up, however many records came before: this is what
    makes movies linear in the number of frames.

    Attributes:
        network: The network painted last, None before the first.
        age_span: Age in yr at which deposits look oldest.
    """

    def __init__(
        self,
        history: Any,
        window: Window,
        shape: tuple[int, int],
        *,
        supersample: int = 2,
        age_span: float | None = None,
    ):
        """Prepare an empty floodplain.

        Args:
            history: History.
            window: (west, south, east, north) of the picture, m.
            shape: (rows, columns) in pixels.
            supersample: Samples per pixel and direction.
            age_span: Age in yr at which deposits look oldest; by default the time that the history spans.
        """
        from matplotlib.backends.backend_agg import RendererAgg

        self._history = history
        self._times = np.asarray(history.times, np.float64)
        self.age_span = default_age_span(history) if age_span is None else float(age_span)
        self._window = window
        self._shape = shape
        self._factor = supersample
        rows, columns = shape[0] * supersample, shape[1] * supersample
        self._renderer = RendererAgg(columns, rows, 72)
        self._pen = self._renderer.new_gc()
        self._pen.set_linewidth(0.0)
        self._pen.set_antialiased(False)
        self._scale = columns / (window[2] - window[0])
        self._cutoffs = sorted(history.cutoffs, key=lambda cutoff: cutoff.time)
        self._cutoff_times = np.array([cutoff.time for cutoff in self._cutoffs])
        self.network: Any = None
        self._courses = 0
        self._oxbows = 0
        self._noise = vegetation_noise(shape)

    @property
    def cutoff_count(self) -> int:
        """Number of cutoffs painted."""
        return self._oxbows

    def advance(self, record: int) -> None:
        """Paint all courses up to ``record`` and all loops cut off until then; going back is not possible."""
        while self._courses <= record:
            time = self._times[self._courses]
            while self._oxbows < len(self._cutoffs) and self._cutoff_times[self._oxbows] <= time:
                cutoff = self._cutoffs[self._oxbows]
                self._oxbows += 1
                xy = np.asarray(cutoff.xy, np.float64)
                if len(xy) >= 3:
                    code = 1 + len(self._times) + self._oxbows - 1
                    self._fill([xy], [taper_ends(xy, float(cutoff.width))], code)
            self.network = self._history.networks[self._courses]
            self._courses += 1
            self._fill(self.network.polylines(), self.network.point_widths(), self._courses)

    def _fill(self, lines: Sequence[np.ndarray], widths: Sequence[np.ndarray], code: int) -> None:
        """Fill the bands of some lines with an event's number: course k is 1 + k, oxbow j is 1 + K + j."""
        from matplotlib.path import Path
        from matplotlib.transforms import Affine2D

        lines, widths = select_inside(lines, widths, self._window)
        if not lines:
            return
        vertices, codes, _ = band_outlines(*refine_lines(lines, widths, step=6.0 / self._scale))
        transform = Affine2D().translate(-self._window[0], -self._window[1]).scale(self._scale)
        rgb = tuple(((code >> shift) & 255) / 255.0 for shift in (0, 8, 16))
        self._renderer.draw_path(self._pen, Path(vertices, codes, readonly=True), transform, rgb)

    def cover(self) -> np.ndarray:
        """Return the number of the event that covered each sample last, 0 for none: (rows, columns) int32."""
        words = np.asarray(self._renderer.buffer_rgba()).view(np.uint32)[..., 0]
        # Samples that nothing covered still have the alpha of an empty picture, 0.
        return np.where(words >> np.uint32(24) != 0, words & np.uint32(0xFFFFFF), 0).astype(np.int32)

    def lakes(self, record: int) -> Iterator[tuple[np.ndarray, float, float, np.ndarray]]:
        """Yield the oxbow lakes painted so far that are still in sight somewhere.

        Args:
            record: Index of the present record.

        Yields:
            Line (n, 2) in m, width in m, age as a part of the age span, and an (n,) mask of the points in
            sight.
        """
        cover = self.cover()
        rows, columns = cover.shape
        for k, cutoff in enumerate(self._cutoffs[: self._oxbows]):
            xy = np.asarray(cutoff.xy, np.float64)
            column = np.floor((xy[:, 0] - self._window[0]) * self._scale).astype(np.int64)
            row = np.floor((self._window[3] - xy[:, 1]) * self._scale).astype(np.int64)
            inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
            code = cover[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
            seen = inside & (code == 1 + len(self._times) + k)
            if seen.any():
                age = (self._times[record] - cutoff.time) / self.age_span
                yield xy, float(cutoff.width), float(np.clip(age, 0.0, 1.0)), seen

    def picture(self, record: int) -> np.ndarray:
        """Return the belt at a record without its channel, (rows, columns, 3) uint8, row 0 in the north."""
        now = self._times[record]
        age = (now - np.concatenate([self._times, self._cutoff_times])) / self.age_span
        age = np.clip(age, 0.0, 1.0)
        courses = len(self._times)
        table = np.zeros((1 + len(age), 4))
        table[0, :3], table[0, 3] = color_ramp(((0.0, GROUND), (1.0, GROUND)), 0.0), 0.4
        table[1 : 1 + courses, :3] = color_ramp(DEPOSIT_RAMP, age[:courses])
        table[1 : 1 + courses, :3] *= 1.0 + _scroll_tone(self._times, self.age_span)[:, None]
        table[1 : 1 + courses, 3] = 0.25 + 0.75 * age[:courses]
        table[1 + courses :, :3] = color_ramp(OXBOW_RAMP, age[courses:])
        table[1 + courses :, 3] = 0.6 * age[courses:]
        words = np.round(255.0 * np.clip(table, 0.0, 1.0)).astype(np.uint8).view(np.uint32)[:, 0]
        samples = words[self.cover()].view(np.uint8).reshape(*self._renderer_shape(), 4)
        mean = _box_mean(samples, self._factor)
        tone = 1.0 + 0.05 * self._noise * mean[..., 3] / 255.0
        return np.clip(mean[..., :3] * tone[..., None], 0.0, 255.0).astype(np.uint8)

    def _renderer_shape(self) -> tuple[int, int]:
        """Return (rows, columns) of the samples."""
        return self._shape[0] * self._factor, self._shape[1] * self._factor


def default_age_span(history: Any) -> float:
    """Return the time in yr that a history spans, 1 for a single record."""
    times = np.asarray(history.times, np.float64)
    return float(times[-1] - times[0]) if times[-1] > times[0] else 1.0


def _box_mean(samples: np.ndarray, factor: int) -> np.ndarray:
    """Average blocks of ``factor`` x ``factor`` samples; returns float32."""
    total = np.zeros((samples.shape[0] // factor, samples.shape[1] // factor, samples.shape[2]), np.uint16)
    for i in range(factor):
        for j in range(factor):
            total += samples[i::factor, j::factor]
    return total.astype(np.float32) / factor**2


def _scroll_tone(times: np.ndarray, span: float) -> np.ndarray:
    """Return a small change of tone for each course, a smooth function of time with several periods."""
    phase = 2.0 * np.pi * (times - times[0]) / span
    waves = 0.5 * np.sin(13.0 * phase) + 0.3 * np.sin(29.3 * phase + 1.0) + 0.4 * np.sin(47.9 * phase + 2.0)
    return SCROLL_STRENGTH * waves


def vegetation_noise(shape: tuple[int, int]) -> np.ndarray:
    """Return a mottling of the ground with mean 0 and spread 1, the same for the same shape: float32."""
    from scipy.ndimage import gaussian_filter, zoom

    random = np.random.default_rng(7)
    total = np.zeros(shape, np.float32)
    for size, weight in ((1, 0.6), (3, 0.8), (9, 0.6)):
        coarse = (shape[0] // size + 4, shape[1] // size + 4)
        layer = gaussian_filter(random.standard_normal(coarse).astype(np.float32), 0.8)
        if size > 1:
            layer = zoom(layer, size, order=1)
        total += weight * layer[: shape[0], : shape[1]] / layer.std()
    return (total - total.mean()) / total.std()


def history_bounds(history: Any, until: int) -> Window:
    """Return (west, south, east, north) in m of all courses up to a record, widths included."""
    boxes = []
    for k in range(until + 1):
        network = history.networks[k]
        reach = 0.5 * float(np.max(network.channel_width))
        west, south, east, north = network.bounds()
        boxes.append((west - reach, south - reach, east + reach, north + reach))
    packed = np.array(boxes)
    low, high = packed.min(axis=0), packed.max(axis=0)
    return float(low[0]), float(low[1]), float(high[2]), float(high[3])


def checked_record(history: Any, until: int | None) -> int:
    """Return the index of a record, counted from the end where negative.

    Raises:
        ValueError: The history has no record of that index.
    """
    count = len(history.times)
    if count == 0:
        raise ValueError("the history holds no record; run the simulation first")
    record = count - 1 if until is None else int(until)
    if not -count <= record < count:
        raise ValueError(f"until is {until}, but the history holds records 0 to {count - 1}")
    return record % count


class BeltSheet:
    """A page with the belt map, which can be turned from one record to a later one."""

    def __init__(
        self,
        history: Any,
        *,
        window: Sequence[float] | None,
        size: tuple[int, int] | None,
        dpi: float,
        title: str | None,
        legend: bool,
        age_span: float | None,
        bounds: Window | None = None,
    ):
        """Lay out the page; parameters as in :func:`draw_belt`, ``bounds`` in m where they are known."""
        last = len(history.times) - 1
        bounds = bounds or history_bounds(history, last)
        view = checked_window(window, bounds, 2.0 * float(np.max(history.networks[0].channel_width)))
        text = "Channel belt" if title is None else title
        self._history = history
        self.sheet = Sheet(view, size=size, dpi=dpi, title=text, legend=legend)
        self.painter = BeltPainter(history, self.sheet.window, self.sheet.shape, age_span=age_span)
        west, south, east, north = self.sheet.window
        blank = np.zeros((*self.sheet.shape, 3), np.uint8)
        self._image = self.sheet.axes.imshow(
            blank, extent=(west, east, south, north), origin="upper", aspect="auto", interpolation="nearest"
        )
        self._water: list[Any] = []
        self._has_note = bool(text)
        if legend:
            lines = history.networks[0].polylines()
            longest = max(lines, key=len)
            self.sheet.add_scale_bar(flow=longest[-1] - longest[0])
            self._add_legend()

    def turn_to(self, record: int) -> None:
        """Show a record, the same one or a later one than before."""
        self.painter.advance(record)
        self._image.set_data(self.painter.picture(record))
        for collection in self._water:
            collection.remove()
        network = self.painter.network
        paths, index = channel_paths(self.sheet, network)
        self._water = (
            add_water(self.sheet, paths, network.channel_width[index], WATER, bank=0.7) if paths else []
        )
        if self._has_note:
            time = float(self._history.times[record])
            count = self.painter.cutoff_count
            cut = {0: "", 1: ", 1 cutoff"}.get(count, f", {count:,} cutoffs")
            digits = 0 if self.painter.age_span >= 50.0 else 1
            self.sheet.note.set_text(f"year {time:,.{digits}f}{cut}")

    def _add_legend(self) -> None:
        """Draw the two ramps over one axis of age at the right of the strip."""
        from matplotlib.ticker import MaxNLocator

        ramp = np.linspace(0.0, 1.0, 256)
        image = np.stack([color_ramp(OXBOW_RAMP, ramp), color_ramp(DEPOSIT_RAMP, ramp)])
        width = self.sheet.legend_width
        box = self.sheet.strip(-width, 0.36, width, 0.34)
        box.imshow(
            image,
            extent=(0.0, self.painter.age_span, 0.0, 2.0),
            origin="lower",
            aspect="auto",
            interpolation="nearest",
        )
        box.axhline(1.0, color="white", linewidth=1.2)
        box.set_yticks([1.5, 0.5], ["point bars", "oxbow lakes"])
        box.xaxis.set_major_locator(MaxNLocator(nbins=max(2, round(1.6 * width)), steps=[1, 2, 5, 10]))
        _style_bar(box)
        box.tick_params(axis="y", length=0, pad=4, labelsize=8.5)
        box.set_xlabel("years since the channel left", fontsize=8.5, color=INK, labelpad=2)


def draw_belt(
    history: Any,
    path: Any = None,
    *,
    until: int | None = None,
    window: Sequence[float] | None = None,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
    title: str | None = None,
    legend: bool = True,
    age_span: float | None = None,
) -> Any:
    """Draw the channel belt: where the river has been, what it left there, and where it runs now.

    Each recorded course is drawn at its true width, in the order of time, as a point-bar deposit whose shade
    tells how long ago the channel left it: sand where it is fresh, closed forest where it is old. Loops that
    were cut off lie among them as lakes that turn into swamp. The present channel is on top. A faint banding
    in time is added to the shades so that scroll bars read as arcs. Record often enough that the channel
    moves less than its width between two records; otherwise bare ground shows between them.

    Args:
        history: History.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        until: Index of the record to show as the present (negative: from the end); by default the last.
        window: (west, south, east, north) to show, in m; by default everything. It grows where the page has
            room.
        size: Width and height of the picture in pixels; by default fitted to the window.
        dpi: Pixels per inch.
        title: Title at the upper left; None writes "Channel belt", "" leaves the line out.
        legend: Draw scale bar, north arrow and the bars of age.
        age_span: Age in yr at which deposits look oldest; by default the time that the whole history spans,
            so that pictures of one history can be compared.

    Returns:
        matplotlib.figure.Figure.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: No record, a record that does not exist, a window that shows nothing, an ``age_span`` that
            is not positive, or a file name with an unknown suffix.
        OSError: The file cannot be written.
    """
    need_matplotlib()
    record = checked_record(history, until)
    if age_span is not None and not age_span > 0.0:
        raise ValueError(f"age_span is {age_span:g} yr; it must be positive")
    page = BeltSheet(
        history, window=window, size=size, dpi=dpi, title=title, legend=legend, age_span=age_span
    )
    page.turn_to(record)
    if path is not None:
        page.sheet.save(path)
    return page.sheet.figure
