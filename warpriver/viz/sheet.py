"""Sheets: maps with known pixels, on a page, on given axes or alone; windows, and files that appear whole.

matplotlib is imported when a sheet is made, not before, and its global state (``pyplot``) is never touched.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from warpriver.errors import InputError, MissingExtraError
from warpriver.files import beside, check_place, in_memory
from warpriver.io.raster.placing import WORLD_FILES, write_placing, write_world_file
from warpriver.validate import finite_numbers
from warpriver.viz.bands import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.text import Text

__all__ = [
    "PICTURES",
    "Sheet",
    "check_drawing",
    "check_picture",
    "checked_axes",
    "checked_window",
    "color_ramp",
    "grow_to_aspect",
    "make_sheet",
    "replacing",
    "save_figure",
    "style_bar",
]

# A map that is narrower has ticks in m.
SHORT_REACH = 1000.0
PICTURES = (".png", ".jpg", ".pdf", ".svg")

WATER = "#3d7ea6"
BANK = "#1d4560"
GROUND = "#cfcbb4"
INK = "#2b2f2c"
FAINT = "#77796f"

# Pixels along the longer side of a map without a frame: about, and at most.
BARE_PIXELS, MAX_PIXELS = 2000, 8192

# Largest ratio of the sides of a map that is fitted to its river; narrower ones get more ground beside it.
MAX_ASPECT = 9.0


class Sheet:
    """A map, or two of one window, whose pixels are square and known: on a page, on given axes, or alone.

    On a page there is a title above the maps and a strip below them; two lie side by side or, where the window is wide,
    one above the other. :meth:`on_axes` draws on axes that somebody else laid out, :meth:`bare` a picture that is
    nothing but the map.

    Attributes:
        figure: The matplotlib figure.
        canvas: What draws a page or a map alone into pixels.
        axes: The map, the first one of several; its units are m.
        panels: All maps.
        window: (west, south, east, north) shown, m.
        shape: (rows, columns) of a map in pixels.
        metres_per_pixel: Ground size of a pixel, m.
        dpi: Pixels per inch.
        note: The text at the upper right.
        is_page: Whether there is room for scale bars and colour bars.
        aspect: Aspect of the axes, as matplotlib has it: where pixels are known to be square nothing is left to do.
    """

    figure: Figure | SubFigure
    canvas: FigureCanvasAgg
    axes: Axes
    panels: list[Axes]
    window: Window
    shape: tuple[int, int]
    metres_per_pixel: float
    dpi: float
    note: Text
    is_page: bool
    aspect: Literal["auto", "equal"] = "auto"
    # A map alone is saved with files that say where it lies, in this CRS.
    _placed: bool = False
    _crs: str | None = None

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
        """Lay out a page.

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
        across, down, columns, rows = _map_size(window, size, dpi, (left + right, top + bottom, gap), legend, two)
        wide, tall = across * columns + (across - 1) * gap, down * rows + (down - 1) * gap
        page = (wide + left + right, tall + top + bottom) if size is None else (int(size[0]), int(size[1]))
        self.window = grow_to_aspect(window, columns / rows)
        self.shape, self.dpi, self.is_page = (rows, columns), dpi, True
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

    @classmethod
    def on_axes(cls, axes: Sequence[Axes], window: Window, title: str = "") -> Sheet:
        """Take axes of a figure for the maps: they show the window, as large as they are, in equal units."""
        sheet = cls.__new__(cls)
        sheet.panels, sheet.axes, sheet.window, sheet.is_page = list(axes), axes[0], window, False
        sheet.aspect = "equal"
        figure = axes[0].get_figure()
        assert figure is not None
        sheet.figure, sheet.dpi = figure, figure.dpi
        for panel in sheet.panels:
            panel.set_xlim(window[0], window[2])
            panel.set_ylim(window[1], window[3])
            panel.set_aspect("equal", adjustable="box")
            panel.apply_aspect()
        box = sheet.axes.get_window_extent()
        sheet.shape = max(16, round(box.height)), max(16, round(box.width))
        sheet.metres_per_pixel = (window[2] - window[0]) / sheet.shape[1]
        if title:
            sheet.axes.set_title(title, loc="left")
        sheet.note = sheet.axes.set_title("", loc="right", fontsize=9, color=FAINT)
        return sheet

    @classmethod
    def bare(
        cls, window: Window, *, size: tuple[int, int] | None, dpi: float, cell: float | None, crs: str | None
    ) -> Sheet:
        """Make a picture that is the window and nothing else.

        Args:
            window: (west, south, east, north) in m.
            size: Width and height in pixels, or None: a whole number of pixels a cell, or else 2,000 along the longer
                side.
            dpi: Pixels per inch: sets the width of lines.
            cell: Side of the cells of a raster whose bounds the window is, m, or None.
            crs: Coordinate reference system, for the files beside the picture.

        Raises:
            ValueError: A size that has not the shape of the window.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        sheet = cls.__new__(cls)
        sheet.window, sheet.dpi, sheet.is_page, sheet._placed, sheet._crs = window, dpi, False, True, crs
        sheet.shape = rows, columns = _bare_shape(window, size, cell)
        sheet.metres_per_pixel = (window[2] - window[0]) / columns
        # A hair more, as matplotlib cuts what is left of a pixel off.
        sheet.figure = Figure(figsize=((columns + 1e-6) / dpi, (rows + 1e-6) / dpi), dpi=dpi, facecolor="white")
        sheet.canvas = FigureCanvasAgg(sheet.figure)
        sheet.panels = [sheet._add_map((0.0, 0.0, 1.0, 1.0))]
        sheet.axes = sheet.panels[0]
        for spine in sheet.axes.spines.values():
            spine.set_visible(False)
        sheet.note = sheet.figure.text(0.0, 0.0, "", visible=False)
        return sheet

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
        """Turn a rectangle in pixels from the lower left into fractions of the page."""
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
        """Draw a north arrow, a scale bar and, where ``flow`` (2,) is given, the direction of flow, on a page."""
        from matplotlib.patches import Rectangle

        if not self.is_page:
            return
        free = self.across - self.legend_width - 1.0 - 0.8 - (0.75 if flow is not None else 0.0)
        if flow is not None and free < 0.8:
            flow, free = None, free + 0.75
        space = float(np.clip(free, 0.4, 2.0)) * self.dpi * self.metres_per_pixel
        power = 10.0 ** np.floor(np.log10(space))
        length = next(k * power for k in (5.0, 2.0, 1.0) if k * power <= space)
        width = length / self.metres_per_pixel / self.dpi
        span = width + 1.6
        box = self.strip(0.0, 0.3, span, 0.5)
        box.set(xlim=(0.0, span), ylim=(0.0, 0.5))
        box.axis("off")
        for k, shade in enumerate((INK, "white")):
            corner, side = (0.36 + 0.5 * k * width, 0.16), 0.5 * width
            box.add_patch(Rectangle(corner, side, 0.055, facecolor=shade, edgecolor=INK, linewidth=0.7))
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

    def add_ticks(self) -> None:
        """Put ticks with kilometres around the map of a page, with metres around that of a short reach."""
        from matplotlib.ticker import FuncFormatter, MaxNLocator

        if not self.is_page:
            return
        rows, columns = self.shape
        unit, name = (1.0, "m") if abs(np.ptp(self.axes.get_xlim())) < SHORT_REACH else (1e3, "km")
        for axis, pixels in ((self.axes.xaxis, columns), (self.axes.yaxis, rows)):
            axis.set_major_locator(MaxNLocator(max(2, min(9, int(pixels / self.dpi / 1.1))), steps=[1, 2, 5, 10]))
            axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v / unit:.10g}"))
        self.axes.tick_params(labelsize=8, colors=FAINT, labelcolor=INK, width=0.6, length=3, pad=2)
        for label in self.axes.get_yticklabels():
            label.set(rotation=90, va="center")
        self.axes.set_xlabel(f"easting, {name}", fontsize=8, color=FAINT, labelpad=2)
        self.axes.set_ylabel(f"northing, {name}", fontsize=8, color=FAINT, labelpad=2)

    def lay(self, pixels: np.ndarray, extent: Sequence[float] | None = None, panel: int = 0, **style: Any) -> Any:
        """Lay an image on a map, row 0 in the north.

        Args:
            pixels: (rows, columns) greys, or (rows, columns, 3 or 4) colours.
            extent: (west, south, east, north) in m; by default the window.
            panel: Number of the map.
            style: Passed to ``imshow``.
        """
        west, south, east, north = self.window if extent is None else extent
        style = {"interpolation": "nearest", "aspect": self.aspect, "zorder": 1} | style
        axes = self.panels[panel]
        image = axes.imshow(pixels, extent=(west, east, south, north), origin="upper", **style)
        axes.set(xlim=(self.window[0], self.window[2]), ylim=(self.window[1], self.window[3]))
        return image

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the figure; the format follows the suffix. Beside a map alone go the files that say where it lies."""
        suffix = pathlib.Path(path).suffix
        parts = (WORLD_FILES.get(suffix.lower(), ".wld"), f"{suffix}.aux.xml")
        with replacing(path, PICTURES, parts=parts) as temporary:
            save_figure(self.axes.figure, temporary, self.dpi)
            if self._placed and suffix.lower() in WORLD_FILES:
                (west, south, east, north), (rows, columns) = self.window, self.shape
                place = (west, north, (east - west) / columns, (north - south) / rows)
                written = pathlib.Path(temporary)
                write_world_file(written.with_suffix(parts[0]), place)
                write_placing(written.with_suffix(parts[1]), place, self._crs)


