"""Kernels of carving against their twin, which looks at all segments from every cell."""

import numpy as np
import pytest
import reference_carving as twin
import reference_terrain
import warp as wp
from kernel_arrays import REALS, SCALARS, to_device, unwritten

from warpriver.kernels import carving

# Products of lengths of 1e3 m and weights; in float32 places are off by 1e-4 m, over banks of some metres.
TOLERANCE = {"float64": 1e-9, "float32": 5e-3}
ROWS, COLUMNS, CELL, WEST, NORTH = 37, 45, 8.0, 120.0, 900.0
CELLS = carving.TILE**2
KINDS = {"level": "double", "cut": "double", "row": "whole", "ends": "flag"}


def river(seed=0, count=14):
    """Segments of a winding channel, and of one beside it that ends in it."""
    rng = np.random.default_rng(seed)
    lines = []
    for y, x in ((760.0, np.linspace(100.0, 500.0, count)), (700.0, np.linspace(150.0, 300.0, count // 2))):
        lines.append(np.column_stack([x, y + np.cumsum(rng.normal(0.0, 12.0, len(x)))]))
    first = np.concatenate([line[:-1] for line in lines])
    last = np.concatenate([line[1:] for line in lines])
    size = len(first)
    unit = (last - first) / np.hypot(*(last - first).T)[:, None]
    head, foot = np.zeros(size, bool), np.zeros(size, bool)
    head[[0, count - 1]] = foot[[count - 2, size - 1]] = True
    before = np.where(head[:, None], unit, np.roll(unit, 1, axis=0))
    behind = np.where(foot[:, None], unit, np.roll(unit, -1, axis=0))
    half = rng.uniform(4.0, 40.0, (size, 2))
    bank = half + rng.uniform(9.0, 30.0, (size, 2))
    return {
        "first": first,
        "last": last,
        "first_tangent": (unit + before) / np.hypot(*(unit + before).T)[:, None],
        "last_tangent": (unit + behind) / np.hypot(*(unit + behind).T)[:, None],
        "level": rng.uniform(20.0, 30.0, (size, 2)),
        "cut": rng.uniform(0.0, 8.0, (size, 2)),
        "half": half,
        "depth": rng.uniform(1.0, 4.0, (size, 2)),
        "bank": bank,
        "reach": bank + rng.uniform(0.0, 30.0, (size, 2)),
        "row": rng.integers(0, 3, (size, 2)),
        "part": rng.uniform(0.0, 1.0, (size, 2)),
        "ends": (carving.HEAD * head + carving.FOOT * foot).astype(np.uint8),
    }


def table():
    y = np.linspace(0.0, 1.0, 17)
    return np.array([4.0 * y * (1.0 - y), np.minimum(1.0, 5.0 * np.minimum(y, 1.0 - y)), y * (1.0 - y) ** 2 * 6.75])


class Bench:
    """The kernels with a river on the device; every tile has all segments."""

    def __init__(self, dtype, device, seg):
        self.scalar, self.real, self.device = SCALARS[dtype], REALS[dtype], device
        self.kernel = carving.build(self.scalar)
        self.segments = self.kernel.Segments()
        for name, values in seg.items():
            setattr(self.segments, name, self._array(values, KINDS.get(name, "real")))
        self.tiles, columns = self.kernel.Tiles(), -(-COLUMNS // carving.TILE)
        self.number = np.arange(columns * -(-ROWS // carving.TILE))
        self.tiles.number, self.tiles.columns = to_device(self.number.astype(np.int32), wp.int32, device), columns
        self.tiles.raster = wp.vec2i(ROWS, COLUMNS)
        count = len(seg["first"])
        starts, every = count * np.arange(len(self.number) + 1), np.tile(np.arange(count), len(self.number))
        self.tiles.start = to_device(starts.astype(np.int32), wp.int32, device)
        self.tiles.segment = to_device(every.astype(np.int32), wp.int32, device)
        self.grid = self.kernel.RasterGrid()
        self.grid.west, self.grid.north, self.grid.cell_size, self.grid.cells_per_meter = WEST, NORTH, CELL, 1.0 / CELL
        self.dim = (len(self.number), CELLS)

    def _array(self, values, kind):
        real = {"double": np.float64, "whole": np.int32, "flag": np.uint8}.get(kind, self.real)
        types = {"double": wp.vec2d, "whole": wp.vec2i, "flag": wp.uint8}
        return to_device(np.asarray(values, real), types.get(kind, self.kernel.vec2), self.device)

    def launch(self, kernel, inputs, outputs):
        wp.launch(kernel, dim=self.dim, inputs=inputs, outputs=outputs, device=self.device)
        return [out.numpy() for out in outputs]

    def unwritten(self, shape, kind):
        return unwritten(shape, kind, self.device)

    def on_raster(self, values):
        """Values of the tiles' cells, as a raster."""
        columns = self.tiles.columns
        out = np.zeros((ROWS, COLUMNS, *values.shape[2:]))
        for slot, tile in enumerate(self.number):
            row, column = (tile // columns) * carving.TILE, (tile % columns) * carving.TILE
            block = values[slot].reshape(carving.TILE, carving.TILE, *values.shape[2:])
            part = out[row : row + carving.TILE, column : column + carving.TILE]
            part[...] = block[: part.shape[0], : part.shape[1]]
        return out

    def in_tiles(self, values, kind):
        """A raster as values of the tiles' cells, on the device."""
        columns, side = self.tiles.columns, carving.TILE
        out = np.zeros((len(self.number), CELLS, *values.shape[2:]))
        for slot, tile in enumerate(self.number):
            row, column = (tile // columns) * side, (tile % columns) * side
            block = np.zeros((side, side, *values.shape[2:]))
            part = values[row : row + side, column : column + side]
            block[: part.shape[0], : part.shape[1]] = part
            out[slot] = block.reshape(CELLS, *values.shape[2:])
        return to_device(out, kind, self.device)


def reference(seg):
    """(rows, columns, 5) of the twin: level, cut, depth, bank, wall."""
    found = np.empty((ROWS, COLUMNS, 5))
    for row in range(ROWS):
        for column in range(COLUMNS):
            xy = np.array([WEST + (column + 0.5) * CELL, NORTH - (row + 0.5) * CELL])
            found[row, column] = twin.water_at(seg, table(), xy, CELL)
    return found


@pytest.fixture(scope="module")
def wanted():
    return reference(river())


def ground():
    rng = np.random.default_rng(5)
    height = rng.uniform(15.0, 60.0, (ROWS, COLUMNS))
    height[rng.random(height.shape) < 0.05] = np.nan
    return height


def test_water_at_cells_is_that_of_the_twin(dtype, device, wanted):
    bench = Bench(dtype, device, river())
    section = to_device(table().astype(bench.real), bench.scalar, device)
    outputs = [bench.unwritten(bench.dim, kind) for kind in (wp.float64, wp.float64, wp.vec3d)]
    inputs = [bench.segments, bench.tiles, bench.grid, section]
    level, cut, shape = (bench.on_raster(v) for v in bench.launch(bench.kernel.find_water, inputs, outputs))
    assert 0.2 < np.isnan(wanted[..., 0]).mean() < 0.8 and 0.05 < (wanted[..., 2] > 0.0).mean() < 0.5
    found = np.concatenate([level[..., None], cut[..., None], shape], axis=-1)
    # Single precision puts a cell on the other side of an edge now and then.
    off = ~np.isclose(found, wanted, atol=TOLERANCE[dtype], rtol=0.0, equal_nan=True)
    assert off.mean() <= (0.0 if dtype == "float64" else 2e-3)


# Below what the banks of the case are cut by.
MAX_CUT = 0.5


def test_cells_are_carved_as_by_the_twin(dtype, device, wanted):
    bench, height = Bench(dtype, device, river()), ground()
    inputs = [bench.tiles, MAX_CUT, *(bench.in_tiles(wanted[..., k], wp.float64) for k in (0, 1))]
    inputs.append(bench.in_tiles(wanted[..., 2:], wp.vec3d))
    dry = np.full(height.shape, np.nan)
    outputs = [to_device(v, wp.float64, device) for v in (height, dry, dry)]
    outputs.append(to_device(np.zeros(height.shape, np.uint8), wp.uint8, device))
    carved, level, depth, support = bench.launch(bench.kernel.carve_cells, inputs, outputs)
    reached = (wanted[..., 4] > 0.0) & np.isfinite(height)
    wet = reached & (wanted[..., 2] > 0.0)
    capped, free = (twin.carved_height(height, *np.moveaxis(wanted, -1, 0), limit) for limit in (MAX_CUT, 1e9))
    assert (reached & (capped > free)).sum() > 50
    expected = np.where(reached, capped, height)
    np.testing.assert_allclose(carved, expected, atol=1e-12, rtol=0.0)
    np.testing.assert_array_equal(support, reached)
    np.testing.assert_array_equal(level, np.where(wet, wanted[..., 0], np.nan))
    np.testing.assert_array_equal(depth, np.where(wet, wanted[..., 2], np.nan))


def test_materials_are_those_of_the_twin(dtype, device, wanted):
    bench, before = Bench(dtype, device, river()), ground()
    shape = wanted[..., 2:]
    after = before - shape[..., 2] * np.random.default_rng(1).uniform(0.0, 3.0, before.shape)
    repose = 2.0
    inputs = [bench.tiles, wp.float64(1.0 / (CELL * repose)), bench.in_tiles(shape, wp.vec3d)]
    inputs += [to_device(v, wp.float64, device) for v in (after, before)]
    outputs = [to_device(np.zeros(before.shape, np.uint8), wp.uint8, device) for _ in range(3)]
    found = np.stack(bench.launch(bench.kernel.weigh_materials, inputs, outputs), axis=-1)
    steep = reference_terrain.slope(after, CELL) / repose
    reached = (shape[..., 2] > 0.0) & np.isfinite(before)
    expected = np.zeros((*before.shape, 3))
    for row, column in np.argwhere(reached):
        change = before[row, column] - after[row, column]
        expected[row, column] = twin.materials(*shape[row, column], steep[row, column], change)
    assert (expected.max(axis=(0, 1)) > 100.0).all()
    # A half may round either way.
    assert np.abs(found - expected).max() <= 1.0 and (found != expected).mean() < 1e-3
