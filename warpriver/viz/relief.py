"""Shaded relief: hillshade of a terrain, and its picture in muted tints of height for channels to lie on."""

from __future__ import annotations

import dataclasses

import numpy as np

from warpriver.crs import same_crs, short_name
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain, surface_of
from warpriver.validate import positive
from warpriver.viz.bands import Window

__all__ = ["Relief", "check_ground", "height_grid", "hillshade", "relief_picture"]

# Valley floors to summits: pale enough for water and deposits to stand out.
TINT = (
    (0.0, "#cdccb4"),
    (0.25, "#d4d0b2"),
    (0.5, "#d3c3a0"),
    (0.75, "#c7b197"),
    (0.92, "#cfc3b4"),
    (1.0, "#e4dfd8"),
)
# Percentiles of height between which the tints run; the slope at which shades are strong.
TINT_SPAN = (1.0, 99.5)
STRONG_SLOPE, MAX_EXAGGERATION = 0.55, 25.0
# The picture's light: the main lamp, and a weaker one from above that makes steep ground darker on all sides.
LAMPS = ((315.0, 45.0, 0.72), (270.0, 75.0, 0.28))


@dataclasses.dataclass(frozen=True)
class Relief:
    """The picture of a piece of terrain.

    Attributes:
        color: (rows, columns, 3) float32 in 0..255, row 0 in the north; anything where there is no data.
        shade: (rows, columns) float32 brightness over that of level ground.
        known: (rows, columns) bool, where there is data.
    """

    color: np.ndarray
    shade: np.ndarray
    known: np.ndarray


@public
def hillshade(
    terrain: Terrain | Raster, azimuth: float = 315.0, altitude: float = 45.0, exaggeration: float | None = None
) -> np.ndarray:
    """Brightness of a terrain under a lamp: the cosine between the light and the ground's normal.

    Slopes are central differences, one-sided at the edge and beside cells without data.

    Args:
        terrain: Terrain, or a Raster of heights in m.
        azimuth: Direction that the light comes from, degrees clockwise from north.
        altitude: Its height above the horizon, degrees, above 0, up to 90.
        exaggeration: Factor on heights; by default 1 on mountains, and as much more on flat land as shows its form.

    Returns:
        (rows, columns) float64 from 0, in shadow, to 1, facing the light; NaN without data. Level ground has the sine
        of the altitude.
    """
    if not (0.0 < altitude <= 90.0 and np.isfinite(azimuth)):
        raise InputError(f"azimuth is {azimuth}, altitude {altitude}; give degrees, the altitude above 0 and up to 90")
    if exaggeration is not None:
        positive(exaggeration, "exaggeration", hint=", or None")
    height = surface_of(terrain).to_numpy()
    east, north = _gradient(height, float(terrain.cell_size))
    factor = _auto_exaggeration(east, north) if exaggeration is None else float(exaggeration)
    return np.where(np.isnan(height), np.nan, _lit(factor * east, factor * north, azimuth, altitude))


def relief_picture(terrain: Terrain, window: Window, shape: tuple[int, int], *, strength: float = 1.0) -> Relief:
    """Paint a window of a terrain in tints of height under light from the north-west.

    Args:
        terrain: The ground.
        window: (west, south, east, north) in m; what lies off the terrain has no data.
        shape: Rows and columns of the picture.
        strength: Strength of the shades; 0 leaves the tints.

    Returns:
        The picture.
    """
    cells = _cells_under(terrain, window, shape)
    if cells is None:
        blank = np.zeros((*shape, 3), np.float32)
        return Relief(blank, np.ones(shape, np.float32), np.zeros(shape, bool))
    height, known = cells.resampled(cells.height), cells.known()
    # Slopes are differences between cells two apart, as in a GIS: they do not see what changes sign from cell to cell,
    # the traces of rivers that run along diagonals, which a slope of the finer picture shows as a cross-hatch.
    east, north = (cells.resampled(slope) for slope in _gradient(cells.height, cells.size))
    seen = height[known]
    # Slopes of the land itself, not of its no-data rim.
    factor = _auto_exaggeration(np.where(known, east, np.nan), np.where(known, north, np.nan))
    east *= factor
    north *= factor
    tone = np.zeros(shape, np.float32)
    for azimuth, altitude, weight in LAMPS:
        level = np.sin(np.radians(altitude))
        tone += np.float32(weight / level) * _lit(east, north, azimuth, altitude).astype(np.float32)
    shade = np.clip(1.0 + np.float32(strength) * (0.85 * (tone - 1.0)), 0.3, 1.16)
    low, high = np.percentile(seen, TINT_SPAN) if len(seen) else (0.0, 1.0)
    # Even a terrain of a few metres' relief gets a fraction of the tints, a level one the lowest.
    fraction = np.clip((height - low) / max(high - low, 1e-9), 0.0, 1.0)
    index = np.round(255.0 * fraction).astype(np.uint8)
    color = _tints()[index]
    # Shadows are cool.
    dark = np.minimum(shade, 1.0)[..., None]
    color *= np.power(dark, np.array([1.06, 1.0, 0.9], np.float32))
    light = np.maximum(shade - 1.0, 0.0)[..., None]
    color += (255.0 - color) * np.minimum(2.0 * light, 1.0)
    return Relief(color, shade.astype(np.float32), known)