def make_sheet(
    window: Window,
    *,
    ax: Axes | Sequence[Axes] | None,
    frame: bool = True,
    size: tuple[int, int] | None,
    dpi: float,
    title: str,
    legend: bool = True,
    ticks: bool = False,
    two: bool = False,
    cell: float | None = None,
    crs: str | None = None,
) -> Sheet:
    """Return the sheet to draw on: given axes, without a frame a map alone, else a page.

    Raises:
        ValueError: Other things than as many axes as there are maps, or axes and a size or no frame.
    """
    if ax is None:
        if frame:
            return Sheet(window, size=size, dpi=dpi, title=title, legend=legend, ticks=ticks, two=two)
        return Sheet.bare(window, size=size, dpi=dpi, cell=cell, crs=crs)
    if size is not None or not frame:
        raise InputError("size= and frame= belong to a picture of its own; leave them out beside ax=")
    return Sheet.on_axes(checked_axes(ax, 2 if two else 1), window, title)


def checked_axes(ax: Axes | Sequence[Axes], count: int) -> list[Axes]:
    """Return axes as a list, or raise ``ValueError`` unless there are ``count``."""
    from matplotlib.axes import Axes

    axes = [ax] if isinstance(ax, Axes) else list(np.ravel(np.array(ax, object)))
    if len(axes) != count or not all(isinstance(one, Axes) for one in axes):
        wanted = "matplotlib axes" if count == 1 else f"a sequence of {count} matplotlib axes"
        raise InputError(f"ax is {type(ax).__name__}; give {wanted}")
    return axes


