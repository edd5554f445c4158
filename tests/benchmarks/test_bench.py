"""The measuring behind ``warpriver bench``: what is measured, never how long it took."""

from types import SimpleNamespace

import numpy as np
import pytest
from plain import plain_params

from warpriver import RiverNetwork, Simulation, bench, generate

SMALL = 2**20


@pytest.fixture(autouse=True)
def quick_rivers(monkeypatch):
    """Rivers that have meandered for a year do for a test."""
    monkeypatch.setattr(bench, "RIVER_YEARS", 1.0)
    monkeypatch.setattr(bench, "RIVER_POINTS", 500)


def pair(**options):
    lines = [generate.noisy_line(3000.0, 50.0, 50.0, k) + [0.0, 900.0 * k] for k in range(2)]
    return Simulation(RiverNetwork.from_polylines(lines, width=50.0), plain_params(), **options)


def test_min_seconds_is_the_minimum_of_the_rounds(monkeypatch):
    """By a clock of our own: rounds of 6, 2 and 4 s, of two calls each."""
    clock, waits = [0.0], iter([3.0, 3.0, 1.5, 0.5, 2.0, 2.0])

    def call():
        clock[0] += next(waits)

    monkeypatch.setattr(bench.time, "perf_counter", lambda: clock[0])
    assert bench.min_seconds(call, repeats=2, rounds=3) == 1.0
    assert next(waits, None) is None


@pytest.mark.parametrize("threads", [1, 3])
def test_a_copy_moves_every_byte(threads, monkeypatch):
    """Two arrays of that many bytes, read and written, in the time that was measured."""
    done = []

    def timed(call, *_, **__):
        call()
        done.append(call)
        return 0.5

    copied = []
    copy = np.copyto
    monkeypatch.setattr(np, "copyto", lambda a, b: (copied.append(a.nbytes), copy(a, b)))
    monkeypatch.setattr(bench, "min_seconds", timed)
    assert bench.copy_bandwidth(threads, nbytes=SMALL) == 2 * SMALL / 0.5
    assert len(copied) == threads and sum(copied) == SMALL and len(done) == 1


def test_copies_of_points():
    """At 32 GB/s a million points of two float64, read and written, take a millisecond."""
    assert bench.copies_of_points(3e-3, 1_000_000, "float64", 32e9) == pytest.approx(3.0)
    assert bench.copies_of_points(3e-3, 1_000_000, "float32", 32e9) == pytest.approx(6.0)


def test_lines_are_reaches_of_one_river():
    lines = bench.cut_lines([3, 100, 1700], seed=1, river_points=500, years=1.0)
    assert [len(line) for line in lines] == [3, 100, 1700]
    for line in lines:  # where the river begins anew, too
        assert np.hypot(*np.diff(line, axis=0).T) == pytest.approx(bench.SPACING, rel=0.05)
    again = bench.cut_lines([3, 100, 1700], seed=1, river_points=500, years=1.0)
    assert all(np.array_equal(a, b) for a, b in zip(lines, again, strict=True))
    other = bench.cut_lines([3, 100, 1700], seed=2, river_points=500, years=1.0)
    assert not np.array_equal(lines[1], other[1])


def test_laid_out_lines_keep_their_shapes_and_their_distance():
    rng = np.random.default_rng(0)
    lines = [np.cumsum(rng.normal(size=(n, 2)), axis=0) * 100.0 for n in rng.integers(3, 60, 40)]
    moved = bench.lay_out(lines, gap=500.0)
    for line, there in zip(lines, moved, strict=True):
        assert there - there[0] == pytest.approx(line - line[0])
    low, high = (np.array([f(line, axis=0) for line in moved]) for f in (np.min, np.max))
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(axis=2)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() >= 500.0 - 1e-6
    assert np.ptp(high, axis=0).max() < 4 * np.ptp(high, axis=0).min()  # neither a row nor a column


