"""Rates, by ``compute_velocity`` and ``resolve_rate``, against O(n^2) twins, closed forms, symmetries and orders."""

import dataclasses
from decimal import Decimal, localcontext

import numpy as np
import pytest
import reference
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import DEALS, SCALARS, SLABS, to_device, unwritten
from migration_case import (
    MOVE_TOLERANCE,
    MOVE_TOLERANCE_32,
    SHORT_STEP,
    SUM_TOLERANCE,
    SUM_TOLERANCE_32,
    Case,
    assert_rates,
    device_constants,
    heading_line,
    meander,
    stacked_lines,
    twin_rates,
    varying_sections,
)
from plain import plain_params
from reference import Law
from scipy.integrate import quad

from warpriver.engine.state import State
from warpriver.kernels import memory, migration, polyline
from warpriver.meander import migration as launcher
from warpriver.network import RiverNetwork

# A weight is a dozen operations, each off by at most half a unit in the last place.
WEIGHT_TOLERANCE, WEIGHT_TOLERANCE_32 = 4e-15, 4e-6


# ---- the weights of one segment


def exact_weights(x):
    """The closed form in decimal arithmetic of 700 digits, where the differences lose nothing."""
    with localcontext() as context:
        context.prec = 700
        depth = Decimal(float(x))
        q = (-depth).exp()
        share = (1 - q) / depth
        return float(q), float(share - q), float(1 - share)


SEAM = 0.5
DEPTHS = [
    1e-300, 1e-20, 1e-12, 1e-8, 1e-3, 0.1, 0.3, np.nextafter(SEAM, 0.0), SEAM, np.nextafter(SEAM, 1.0),
    0.55, 1.0, 2.0, 5.0, 10.0, 50.0, 700.0, 745.0, 800.0, 1e5, 1e12,
]  # fmt: skip


def device_weights(depths, dtype, device):
    scalar = SCALARS[dtype]
    decay_weights = memory.build(scalar).decay_weights
    vec3 = wp.types.vector(3, scalar)

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(x: wp.array[scalar], weights_out: wp.array[vec3]):
        i = wp.tid()
        weights_out[i] = decay_weights(x[i])

    out = unwritten(len(depths), vec3, device)
    wp.launch(evaluate, dim=len(depths), inputs=[to_device(depths, scalar, device)], outputs=[out], device=device)
    return out.numpy().astype(np.float64)


def test_weights_match_the_closed_form_at_every_optical_depth(device):
    depths = np.array(DEPTHS)
    expected = np.array([exact_weights(x) for x in depths])
    assert device_weights(depths, "float64", device) == pytest.approx(expected, rel=WEIGHT_TOLERANCE, abs=1e-320)


def test_weights_in_single_precision(device):
    depths = np.array([x for x in DEPTHS if 1e-30 < x], np.float32)
    expected = np.array([exact_weights(x) for x in depths])
    weights = device_weights(depths, "float32", device)
    assert weights == pytest.approx(expected, rel=WEIGHT_TOLERANCE_32, abs=1e-38)


def test_weights_of_a_segment_without_length_keep_the_past(device):
    assert device_weights(np.array([0.0]), "float64", device).tolist() == [[1.0, 0.0, 0.0]]


@pytest.mark.parametrize("x", [1e-6, 0.2, SEAM, 1.7, 30.0])
def test_weights_integrate_a_linear_rate_exactly(x):
    """int_0^1 v(t) x e^(-x (1 - t)) dt with v = 3 - 5 t, by adaptive quadrature; the twin's weights alike."""
    integral = quad(lambda t: (3.0 - 5.0 * t) * x * np.exp(-x * (1.0 - t)), 0.0, 1.0, epsabs=0.0, epsrel=1e-13)[0]
    for weights in (device_weights(np.array([x]), "float64", "cpu")[0], reference.decay_weights(x)):
        assert weights[1] * 3.0 + weights[2] * -2.0 == pytest.approx(integral, rel=1e-12)


def test_twin_weights_match_the_closed_form():
    for x in DEPTHS:
        assert reference.decay_weights(x) == pytest.approx(exact_weights(x), rel=2e-13, abs=1e-320), x


