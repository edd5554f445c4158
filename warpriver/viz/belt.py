"""The channel belt: where the river has been, coloured by what it left there and how long ago."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.history import Avulsion, Collision, Cutoff, History, Split
from warpriver.hydrology.orders import strahler_order
from warpriver.kernels import covers
from warpriver.landscape.maps import Cover, Landscape
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.viz.bands import Window
from warpriver.viz.maps import (
    FLOW_RAMP,
    RELIEF_RAMP,
    VALUE_LABELS,
    add_channels,
    add_value_bar,
    channel_values,
    map_window,
    value_colors,
    value_norm,
)
from warpriver.viz.relief import relief_picture
from warpriver.viz.sheet import GROUND, INK, WATER, Sheet, check_drawing, color_ramp, make_sheet, style_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_before_after", "draw_belt"]

# Deposits run from bare sand through grass and willow to closed forest, lakes from open water to swamp.
DEPOSIT_RAMP = ((0.0, "#f3e7c6"), (0.1, "#e3d3a1"), (0.28, "#bcb877"), (0.55, "#83935a"), (1.0, "#496843"))
OXBOW_RAMP = ((0.0, "#5c98b8"), (0.12, "#86aeae"), (0.3, "#85a08a"), (0.6, "#607f5c"), (1.0, "#3f5c40"))

# A course that the water has left, for another channel or a new course, falls dry: bare gravel, then scrub.
DRY_RAMP = ((0.0, "#c99a72"), (0.15, "#b98a66"), (0.45, "#95805f"), (1.0, "#6f7356"))

# Events that are counted at the upper right.
COUNTED = (Cutoff, Collision, Split, Avulsion)

RELIEF_WATER = RELIEF_RAMP[1][1]

# Inches beside the bar of ages: for its labels; and for them, a scale bar and an arrow to the north.
LEGEND_GAP, MIN_LEGEND = 1.15, 3.2

# Fraction of the relief's shades that deposits carry; narrower courses are painted as wide as this many cells.
DEPOSIT_SHADE, MIN_CELLS = 0.6, 1.5

# Weights of a cell and its neighbours where they are blended.
SOFT_WEIGHTS = (0.2, 0.6, 0.2)

# Oxbow lakes narrow over so many widths at their ends; steps of a ramp.
TAPER_WIDTHS, RAMP_STEPS = 1.5, 1024

# Strength of the faint banding in time that the shades of age carry, so that scroll bars read as arcs.
SCROLL_STRENGTH = 0.075


@public
def draw_belt(
    history: History,
    path: str | os.PathLike[str] | None = None,
    *,
    terrain: Terrain | None = None,
    color: str = "water",
    until: int | None = None,
    window: Sequence[float] | None = None,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
    title: str | None = None,
    legend: bool = True,
    age_span: float | None = None,
    frame: bool = True,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Draw the channel belt: where the river has been, what it left there, and where it runs now.

    Colours are those of landscape maps, see :func:`warpriver.landscape_maps`, with a cell a pixel: ground that the
    channel moved over is a point-bar deposit whose shade tells how long ago the channel left it: sand where it is
    fresh, closed forest where it is old. Loops that were cut off lie among them as lakes that turn into swamp, and
    courses given up where two channels met, or where one left for a new course, as dry beds that scrub covers. The
    present channel is on top. A faint banding in time is added to the shades so that scroll bars read as arcs. Between
    two records a channel sweeps the ground, up to 6 widths; where it moved further, or was cut off, bare ground shows.

    Args:
        history: The run.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        terrain: Terrain whose shaded relief is drawn as the ground; by default the ground is plain.
        color: Colour of the present channels: "water", or by "discharge" (m3/s), "width" (m), "area" (drainage area,
            km2; where the networks have it) or Strahler "order", with a bar of it where there is room.
        until: Index of the record to show as the present (negative: from the end); by default the last.
        window: (west, south, east, north) to show, in m; by default everything. It grows where the page has
            room.
        size: Width and height of the picture in pixels; by default fitted to the window.
        dpi: Pixels per inch.
        title: Title at the upper left; None writes "Channel belt", "" leaves the line out.
        legend: Draw scale bar, north arrow and the bars of age.
        age_span: Age in yr at which deposits look oldest; by default the time that the whole history spans,
            so that pictures of one history can be compared.
        frame: False for the map alone, exactly the window (by default the terrain, or everything), as in
            :func:`draw_network`.
        ax: Axes of your own to draw on, without bars and scale.

    Returns:
        The figure, whose first axes are the map, in m; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: No record, a record that does not exist, an unknown ``color``, a window that shows nothing, a
            terrain elsewhere or in another CRS, an ``age_span`` that is not positive, or a file name with an unknown
            suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    record = checked_record(history, until)
    if age_span is not None and not age_span > 0.0:
        raise InputError(f"age_span is {age_span:g} yr; it must be positive")
    page = BeltSheet(
        history,
        window=window,
        size=size,
        dpi=dpi,
        title=title,
        legend=legend,
        age_span=age_span,
        terrain=terrain,
        color=color,
        frame=frame,
        ax=ax,
    )
    page.turn_to(record)
    if path is not None:
        page.sheet.save(path)
    return page.sheet.figure if ax is None else ax  # type: ignore[return-value]


@public
def draw_before_after(
    history: History,
    path: str | os.PathLike[str] | None = None,
    *,
    terrain: Terrain | None = None,
    color: str = "water",
    until: int | None = None,
    window: Sequence[float] | None = None,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
    title: str | None = None,
    ax: Sequence[Axes] | None = None,
) -> Figure | Sequence[Axes]:
    """Draw the first record and the last one of a history in two maps of the same extent, as :func:`draw_belt` does.

    The maps lie side by side or, where the river is long from west to east, one above the other.

    Args:
        history: The run.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        terrain: Terrain whose shaded relief is drawn as the ground; by default the ground is plain.
        color: Colour of the present channels: "water", or by "discharge" (m3/s), "width" (m), "area" (drainage area,
            km2; where the networks have it) or Strahler "order", with a bar of it where there is room.
        until: Index of the record to show second; by default the last.
        window: (west, south, east, north) to show, in m; by default everything. It grows where the page has room.
        size: Width and height of the picture in pixels; by default fitted to the window.
        dpi: Pixels per inch.
        title: Title at the upper left; None writes "Before and after", "" leaves the line out.
        ax: Two axes of your own to draw on, without bars and scale.

    Returns:
        The figure, whose first axes are the two maps, in m; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: As :func:`draw_belt`.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    record = checked_record(history, until)
    page = BeltSheet(
        history,
        window=window,
        size=size,
        dpi=dpi,
        title="Before and after" if title is None else title,
        legend=True,
        age_span=None,
        terrain=terrain,
        color=color,
        two=True,
        ax=ax,
    )
    page.turn_to(0, panel=0)
    page.turn_to(record, panel=1)
    if path is not None:
        page.sheet.save(path)
    return page.sheet.figure if ax is None else ax  # type: ignore[return-value]