def height_grid(terrain: Terrain, window: Window, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Resample a window of a terrain: means where it gets coarser, cubic splines where it gets finer.

    Args:
        terrain: The ground.
        window: (west, south, east, north) in m.
        shape: Rows and columns of the result.

    Returns:
        Heights at the cells' centres, (rows, columns) float64 in m, in gaps those of the nearest data; and a mask of
        the cells with data.
    """
    cells = _cells_under(terrain, window, shape)
    if cells is None:
        return np.zeros(shape), np.zeros(shape, bool)
    return cells.resampled(cells.height), cells.known()


@dataclasses.dataclass(frozen=True)
class _Cells:
    """The cells of a terrain under a window, averaged where pixels are larger, and where the pixels lie in them.

    Attributes:
        height: (r, c) heights in m, in gaps those of the nearest data.
        gap: (r, c) whether a cell has no data.
        size: Side of a cell in m.
        shape: Rows and columns of pixels.
        scale: Sides of a pixel in cells, down and across.
        offset: Index of the first pixel's centre, down and across.
    """

    height: np.ndarray
    gap: np.ndarray
    size: float
    shape: tuple[int, int]
    scale: np.ndarray
    offset: np.ndarray

    def resampled(self, values: np.ndarray) -> np.ndarray:
        """Return values of the cells at the pixels, by cubic splines."""
        with IMPORTING:
            from scipy.ndimage import affine_transform

        out = affine_transform(values, self.scale, self.offset, output_shape=self.shape, order=3, mode="nearest")
        # Splines swing below and above at cliffs.
        limited: np.ndarray = np.clip(out, values.min(), values.max(), out=out)
        return limited

    def known(self) -> np.ndarray:
        """Return which pixels have data."""
        with IMPORTING:
            from scipy.ndimage import map_coordinates

        gap, places = self.gap, [self.offset[k] + self.scale[k] * np.arange(self.shape[k]) for k in (0, 1)]
        row, column = (np.floor(place + 0.5).astype(int) for place in places)
        inside = ((row >= 0) & (row < gap.shape[0]))[:, None] & ((column >= 0) & (column < gap.shape[1]))[None, :]
        missing = gap[np.clip(row, 0, gap.shape[0] - 1)][:, np.clip(column, 0, gap.shape[1] - 1)]
        if gap.any() and missing.any() and max(self.scale) < 0.5:
            # Where cells are many pixels wide, the edge of the data is a smooth line, not stairs.
            grid = np.meshgrid(*places, indexing="ij")
            sure: np.ndarray = inside & (map_coordinates(gap.astype(np.float32), grid, order=1, mode="nearest") < 0.5)
            return sure
        known: np.ndarray = inside & ~missing
        return known


def _cells_under(terrain: Terrain, window: Window, shape: tuple[int, int]) -> _Cells | None:
    """Return the cells under a window, None where none of them has data."""
    with IMPORTING:
        from scipy.ndimage import distance_transform_edt

    west, south, east, north = window
    size, (left, top) = float(terrain.cell_size), terrain.origin
    step = np.array([(north - south) / shape[0], (east - west) / shape[1]]) / size
    # The window of the raster under the window, with a rim for the spline.
    factor = max(1, int(min(step)))
    rim = 8 * factor
    first = np.floor([(top - north) / size, (west - left) / size]).astype(int) - rim
    last = np.ceil([(top - south) / size, (east - left) / size]).astype(int) + rim
    first, last = np.clip(first, 0, np.array(terrain.shape) - 1), np.clip(last, 1, terrain.shape)
    last = np.maximum(last, first + 1)
    (top_row, left_column), (end_row, end_column) = first.tolist(), last.tolist()
    height = terrain.height[top_row:end_row, left_column:end_column].contiguous().numpy()
    if factor > 1:
        height = _block_mean(height, factor)
    gap = np.isnan(height)
    if gap.all():
        return None
    if gap.any():
        nearest = distance_transform_edt(gap, return_distances=False, return_indices=True)
        height = height[tuple(nearest)]
    begin = np.array([(top - north) / size, (west - left) / size]) - first
    return _Cells(height, gap, size * factor, shape, step / factor, (begin + 0.5 * step) / factor - 0.5)


def check_ground(terrain: Terrain | Raster, bounds: Window, crs: str | None) -> None:
    """Raise ``ValueError`` unless a terrain or raster is in a CRS and lies under some of ``bounds``, (w, s, e, n)."""
    kind = "raster" if isinstance(terrain, Raster) else "terrain"
    if terrain.crs is not None and crs is not None and not same_crs(terrain.crs, crs):
        raise InputError(
            f"the {kind} is in {short_name(terrain.crs)}, the channels in {short_name(crs)}; "
            "read one of them with to_crs="
        )
    west, south, east, north = terrain.bounds
    if west > bounds[2] or east < bounds[0] or south > bounds[3] or north < bounds[1]:
        raise InputError(
            f"the {kind}, ({west:g}, {south:g}, {east:g}, {north:g}) m, lies beside the channels, "
            f"({bounds[0]:g}, {bounds[1]:g}, {bounds[2]:g}, {bounds[3]:g}) m"
        )


def _gradient(height: np.ndarray, cell_size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return dh/dx towards east and dh/dy towards north; 0 where no neighbour has data."""
    east, south = (_difference(height, axis) for axis in (1, 0))
    east /= cell_size
    south /= -cell_size
    return east, south


def _difference(height: np.ndarray, axis: int) -> np.ndarray:
    """Return the change per cell along an axis: the mean of the steps to both sides, or the one that is known."""
    step = np.diff(height, axis=axis)
    known = np.isfinite(step)
    step[~known] = 0.0
    pad = [(0, 0), (0, 0)]
    pad[axis] = (1, 1)
    step, known = np.pad(step, pad), np.pad(known, pad)
    low, high = [slice(None)] * 2, [slice(None)] * 2
    low[axis], high[axis] = slice(None, -1), slice(1, None)
    total = step[tuple(low)] + step[tuple(high)]
    count = known[tuple(low)].astype(np.int8) + known[tuple(high)]
    mean: np.ndarray = total / np.maximum(count, 1)
    return mean


def _lit(east: np.ndarray, north: np.ndarray, azimuth: float, altitude: float) -> np.ndarray:
    """Return the cosine between light and normal, 0 in shadow."""
    turn, rise = np.radians(azimuth), np.radians(altitude)
    facing = np.sin(rise) - np.cos(rise) * (np.sin(turn) * east + np.cos(turn) * north)
    light: np.ndarray = np.clip(facing / np.sqrt(1.0 + east * east + north * north), 0.0, 1.0)
    return light


def _auto_exaggeration(east: np.ndarray, north: np.ndarray) -> float:
    """Return the factor on heights that makes the steeper tenth of the land strongly shaded, 1 to 25."""
    slope = np.hypot(east, north)
    slope = slope[np.isfinite(slope)]
    if not len(slope):
        return 1.0
    steep = float(np.percentile(slope[:: max(1, len(slope) // 200_000)], 90.0))
    return float(np.clip(STRONG_SLOPE / max(steep, 1e-9), 1.0, MAX_EXAGGERATION))


def _block_mean(height: np.ndarray, factor: int) -> np.ndarray:
    """Average blocks of cells, those with data; blocks at the end may be smaller; NaN where less than half is known."""
    rows, columns = (-(-n // factor) for n in height.shape)
    total, count = np.zeros((rows, columns)), np.zeros((rows, columns))
    for i in range(factor):
        for j in range(factor):
            block = height[i::factor, j::factor]
            known = np.isfinite(block)
            total[: block.shape[0], : block.shape[1]] += np.where(known, block, 0.0)
            count[: block.shape[0], : block.shape[1]] += known
    return np.where(2.0 * count >= 1.0 * _block_cells(height.shape, factor), total / np.maximum(count, 1.0), np.nan)


def _block_cells(shape: tuple[int, ...], factor: int) -> np.ndarray:
    """Return how many cells each block holds."""
    rows, columns = (np.minimum(factor, n - factor * np.arange(-(-n // factor))) for n in shape)
    return rows[:, None] * columns[None, :]


def _tints() -> np.ndarray:
    """Return the tints of 256 heights, (256, 3) float32 in 0..255."""
    at = [p for p, _ in TINT]
    rgb = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for _, c in TINT], np.float64)
    fraction = np.linspace(0.0, 1.0, 256)
    return np.stack([np.interp(fraction, at, rgb[:, k]) for k in range(3)], axis=1).astype(np.float32)
