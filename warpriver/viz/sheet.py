"""Pages: a map with known pixels, a title above it and a strip below it; windows, and files that appear whole.

matplotlib is imported when a page is laid out, not before, and its global state (``pyplot``) is never touched.
"""

from __future__ import annotations

import contextlib
import pathlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from warpriver.errors import InputError, MissingExtraError, MissingFileError, WrongPathError
from warpriver.files import beside, in_memory
from warpriver.viz.bands import Window

__all__ = [
    "Sheet",
    "checked_window",
    "color_ramp",
    "grow_to_aspect",
    "need_matplotlib",
    "replacing",
    "save_figure",
    "style_bar",
]

WATER = "#3d7ea6"
BANK = "#1d4560"
GROUND = "#cfcbb4"
INK = "#2b2f2c"
FAINT = "#77796f"

# Largest ratio of the sides of a map that is fitted to its river; narrower ones get more ground beside it.
MAX_ASPECT = 9.0


class Sheet:
    """A page with a map whose pixels are square and known, a title above it and a strip below it.

    It may hold two maps of one window, side by side or, where the window is wide, one above the other.

    Attributes:
        figure: The matplotlib figure.
        canvas: Its Agg canvas.
        axes: The map, the first one of several; its units are m.
        panels: All maps.
        window: (west, south, east, north) shown, m.
        shape: (rows, columns) of a map in pixels.
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
        two: bool = False,
    ):
        """Lay out the page.

        Args:
            window: (west, south, east, north) in m; it grows until it fills the map.
            size: Width and height of the whole picture in pixels, or None: fitted to the window.
            dpi: Pixels per inch: sets the size of letters.
            title: Title, or "" for none.
            legend: Leave a strip below the map.
            ticks: Leave room for tick labels.
            two: Lay out two maps.

        Raises:
            ValueError: A size too small to hold a map.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        left, right = round((0.62 if ticks else 0.3) * dpi), round(0.3 * dpi)
        top = round((0.55 if title else 0.3) * dpi)
        bottom = round(((0.92 if legend else 0.3) + (0.3 if ticks else 0.0)) * dpi)
        gap = round(0.3 * dpi)
        aspect = (window[2] - window[0]) / (window[3] - window[1])
        if size is not None:
            # Two maps lie in the way that leaves each the longer scale.
            aspect *= (size[1] - top - bottom) / max(size[0] - left - right, 1)
        across, down = (1, 1) if not two else (1, 2) if aspect > (1.6 if size is None else 1.0) else (2, 1)
        if size is None:
            width, height = _fitted_size(window)
            part = 0.68 if two else 1.0
            width, height = part * width, part * height
            if legend:
                width = max(width, (6.0 - 0.3 * (across - 1)) / across)
            columns, rows = round(width * dpi), round(height * dpi)
        else:
            columns = (int(size[0]) - left - right - (across - 1) * gap) // across
            rows = (int(size[1]) - top - bottom - (down - 1) * gap) // down
            if columns < 64 or rows < 64:
                least = 64 * across + (across - 1) * gap + left + right, 64 * down + (down - 1) * gap + top + bottom
                raise InputError(
                    f"size is {tuple(size)} pixels, too small for a map at {dpi:g} dpi; give at least "
                    f"{least}, or a smaller dpi"
                )
        wide, tall = across * columns + (across - 1) * gap, down * rows + (down - 1) * gap
        page = (wide + left + right, tall + top + bottom) if size is None else (int(size[0]), int(size[1]))
        self.window = grow_to_aspect(window, columns / rows)
        self.shape = (rows, columns)
        self.metres_per_pixel = (self.window[2] - self.window[0]) / columns
        self.figure = Figure(figsize=(page[0] / dpi, page[1] / dpi), dpi=dpi, facecolor="white")
        self.canvas = FigureCanvasAgg(self.figure)
        self._page, self._left, self._right = page, left, left + wide
        corners = [
            (left + i * (columns + gap), bottom + (down - 1 - j) * (rows + gap)) for j, i in np.ndindex(down, across)
        ]
        self.panels = [self._add_map(self._box(x, y, columns, rows)) for x, y in corners]
        self.axes = self.panels[0]
        y = (bottom + tall + 0.16 * dpi) / page[1]
        self.figure.text(left / page[0], y, title, fontsize=13, color=INK, weight="bold")
        self.note = self.figure.text(self._right / page[0], y, "", fontsize=10, color=FAINT, ha="right")
        self.dpi = dpi

    def _add_map(self, box: tuple[float, float, float, float]) -> Any:
        """Add the axes of a map, without ticks."""
        axes = self.figure.add_axes(box)
        axes.set_xlim(self.window[0], self.window[2])
        axes.set_ylim(self.window[1], self.window[3])
        for spine in axes.spines.values():
            spine.set(linewidth=0.6, color=FAINT)
        axes.set(xticks=[], yticks=[])
        return axes

    def _box(self, x: float, y: float, width: float, height: float) -> tuple[float, float, float, float]:
        """Turn a rectangle in pixels from the lower left into parts of the page."""
        return x / self._page[0], y / self._page[1], width / self._page[0], height / self._page[1]

    @property
    def across(self) -> float:
        """Width of all maps, inches."""
        return (self._right - self._left) / self.dpi

    @property
    def legend_width(self) -> float:
        """Width of the colour bar in the strip, inches."""
        return float(np.clip(0.38 * self.across, 1.0, 2.5))

    def strip(self, x: float, y: float, width: float, height: float) -> Any:
        """Add axes in the strip, in inches, with ``x`` from the map's left or, below 0, from its right."""
        dpi = self.dpi
        edge = self._left + x * dpi if x >= 0.0 else self._right + x * dpi
        return self.figure.add_axes(self._box(edge, y * dpi, width * dpi, height * dpi))

    def add_scale_bar(self, flow: np.ndarray | None = None) -> None:
        """Draw a north arrow, a scale bar and, where ``flow`` (2,) is given, the direction of flow."""
        from matplotlib.patches import Rectangle

        free = self.across - self.legend_width - 1.0 - 0.8 - (0.75 if flow is not None else 0.0)
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
            save_figure(self.figure, temporary, self.dpi)