class BeltSheet:
    """A page with the belt map, or two, each of which can be turned from one record to a later one."""

    def __init__(
        self,
        history: History,
        *,
        window: Sequence[float] | None = None,
        size: tuple[int, int] | None = None,
        dpi: float = 200.0,
        title: str | None = None,
        legend: bool = True,
        age_span: float | None = None,
        bounds: Window | None = None,
        terrain: Terrain | None = None,
        color: str = "water",
        two: bool = False,
        frame: bool = True,
        ax: Axes | Sequence[Axes] | None = None,
    ):
        """Lay out the page; parameters as in :func:`draw_belt`, ``bounds`` in m where they are known."""
        bounds = bounds or history_bounds(history, len(history.times) - 1)
        margin = 2.0 * float(np.max(history.networks[0].channel_width))
        if window is None and terrain is not None and not frame:
            window = terrain.bounds
        view = map_window(window, bounds, margin, terrain, getattr(history, "crs", None))
        text = "Channel belt" if title is None else title
        self._history = history
        self.sheet = make_sheet(
            view,
            ax=ax,
            frame=frame,
            size=size,
            dpi=dpi,
            title=text,
            legend=legend,
            two=two,
            cell=None if terrain is None else terrain.cell_size,
            crs=getattr(history, "crs", None),
        )
        self.age_span = default_age_span(history) if age_span is None else float(age_span)
        self._terrain = terrain
        self._painter: BeltPainter | None = None
        self._water_color = WATER if terrain is None else RELIEF_WATER
        self._ramp = FLOW_RAMP if terrain is None else RELIEF_RAMP
        self._color, self._norm = color, None
        ends = [_values(history.networks[k], color) for k in (0, -1)]
        if color != "water":
            self._norm = value_norm(np.concatenate([v for v in ends if v is not None]), whole=color == "order")
        blank = np.zeros((*self.sheet.shape, 3), np.uint8)
        self._images = [self.sheet.lay(blank, panel=k) for k in range(len(self.sheet.panels))]
        self._water: list[list[Any]] = [[] for _ in self.sheet.panels]
        self._notes = [self.sheet.note if text else None]
        if two:
            self._notes = [self._add_note(axes) for axes in self.sheet.panels]
        if legend and self.sheet.is_page:
            network = history.networks[0]
            longest = max(network.polylines(), key=len)
            # Several channels, and a ring, have no one direction.
            alone = network.channel_count == 1 and not network.channel_closed[0]
            self.sheet.add_scale_bar(flow=longest[-1] - longest[0] if alone else None)
            self._add_legend()

    @property
    def painter(self) -> BeltPainter:
        """What colours the ground; set one to share it with other pages, on which it shows at least as much."""
        if self._painter is None:
            place = self.sheet.window, self.sheet.shape
            self._painter = BeltPainter(self._history, *place, age_span=self.age_span, terrain=self._terrain)
        return self._painter

    @painter.setter
    def painter(self, painter: BeltPainter) -> None:
        self._painter = painter

    def pixels(self) -> np.ndarray:
        """Return the page as it is, (rows, columns, 3) uint8."""
        self.sheet.canvas.draw()
        return np.ascontiguousarray(np.asarray(self.sheet.canvas.buffer_rgba())[..., :3])

    def turn_to(self, record: int, panel: int = 0) -> None:
        """Show a record, the same one or a later one than before, in one of the maps."""
        painter = self.painter
        painter.advance(record)
        # Edges are soft where cells are pixels.
        soft = painter.cell_size > 0.75 * self.sheet.metres_per_pixel
        self._images[panel].set_data(_cut_out(painter.picture(record, soft), painter.window, self.sheet))
        for collection in self._water[panel]:
            collection.remove()
        network = self._history.networks[record]
        values, bank = _values(network, self._color), 0.7
        colors: Any = self._water_color
        if values is not None:
            colors, bank = value_colors(values, self._norm, self._ramp), 0.4
        axes = self.sheet.panels[panel]
        self._water[panel] = add_channels(self.sheet, network, colors, bank=bank, rank=values, axes=axes)
        note = self._notes[panel]
        if note is not None:
            time = float(self._history.times[record])
            words = [f"year {time:,.{0 if self.age_span >= 50.0 else 1}f}"]
            for kind in COUNTED:
                count = int((self._history.events.of(kind).times <= time).sum())
                words += [f"{count:,} {kind.kind}{'s' if count > 1 else ''}"] if count else []
            note.set_text(", ".join(words))

    def _add_note(self, axes: Any) -> Any:
        """Add an empty label in the upper left corner of a map."""
        rows, columns = self.sheet.shape
        inch = self.sheet.dpi
        place = (0.08 * inch / columns, 1.0 - 0.08 * inch / rows)
        box = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.82}
        return axes.text(
            *place, "", transform=axes.transAxes, fontsize=9, color=INK, va="top", ha="left", bbox=box, zorder=9
        )

    def _add_legend(self) -> None:
        """Draw the ramps over one axis of age at the right of the strip."""
        from matplotlib.ticker import MaxNLocator

        rows: list[tuple[str, Sequence[tuple[float, str]]]] = [
            ("oxbow lakes", OXBOW_RAMP),
            ("point bars", DEPOSIT_RAMP),
        ]
        if DRY_RAMP in belt_ramps(self._history):
            rows.insert(0, ("dry courses", DRY_RAMP))
        ramp = np.linspace(0.0, 1.0, 256)
        image = np.stack([color_ramp(stops, ramp) for _, stops in rows])
        width, count = self.sheet.legend_width, len(rows)
        box = self.sheet.strip(-width, 0.36, width, 0.34 if count == 2 else 0.44)
        box.imshow(
            image,
            extent=(0.0, self.age_span, 0.0, count),
            origin="lower",
            aspect="auto",
            interpolation="nearest",
        )
        for level in range(1, count):
            box.axhline(level, color="white", linewidth=1.2)
        box.set_yticks(np.arange(count) + 0.5, [name for name, _ in rows])
        box.xaxis.set_major_locator(MaxNLocator(nbins=max(2, round(1.6 * width)), steps=[1, 2, 5, 10]))
        style_bar(box)
        box.tick_params(axis="y", length=0, pad=4, labelsize=8.5)
        box.set_xlabel("years since the channel left", fontsize=8.5, color=INK, labelpad=2)
        if self._norm is not None and self.sheet.across > 2.0 * width + MIN_LEGEND:
            add_value_bar(self.sheet, self._norm, VALUE_LABELS[self._color], self._ramp, right=width + LEGEND_GAP)


