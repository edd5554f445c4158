"""Hydrology beside RichDEM and fastscapelib, which are GPL and so no dependency of anything here.

Run with WARPRIVER_ORACLES=1 where they are installed by hand; skipped otherwise.
"""

import os

import numpy as np
import pytest

from warpriver import hydrology
from warpriver.terrain import Terrain

SIZE, CELL = 160, 10.0

pytestmark = pytest.mark.skipif(
    os.environ.get("WARPRIVER_ORACLES") != "1", reason="set WARPRIVER_ORACLES=1 to compare with GPL programs"
)


def rough(seed):
    """Heights from 1,000 to 1,200 m with pits of every size and no ties."""
    wave = np.hypot(np.fft.rfftfreq(SIZE)[None], np.fft.fftfreq(SIZE)[:, None])
    wave[0, 0] = 1.0
    noise = np.fft.rfft2(np.random.default_rng(seed).standard_normal((SIZE, SIZE)))
    height = np.fft.irfft2(noise / wave**1.5, (SIZE, SIZE))
    return 1000.0 + 200.0 * (height - height.min()) / np.ptp(height)


def tilted(seed):
    """Heights that fall to the west everywhere, without pits, flats and ties."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float64)
    return x + 0.37 * y + 0.2 * np.random.default_rng(seed).random((SIZE, SIZE))


@pytest.fixture
def richdem():
    return pytest.importorskip("richdem")


@pytest.fixture
def fastscapelib():
    return pytest.importorskip("fastscapelib")


def as_richdem(richdem, height):
    raster = richdem.rdarray(height.copy(), no_data=-9999.0)
    raster.geotransform = (0.0, CELL, 0.0, 0.0, 0.0, -CELL)
    return raster


def fastscapelib_flow(fs, height, *operators):
    """Heights as it changed them, and drainage area in m2, with all four sides at base level."""
    grid = fs.RasterGrid([SIZE, SIZE], [CELL, CELL], fs.NodeStatus.FIXED_VALUE)
    graph = fs.FlowGraph(grid, list(operators))
    changed = graph.update_routes(height.copy())
    return changed, graph.accumulate(1.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("epsilon", [True, False])
def test_filled_heights_equal_richdem(richdem, seed, epsilon):
    height = rough(seed)
    theirs = np.asarray(richdem.FillDepressions(as_richdem(richdem, height), epsilon=epsilon))
    ours = hydrology.fill_depressions(Terrain(height, CELL), epsilon=epsilon).to_numpy()
    if epsilon:
        # Theirs deals with some cells of a depression out of order, and may end a few steps higher.
        assert (theirs >= ours).all() and (theirs - ours).max() <= 1e-9
    else:
        assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("exponent", [1.0, 1.1, 2.0])
def test_multiple_flow_equals_richdem(richdem, exponent):
    height = tilted(0)
    theirs = np.asarray(richdem.FlowAccumulation(as_richdem(richdem, height), method="Freeman", exponent=exponent))
    ours = hydrology.drainage_area(Terrain(height, CELL), method="mfd", exponent=exponent).numpy() / CELL**2
    # Their shares are float32.
    assert np.allclose(ours, theirs, rtol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_filled_heights_agree_with_fastscapelib(fastscapelib, seed):
    height = rough(seed)
    theirs, _ = fastscapelib_flow(
        fastscapelib, height, fastscapelib.PFloodSinkResolver(), fastscapelib.SingleFlowRouter()
    )
    ours = hydrology.fill_depressions(Terrain(height, CELL)).to_numpy()
    # Steps of their own, of the order of the spacing of numbers.
    assert np.allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_areas_equal_fastscapelib(fastscapelib, seed):
    height = tilted(seed)
    _, single = fastscapelib_flow(fastscapelib, height, fastscapelib.SingleFlowRouter())
    assert np.array_equal(hydrology.drainage_area(Terrain(height, CELL)), single)
    _, multiple = fastscapelib_flow(fastscapelib, height, fastscapelib.MultiFlowRouter(1.1))
    assert np.allclose(hydrology.drainage_area(Terrain(height, CELL), method="mfd"), multiple, rtol=1e-12)
