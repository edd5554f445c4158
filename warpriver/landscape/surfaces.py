"""Surfaces of a landscape as triangles with normals and texture coordinates: ground, water, and ribbons of channels."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from warpriver.arrays import FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.io.gltf import point_normals
from warpriver.io.meshes import cell_triangles
from warpriver.landscape.carving import Carved
from warpriver.landscape.profiles import fine_lines, lines_of
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.validate import whole

__all__ = ["Surface", "channel_ribbons", "landscape_surfaces"]


# Colours of the surfaces, linear red, green, blue and opacity.
GROUND, WATER = (0.42, 0.39, 0.29, 1.0), (0.10, 0.24, 0.30, 0.85)
# The sides of a ribbon over its width, and how far a water's edge is led into the bank, in cells.
RIBBON_STEP = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """Triangles in space.

    Attributes:
        name: What it is.
        points: (n, 3) absolute places in m, z up.
        normals: (n, 3) unit vectors.
        uv: (n, 2) texture coordinates; of a raster 0 to 1 from west to east and from south to north, of a ribbon across
            from the left bank and along the flow, in widths.
        triangles: (m, 3) points of each, counter-clockwise seen from above.
        color: Red, green, blue and opacity, 0 to 1.
        crs: Coordinate reference system, or None.
    """

    name: str
    points: FloatArray
    normals: FloatArray
    uv: FloatArray
    triangles: IndexArray
    color: tuple[float, float, float, float]
    crs: str | None = None

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest coordinates, (3,) each."""
        return self.points.min(axis=0), self.points.max(axis=0)


@public
def landscape_surfaces(carved: Carved, *, max_points: int = 1_000_000) -> list[Surface]:
    """Return the ground, the water and the ribbons of a carved terrain as triangles.

    The water is that of the raster, led a cell into the banks, where the ground hides it: so the shore is where both
    meet. Ribbons follow the lines of the channels and are as wide as these, for programs that draw rivers by splines.

    Args:
        carved: The landscape.
        max_points: Maximum of points of the ground; where there are more cells it is resampled to larger ones.

    Raises:
        ValueError: A terrain of which no three cells meet.
    """
    most = whole(max_points, "max_points", 4)
    surfaces = [_ground_surface(carved, most)]
    if np.isfinite(carved.water.numpy()).any():
        surfaces.append(_water_surface(carved))
    return [*surfaces, channel_ribbons(carved.network)]


@public
def channel_ribbons(network: RiverNetwork) -> Surface:
    """Return the water of all channels as ribbons along their lines, at the elevations of their points (0 without)."""
    lines = lines_of(network)
    xy, base, part = fine_lines(lines, RIBBON_STEP * 2.0 * lines.half)
    after = np.minimum(base + 1, len(lines.xy) - 1)
    level = np.zeros(network.point_count) if network.point_z is None else network.point_z
    half, z = (values[base] + part * (values[after] - values[base]) for values in (lines.half, level[lines.source]))
    start = np.append(np.searchsorted(base, lines.start[:-1]), len(xy))
    owner = np.repeat(np.arange(len(start) - 1), np.diff(start))
    ahead, behind = np.arange(len(xy)) + 1, np.arange(len(xy)) - 1
    ahead[start[1:] - 1] -= 1
    behind[start[:-1]] += 1
    along = xy[ahead] - xy[behind]
    along /= np.maximum(np.hypot(*along.T), 1e-300)[:, None]
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    step = np.append(0.0, np.hypot(*np.diff(xy, axis=0).T))
    step[start[:-1]] = 0.0
    distance = np.cumsum(step / (2.0 * half))
    distance -= distance[start[:-1]][owner]
    banks = np.stack([xy + half[:, None] * left, xy - half[:, None] * left], axis=1).reshape(-1, 2)
    points = np.column_stack([banks, np.repeat(z, 2)])
    uv = np.column_stack([np.tile([0.0, 1.0], len(xy)), np.repeat(distance, 2)])
    first = np.setdiff1d(np.arange(len(xy)), start[1:] - 1)
    a, b, c, d = 2 * first, 2 * first + 1, 2 * first + 2, 2 * first + 3
    # Left and right bank here, then of the next place.
    triangles = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    return Surface("channels", points, point_normals(points, triangles), uv, triangles, WATER, network.crs)


def _ground_surface(carved: Carved, most: int) -> Surface:
    terrain = carved.terrain
    rows, columns = terrain.shape
    if rows * columns > most:
        terrain = terrain.resampled(terrain.cell_size * math.sqrt(1.01 * rows * columns / most))
    return _raster_surface("terrain", terrain, terrain.to_numpy(), GROUND)


def _water_surface(carved: Carved) -> Surface:
    level = carved.water.numpy()
    wet = np.isfinite(level)
    total, count = np.zeros(level.shape), np.zeros(level.shape, np.int64)
    padded = np.pad(np.where(wet, level, 0.0), 1), np.pad(wet.astype(np.int64), 1)
    for row in range(3):
        for column in range(3):
            window = slice(row, row + level.shape[0]), slice(column, column + level.shape[1])
            total += padded[0][window]
            count += padded[1][window]
    known = np.isfinite(carved.terrain.to_numpy())
    led = np.where(wet, level, np.where((count > 0) & known, total / np.maximum(count, 1), np.nan))
    return _raster_surface("water", carved.terrain, led, WATER)


def _raster_surface(
    name: str, terrain: Terrain, height: FloatArray, color: tuple[float, float, float, float]
) -> Surface:
    """Return a point at the centre of each cell with a value, and the triangles between those that meet."""
    (rows, columns), size, (west, north) = height.shape, terrain.cell_size, terrain.origin
    known = np.isfinite(height)
    row, column = np.nonzero(known)
    points = np.column_stack([west + (column + 0.5) * size, north - (row + 0.5) * size, height[known]])
    uv = np.column_stack([(column + 0.5) / columns, 1.0 - (row + 0.5) / rows])
    triangles = cell_triangles(known)
    if not len(triangles):
        raise InputError(f"the {name} has no three cells that meet: there are no triangles to write")
    used = np.zeros(len(points), bool)
    used[triangles.ravel()] = True
    points, uv, triangles = points[used], uv[used], (np.cumsum(used) - 1)[triangles]
    return Surface(name, points, point_normals(points, triangles), uv, triangles, color, terrain.crs)
