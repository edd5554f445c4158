"""Maps of banks from two dated lines: they find the banks that a simulated river had, and help to predict it."""

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr

WIDTH = 60.0
LAW = plain_params(
    spacing=30.0, migration_rate=20.0, sinuosity_scaling="none", memory_length=2.5, curvature_saturation=0.2
)


@pytest.fixture(scope="module")
def surveys():
    """A river at three dates, a year apart, whose banks are weak in one half of its valley; and their map."""
    line = wr.generate.sine_generated(16.0 * WIDTH, 1.1, 14, 30.0)
    middle, x = 0.5 * line[:, 0].max(), line[:, 0].max()
    box = [(middle, -3000.0), (x + 3000.0, -3000.0), (x + 3000.0, 3000.0), (middle, 3000.0)]
    weak = wr.ErodibilityField(box, 3.0)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], WIDTH), LAW, controls=[weak])
    found = [sim.network.polylines()[0]]
    for _ in range(2):
        sim.run(years=1, record_every=10**6)
        found.append(sim.network.polylines()[0])
    return [wr.RiverNetwork.from_polylines([xy], WIDTH) for xy in found], middle


def test_the_map_has_the_ratio_of_weak_and_strong_banks(surveys):
    (first, second, _), middle = surveys
    field = wr.meander.mapped_banks(first, second, LAW)
    assert field.raster is not None
    xy = first.polylines()[0]
    row, column = (
        np.floor((field.raster.origin[1] - xy[:, 1]) / field.raster.cell_size).astype(int),
        np.floor((xy[:, 0] - field.raster.origin[0]) / field.raster.cell_size).astype(int),
    )
    factor = field.raster.numpy()[row, column]
    weak, strong = xy[:, 0] > middle + 10.0 * WIDTH, xy[:, 0] < middle - 10.0 * WIDTH
    weak[-60:] = strong[:60] = False
    # Bends move on between the dates, and what they are compared with is their rate at the first.
    assert np.median(factor[weak]) / np.median(factor[strong]) == pytest.approx(3.0, rel=0.2)
    assert field.raster.numpy()[0, 0] == pytest.approx(1.0, abs=0.05), "away from the channel nothing is known"


def test_a_map_of_one_period_predicts_the_next(surveys):
    (first, second, third), _ = surveys
    field = wr.meander.mapped_banks(first, second, LAW)
    errors = []
    for controls in ([], [field]):
        sim = wr.Simulation(second, LAW.replace(migration_rate=40.0), controls=controls)
        sim.run(years=1, record_every=10**6)
        apart = wr.metrics.migration(third.polylines()[0], sim.network.polylines()[0], max_distance=WIDTH)
        errors.append(np.nanmean(np.abs(apart)))
    assert errors[1] < 0.6 * errors[0], errors


def test_other_rivers_are_refused(surveys):
    (first, second, _), _ = surveys
    both = wr.RiverNetwork.from_polylines([*first.polylines(), first.polylines()[0] + [0.0, 9000.0]], WIDTH)
    with pytest.raises(ValueError, match="after has 2 channels where before has 1"):
        wr.meander.mapped_banks(first, both, LAW)
    far = wr.RiverNetwork.from_polylines([first.polylines()[0] + [0.0, 50_000.0]], WIDTH)
    with pytest.raises(ValueError, match="no point of the channels before was found after"):
        wr.meander.mapped_banks(first, far, LAW)
    with pytest.raises(ValueError, match="smoothing"):
        wr.meander.mapped_banks(first, second, LAW, smoothing=0.0)