def _map_size(
    window: Window,
    size: tuple[int, int] | None,
    dpi: float,
    margins: tuple[int, int, int],
    legend: bool,
    two: bool,
) -> tuple[int, int, int, int]:
    """Return how many maps lie across and down a page, and their width and height in pixels.

    ``margins`` are those beside and above and below the maps, and the gap between them.
    """
    beside_maps, above_maps, gap = margins
    aspect = (window[2] - window[0]) / (window[3] - window[1])
    if size is not None:
        # Two maps lie in the way that leaves each the longer scale.
        aspect *= (size[1] - above_maps) / max(size[0] - beside_maps, 1)
    across, down = (1, 1) if not two else (1, 2) if aspect > (1.6 if size is None else 1.0) else (2, 1)
    if size is None:
        width, height = _fitted_size(window)
        fraction = 0.68 if two else 1.0
        width, height = fraction * width, fraction * height
        if legend:
            width = max(width, (6.0 - 0.3 * (across - 1)) / across)
        return across, down, round(width * dpi), round(height * dpi)
    columns = (int(size[0]) - beside_maps - (across - 1) * gap) // across
    rows = (int(size[1]) - above_maps - (down - 1) * gap) // down
    if columns < 64 or rows < 64:
        smallest = 64 * across + (across - 1) * gap + beside_maps, 64 * down + (down - 1) * gap + above_maps
        raise InputError(
            f"size is {tuple(size)} pixels, too small for a map at {dpi:g} dpi; give at least {smallest}, or a smaller "
            "dpi"
        )
    return across, down, columns, rows


