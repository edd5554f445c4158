"""Pictures of landscapes: the ground that a river has made, in the colours of an aerial photograph, or single maps."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.history import Cutoff, History
from warpriver.landscape import PLANTS, LandscapeMaps, LandscapeParams, landscape_maps
from warpriver.landscape.falloff import smoothstep
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.validate import shown
from warpriver.viz.belt import checked_record, history_bounds
from warpriver.viz.maps import map_window
from warpriver.viz.relief import relief_picture
from warpriver.viz.sheet import INK, Sheet, check_drawing, color_ramp, make_sheet, style_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["LANDSCAPE_LAYERS", "LandscapeSheet", "draw_landscape", "landscape_picture"]

# Maps that are drawn by themselves: what their bar says, and their ramp.
LANDSCAPE_LAYERS: dict[str, tuple[str, Sequence[tuple[float, str]]]] = {
    "moisture": (
        "moisture",
        ((0.0, "#efe9d8"), (0.25, "#c9dbcf"), (0.55, "#6fa8b4"), (0.8, "#2f6f95"), (1.0, "#173f6b")),
    ),
    "sediment": (
        "deposits, m",
        ((0.0, "#f4f1e8"), (0.3, "#ead9ae"), (0.6, "#cf9f5c"), (0.85, "#9a6233"), (1.0, "#5d3419")),
    ),
    "vegetation": (
        "density of vegetation",
        ((0.0, "#f0ead6"), (0.3, "#c7cf94"), (0.6, "#7fa257"), (1.0, "#24512b")),
    ),
    "age": (
        "years since the channel left",
        ((0.0, "#fff3c4"), (0.2, "#f3b562"), (0.5, "#c65f4f"), (0.8, "#6f3a6d"), (1.0, "#2c2350")),
    ),
    "occupied": ("years under a channel", ((0.0, "#f3f1ea"), (0.15, "#b9d3d8"), (0.5, "#4f8fa8"), (1.0, "#12395c"))),
    "elevation_change": ("change of height, m", ((0.0, "#3d5f86"), (0.5, "#f2efe6"), (1.0, "#8f5a2b"))),
    "sand": ("fraction of sand", ((0.0, "#5b5347"), (0.5, "#b39d72"), (1.0, "#f6e7b8"))),
}

# Colours of the picture: ground without water, moist ground, sand, mud, plants, water.
DRY, MOIST, SAND, WET_SAND, MUD = "#c2b58c", "#8f8a5e", "#ecdfba", "#cdbb8d", "#857657"
GRASS, WILLOW, FOREST, LUSH, MARSH = "#a3a265", "#8c9a55", "#4b6638", "#34582f", "#6d7c48"
RIVER, DEEP, LAKE, POND = "#5d93a3", "#2f6480", "#3f7480", "#566f58"
# Sizes of crowns and of groves, m, where pixels can show them.
CROWN, GROVE = 12.0, 160.0
# Time in which sand becomes soil, yr.
SOIL_TIME = 30.0
# Brightness of a bank that is cut, beside the water.
CUT_BANK = 0.72
# Slope of the ground's small forms, at which they are shaded strongly, after they are exaggerated.
SHADED_SLOPE, SHADE = 0.5, 0.28


@public
def draw_landscape(
    history: History,
    path: str | os.PathLike[str] | None = None,
    *,
    layer: str = "natural",
    terrain: Terrain | None = None,
    params: LandscapeParams | None = None,
    until: int | None = None,
    window: Sequence[float] | None = None,
    size: tuple[int, int] | None = None,
    dpi: float = 200.0,
    title: str | None = None,
    legend: bool = True,
    frame: bool = True,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Draw the landscape that a river has made, as seen from above.

    Fresh sand lies on the inner side of bends, pioneers, willows and forest cover it as it grows older, and scroll bars
    show in relief and in the plants. Loops that were cut off are lakes that turn into swamp from their ends. Maps are
    made with a cell a pixel, see :func:`warpriver.landscape_maps`.

    Args:
        history: The run.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        layer: "natural", or one map with a bar: "moisture", "sediment", "vegetation", "age", "occupied",
            "elevation_change" or "sand".
        terrain: Terrain whose shaded relief is the ground; by default that is plain.
        params: Constants of the maps.
        until: Index of the record to show as the present (negative: from the end); by default the last.
        window: (west, south, east, north) to show, in m; by default everything. It grows where the page has room.
        size: Width and height of the picture in pixels; by default fitted to the window.
        dpi: Pixels per inch.
        title: Title at the upper left; None writes one, "" leaves the line out.
        legend: Draw scale bar, north arrow and a key or the bar.
        frame: False for the map alone, exactly the window, as in :func:`draw_network`.
        ax: Axes of your own to draw on, without scale and key.

    Returns:
        The figure, whose first axes are the map, in m; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: No record, a record that does not exist, another layer, a window that shows nothing, a terrain
            elsewhere or in another CRS, or a file name with an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    if layer != "natural" and layer not in LANDSCAPE_LAYERS:
        raise InputError(f"layer is {shown(layer)}; use 'natural', {', '.join(map(repr, LANDSCAPE_LAYERS))}")
    record = checked_record(history, until)
    page = LandscapeSheet(
        history, layer, terrain, params, record, window=window, size=size, dpi=dpi, title=title, legend=legend,
        frame=frame, ax=ax,
    )  # fmt: skip
    page.show(landscape_maps(history, terrain, page.cell_size, params=params, bounds=page.sheet.window, until=record))
    if legend and page.sheet.is_page:
        page.add_legend()
    if path is not None:
        page.sheet.save(path)
    return page.sheet.figure if ax is None else ax  # type: ignore[return-value]


class LandscapeSheet:
    """A page with the picture of a landscape, which can be shown at one time after the other."""

    def __init__(
        self,
        history: History,
        layer: str,
        terrain: Terrain | None,
        params: LandscapeParams | None,
        record: int,
        *,
        window: Sequence[float] | None,
        size: tuple[int, int] | None,
        dpi: float,
        title: str | None,
        legend: bool,
        frame: bool,
        ax: Axes | None,
    ):
        """Lay out the page; parameters as in :func:`draw_landscape`."""
        bounds = history_bounds(history, record)
        margin = 6.0 * float(np.max(history.networks[record].channel_width))
        if window is None and terrain is not None and not frame:
            window = terrain.bounds
        view = map_window(window, bounds, margin, terrain, history.crs)
        words = "Landscape" if layer == "natural" else LANDSCAPE_LAYERS[layer][0].capitalize()
        self._history, self._layer, self._terrain = history, layer, terrain
        self.sheet: Sheet = make_sheet(
            view, ax=ax, frame=frame, size=size, dpi=dpi, title=words if title is None else title, legend=legend,
            cell=None if terrain is None else terrain.cell_size, crs=history.crs,
        )  # fmt: skip
        west, south, east, north = self.sheet.window
        rows, columns = self.sheet.shape
        # Square, and no more of them than pixels.
        self.cell_size = max((east - west) / columns, (north - south) / rows)
        self._image: Any = None
        self._limits = (0.0, 1.0)

    def show(self, maps: LandscapeMaps) -> None:
        """Show maps that were made in the window of the sheet."""
        if self._layer == "natural":
            pixels = landscape_picture(maps, self._terrain)
        else:
            pixels, self._limits = layer_picture(maps, self._layer)
        if self._image is None:
            self._image = self.sheet.lay(pixels)
        else:
            self._image.set_data(pixels)
        cutoffs = int((self._history.events.of(Cutoff).times <= maps.time).sum())
        words = f"year {maps.time:,.0f}" + (f", {cutoffs:,} cutoffs" if cutoffs else "")
        self.sheet.note.set_text(words)

    def add_legend(self) -> None:
        """Draw the scale bar, and a key of the ground or the bar of the layer."""
        self.sheet.add_scale_bar()
        width = self.sheet.legend_width
        if self._layer != "natural":
            box = self.sheet.strip(-width, 0.42, width, 0.18)
            ramp = color_ramp(LANDSCAPE_LAYERS[self._layer][1], np.linspace(0.0, 1.0, 256))[None]
            box.imshow(ramp, extent=(*self._limits, 0.0, 1.0), aspect="auto", interpolation="nearest")
            box.set_yticks([])
            style_bar(box)
            box.set_xlabel(LANDSCAPE_LAYERS[self._layer][0], fontsize=8.5, color=INK, labelpad=2)
            return
        key = (
            ("water", RIVER), ("oxbow lake", LAKE), ("point bar", SAND), ("willows", WILLOW), ("forest", FOREST),
            ("swamp", MARSH), ("grassland", GRASS),
        )  # fmt: skip
        from matplotlib.patches import Rectangle

        span = 0.95 * len(key)
        span = min(span, self.sheet.across - 2.2)
        box = self.sheet.strip(-span, 0.3, span, 0.5)
        box.set(xlim=(0.0, len(key)), ylim=(0.0, 1.0))
        box.axis("off")
        for k, (word, color) in enumerate(key):
            box.add_patch(Rectangle((k + 0.02, 0.5), 0.9, 0.36, facecolor=color, edgecolor=INK, linewidth=0.4))
            box.text(k + 0.47, 0.36, word, fontsize=7.5, color=INK, ha="center", va="top")


def layer_picture(maps: LandscapeMaps, layer: str) -> tuple[np.ndarray, tuple[float, float]]:
    """Return one map in its colours, (rows, columns, 3) uint8, and the values at the ends of its ramp."""
    values = maps.rasters[layer].numpy().astype(np.float64)
    known = np.isfinite(values)
    seen = values[known]
    low, high = (float(seen.min()), float(np.percentile(seen, 99.8))) if len(seen) else (0.0, 1.0)
    if layer == "elevation_change":
        high = max(abs(low), abs(high), 1e-9)
        low = -high
    elif layer in ("vegetation", "sand"):
        low, high = 0.0, 1.0
    else:
        low, high = 0.0, max(high, 1e-9)
    part = np.clip((np.where(known, values, low) - low) / (high - low), 0.0, 1.0)
    color = color_ramp(LANDSCAPE_LAYERS[layer][1], part)
    color[~known] = np.array([0.953, 0.945, 0.918])
    tone = 1.0 + 0.5 * SHADE * _shade(maps.elevation_change.numpy(), maps.age.cell_size)
    water = _channel_cover(maps)[..., None]
    color = (1.0 - water) * np.clip(color * tone[..., None], 0.0, 1.0) + water * _rgb(DEEP)
    return np.round(255.0 * color).astype(np.uint8), (low, high)


def landscape_picture(maps: LandscapeMaps, terrain: Terrain | None = None, *, strength: float = 1.0) -> np.ndarray:
    """Return a landscape in the colours of an aerial photograph, (rows, columns, 3) uint8, row 0 in the north.

    Args:
        maps: The maps; a pixel is a cell.
        terrain: Terrain whose relief is the ground, or None.
        strength: Strength of the shades of the terrain.
    """
    cell, shape = maps.age.cell_size, maps.age.shape
    plants, ground = maps.plants.numpy(), maps.ground.numpy()
    moist = smoothstep(maps.moisture.numpy())
    density, sand = maps.vegetation.numpy(), np.nan_to_num(maps.sand.numpy(), nan=0.3)
    age = np.nan_to_num(maps.age.numpy(), nan=np.inf)
    fine, broad = _noise(shape, max(0.9, CROWN / cell), 3), _noise(shape, max(4.0, GROVE / cell), 5)
    color = _mix(_rgb(DRY), _rgb(MOIST), moist)
    touched = np.isfinite(maps.sand.numpy()) & np.isfinite(maps.age.numpy())
    bed = _mix(_mix(_rgb(MUD), _rgb(WET_SAND), sand), _rgb(SAND), np.where(sand > 0.5, 1.0 - moist * 0.3, 0.0))
    # Under old woods the sand has become soil.
    bed = _mix(bed, _mix(_rgb(DRY), _rgb(MOIST), moist), 1.0 - np.exp(-np.minimum(age, 1e4) / SOIL_TIME))
    color = np.where(touched[..., None], bed, color)
    if terrain is not None:
        relief = relief_picture(terrain, maps.age.bounds, shape, strength=strength)
        known = relief.known[..., None]
        tinted = _mix(relief.color / 255.0, color, 0.35 + 0.65 * np.maximum(moist, touched))
        color = np.where(known, tinted, color)
    color *= (1.0 + 0.03 * fine + 0.03 * broad)[..., None]
    color = _planted(color, plants, density, moist, age, fine, broad)
    tone = 1.0 + SHADE * _shade(maps.elevation_change.numpy(), cell)
    if terrain is not None:
        tone *= np.where(relief.known, 1.0 + (1.0 - 0.5 * moist) * (relief.shade - 1.0), 1.0)
    color *= tone[..., None]
    color = _watered(color, maps, ground)
    return np.asarray(np.round(255.0 * np.clip(color, 0.0, 1.0)), np.uint8)


def _planted(
    color: np.ndarray,
    plants: np.ndarray,
    density: np.ndarray,
    moist: np.ndarray,
    age: np.ndarray,
    fine: Any,
    broad: Any,
) -> np.ndarray:
    """Cover the ground with plants: grass evenly, crowns of trees where the density exceeds a mottled threshold."""
    green = np.empty((*plants.shape, 3))
    green[:] = _mix(_rgb(FOREST), _rgb(LUSH), np.clip(0.5 + 0.4 * broad, 0.0, 1.0) * moist)
    for name, tint in (("pioneers", WILLOW), ("willow", WILLOW), ("swamp", MARSH), ("bare sand", WILLOW)):
        green[plants == PLANTS.index(name)] = _rgb(tint)
    # Willows grow into forest, and so does what is left of a swamp.
    grown = smoothstep((np.minimum(age, 1e3) - 15.0) / 45.0) * (plants == PLANTS.index("willow"))
    grown = np.maximum(
        grown, 0.5 * smoothstep((np.minimum(age, 1e3) - 80.0) / 120.0) * (plants == PLANTS.index("swamp"))
    )
    green = _mix(green, _rgb(FOREST), 0.85 * grown)
    open_ground = plants == PLANTS.index("grassland")
    color = _mix(color, _rgb(GRASS), 0.75 * open_ground)
    # Where plants are few, they stand in groups.
    crowns = smoothstep(1.6 * (density - 0.5 + 0.14 * fine + 0.1 * broad) + 0.5)
    cover = crowns * np.minimum(1.0, 3.0 * density)
    # Light from the north-west on crowns.
    lit = np.roll(fine, 1, (0, 1)) - fine
    forest = (plants == PLANTS.index("forest")) | open_ground
    tall = np.where(forest, 1.0, 0.45) * cover
    green *= (1.0 + 0.07 * fine * tall - 0.09 * lit * tall)[..., None]
    return _mix(color, green, 0.94 * cover)


def _watered(color: np.ndarray, maps: LandscapeMaps, ground: np.ndarray) -> np.ndarray:
    """Add lakes and channels, deeper in the middle, and the cut banks on the outer side of bends."""
    lake, age = maps.lake.numpy(), np.nan_to_num(maps.age.numpy(), nan=1e3)
    fill = 1.0 - np.exp(-age / maps.params.lake_time)
    wet = np.clip(lake / 0.25, 0.0, 1.0)
    tint = _mix(_rgb(LAKE), _rgb(POND), fill)
    color = _mix(color, tint, 0.92 * wet)
    offset = np.nan_to_num(maps.water.numpy(), nan=9.0)
    cover = _channel_cover(maps)
    middle = smoothstep(1.0 - (np.abs(offset) / 0.5) ** 2)
    fresh = (np.abs(offset) > 0.5) & (np.abs(offset) < 0.62) & ((ground == 0) | (age > 4.0))
    color = np.where(fresh[..., None], color * CUT_BANK, color)
    return _mix(color, _mix(_rgb(RIVER), _rgb(DEEP), middle), cover)


def _channel_cover(maps: LandscapeMaps) -> np.ndarray:
    """Return the part of each cell that lies under the present channels, 0 to 1."""
    away = np.abs(np.nan_to_num(maps.water.numpy(), nan=9.0))
    down, across = np.gradient(away)
    # Distance per cell, in widths; in the middle of a channel, where the distance turns, it says nothing.
    step = np.hypot(down, across)
    return np.where(away < 0.4, 1.0, np.clip((0.5 - away) / np.maximum(step, 1e-6) + 0.5, 0.0, 1.0))


def _shade(height: np.ndarray, cell: float) -> np.ndarray:
    """Return the light and shade of small forms, exaggerated, about -1 to 1; light from the north-west."""
    down, across = np.gradient(np.nan_to_num(height), cell)
    slope = (-across + down) / np.sqrt(2.0)
    slope = np.nan_to_num(slope)
    strong = np.percentile(np.abs(slope[slope != 0.0]), 95.0) if (slope != 0.0).any() else 1.0
    return np.asarray(np.tanh(-slope * SHADED_SLOPE * 2.0 / max(float(strong), 1e-12)))


def _noise(shape: tuple[int, int], size: float, seed: int) -> np.ndarray:
    """Return smooth noise of a size in cells, mean 0 and spread 1."""
    with IMPORTING:
        from scipy.ndimage import gaussian_filter, zoom

    step = max(1, int(size / 2.0))
    coarse = tuple(-(-n // step) + 4 for n in shape)
    field = gaussian_filter(np.random.default_rng(seed).standard_normal(coarse).astype(np.float32), size / step)
    if step > 1:
        field = zoom(field, step, order=1)
    field = field[: shape[0], : shape[1]]
    return np.asarray((field - field.mean()) / max(float(field.std()), 1e-9))


def _rgb(color: str) -> np.ndarray:
    return np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0


def _mix(a: Any, b: Any, part: Any) -> np.ndarray:
    """Blend colours, (rows, columns, 3) or (3,), by a part of the second."""
    part = np.asarray(part)[..., None]
    return np.asarray((1.0 - part) * a + part * b)
