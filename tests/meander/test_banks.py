"""Banks that differ in strength: their field, what it does to a move, and runs that keep their bits and untangled."""

import numpy as np
import pytest
import reference_banks as twin
import warp as wp
from crossings import crosses_itself, crossings

import warpriver as wr
from warpriver.device import PRECISIONS
from warpriver.kernels import banks as kernels
from warpriver.meander.banks import BankField, bank_table, highest_factor

WIDTH = 40.0
ROUGH = wr.MeanderParams(
    spacing=20.0, inlet="all", sinuosity_scaling="whole", memory_length=2.5, curvature_saturation=0.25, bank_spread=0.8,
    bank_correlation=3.0,
)  # fmt: skip


def factors(xy, width, params, *, seed=3, origin=(0.0, 0.0), dtype="float64", device="cpu"):
    """Factors at positions about an origin, by the kernels' function."""
    scalar, vec2, real = PRECISIONS[dtype]
    kernel = kernels.build(scalar)
    bank_scale, bank_factor, Banks = kernel.bank_scale, kernel.bank_factor, kernel.Banks

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(banks: Banks, width: scalar, xy: wp.array[vec2], factor_out: wp.array[scalar]):
        i = wp.tid()
        factor_out[i] = bank_factor(banks, bank_scale(banks, width), xy[i])

    given = wp.array(xy.astype(real), dtype=vec2, device=device)
    out = wp.zeros(len(xy), dtype=scalar, device=device)
    banks = BankField(seed, device).struct(params, dtype, np.array(origin))
    wp.launch(evaluate, dim=len(xy), inputs=[banks, scalar(width), given], outputs=[out], device=device)
    return out.numpy().astype(np.float64)


def test_the_table_is_a_normal_field_that_comes_again():
    table = bank_table(5).astype(np.float64)
    assert table.shape == (kernels.SIZE, kernels.SIZE)
    assert abs(table.mean()) < 1e-6 and table.std() == pytest.approx(1.0, abs=1e-6)
    # 128^2 / pi independent patches: shares of a normal law to a percent.
    assert (np.abs(table) < 1.0).mean() == pytest.approx(0.683, abs=0.012)
    assert (np.abs(table) < 2.0).mean() == pytest.approx(0.954, abs=0.006)
    for axis in (0, 1):
        for cells, expected in ((2, np.exp(-0.25)), (4, np.exp(-1.0)), (12, 0.0)):
            # Rolled round, so that the sides count as well.
            assert (table * np.roll(table, cells, axis)).mean() == pytest.approx(expected, abs=0.03)
    assert not np.array_equal(bank_table(6), bank_table(5))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("width", [7.3, 64.0, 500.0])
def test_factors_are_those_of_the_twin_wherever_the_origin_is(device, dtype, width):
    rng = np.random.default_rng(1)
    xy = rng.uniform(-9000.0, 9000.0, (500, 2)).astype(PRECISIONS[dtype][2]).astype(np.float64)
    expected = twin.bank_factor(bank_table(3), xy, width, 3.0, 0.8)
    found = factors(xy, width, ROUGH, dtype=dtype, device=device)
    np.testing.assert_allclose(found, expected, rtol=1e-9 if dtype == "float64" else 1e-6)
    origin = np.array([512_000.0, -4_096_000.0])
    moved = twin.bank_factor(bank_table(3), xy + origin, width, 3.0, 0.8)
    again = factors(xy, width, ROUGH, origin=origin, dtype=dtype, device=device)
    np.testing.assert_allclose(again, moved, rtol=1e-9 if dtype == "float64" else 1e-6)


def test_factors_are_lognormal_of_mean_1_with_the_spread_that_is_stated(device):
    xy = np.random.default_rng(2).uniform(-4e5, 4e5, (40_000, 2))
    for spread in (0.4, 0.8):
        found = factors(xy, 55.0, ROUGH.replace(bank_spread=spread), device=device)
        # Cut off at 2.5 deviations, and straight between cells: both take a few percent.
        assert np.log(found).std() == pytest.approx(spread, rel=0.05)
        assert found.mean() == pytest.approx(1.0, abs=0.04)
        assert found.max() <= highest_factor(ROUGH.replace(bank_spread=spread)) * (1.0 + 1e-12)
    assert highest_factor(ROUGH.replace(bank_spread=0.0)) == 1.0


def test_a_step_is_multiplied_by_the_factor_of_each_place(device):
    line = wr.generate.sine_generated(15.0 * WIDTH, 1.0, 6, 20.0)
    moved = []
    for spread in (0.0, 0.8):
        params = ROUGH.replace(inlet="none", bank_spread=spread, time_step=1e-3, cutoff_distance=0.0)
        sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], WIDTH), params, seed=3, device=device)
        before = sim.network.polylines()[0]
        sim.step()
        moved.append(sim.network.polylines()[0] - before)
    normal = np.stack([-np.gradient(before[:, 1]), np.gradient(before[:, 0])], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    plain, rough = ((move * normal).sum(axis=1) for move in moved)
    strong = np.abs(plain) > 0.2 * np.abs(plain).max()
    expected = twin.bank_factor(bank_table(3), before, WIDTH, 3.0, 0.8)
    # Sampling anew carries points along the line by a thousandth of what they moved.
    np.testing.assert_allclose(rough[strong] / plain[strong], expected[strong], rtol=0.03)
    assert np.ptp(expected[strong]) > 1.0


def test_bits_do_not_depend_on_threads_or_a_stop(tmp_path):
    def simulation(**options):
        line = wr.generate.noisy_line(100.0 * WIDTH, 20.0, 10.0, 3)
        network = wr.RiverNetwork.from_polylines([line, line + [0.0, 5000.0]], [WIDTH, 50.0])
        return wr.Simulation(network, ROUGH, seed=9, **options)

    whole = simulation(threads=1)
    whole.run(steps=60)
    several = simulation(threads=3, capture=False)
    several.run(steps=60)
    np.testing.assert_array_equal(several.network.points(), whole.network.points())
    stopped = simulation(threads=1)
    stopped.run(steps=23, store=tmp_path / "run")
    again = wr.Simulation.resume(tmp_path / "run", threads=1, device="cpu")
    again.run(steps=37)
    np.testing.assert_array_equal(again.network.points(), whole.network.points())


@pytest.mark.parametrize(("part", "time_step"), [(0.25, 0.29), (1.0, 5.0)])
def test_lines_among_strong_and_weak_banks_do_not_cross_themselves(part, time_step, device):
    line = wr.generate.noisy_line(300.0 * WIDTH, part * WIDTH, 2.0, 0)
    params = ROUGH.replace(spacing=part * WIDTH, time_step=time_step)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], WIDTH), params, device=device)
    history = sim.run(years=300, record_every=10**6)
    assert len(history.cutoffs) > 5
    assert not len(crossings(sim.network.polylines()[0]))
    assert not any(crosses_itself(cutoff.xy) for cutoff in history.cutoffs)