# ---- rates


@pytest.mark.parametrize("scales", [(0, 0), (0, 1), (1, 1)], ids=["none", "upstream", "whole"])
def test_rates_match_the_double_sum_however_they_are_dealt_out(device, scales):
    lines = stacked_lines()
    law = Law(time_step=SHORT_STEP, scale_local=scales[0], scale_upstream=scales[1])
    width, depth = np.linspace(30.0, 90.0, len(lines)), np.linspace(1.0, 4.0, len(lines))
    case = Case(lines, width=width, depth=depth, device=device)
    expected = twin_rates(lines, law, width, depth)
    for deal in DEALS:
        rates = case.rates(law, deal)
        assert_rates(rates, expected, SUM_TOLERANCE)
        assert all(rate[0] == 0.0 for rate in rates), "the reach above a head counts as straight"


def test_rates_with_sections_that_vary_along_the_channel(device):
    lines = stacked_lines(seed=8)
    sections, law = varying_sections(lines), Law(time_step=SHORT_STEP)
    case = Case(lines, sections=sections, device=device)
    expected = twin_rates(lines, law, sections=sections)
    for deal in DEALS:
        assert_rates(case.rates(law, deal), expected, SUM_TOLERANCE)


def test_rates_on_uneven_points(device):
    """Arc length is measured, not assumed: what a careless edit leaves uneven still integrates by its true length."""
    rng = np.random.default_rng(2)
    lines = [xy + rng.uniform(-12.0, 12.0, xy.shape) for xy in stacked_lines(seed=4)]
    law = Law(time_step=SHORT_STEP)
    for deal in (1, 7, 4096, *SLABS):
        assert_rates(Case(lines, device=device).rates(law, deal), twin_rates(lines, law), SUM_TOLERANCE)


@settings(max_examples=30, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.integers(3, 90), min_size=1, max_size=6),
    deal=st.one_of(st.integers(1, 130), st.sampled_from(SLABS)),
    seed=st.integers(0, 2**32 - 1),
    depth=st.floats(0.05, 50.0),
    time_step=st.sampled_from([SHORT_STEP, 0.3, 3.0]),
)
def test_any_channels_in_any_chunks_or_slabs(counts, deal, seed, depth, time_step):
    """Both kernels, smoothing included, for channels of 3 points and more that share and straddle chunks."""
    lines = stacked_lines(seed, counts)
    law = Law(time_step=time_step)
    case = Case(lines, depth=depth, width=80.0)
    expected = []
    for xy, rate in zip(lines, twin_rates(lines, law, 80.0, depth), strict=True):
        r = reference.recurrence_root(reference.implicit_share(xy, 50.0, 80.0, law))
        rate[0] = 0.0
        expected.append(reference.fading_sum(reference.velocities(xy, rate), r))
    found = case.velocities(law, deal)
    assert_rates(found, expected, SUM_TOLERANCE)
    for xy, velocity, moved in zip(lines, found, case.moved(law, found, deal), strict=True):
        twin = reference.move_points(xy, velocity, 50.0, 80.0, law)
        size = np.abs(xy).max() + np.abs(twin - xy).max()
        assert np.abs(moved - twin).max() <= 1e-15 * size + SUM_TOLERANCE * np.abs(twin - xy).max()


