"""The channel belt: where the river has been, painted course by course and coloured by age."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.history import History
from warpriver.hydrology.orders import strahler_order
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.viz.bands import Window, band_outlines, refine_lines, select_inside, taper_ends
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
from warpriver.viz.sheet import GROUND, INK, WATER, check_drawing, color_ramp, make_sheet, style_bar
from warpriver.viz.sweeps import STAGES, courses_between

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
COUNTED = ("cutoff", "collision", "split", "avulsion")

RELIEF_WATER = RELIEF_RAMP[1][1]

# Inches beside the bar of ages: for its labels; and for them, a scale bar and an arrow to the north.
LEGEND_GAP, MIN_LEGEND = 1.15, 3.2

# Fraction of the relief's shades that deposits carry; narrower courses are painted as wide as this many samples.
DEPOSIT_SHADE, MIN_SAMPLES = 0.6, 1.5

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

    Each recorded course is drawn at its true width, in the order of time, as a point-bar deposit whose shade
    tells how long ago the channel left it: sand where it is fresh, closed forest where it is old. Loops that
    were cut off lie among them as lakes that turn into swamp, and courses given up where two channels met, or where one
    left for a new course, as dry beds that scrub covers. The present channel is on top. A faint banding in time is
    added to the shades so that scroll bars read as arcs. Between two records the channel is taken to have moved in
    straight lines, up to a dozen widths; where it moved further, or was cut off, bare ground shows.

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
        window: Sequence[float] | None,
        size: tuple[int, int] | None,
        dpi: float,
        title: str | None,
        legend: bool,
        age_span: float | None,
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
        self.painter = BeltPainter(history, self.sheet.window, self.sheet.shape, age_span=age_span, terrain=terrain)
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

    def turn_to(self, record: int, panel: int = 0) -> None:
        """Show a record, the same one or a later one than before, in one of the maps."""
        self.painter.advance(record)
        self._images[panel].set_data(self.painter.picture(record))
        for collection in self._water[panel]:
            collection.remove()
        network = self.painter.network
        assert network is not None
        values, bank = _values(network, self._color), 0.7
        colors: Any = self._water_color
        if values is not None:
            colors, bank = value_colors(values, self._norm, self._ramp), 0.4
        axes = self.sheet.panels[panel]
        self._water[panel] = add_channels(self.sheet, network, colors, bank=bank, rank=values, axes=axes)
        note = self._notes[panel]
        if note is not None:
            time = float(self._history.times[record])
            words = [f"year {time:,.{0 if self.painter.age_span >= 50.0 else 1}f}"]
            for name in COUNTED:
                count = sum(event.time <= time for event in getattr(self._history, f"{name}s", ()))
                words += [f"{count:,} {name}{'s' if count > 1 else ''}"] if count else []
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
        if abandoned_beds(self._history):
            rows.insert(0, ("dry courses", DRY_RAMP))
        ramp = np.linspace(0.0, 1.0, 256)
        image = np.stack([color_ramp(stops, ramp) for _, stops in rows])
        width, count = self.sheet.legend_width, len(rows)
        box = self.sheet.strip(-width, 0.36, width, 0.34 if count == 2 else 0.44)
        box.imshow(
            image,
            extent=(0.0, self.painter.age_span, 0.0, count),
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


class BeltPainter:
    """Paints which course, oxbow lake or dry bed covered each pixel last, and colours the pixels by its age.

    A course costs one filled path and a picture one look-up, however many records came before: this is what
    makes movies linear in the number of frames.

    Attributes:
        network: The network painted last, None before the first.
        age_span: Age in yr at which deposits look oldest.
    """

    def __init__(
        self,
        history: History,
        window: Window,
        shape: tuple[int, int],
        *,
        supersample: int = 2,
        age_span: float | None = None,
        terrain: Terrain | None = None,
        strength: float = 1.0,
    ):
        """Prepare an empty floodplain.

        Args:
            history: The run.
            window: (west, south, east, north) of the picture, m.
            shape: (rows, columns) in pixels.
            supersample: Samples per pixel and direction.
            age_span: Age in yr at which deposits look oldest; by default the time that the history spans.
            terrain: Terrain whose relief is the ground, or None for a plain one.
            strength: Strength of its shades.
        """
        from matplotlib.backends.backend_agg import RendererAgg

        self._history = history
        self._times = np.asarray(history.times, np.float64)
        self.age_span = default_age_span(history) if age_span is None else float(age_span)
        self._window = window
        self._factor = supersample
        rows, columns = shape[0] * supersample, shape[1] * supersample
        self._renderer = RendererAgg(columns, rows, 72)
        self._pen = self._renderer.new_gc()
        self._pen.set_linewidth(0.0)
        self._pen.set_antialiased(False)
        self._scale = columns / (window[2] - window[0])
        self._cutoffs = sorted(history.cutoffs, key=lambda cutoff: cutoff.time)
        self._cutoff_times = np.array([cutoff.time for cutoff in self._cutoffs])
        self.network: RiverNetwork | None = None
        self._courses = 0
        self._oxbows = 0
        self._abandoned = abandoned_beds(history)
        self._abandoned_times = np.array([event.time for event in self._abandoned])
        self._beds = 0
        self._noise = vegetation_noise(shape)
        # Where there is data: the relief; elsewhere the plain ground.
        self._relief: Any = None
        if terrain is not None:
            self._relief = relief_picture(terrain, window, shape, strength=strength)
            plain = 255.0 * color_ramp(((0.0, GROUND),), 0.0)
            self._relief.color[~self._relief.known] = plain
            self._relief.shade[~self._relief.known] = 1.0
            self._relief.color[:] *= (1.0 + 0.015 * self._noise)[..., None]

    def advance(self, record: int) -> None:
        """Paint all courses up to ``record`` and all loops cut off until then; going back is not possible."""
        while self._courses <= record:
            time, following = self._times[self._courses], self._history.networks[self._courses]
            if self.network is not None:
                for stage, lines, widths in courses_between(self.network, following):
                    self._fill(lines, widths, self.course_number(self._courses - 1) + stage)
            while self._oxbows < len(self._cutoffs) and self._cutoff_times[self._oxbows] <= time:
                cutoff = self._cutoffs[self._oxbows]
                xy = np.asarray(cutoff.xy, np.float64)
                if len(xy) >= 3:
                    self._fill([xy], [taper_ends(xy, float(cutoff.width))], self.oxbow_number(self._oxbows))
                self._oxbows += 1
            while self._beds < len(self._abandoned) and self._abandoned_times[self._beds] <= time:
                self._fill_bed(self._abandoned[self._beds])
                self._beds += 1
            self._fill(
                following.polylines(close=True), following.point_widths(close=True), self.course_number(self._courses)
            )
            self.network = following
            self._courses += 1

    def course_number(self, record: int) -> int:
        """Number of the course of a record; those of the stages on the way to the next record follow it."""
        return 1 + STAGES * record

    def oxbow_number(self, cutoff: int) -> int:
        """Number of the lake that a cutoff left."""
        return self.course_number(len(self._times)) + cutoff

    def bed_number(self, bed: int) -> int:
        """Number of a dry bed, which a collision or an avulsion left."""
        return self.oxbow_number(len(self._cutoffs)) + bed

    def _fill_bed(self, event: Any) -> None:
        """Fill the course that was given up in a collision or an avulsion."""
        pieces = event.pieces() if hasattr(event, "pieces") else [event.xy]
        lines = [np.asarray(xy, np.float64) for xy in pieces if len(xy) >= 2]
        code = self.bed_number(self._beds)
        self._fill(lines, [np.full(len(xy), float(event.width)) for xy in lines], code)

    def _fill(self, lines: Sequence[np.ndarray], widths: Sequence[np.ndarray], code: int) -> None:
        """Fill the bands of some lines with the number of a course, an oxbow lake or a dry bed."""
        from matplotlib.path import Path
        from matplotlib.transforms import Affine2D

        lines, widths = select_inside(lines, widths, self._window)
        if not lines:
            return
        smallest = MIN_SAMPLES / self._scale
        widths = [np.maximum(width, smallest) for width in widths]
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
            Line (n, 2) in m, width in m, age as a fraction of the age span, and an (n,) mask of the points in
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
            seen = inside & (code == self.oxbow_number(k))
            if seen.any():
                age = (self._times[record] - cutoff.time) / self.age_span
                yield xy, float(cutoff.width), float(np.clip(age, 0.0, 1.0)), seen

    def picture(self, record: int) -> np.ndarray:
        """Return the belt at a record without its channel, (rows, columns, 3) uint8, row 0 in the north."""
        now = self._times[record]
        share = np.arange(STAGES) / STAGES
        step = np.diff(self._times, append=self._times[-1])
        courses_at = (self._times[:, None] + share * step[:, None]).ravel()
        age = (now - np.concatenate([courses_at, self._cutoff_times, self._abandoned_times])) / self.age_span
        age = np.clip(age, 0.0, 1.0)
        courses = slice(1, self.oxbow_number(0))
        oxbows = slice(courses.stop, courses.stop + len(self._cutoffs))
        beds = slice(oxbows.stop, 1 + len(age))
        age = np.concatenate([[0.0], age])
        table = np.zeros((len(age), 4))
        table[0, :3], table[0, 3] = color_ramp(((0.0, GROUND),), 0.0), 0.4
        table[courses, :3] = color_ramp(DEPOSIT_RAMP, age[courses])
        table[courses, :3] *= 1.0 + _scroll_tone(courses_at, self.age_span)[:, None]
        table[courses, 3] = 0.25 + 0.75 * age[courses]
        table[oxbows, :3] = color_ramp(OXBOW_RAMP, age[oxbows])
        table[oxbows, 3] = 0.6 * age[oxbows]
        table[beds, :3] = color_ramp(DRY_RAMP, age[beds])
        table[beds, 3] = 0.2 + 0.7 * age[beds]
        if self._relief is not None:
            table[0] = 0.0
        words = np.round(255.0 * np.clip(table, 0.0, 1.0)).astype(np.uint8).view(np.uint32)[:, 0]
        cover = self.cover()
        mean = _box_mean(words[cover].view(np.uint8).reshape(*cover.shape, 4), self._factor)
        tone = 1.0 + 0.05 * self._noise * mean[..., 3] / 255.0
        if self._relief is None:
            return self._bytes(mean[..., :3] * tone[..., None])
        bare = _box_mean((cover == 0).astype(np.uint8)[..., None], self._factor)
        tone *= 1.0 + DEPOSIT_SHADE * (self._relief.shade - 1.0)
        return self._bytes(mean[..., :3] * tone[..., None] + bare * self._relief.color)

    @staticmethod
    def _bytes(color: np.ndarray) -> np.ndarray:
        rgb: np.ndarray = np.clip(color, 0.0, 255.0).astype(np.uint8)
        return rgb


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


def abandoned_beds(history: History) -> list[Any]:
    """Return the events that left dry beds, collisions and avulsions, in the order of time."""
    events = [*getattr(history, "collisions", ()), *getattr(history, "avulsions", ())]
    return sorted(events, key=lambda event: event.time)


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