def _values(network: RiverNetwork, color: str) -> np.ndarray | None:
    """Return the value of each channel that sets its colour, None for one colour."""
    order = strahler_order(network.channel_from, network.channel_to) if color == "order" else None
    return channel_values(network, color, order)


def share_painter(pages: Sequence[BeltSheet], history: History, terrain: Terrain | None = None) -> None:
    """Let pages have one painter, as fine as the finest of them needs."""
    boxes = np.array([page.sheet.window for page in pages])
    west, south = boxes[:, :2].min(axis=0).tolist()
    east, north = boxes[:, 2:].max(axis=0).tolist()
    pixel = min(page.sheet.metres_per_pixel for page in pages)
    shape = round((north - south) / pixel), round((east - west) / pixel)
    painter = BeltPainter(history, (west, south, east, north), shape, terrain=terrain)
    for page in pages:
        page.painter = painter


def _cut_out(pixels: np.ndarray, window: Window, sheet: Sheet) -> np.ndarray:
    """Return the part of a picture of a window that a sheet shows, in its pixels."""
    if window == sheet.window and pixels.shape[:2] == sheet.shape:
        return pixels
    from PIL import Image

    rows, columns = pixels.shape[:2]
    west, south, east, north = sheet.window
    across, down = columns / (window[2] - window[0]), rows / (window[3] - window[1])
    left, right = (min(max(across * (x - window[0]), 0.0), float(columns)) for x in (west, east))
    top, bottom = (min(max(down * (window[3] - y), 0.0), float(rows)) for y in (north, south))
    size = sheet.shape[1], sheet.shape[0]
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.HAMMING, box=(left, top, right, bottom)))