def test_ten_thousand_kilometres_do_not_underflow(device):
    """exp(-alpha s) is 10^(-48,000) at the far end; the mean there is that of the points nearby all the same."""
    count, spacing = 200_001, 50.0
    xy = meander(count, spacing)
    # About the origin, as the simulation holds it.
    xy -= np.round(xy.mean(axis=0))
    law = Law(time_step=SHORT_STEP, scale_upstream=0, end_damping=0.0)
    case = Case([xy], device=device)
    rates = {deal: case.rates(law, deal)[0] for deal in (64, 4096, *SLABS[:1])}
    largest = np.abs(rates[64]).max()
    for deal in (4096, *SLABS[:1]):
        assert np.abs(rates[64] - rates[deal]).max() <= SUM_TOLERANCE * largest
    # Only what lies within 60 e-foldings counts in the twin: the points before it have no share in double precision.
    window = int(60.0 / (2.0 * law.friction / 2.0 * spacing)) + 3
    for i in np.linspace(2 * window, count - 4, 60).astype(int):
        piece = xy[i - window : i + 4]
        curvature = reference.circle_curvature(piece)
        change = np.diff(curvature, 2)
        strength = law.migration_rate * 50.0
        value = strength * (curvature[1:-1] - change / 6.0)
        depth = reference.optical_depths(spacing, 50.0, np.full(len(piece) - 4, 2.0), law)
        upstream = reference.upstream_mean(value, depth)[-2]
        local = strength * (curvature[1:-1] - change / 12.0)[-2]
        expected = law.local_weight * local + law.upstream_weight * upstream
        assert abs(rates[4096][i] - expected) <= SUM_TOLERANCE * largest


def test_a_bend_fades_downstream_by_its_exponential():
    """Below a single bend the rate is A e^(-alpha z): 18 e-foldings down where chunks restart the sum, 100 else."""
    bend = meander(40)
    # Due east from there, so that not even rounding bends it again.
    foot = bend[-1] + np.arange(1, 261)[:, None] * np.array([50.0, 0.0])
    law = Law(time_step=SHORT_STEP, scale_upstream=0, friction=0.008)
    for deal, reach in ((1, 45), (64, 45), (4096, 250), ("one slab", 250)):
        rate = Case([np.concatenate([bend, foot])]).rates(law, deal)[0][45:-4]
        z = 2.0 * law.friction / 2.0 * 50.0 * np.arange(len(rate))
        # The walk back stops 40 e-foldings up: e^-22 of what is left after 18.
        assert (rate * np.exp(z))[:reach] == pytest.approx(rate[0], rel=1e-9)


def test_a_circle_has_the_curvature_of_its_radius(device):
    """All of it: the local term alone is -k w / R, and far down the bend both terms give k w / R (omega + gamma)."""
    radius, count = 400.0, 160
    angle = np.arange(count) * 0.11
    xy = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    chord = 2.0 * radius * np.sin(0.055)
    local = Law(time_step=SHORT_STEP, upstream_weight=0.0)
    rate = Case([xy], spacing=chord, device=device).rates(local)[0]
    assert rate[2:-2] == pytest.approx(-60.0 * 50.0 / radius, rel=SUM_TOLERANCE)
    both = Law(time_step=SHORT_STEP, scale_upstream=0, end_damping=0.0)
    rate = Case([xy[::-1]], spacing=chord, device=device).rates(both)[0]
    assert rate[110:-2] == pytest.approx(-60.0 * 50.0 / radius * 1.5, rel=SUM_TOLERANCE)