def test_ground_lies_under_the_network_and_is_as_steep_as_asked():
    sim = pair()
    ground = bench.ground_under(sim.network, relief_slope=0.1)
    slope = np.hypot(*np.gradient(ground.to_numpy(), ground.cell_size))
    assert 0.08 < slope.max() <= 0.1
    west, south, east, north = sim.network.bounds()
    assert ground.bounds[0] < west and ground.bounds[1] < south and ground.bounds[2] > east and ground.bounds[3] > north


class Calls:
    """Stands in for a simulation on either device, and notes how many steps each call asks for."""

    def __init__(self, is_cpu):
        self.device = SimpleNamespace(is_cpu=is_cpu)
        self.asked = []

    def step(self, count=1):
        self.asked.append(count)


def test_steps_are_asked_for_one_by_one_on_the_cpu_and_at_once_on_a_gpu():
    cpu, gpu = Calls(True), Calls(False)
    for sim in (cpu, gpu):
        bench.advance(sim, 5)
    assert cpu.asked == [1] * 5 and gpu.asked == [5]


def test_a_warm_up_has_a_row_of_every_length_on_a_gpu():
    """Else the first row of some length would be recorded while it is timed."""
    cpu, gpu = Calls(True), Calls(False)
    for sim in (cpu, gpu):
        bench.warm_up(sim, 3)
    assert cpu.asked == [1] * 3 and gpu.asked == [1, 2, 4, 8, 16, 32, 64]
    assert gpu.asked[-1] == bench.GPU_STEPS


def test_a_step_that_is_measured_is_the_step_of_a_run():
    measured, plain = pair(), pair()
    found = bench.step_cost(measured, rounds=2, repeats=4, warmup=1)
    assert measured.step_count == 9
    for _ in range(9):
        plain.step()
    assert np.array_equal(measured.network.points(), plain.network.points())
    assert found["channels"] == 2 and found["substeps"] == 1
    assert found["ns_per_point"] == pytest.approx(1e6 * found["ms_per_step"] / found["points"])
    assert 0 < found["ms_per_step"] <= found["ms_mean"]


@pytest.mark.parametrize("threads", [1, 2])
def test_phases_are_those_of_the_step_and_change_no_bit(threads):
    split, plain = pair(threads=threads), pair()
    seconds = bench.phase_seconds(split, steps=4, warmup=1)
    assert list(seconds) == ["migrate", "cut off", "resample", "collide", *bench.HOST_PHASES]
    assert all(cost >= 0.0 for cost in seconds.values()) and seconds["migrate"] > 0.0
    for _ in range(5):
        plain.step()
    assert np.array_equal(split.network.points(), plain.network.points())
    split.step()  # goes on as if nothing had been
    plain.step()
    assert np.array_equal(split.network.points(), plain.network.points())
    assert "_launch" not in vars(split)


def test_phases_of_a_step_without_cutoffs_and_collisions():
    sim = bench.synthetic_network(600, 3, cutoffs=False, collisions=False)
    assert list(bench.phase_seconds(sim, steps=2)) == ["migrate", "resample", *bench.HOST_PHASES]


def test_measure_says_what_it_measured():
    found = bench.measure(600, 3, threads=2, terrain=True, collisions=False, dtype="float32", copy_bytes=SMALL)
    # The rivers lengthen while they are measured.
    assert found["channels"] == 3 and abs(found["points"] / 600 - 1.0) < 0.6
    assert (found["threads"], found["terrain"], found["cutoffs"], found["collisions"]) == (2, True, True, False)
    assert found["dtype"] == "float32" and found["copy_bytes_per_second"] > 0.0
    expected = bench.copies_of_points(
        1e-3 * found["ms_per_step"], found["points"], "float32", found["copy_bytes_per_second"]
    )
    assert found["copies_of_points"] == expected


@pytest.mark.parametrize(("points", "channels"), [(2, 1), (100, 0), (100, 50)])
def test_too_few_points(points, channels):
    with pytest.raises(ValueError, match="3 points for each"):
        bench.synthetic_network(points, channels)