class BeltPainter:
    """Colours the ground by what has covered it last, a course, an oxbow lake or a dry bed, and how long ago.

    The cells of landscape maps are led from record to record, so that movies take no longer than their last picture.

    Attributes:
        network: The network at the present record, None before the first.
        age_span: Age in yr at which deposits look oldest.
        window: (west, south, east, north) of the picture, m.
        cell_size: Side of a cell, m.
    """

    def __init__(
        self,
        history: History,
        window: Window,
        shape: tuple[int, int],
        *,
        age_span: float | None = None,
        terrain: Terrain | None = None,
        strength: float = 1.0,
    ):
        """Prepare an empty floodplain.

        Args:
            history: The run.
            window: (west, south, east, north) of the picture, m.
            shape: (rows, columns) in pixels.
            age_span: Age in yr at which deposits look oldest; by default the time that the history spans.
            terrain: Terrain whose relief is the ground, or None for a plain one.
            strength: Strength of its shades.
        """
        self._history = history
        self._times = np.asarray(history.times, np.float64)
        self.age_span = default_age_span(history) if age_span is None else float(age_span)
        self.window = window
        rows, columns = shape
        # Square cells from the north-western corner on.
        cell = max((window[2] - window[0]) / columns, (window[3] - window[1]) / rows)
        self.cell_size = cell
        west, north = window[0], window[3]
        bounds = (west, north - rows * cell, west + columns * cell, north)
        self._landscape = Landscape(history, None, cell, bounds=bounds, narrowest=MIN_CELLS * cell, counted=False)
        self.network: RiverNetwork | None = None
        self._noise = vegetation_noise(shape)
        # Where there is data: the relief; elsewhere the plain ground.
        plain = 255.0 * color_ramp(((0.0, GROUND),), 0.0)
        self._shade: np.ndarray | None = None
        if terrain is None:
            self._ground = (plain * (1.0 + 0.02 * self._noise)[..., None]).astype(np.float32)
        else:
            relief = relief_picture(terrain, window, shape, strength=strength)
            relief.color[~relief.known] = plain
            relief.shade[~relief.known] = 1.0
            self._ground = (relief.color * (1.0 + 0.015 * self._noise)[..., None]).astype(np.float32)
            self._shade = 1.0 + DEPOSIT_SHADE * (relief.shade - 1.0)

    def advance(self, record: int) -> None:
        """Lead the cells up to ``record``; going back is not possible."""
        self._landscape.lead_to(record)
        if self._landscape.record == record:
            self.network = self._history.networks[record]

    def cover(self) -> Cover:
        """Return what has covered each cell last, and when."""
        return self._landscape.cover()

    def lakes(self, record: int) -> Iterator[tuple[np.ndarray, float, float, np.ndarray]]:
        """Yield the oxbow lakes so far that are still in sight somewhere.

        Args:
            record: Index of the present record.

        Yields:
            Line (n, 2) in m, width in m, age as a fraction of the age span, and an (n,) mask of the points in
            sight.
        """
        cover, now = self.cover(), self._times[record]
        rows, columns = cover.kind.shape
        for cutoff in self._history.cutoffs:
            if cutoff.time > now:
                continue
            xy = np.asarray(cutoff.xy, np.float64)
            column = np.floor((xy[:, 0] - self.window[0]) / self.cell_size).astype(np.int64)
            row = np.floor((self.window[3] - xy[:, 1]) / self.cell_size).astype(np.int64)
            inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
            place = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)
            seen = inside & (cover.kind[place] == covers.OXBOW) & (cover.left[place] == cutoff.time)
            if seen.any():
                yield xy, float(cutoff.width), float(np.clip((now - cutoff.time) / self.age_span, 0.0, 1.0)), seen

    def picture(self, record: int, soft: bool = False) -> np.ndarray:
        """Return the belt at a record without its channel, (rows, columns, 3) uint8, row 0 in the north.

        Args:
            record: Index of the record that the cells are at.
            soft: Blend cells with their neighbours.
        """
        cover = self.cover()
        place = np.flatnonzero(cover.kind != covers.NOTHING)
        kind, left = cover.kind.ravel()[place], cover.left.ravel()[place]
        left[cover.is_channel.ravel()[place]] = self._times[record]
        age = np.clip((self._times[record] - left) / self.age_span, 0.0, 1.0)
        # Red, green, blue, and how mottled it is by plants.
        tint = np.empty((len(place), 4), np.float32)
        tint[:, :3], tint[:, 3] = _ramped(DEPOSIT_RAMP, age), 0.25 + 0.75 * age
        tint[:, :3] *= 1.0 + _scroll_tone(left - self._times[0], self.age_span)[:, None]
        # A lake narrows towards its ends, where plugs of sand are laid down first.
        tapered = 0.15 + 0.85 * np.sqrt(np.clip(cover.from_end.ravel()[place] / TAPER_WIDTHS, 0.0, 1.0))
        lake = (kind == covers.OXBOW) & (cover.across.ravel()[place] <= 0.5 * tapered)
        dry = kind == covers.ABANDONED
        for some, ramp, fresh, grown in ((lake, OXBOW_RAMP, 0.0, 0.6), (dry, DRY_RAMP, 0.2, 0.7)):
            tint[some, :3], tint[some, 3] = _ramped(ramp, age[some]), fresh + grown * age[some]
        if soft:
            belt, mottled = self._blended(place, tint)
        else:
            belt, mottled = place, np.pad(tint, ((0, 0), (0, 1)), constant_values=1.0)
        tone = 1.0 + 0.05 * self._noise.reshape(-1)[belt] * mottled[:, 3]
        if self._shade is not None:
            tone *= self._shade.reshape(-1)[belt]
        color = self._ground.copy()
        flat = color.reshape(-1, 3)
        # The last column is the part of the pixel that deposits cover.
        flat[belt] = 255.0 * mottled[:, :3] * tone[:, None] + (1.0 - mottled[:, 4:]) * flat[belt]
        return self._bytes(color)

    def _blended(self, place: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Blend the values of some cells, (n,) flat and (n, k), with those of their neighbours.

        Returns:
            (m,) pixels that hold any of these cells, and their values (m, k + 1), of which the last is how much of a
            pixel these cells take up; the others count as 0.
        """
        with IMPORTING:
            from scipy.ndimage import correlate1d

        spread = np.zeros((self._noise.size, values.shape[1] + 1), np.float32)
        spread[place, :-1], spread[place, -1] = values, 1.0
        image = spread.reshape(*self._noise.shape, -1)
        for axis in (0, 1):
            image = correlate1d(image, SOFT_WEIGHTS, axis, mode="nearest")
        pixel = np.flatnonzero(image[..., -1])
        return pixel, image.reshape(spread.shape)[pixel]

    @staticmethod
    def _bytes(color: np.ndarray) -> np.ndarray:
        rgb: np.ndarray = np.clip(color, 0.0, 255.0).astype(np.uint8)
        return rgb


def _ramped(stops: Sequence[tuple[float, str]], part: np.ndarray) -> np.ndarray:
    """Return the colours of a ramp at parts of it, (n, 3), in as many steps as can be told apart."""
    table = color_ramp(stops, np.linspace(0.0, 1.0, RAMP_STEPS)).astype(np.float32)
    return np.asarray(table[np.round(part * (RAMP_STEPS - 1)).astype(np.int32)])


def _scroll_tone(times: np.ndarray, span: float) -> np.ndarray:
    """Return a small change of tone by the time since the beginning, a smooth function with several periods."""
    phase = 2.0 * np.pi * times / span
    waves = 0.5 * np.sin(13.0 * phase) + 0.3 * np.sin(29.3 * phase + 1.0) + 0.4 * np.sin(47.9 * phase + 2.0)
    tone: np.ndarray = SCROLL_STRENGTH * waves
    return tone


def vegetation_noise(shape: tuple[int, int]) -> np.ndarray:
    """Return a mottling of the ground with mean 0 and spread 1, the same for the same shape: float32."""
    with IMPORTING:
        from scipy.ndimage import gaussian_filter, zoom

    random = np.random.default_rng(7)
    total = np.zeros(shape, np.float32)
    for size, weight in ((1, 0.6), (3, 0.8), (9, 0.6)):
        coarse = (shape[0] // size + 4, shape[1] // size + 4)
        layer = gaussian_filter(random.standard_normal(coarse).astype(np.float32), 0.8)
        if size > 1:
            layer = zoom(layer, size, order=1)
        total += weight * layer[: shape[0], : shape[1]] / layer.std()
    noise: np.ndarray = (total - total.mean()) / total.std()
    return noise


# ---- histories


def belt_ramps(history: History) -> tuple[Sequence[tuple[float, str]], ...]:
    """Return the ramps of age of what a history holds: bars, lakes, and dry beds where channels left any."""
    dry = len(history.events.of(Collision, Avulsion)) > 0
    return (DEPOSIT_RAMP, OXBOW_RAMP, DRY_RAMP) if dry else (DEPOSIT_RAMP, OXBOW_RAMP)


def checked_record(history: History, until: int | None) -> int:
    """Return the index of a record, counted from the end where negative.

    Raises:
        ValueError: The history has no record of that index.
    """
    count = len(history.times)
    if count == 0:
        raise InputError("the history holds no record; run the simulation first")
    record = count - 1 if until is None else int(until)
    if not -count <= record < count:
        raise InputError(f"until is {until}, but the history holds records 0 to {count - 1}")
    return record % count


def default_age_span(history: History) -> float:
    """Return the time in yr that a history spans, 1 for a single record."""
    times = np.asarray(history.times, np.float64)
    return float(times[-1] - times[0]) if times[-1] > times[0] else 1.0


def history_bounds(history: History, until: int) -> Window:
    """Return (west, south, east, north) in m of all courses up to a record, widths included."""
    boxes = []
    for k in range(until + 1):
        network = history.networks[k]
        reach = 0.5 * float(np.max(network.channel_width))
        west, south, east, north = network.bounds()
        boxes.append((west - reach, south - reach, east + reach, north + reach))
    low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
    return float(low[0]), float(low[1]), float(high[2]), float(high[3])
