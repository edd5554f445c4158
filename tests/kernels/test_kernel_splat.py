"""Splat kernels against a float64 twin in which every cell looks at every segment.

The kernels ``count_blocks``, ``list_blocks``, ``find_starts``, ``trace_points``, ``advance_cells`` and ``lay_courses``
are launched by ``landscape/splatting.py``, through which they are tested.
"""

import dataclasses

import numpy as np
import pytest
import reference_splat as twin

import warpriver as wr
from warpriver.kernels import covers
from warpriver.landscape.falloff import falloff_table, moisture_falloff, sediment_falloff
from warpriver.landscape.splatting import Segments, Splat, segments_of

CELL, SHAPE, ORIGIN = 7.0, (83, 101), (1000.0, 5000.0)
TABLES = (falloff_table(moisture_falloff, "moisture"), falloff_table(sediment_falloff, "sediment"))
# Of a distance, in cells.
WITHIN = {"float64": 1e-6, "float32": 2e-3}


def splat_of(device, dtype="float64", threads=None, shape=SHAPE, cell=CELL, origin=ORIGIN):
    return Splat(shape, cell, origin, TABLES, device=device, dtype=dtype, threads=threads)


def networks(seed, count=5, channels=4):
    """A few crooked channels of different widths that move; some leave the raster."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-80.0, SHAPE[1] * CELL + 80.0, 45)
    phase, size, middle = rng.uniform(0, 6, (3, channels)) * np.array([[1.0], [9.0], [100.0]])
    width = rng.uniform(8.0, 40.0, channels)
    for k in range(count):
        lines, sections = [], []
        for c in range(channels):
            y = middle[c] + size[c] * np.sin(x / 60.0 + phase[c] + 0.25 * k) + 15.0 * np.sin(x / 23.0 + c)
            lines.append(np.stack([ORIGIN[0] + x + 10.0 * np.cos(x / 40.0), ORIGIN[1] - y], axis=1))
            sections.append(width[c] * (1.0 + 0.3 * np.sin(x / 100.0)))
        yield wr.RiverNetwork.from_polylines(lines, width=sections)


def led(splat, network, time, span=0.0):
    """Lead the cells to a network, whose segments have come from the one before; return these."""
    segments = segments_of(network)
    if time > 0.0:
        moved = splat.trace(segments.line.reshape(-1, 2))[1].reshape(-1, 2)
        # Along a channel from one side to the other, by up to a seventh of its width: more than counts.
        x = segments.line[:, ::2]
        segments = dataclasses.replace(segments, moved=moved, sag=segments.section[:, ::2] * np.sin(x / 50.0) / 7.0)
    splat.advance(splat.frame(segments), time, span=span)
    return segments


def reshaped(values):
    return values.reshape(SHAPE)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_cells_are_those_of_the_twin(device, dtype, seed):
    """Distances in widths times the least width in cells: within 1e-6 of a cell. Sums within that over a profile."""
    splat, cells = splat_of(device, dtype), twin.Cells(SHAPE, CELL, ORIGIN)
    for k, network in enumerate(networks(seed)):
        segments = led(splat, network, 2.5 * k, 2.5)
        cells.advance(segments.line, segments.section, 2.5 * k, segments.sag)
    got, widest = splat.cells, segments.section[:, ::2].max() / CELL
    offset, expected = got.offset.numpy(), reshaped(cells.offset)
    np.testing.assert_allclose(np.abs(offset), np.abs(expected), atol=WITHIN[dtype] / widest)
    # The side is told apart but on the line itself, and beyond the ends of channels.
    assert (np.sign(offset) == np.sign(expected)).mean() > (0.9999 if dtype == "float64" else 0.999)
    for name in ("moisture", "sediment", "occupied"):
        years = getattr(got, name).numpy() / covers.QUANTA
        off = np.abs(years - reshaped(getattr(cells, name)))
        assert np.quantile(off, 0.999) < 10.0 * WITHIN[dtype], name
        assert off.mean() < WITHIN[dtype], name
    total = reshaped(cells.sediment).sum()
    assert got.sediment.numpy().sum() / covers.QUANTA == pytest.approx(total, rel=1e-6 if dtype == "float64" else 1e-3)
    left = got.left.numpy()
    assert ((left > -1e29) == reshaped(cells.left > -1e29)).mean() > 0.9998
    both = (left > -1e29) & reshaped(cells.left > -1e29)
    assert np.quantile(np.abs(left - reshaped(cells.left))[both], 0.999) < 100.0 * WITHIN[dtype]


def test_nothing_depends_on_threads_or_on_the_order_of_channels(device):
    def state(threads, order):
        splat = splat_of(device, threads=threads)
        for k, network in enumerate(networks(3)):
            lines = network.polylines()
            widths = network.point_widths()
            mixed = wr.RiverNetwork.from_polylines([lines[c] for c in order], width=[widths[c] for c in order])
            led(splat, mixed, 3.0 * k)
        return {name: getattr(splat.cells, name).numpy() for name in ("offset", "moisture", "sediment", "left", "kind")}

    first = state(1, [0, 1, 2, 3])
    for threads, order in ((2, [0, 1, 2, 3]), (4, [0, 1, 2, 3]), (1, [2, 0, 3, 1])):
        for name, values in state(threads, order).items():
            np.testing.assert_array_equal(values, first[name], err_msg=f"{name}, {threads} threads, {order}")


def test_blocks_that_no_channel_reaches_are_left_alone(device):
    shape = (640, 640)
    splat = splat_of(device, shape=shape, cell=10.0, origin=(0.0, 6400.0))
    line = np.stack([np.linspace(100.0, 6300.0, 200), np.full(200, 3200.0)], axis=1)
    splat.advance(splat.frame(segments_of(wr.RiverNetwork.from_polylines([line], width=30.0))), 0.0)
    # 6 widths on both sides are 36 cells; whole blocks of 32 are worked at.
    assert splat.touched <= 4 * 32 * 640
    felt = np.abs(splat.cells.offset.numpy()) < covers.FELT
    assert 34 * 600 < felt.sum() < 38 * 640


def test_old_courses_are_laid_at_their_own_time(device):
    splat = splat_of(device)
    line = np.array([[1100.0, 4700.0, 1200.0, 4700.0], [1200.0, 4700.0, 1300.0, 4650.0]])
    section = np.tile([40.0, 3.0], (2, 2))
    from_end = np.array([[0.0, 2.5], [2.5, 0.0]])
    none = np.zeros((2, 2))
    splat.lay(Segments(line, section, from_end, none, np.array([7.0, 7.0]), none), covers.OXBOW)
    widths, _, _ = twin.distances(line, section, twin.Cells(SHAPE, CELL, ORIGIN).xy)
    under = reshaped(np.abs(widths) <= 0.5)
    cells = splat.cells
    np.testing.assert_array_equal(cells.kind.numpy() == covers.OXBOW, under)
    assert (cells.left.numpy()[under] == 7.0).all() and (cells.section.numpy()[under] == [40.0, 3.0]).all()
    np.testing.assert_allclose(cells.across.numpy()[under], np.abs(reshaped(widths))[under], atol=1e-6)
    splat.lay(Segments(line, section, from_end, none, np.array([9.0, 9.0]), none), covers.BAR)
    thick = np.where(under, 3.0 * (1.0 - 4.0 * reshaped(widths) ** 2), 0.0)
    np.testing.assert_allclose(cells.lobe.numpy(), thick, atol=1e-5)
    assert (cells.left.numpy()[under] == 7.0).all()