def save_figure(figure: Any, path: str, dpi: float) -> None:
    """Write a figure in the format that the suffix names."""
    with in_memory(path) as buffer:
        figure.savefig(buffer, format=pathlib.Path(path).suffix[1:], dpi=dpi)


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
        raise InputError(f"window is {tuple(window)}; give (west, south, east, north) in m, west < east, south < north")
    west, south, east, north = values
    if west > bounds[2] or east < bounds[0] or south > bounds[3] or north < bounds[1]:
        raise InputError(
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
        raise MissingExtraError('maps are drawn with matplotlib: pip install "warpriver[viz]"') from error


@contextlib.contextmanager
def replacing(path: Any, suffixes: Sequence[str], check: Callable[[pathlib.Path], None] | None = None) -> Iterator[str]:
    """Yield a temporary name for ``path``, which it replaces when the block ends without an error.

    Args:
        path: File to write.
        suffixes: Suffixes allowed, with their dots.
        check: As in :func:`warpriver.files.beside`.

    Raises:
        ValueError: Another suffix.
        OSError: The folder does not exist or cannot be written.
    """
    target = pathlib.Path(path)
    if target.suffix.lower() not in suffixes:
        raise InputError(f"cannot write {target}: the name must end in {', '.join(suffixes)}")
    if not target.parent.is_dir():
        raise MissingFileError(f"cannot write {target}: the folder {target.parent} does not exist")
    if target.is_dir():
        raise WrongPathError(f"cannot write {target}: it is a folder")
    with beside(target, check=check) as temporary:
        yield str(temporary)


def color_ramp(stops: Sequence[tuple[float, str]], values: Any) -> np.ndarray:
    """Interpolate a ramp of (position, "#rrggbb") stops at ``values`` in 0..1: (..., 3) floats in 0..1."""
    at = [p for p, _ in stops]
    rgb = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for _, c in stops]) / 255.0
    return np.stack([np.interp(values, at, rgb[:, k]) for k in range(3)], axis=-1)