def test_local_rate_converges_at_fourth_order():
    """Against the exact curvature of a strongly bent line; the rate falls with h^4."""
    length, q = 4000.0, 2.0 * np.pi / 1000.0
    law = Law(time_step=SHORT_STEP, upstream_weight=0.0)
    errors = []
    for count in (101, 201, 401):
        spacing = length / (count - 1)
        xy = heading_line(lambda s: 1.3 * np.sin(q * s), count, spacing)
        s = spacing * np.arange(count)
        exact = -60.0 * 50.0 * 1.3 * q * np.cos(q * s)
        inner = (s > 500.0) & (s < length - 500.0)
        errors.append(np.abs(Case([xy], spacing=spacing).rates(law)[0] - exact)[inner].max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx(4.0, abs=0.15), errors


def test_upstream_rate_of_a_slight_bend_converges_at_fourth_order():
    """For C = c cos(q s) the mean is c alpha (alpha cos + q sin) / (alpha^2 + q^2), once the head has faded."""
    length, q, swing = 10_000.0, 2.0 * np.pi / 800.0, 1e-3
    law = Law(time_step=SHORT_STEP, local_weight=0.0, upstream_weight=1.0, scale_upstream=0)
    alpha = 2.0 * law.friction / 2.0
    errors = []
    for count in (201, 401, 801):
        spacing = length / (count - 1)
        xy = heading_line(lambda s: swing * np.sin(q * s), count, spacing)
        s = spacing * np.arange(count)
        exact = alpha * (alpha * np.cos(q * s) + q * np.sin(q * s)) / (alpha**2 + q**2) * 60.0 * 50.0 * swing * q
        far = (s > 5000.0) & (s < length - 500.0)
        errors.append(np.abs(Case([xy], spacing=spacing).rates(law)[0] - exact)[far].max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx(4.0, abs=0.2), errors


def test_a_straight_line_has_no_rate(device):
    for turn in (0.0, 0.3, np.pi / 2, 2.0):
        xy = np.arange(300)[:, None] * 50.0 * np.array([np.cos(turn), np.sin(turn)])
        rate = Case([xy], device=device).rates(Law(time_step=SHORT_STEP))[0]
        # Points 15 km out are rounded to 2e-12 m, a curvature of some 2e-12 / 50^2 per m.
        assert np.abs(rate).max() <= 60.0 * 50.0 * 4e-15


def test_rates_turn_with_the_line_and_change_sign_in_its_mirror(device):
    lines, law = stacked_lines(seed=6), Law(time_step=0.3)
    found = Case(lines, device=device).velocities(law)
    moved = Case(lines, device=device).moved(law, found)
    rates = Case(lines, device=device).rates(Law(time_step=SHORT_STEP))
    c, s = np.cos(0.7), np.sin(0.7)
    for image in (np.array([[c, s], [-s, c]]), np.diag([1.0, -1.0])):
        sign = np.sign(np.linalg.det(image))
        case = Case([xy @ image for xy in lines], device=device)
        assert_rates(case.rates(Law(time_step=SHORT_STEP)), [sign * rate for rate in rates], SUM_TOLERANCE)
        image_velocities = case.velocities(law)
        assert_rates(image_velocities, [velocity @ image for velocity in found], SUM_TOLERANCE)
        for a, b in zip(case.moved(law, image_velocities), moved, strict=True):
            assert np.abs(a - b @ image).max() <= MOVE_TOLERANCE


def test_rates_in_proportion_to_width(device):
    """With a reference width, k belongs to channels so wide; at that width nothing changes."""
    lines = stacked_lines(seed=4)
    sections = varying_sections(lines)
    law = Law(reference_width=70.0, time_step=SHORT_STEP)
    assert_rates(
        Case(lines, sections=sections, device=device).rates(law),
        twin_rates(lines, law, sections=sections),
        SUM_TOLERANCE,
    )
    even = Case(lines, width=70.0, device=device)
    for a, b in zip(even.rates(law), even.rates(Law(time_step=SHORT_STEP)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_network_far_from_the_origin_moves_as_near_it(dtype):
    """Through RiverNetwork.origin, to the bit, in both precisions: nothing is ever computed in absolute coordinates."""
    params = plain_params(time_step=0.3, spacing=50.0)
    results = []
    for offset in ((0.0, 0.0), (512_000.0, 4_096_000.0)):
        lines = [np.round(xy * 64.0) / 64.0 + offset for xy in stacked_lines(seed=1)]
        network = RiverNetwork.from_polylines(lines, width=50.0, dtype=dtype, device="cpu")
        mover = launcher.Migrate()
        state = State(network, params, None, (mover,), launcher.step_limits)
        state.begin()
        state.step.fill_(params.time_step)
        state.begin_batch()
        state.run(mover.stages(state))
        count = network.point_count
        results.append((mover.point_velocity.numpy()[:count], state.point_moved.numpy()[:count]))
    assert np.isfinite(results[0][1]).all() and np.abs(results[0][0]).max() > 1.0
    assert (results[0][0] == results[1][0]).all()
    assert (results[0][1] == results[1][1]).all()


def test_single_precision_rates_and_moves(device):
    lines = [np.float32(xy).astype(np.float64) for xy in stacked_lines(seed=11)]
    sections = varying_sections(lines)
    for law in (Law(time_step=SHORT_STEP), Law(time_step=0.3), Law(time_step=0.3, scale_local=1)):
        wide, narrow = (Case(lines, sections=sections, dtype=d, device=device) for d in ("float64", "float32"))
        found = wide.velocities(law)
        for deal in (1, 7, 4096, *SLABS):
            assert_rates(narrow.velocities(law, deal), found, SUM_TOLERANCE_32)
        for a, b in zip(narrow.moved(law, found), wide.moved(law, found), strict=True):
            assert np.abs(a - b).max() <= MOVE_TOLERANCE_32


def test_end_damping_is_a_smoothstep_of_the_distance_to_the_end(device):
    """Of what is felt of the bends upstream; five widths of 60 m are six points of 50 m: t = k / 6, from both ends."""
    case = Case([meander(40)], width=60.0, device=device)
    law = Law(time_step=SHORT_STEP, local_weight=0.0, end_damping=5.0)
    free, damped = (case.rates(dataclasses.replace(law, end_damping=d))[0] for d in (0.0, 5.0))
    by_hand = np.array([0.0, 2.0 / 27.0, 7.0 / 27.0, 0.5, 20.0 / 27.0, 25.0 / 27.0, 1.0, 1.0])
    assert damped[:8] == pytest.approx(by_hand * free[:8], rel=1e-14)
    assert damped[:-9:-1] == pytest.approx(by_hand * free[:-9:-1], rel=1e-14)
    assert (damped[6:-6] == free[6:-6]).all()
    local = dataclasses.replace(law, local_weight=-1.0, upstream_weight=0.0)
    np.testing.assert_array_equal(
        case.rates(local)[0], case.rates(dataclasses.replace(local, end_damping=0.0))[0], "bends straighten everywhere"
    )


# ---- implicit smoothing


def device_roots(time_steps, width, spacing, law, factor, device="cpu"):
    kernel = migration.build(wp.float64)
    smoothing_root = memory.build(wp.float64).smoothing_root
    Constants, Run = kernel.MigrationConstants, polyline.build(wp.float64).Run

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(step: wp.array[wp.float64], constants: Constants, width: wp.float64, spacing: wp.float64,
                 factor: wp.float64, root_out: wp.array[wp.float64]):  # fmt: skip
        i = wp.tid()
        run = Run()
        run.spacing = spacing
        run.step = step[i]
        root_out[i] = smoothing_root(width, run, factor, constants)

    out = unwritten(len(time_steps), wp.float64, device)
    inputs = [to_device(np.array(time_steps, np.float64), wp.float64, device), device_constants(kernel, law)]
    inputs += [width, spacing, factor]
    wp.launch(evaluate, dim=len(time_steps), inputs=inputs, outputs=[out], device=device)
    return out.numpy()


def test_smoothing_begins_where_the_explicit_step_rings():
    """r = 0 up to D dt / h^2 = 9/32, above it the root of c r^2 - (1 + 2 c) r + c = 0 with the least c that damps."""
    width, spacing, law = 200.0, 50.0, Law()
    limit = float(launcher.explicit_dt(width, plain_params()))
    assert limit == pytest.approx(9.0 / 32.0 * spacing**2 / (60.0 * width))
    parts = np.array([1e-9, 0.5, 1.0 - 1e-12, 1.0 + 1e-9, 1.1, 2.0, 10.0, 1e3])
    roots = device_roots(parts * limit, width, spacing, law, 1.0)
    assert (roots[:3] == 0.0).all() and (roots[3:] > 0.0).all()
    straight = np.stack([np.arange(9) * spacing, np.zeros(9)], axis=1)
    for part, root in zip(parts[4:], roots[4:], strict=True):
        share = reference.implicit_share(straight, spacing, width, dataclasses.replace(law, time_step=part * limit))
        assert root == pytest.approx(reference.recurrence_root(share), rel=1e-12)


def test_smoothing_root_takes_the_sinuosity_only_where_it_scales_the_local_term():
    plain, scaled = (device_roots([0.3], 200.0, 50.0, Law(scale_local=s), 0.4)[0] for s in (0, 1))
    assert plain == device_roots([0.3], 200.0, 50.0, Law(), 1.0)[0]
    assert scaled == pytest.approx(device_roots([0.12], 200.0, 50.0, Law(), 1.0)[0], rel=1e-14)


def smoothed_velocity(case, law, xy, deal):
    """What both kernels together make of the rates, (n, 2)."""
    return (case.moved(law, case.velocities(law, deal), deal)[0] - xy) / law.time_step


@pytest.mark.parametrize("deal", DEALS)
def test_two_recurrences_solve_the_implicit_equation(deal):
    """Inside a long channel the forward run of one kernel and the backward run of the other give (I - c d2)^-1."""
    xy = meander(400)
    law = Law(time_step=0.6, end_damping=0.0)
    width = 250.0
    share = reference.implicit_share(xy, 50.0, width, law)
    r = reference.recurrence_root(share)
    assert 0.3 < r < 0.8
    expected = reference.implicit_smoothing(reference.velocities(xy, twin_rates([xy], law, width)[0]), share)
    margin = int(np.log(1e-16) / np.log(r))  # where the ends, which are held, are forgotten
    assert 2 * margin < 200
    actual = smoothed_velocity(Case([xy], width=width), law, xy, deal)
    inner = slice(margin, len(xy) - margin)
    assert np.abs(actual - expected)[inner].max() <= SUM_TOLERANCE * np.abs(expected).max()


def test_smoothing_holds_a_circle_back_as_a_backward_step_does():
    """Far from the ends, points a apart on a circle go straight to its middle, by v / (1 + 2 c (1 - cos a)).

    So the local term never carries a bend beyond its own middle, however long the step is.
    """
    angle, radius, width = np.arange(600) * 0.1, 500.0, 200.0
    spacing = 2.0 * radius * np.sin(0.05)
    xy = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for time_step in (1.0, 10.0):
        law = Law(time_step=time_step, upstream_weight=0.0, end_damping=0.0)
        share = reference.implicit_share(xy, spacing, width, law)
        velocity = smoothed_velocity(Case([xy], width=width, spacing=spacing), law, xy, 64)
        expected = -60.0 * width / radius / (1.0 + 2.0 * share * (1.0 - np.cos(0.1))) * xy / radius
        # The ends, which are held, are forgotten after so many points.
        middle = slice(250, -250)
        np.testing.assert_allclose(velocity[middle], expected[middle], rtol=0.0, atol=SUM_TOLERANCE * 100.0)


def test_a_kink_alternating_from_point_to_point_halves_and_turns():
    """The shortest wave of the grid is multiplied by -1/2 in a step of any length that smoothing acts in."""
    n = 400
    small = 1e-6 * (-1.0) ** np.arange(n)
    xy = np.stack([50.0 * np.arange(n), small], axis=1)
    for time_step in (0.1, 0.5, 5.0):
        law = Law(time_step=time_step, upstream_weight=0.0, end_damping=0.0)
        case = Case([xy], width=200.0)
        moved = case.moved(law, case.velocities(law))[0]
        middle = slice(150, 250)
        assert moved[middle, 1] / small[middle] == pytest.approx(-0.5, abs=1e-6)


def test_smoothing_goes_by_the_width_of_each_point(device):
    """A narrow reach is not smoothed as its wide neighbour asks for."""
    lines = stacked_lines(seed=21)
    sections = varying_sections(lines)
    law = Law(time_step=0.6)
    expected = [
        reference.fading_sum(
            reference.velocities(xy, reference.migration_rate(xy, 50.0, section[:, 0], section[:, 1], law)),
            reference.point_roots(xy, 50.0, section[:, 0], law),
        )
        for xy, section in zip(lines, sections, strict=True)
    ]
    assert any(reference.point_roots(xy, 50.0, s[:, 0], law).any() for xy, s in zip(lines, sections, strict=True))
    case = Case(lines, sections=sections, device=device)
    for deal in DEALS:
        assert_rates(case.velocities(law, deal), expected, SUM_TOLERANCE)
