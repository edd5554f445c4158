"""Statistics of rivers against lines whose bends, straight reaches and junctions are known, and measured rivers."""

import math

import numpy as np
import pytest
from data_folder import SURVEYS, data_folder

import warpriver as wr
from warpriver.generate import noisy_line, sine_generated
from warpriver.metrics import Comparison, RiverStatistics, compare, statistics

WIDTH = 40.0


def river(xy, width=WIDTH, **options):
    return wr.RiverNetwork.from_polylines([xy] if isinstance(xy, np.ndarray) else xy, width, **options)


def test_a_train_of_equal_bends_has_their_sizes():
    """A sine-generated line of wavelength 20 w and swing 1.1 rad: arc a bend 10 w / J0(1.1), R = arc / (pi swing)."""
    told = statistics(river(sine_generated(20.0 * WIDTH, 1.1, 12, 5.0)))
    arc = 10.0 / 0.71962
    assert told.bend_length == pytest.approx(arc, rel=0.01)
    assert told.wavelength == pytest.approx(20.0, rel=0.01)
    # The smoothing takes 1 % off the curvature of waves of 28 widths of arc.
    assert told.radius == pytest.approx(arc / (math.pi * 1.1), rel=0.02)
    assert told.tight_share == 0.0 and math.isnan(told.lean_strong) and math.isnan(told.lag)
    assert told.straight < 3.0


@pytest.mark.parametrize("lean", [-1, 1])
def test_bends_lean_to_where_their_apex_lies(lean):
    """Kinoshita's curve: a third harmonic of the heading skews every bend; read backwards it leans the other way."""
    s = np.arange(0.0, 240.0 * WIDTH, 5.0)
    phase = 2.0 * np.pi * s / (20.0 * WIDTH)
    heading = 1.3 * np.sin(phase) + 1.3**3 / 32.0 * np.cos(3.0 * phase)
    xy = 5.0 * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    bend = wr.metrics.bends(xy, WIDTH)
    ahead = float((bend.apex < 0.5 * (bend.start + bend.end)).mean())
    assert ahead in (0.0, 1.0)
    told = statistics(river(xy[::lean]))
    assert told.lean_middle == (ahead if lean == 1 else 1.0 - ahead)


def test_straight_reaches_are_measured_from_bend_to_bend():
    bent = sine_generated(20.0 * WIDTH, 1.1, 3, 10.0)
    along = np.arange(1, 201)[:, None] * np.array([10.0, 0.0])  # 50 widths
    middle = bent[-1] + along
    xy = np.concatenate([bent, middle, middle[-1] + bent[1:] - bent[0]])
    told = statistics(river(xy))
    assert told.straight == pytest.approx(50.0, abs=3.0) and told.straight_below_head < 2.0
    headless = statistics(river(np.concatenate([bent[0] - along[::-1], bent])))
    assert headless.straight_below_head == headless.straight == pytest.approx(50.0, abs=3.0)


def joined(angle, bent_below=True):
    """A tributary that meets a straight main stem at an angle, and what flows on."""
    x = np.arange(0.0, 4001.0, 20.0)
    main = np.stack([x - 4000.0, 0.0 * x], axis=1)
    turn = np.radians(angle)
    tributary = (x[::-1, None] - 0.0) * -np.array([[np.cos(turn), np.sin(turn)]])
    below = sine_generated(20.0 * WIDTH, 1.1, 6, 10.0)
    if not bent_below:
        below = np.concatenate([main - main[0], below[1:] + [4000.0, 0.0]])
    return river([main, tributary, below], [WIDTH, 0.5 * WIDTH, WIDTH])


@pytest.mark.parametrize("angle", [15.0, 60.0, 110.0])
def test_angles_of_tributaries(angle):
    told = statistics(joined(angle))
    assert told.tributary_angle == pytest.approx(angle, abs=0.5)
    assert told.narrow_share == (angle < 25.0)


def test_curvature_below_junctions_against_that_elsewhere():
    """Nothing bends above; below, where the channel goes on straight for 100 widths, nothing bends near it either."""
    assert statistics(joined(60.0)).junction_curvature > 1.5
    assert statistics(joined(60.0, bent_below=False)).junction_curvature < 1e-6


