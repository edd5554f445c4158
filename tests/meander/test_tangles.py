"""No line and no loop that is cut off crosses itself, at any width, spacing and time step."""

import numpy as np
import pytest
from crossings import crosses_itself, crossings
from plain import plain_params

import warpriver as wr

# Cut-off loops that crossed themselves while rates were smoothed as numbers and not as vectors: 85 % of those of the
# first case, 75 % of the second, 31 % of the third.
FINE = [(50.0, 0.125, "upstream"), (20.0, 0.25, "upstream"), (10.0, 0.5, "upstream")]
# The ends of channels were where the last ones crossed.
ENDS = [(20.0, 0.25, "whole"), (100.0, 0.25, "whole"), (200.0, 1.0, "whole")]


def river(width, part, length=400.0, seed=0):
    """A straight line with noise, ``length`` widths long, with a point every ``part`` of a width."""
    line = wr.generate.noisy_line(length * width, part * width, width / 20.0, seed)
    return wr.RiverNetwork.from_polylines([line], width=width)


def grown(width, part, scaling, time_step, years, device, length=400.0):
    """History of a river by the law alone; see ``watched``."""
    params = plain_params(spacing=part * width, sinuosity_scaling=scaling, time_step=time_step)
    return watched(width, part, params, years, device, length)


def watched(width, part, params, years, device, length=400.0):
    """History of a river; its line must not cross itself in any state, taken every five years."""
    sim = wr.Simulation(river(width, part, length), params, device=device)

    def look(sim):
        pairs = crossings(sim.network.polylines()[0])
        assert not len(pairs), f"segments {pairs[:3].tolist()} cross at {sim.time:.1f} yr"

    history = sim.run(years=years, record_every=10**6, callbacks=[(wr.history.Every(years=5), look)])
    assert history.stop_reason is wr.history.StopReason.COMPLETED
    return history


@pytest.mark.parametrize(("width", "part", "scaling"), FINE + ENDS)
@pytest.mark.parametrize("time_step", [106.0 / 365.25, 10.0])
def test_neither_lines_nor_loops_cross_themselves(width, part, scaling, time_step, device):
    history = grown(width, part, scaling, time_step, 500.0, device)
    assert len(history.cutoffs) > 5
    assert not any(crosses_itself(cutoff.xy) for cutoff in history.cutoffs)


def test_a_tenth_of_a_width_is_not_too_fine(device):
    history = grown(100.0, 0.1, "whole", 1.0, 400.0, device, length=200.0)
    assert len(history.cutoffs) > 5
    assert not any(crosses_itself(cutoff.xy) for cutoff in history.cutoffs)


@pytest.mark.parametrize(
    "options", [{}, {"bank_spread": 0.0}, {"cutoff_distance": 1.0}, {"curvature_saturation": 0.1, "bank_spread": 1.0}]
)
def test_bends_that_saturate_do_not_fold(options, device):
    """Where the local term saturated altogether, 2 to 13 % of the loops of so narrow a river crossed themselves."""
    params = wr.MeanderParams(spacing=1.0, spacing_in_widths=0.0, **options)
    history = watched(10.0, 0.1, params, 300.0, device, length=60.0)
    assert len(history.cutoffs) > 5
    assert not any(crosses_itself(cutoff.xy) for cutoff in history.cutoffs)


def test_loops_of_a_narrow_river_do_not_depend_on_the_spacing(device):
    """Median length of the loops in widths, from half a width to an eighth; tangled, it fell to a tenth."""
    median = []
    for part in (0.5, 0.25, 0.125):
        cutoffs = grown(50.0, part, "upstream", 2.0, 600.0, device, length=500.0).cutoffs
        median.append(np.median(wr.metrics.oxbow_lengths(cutoffs)) / 50.0)
    assert np.ptp(median) < 0.2 * np.mean(median), median


def test_crossings_are_those_of_comparing_all_pairs():
    """Of a random walk, by hand for a bow tie; where lines touch they do not cross."""
    assert crossings(np.array([[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0]])).tolist() == [[0, 2]]
    assert not crosses_itself(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 1.0], [1.0, 0.0]]))
    xy = np.cumsum(np.random.default_rng(0).normal(size=(120, 2)), axis=0)
    found = {tuple(pair) for pair in crossings(xy).tolist()}
    expected = set()
    for i in range(len(xy) - 1):
        for j in range(i + 2, len(xy) - 1):
            along = np.stack([xy[i + 1] - xy[i], xy[j] - xy[j + 1]], axis=1)
            place = np.linalg.solve(along, xy[j] - xy[i])
            if (0.0 < place).all() and (place < 1.0).all():
                expected.add((i, j))
    assert found == expected and len(found) > 20