def _bare_shape(window: Window, size: tuple[int, int] | None, cell: float | None) -> tuple[int, int]:
    """Return rows and columns of a picture of a window, as :meth:`Sheet.bare` has it."""
    width, height = window[2] - window[0], window[3] - window[1]
    if size is not None:
        columns, rows = (int(n) for n in size)
        if min(columns, rows) < 1 or abs(columns * height / width - rows) > 1.0:
            fit = max(1, columns), max(1, round(max(1, columns) * height / width))
            raise InputError(
                f"size is {tuple(size)} pixels, the window {width:g} x {height:g} m: without a frame both have one "
                f"shape; give {fit}, or leave size= out"
            )
        return rows, columns
    if cell is None:
        scale = BARE_PIXELS / max(width, height)
        return max(1, round(height * scale)), max(1, round(width * scale))
    rows, columns = max(1, round(height / cell)), max(1, round(width / cell))
    fine, coarse = max(1, round(BARE_PIXELS / max(rows, columns))), -(-max(rows, columns) // MAX_PIXELS)
    return max(1, rows * fine // coarse), max(1, columns * fine // coarse)


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
    """Return the window in m: the requested one, or ``bounds`` with a margin.

    Args:
        window: (west, south, east, north) in m, or None.
        bounds: What there is to show, in m.
        margin: Minimum margin around it, m.

    Raises:
        ValueError: The window is not four finite numbers, is empty, or shows none of ``bounds``.
    """
    if window is None:
        west, south, east, north = bounds
        pad = max(margin, 0.035 * max(east - west, north - south))
        return west - pad, south - pad, east + pad, north + pad
    west, south, east, north = finite_numbers(window, 4, "window")
    if west >= east or south >= north:
        raise InputError(f"window is {tuple(window)}; give (west, south, east, north) in m, west < east, south < north")
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


def check_drawing(path: str | os.PathLike[str] | None = None) -> None:
    """Raise, before anything is computed, unless matplotlib is there and a picture can be written to the path."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise MissingExtraError('maps are drawn with matplotlib: pip install "warpriver[viz]"') from error
    if path is not None:
        check_picture(path)


def check_picture(path: str | os.PathLike[str], suffixes: Sequence[str] = PICTURES) -> pathlib.Path:
    """Return the path of a picture, or raise unless a file of such a suffix can be written there."""
    target = pathlib.Path(path)
    if target.suffix.lower() not in suffixes:
        raise InputError(f"cannot write {target}: the name must end in {', '.join(suffixes)}")
    check_place(target)
    return target


@contextlib.contextmanager
def replacing(
    path: str | os.PathLike[str],
    suffixes: Sequence[str],
    parts: Sequence[str] = (),
    check: Callable[[pathlib.Path], None] | None = None,
) -> Iterator[str]:
    """Yield a temporary name for ``path``, which it replaces when the block ends without an error.

    Args:
        path: File to write.
        suffixes: Suffixes allowed, with their dots.
        parts: Suffixes of files that belong to it; those that are not written anew are removed.
        check: As in :func:`warpriver.files.beside`.

    Raises:
        ValueError: Another suffix.
        OSError: The folder does not exist or cannot be written.
    """
    target = check_picture(path, suffixes)
    with beside(target, parts, check) as temporary:
        yield str(temporary)


def color_ramp(stops: Sequence[tuple[float, str]], values: Any) -> np.ndarray:
    """Interpolate a ramp of (position, "#rrggbb") stops at ``values`` in 0..1: (..., 3) floats in 0..1."""
    at = [p for p, _ in stops]
    rgb = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for _, c in stops]) / 255.0
    return np.stack([np.interp(values, at, rgb[:, k]) for k in range(3)], axis=-1)