def test_bends_go_on_through_nodes():
    """A river cut into links has the bends that it has in one piece."""
    xy = noisy_line(12_000.0, 20.0, 40.0, 3)
    # A river without a bend at the threshold of what counts as one.
    params = wr.MeanderParams(curvature_saturation=0.3, bank_spread=0.6, bank_correlation=3.0)
    sim = wr.Simulation(river(xy), params, seed=0)
    sim.run(years=60)
    (xy,) = sim.network.polylines()
    third = len(xy) // 3
    cut = [xy[: third + 1], xy[third : 2 * third + 1], xy[2 * third :]]
    whole, links = statistics(river(xy)), statistics(river(cut))
    assert whole.bends > 20
    for name, value, _, _ in whole.rows():
        if not math.isnan(value) and name not in ("sinuosity", "junction_curvature"):
            # Samples lie an eighth of a width apart, and not in the same places.
            apart = 0.25 if name.startswith("straight") else 0.0
            assert getattr(links, name) == pytest.approx(value, rel=0.02, abs=apart), name


def test_rings_and_lines_without_bends():
    angle = 2.0 * np.pi * np.arange(200) / 200
    ring = statistics(river(1000.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True))
    assert ring.bends == 0 and math.isnan(ring.radius) and ring.sinuosity == pytest.approx(1.0, abs=1e-3)
    line = statistics(river(np.stack([np.linspace(0.0, 4000.0, 200), np.zeros(200)], axis=1)))
    assert line.bends == 0 and line.straight == pytest.approx(100.0, abs=0.1)


def test_runs_tell_of_their_oxbow_lakes_and_their_lag():
    params = wr.MeanderParams(sinuosity_scaling="whole", memory_length=2.5, curvature_saturation=0.2)
    sim = wr.Simulation(river(noisy_line(8000.0, 20.0, 40.0, 5)), params, seed=0)
    history = sim.run(years=250, record_every=10)
    assert len(history.cutoffs) > 3
    told = statistics(history)
    assert told.oxbows == len(history.cutoffs)
    lengths = [wr.metrics.arc_length(cut.xy)[-1] / WIDTH for cut in history.cutoffs]
    assert told.oxbow_length == pytest.approx(np.exp(np.mean(np.log(lengths))))
    assert 0.5 < told.lag < 10.0
    both = compare(history.networks[0], history)
    assert isinstance(both, Comparison) and both.b == told
    rows = {name: (a, b, change) for name, a, b, change in both.rows()}
    assert rows["bend_length"][2] == rows["bend_length"][1] - rows["bend_length"][0]
    assert str(both).count("\n") == len(rows) and "b - a" in str(both) and "none" in str(both)


def test_what_cannot_be_measured_is_refused():
    network = river(sine_generated(20.0 * WIDTH, 1.1, 4, 10.0))
    with pytest.raises(ValueError, match="no records"):
        statistics(wr.history.History(wr.MeanderParams()))
    with pytest.raises(ValueError, match="later has 3 channels where the river has 1"):
        statistics(network, joined(60.0))


def test_measured_rivers_have_the_statistics_that_models_are_held_against():
    """Six reaches of the Amazon basin.

    Measured on ten, these among them: bends of 10.6 widths, R of 3.2 w, 22 % of them below 2 w, and 43, 61 and 73 %
    that lean upstream by class; a lag of 2.4 to 4.3 w; wavelengths of 13 to 20 w.
    """
    found: list[RiverStatistics] = []
    for name, days in SURVEYS.items():
        before, after = (wr.read_network(data_folder("centerlines") / f"{name}_{day}.csv.gz") for day in days)
        found.append(statistics(before, after))
        assert 13.0 < found[-1].wavelength < 20.0 and 2.4 < found[-1].lag < 4.4
        assert found[-1].straight < 50.0
    weight = [told.bends for told in found]

    def mean(name):
        return np.average([getattr(told, name) for told in found], weights=weight)

    assert sum(weight) == 1192
    assert mean("bend_length") == pytest.approx(10.6, abs=0.6)
    assert mean("radius") == pytest.approx(3.2, abs=0.1)
    assert mean("tight_share") == pytest.approx(0.22, abs=0.03)
    for name, share in (("lean_slight", 0.43), ("lean_middle", 0.61), ("lean_strong", 0.73)):
        assert mean(name) == pytest.approx(share, abs=0.05), name
