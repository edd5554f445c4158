"""Planform metrics against closed forms, brute force and measured rivers."""

import functools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from data_folder import data_folder
from scipy.special import j0

from warpriver import metrics
from warpriver.generate import noisy_line, sine_generated, straight_line

# Dates of two surveys, years between them, published median displacement in m/yr, and half its last digit.
SURVEYS = {
    "jurua": ("19871012", "20170710", 29.74, 3.1, 0.05),
    "jutai": ("19890805", "20170802", 27.99, 0.8, 0.05),
    "mamore": ("19861105", "19890708", 2.67, 16.0, 0.5),
    "purus": ("19870701", "20170804", 30.09, 3.9, 0.05),
}
FIRST_DATES = {river: row[0] for river, row in SURVEYS.items()}
FIRST_DATES |= {"tarauaca": "20070729", "tarauaca_jurua": "20070729"}


@functools.cache
def read_river(path):
    """Points in m and median width in m of a measured centreline."""
    table = np.loadtxt(path, delimiter=",", skiprows=2, usecols=(0, 1, 6))
    return table[:, :2], float(np.median(table[:, 2]))


def river(name, date):
    return read_river(data_folder("centerlines") / f"{name}_{date}.csv.gz")


def circle(radius, count, turn=2.0 * np.pi, even=True):
    """Points along an arc to the left; uneven ones have smoothly varied gaps."""
    part = np.linspace(0.0, 1.0, count)
    angle = turn * (part if even else part + 0.1 * np.sin(2.0 * np.pi * part))
    return radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])


def sine(amplitude, length, count, span):
    """Points of y = amplitude sin(2 pi x / length), even in x and so uneven in arc length."""
    x = np.linspace(0.0, span, count)
    return np.column_stack([x, amplitude * np.sin(2.0 * np.pi * x / length)])


def moved(xy, east, north):
    """The line somewhere else."""
    return xy + np.array([east, north])


def from_curvature(values, step):
    """A line whose curvature over the k-th step is values[k]."""
    heading = np.cumsum(values) * step
    moves = step * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])


LINE = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 10.0], [6.0, 14.0]])


# ---- input


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (np.zeros((5, 3)), r"shape \(5, 3\)"),
        (np.arange(6.0), r"shape \(6,\)"),
        (LINE[:2], r"2 point\(s\)"),
        (np.array([[0.0, 0.0], [1.0, np.nan], [2.0, 0.0]]), "point 1 is not finite"),
        (np.array([[0.0, 0.0], [1.0, 0.0], [np.inf, 0.0]]), "point 2 is not finite"),
        (np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]]), "points 1 and 2 are both at"),
    ],
)
@pytest.mark.parametrize(
    "call",
    [
        metrics.arc_length,
        metrics.curvature,
        metrics.sinuosity,
        lambda xy: metrics.sinuosity_window(xy, 10.0),
        metrics.bend_sinuosity,
        metrics.inflection_points,
        metrics.bends,
        lambda xy: metrics.wavelength(xy, 1.0),
        metrics.bend_radius,
        lambda xy: metrics.migration(xy, LINE),
        lambda xy: metrics.migration(LINE, xy),
        lambda xy: metrics.oxbow_lengths([LINE, xy]),
    ],
)
def test_lines_that_are_none_are_refused_with_place_and_remedy(call, bad, reason):
    with pytest.raises(ValueError, match=f"{reason}.*; (give|remove)"):
        call(bad)


@pytest.mark.parametrize(
    "call",
    [
        lambda: metrics.sinuosity_window(LINE, 0.0),
        lambda: metrics.inflection_points(LINE, width=-1.0),
        lambda: metrics.wavelength(LINE, math.nan),
        lambda: metrics.wavelength_range(0.0),
        lambda: metrics.migration(LINE, LINE, years=0.0),
        lambda: metrics.migration(LINE, LINE, max_distance=-5.0),
        lambda: metrics.lag(np.ones(9), np.ones(8), 1.0),
        lambda: metrics.lag(np.ones(3), np.ones(3), 1.0),
        lambda: metrics.lag(np.ones(9), np.ones(9), 0.0),
        lambda: metrics.lag(np.ones(9), np.ones(9), 1.0, max_lag=5.0),
        lambda: metrics.lognormal_fit([]),
        lambda: metrics.lognormal_fit([1.0, 0.0]),
        lambda: metrics.lognormal_fit([1.0, math.nan]),
    ],
)
def test_numbers_out_of_range_are_refused(call):
    with pytest.raises(ValueError, match="; give "):
        call()


def test_lists_and_integers_are_taken():
    np.testing.assert_array_equal(metrics.arc_length([[0, 0], [3, 4], [3, 10]]), [0.0, 5.0, 11.0])


# ---- arc length, curvature


def test_arc_length():
    np.testing.assert_array_equal(metrics.arc_length(LINE), [0.0, 5.0, 11.0, 16.0])


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_curvature_of_a_circle_holds_up_to_its_ends(even, side):
    radius, count = 250.0, 400
    xy = circle(radius, count, even=even) * [1.0, side]
    # On even chords of angle a the stencil gives 1 / (R cos^2(a/2)), 1 + a^2/4; gaps here reach 1.63 a.
    a = 2.0 * np.pi / (count - 1) * (1.0 if even else 1.7)
    np.testing.assert_allclose(metrics.curvature(xy), side / radius, rtol=0.3 * a**2)


def test_curvature_of_a_minimal_line():
    xy = circle(100.0, 3, turn=0.2)
    np.testing.assert_allclose(metrics.curvature(xy), 0.01, rtol=1e-12)


def test_curvature_is_of_second_order_up_to_the_ends():
    amplitude, length, span = 120.0, 700.0, 1200.0
    q = 2.0 * np.pi / length

    def errors(count):
        xy = sine(amplitude, length, count, span)
        slope = amplitude * q * np.cos(q * xy[:, 0])
        exact = -amplitude * q**2 * np.sin(q * xy[:, 0]) / (1.0 + slope**2) ** 1.5
        error = np.abs(metrics.curvature(xy) - exact)
        return error[1:-1].max(), max(error[0], error[-1])

    inner, end = np.array([errors(count) for count in (481, 961, 1921)]).T
    # Halving the spacing divides the error by four; a tenth either way for the next term of the series.
    np.testing.assert_allclose(inner[:-1] / inner[1:], 4.0, atol=0.4)
    np.testing.assert_allclose(end[:-1] / end[1:], 4.0, atol=0.4)


def test_curvature_ignores_position_and_changes_sign_when_reversed_or_mirrored():
    xy = sine_generated(900.0, 1.6, 2, 25.0)
    value = metrics.curvature(xy)
    # Coordinates of 9,000 km carry 1e-9 m of rounding, over squared gaps of 25 m: 1e-11, a millionth of it.
    np.testing.assert_allclose(metrics.curvature(moved(xy, 3e5, -9e6)), value, atol=2e-11)
    np.testing.assert_allclose(metrics.curvature(xy[::-1])[::-1], -value, atol=1e-15)
    np.testing.assert_allclose(metrics.curvature(xy * [1, -1]), -value, atol=1e-15)


def test_curvature_of_a_line_that_doubles_back_is_finite():
    value = metrics.curvature([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]])
    np.testing.assert_array_equal(value, 0.0)


# ---- sinuosity


def test_sinuosity_of_known_lines():
    assert metrics.sinuosity(moved(straight_line(1000.0, 7.0), 4e5, 7e6)) == pytest.approx(1.0, abs=1e-12)
    # 2,000 chords of a half circle are short by (pi/2000)^2 / 24 = 1e-7 of it.
    assert metrics.sinuosity(circle(50.0, 2001, turn=np.pi)) == pytest.approx(np.pi / 2.0, rel=2e-7)
    assert metrics.sinuosity([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]) == math.inf


def test_sinuosity_window_on_a_circle():
    radius, window = 300.0, 400.0
    xy = circle(radius, 4001)
    value = metrics.sinuosity_window(xy, window)
    s = metrics.arc_length(xy)
    inside = np.minimum(s + 200.0, s[-1]) - np.maximum(s - 200.0, 0.0)
    exact = inside / (2.0 * radius * np.sin(0.5 * inside / radius))
    # Chords of 0.47 m sag 1e-4 m; window ends lie on them.
    np.testing.assert_allclose(value, exact, rtol=1e-6)


def test_sinuosity_window_limits():
    xy = sine_generated(500.0, 1.5, 3, 5.0)
    whole = metrics.sinuosity(xy)
    np.testing.assert_allclose(metrics.sinuosity_window(xy, 1e6), whole, rtol=1e-12)
    # A window far below the spacing sees a straight line or one corner of at most 0.1 rad.
    assert np.all(metrics.sinuosity_window(xy, 0.01) >= 1.0)
    assert metrics.sinuosity_window(xy, 0.01).max() < 1.005
    closed = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    assert np.all(np.isinf(metrics.sinuosity_window(closed, 100.0)))


# ---- inflections, bends


def test_inflection_points_of_a_sine_converge_at_second_order():
    exact = np.array([350.0, 700.0, 1050.0, 1400.0, 1750.0])

    def error(count):
        xy = sine(90.0, 700.0, count, 1800.0)[count // 20 :]
        return np.abs(metrics.inflection_points(xy).xy[:, 0] - exact).max()

    errors = np.array([error(count) for count in (68, 135, 269)])
    assert errors[0] < 2.0  # m, at 27 m spacing
    assert np.all(errors[1:] < 0.35 * errors[:-1])


def test_inflection_points_lie_on_the_line_at_their_arc_length():
    xy = sine_generated(800.0, 1.4, 3, 11.0)
    found = metrics.inflection_points(xy, width=40.0)
    s = metrics.arc_length(xy)
    np.testing.assert_allclose(np.interp(found.arc_length, s, xy[:, 0]), found.xy[:, 0], atol=1e-9)
    np.testing.assert_allclose(np.interp(found.arc_length, s, xy[:, 1]), found.xy[:, 1], atol=1e-9)
    quarter = 800.0 / j0(1.4) / 4.0
    # Interpolation between samples 5 m apart, and an arc length that is short by the chords' 0.03 %.
    np.testing.assert_allclose(found.arc_length, quarter * np.arange(1, 12, 2), atol=1.5)


@pytest.mark.parametrize("width", [None, 30.0])
@pytest.mark.parametrize("offset", [0.0, 9e6])
def test_lines_that_turn_one_way_or_not_at_all_have_no_inflections(width, offset):
    turned = straight_line(3000.0, 13.0) @ np.array([[0.6, 0.8], [-0.8, 0.6]])
    for xy in (turned, circle(400.0, 300, turn=3.0)):
        found = metrics.inflection_points(xy + offset, width)
        assert found.arc_length.shape == (0,)
        assert found.xy.shape == (0, 2)
        assert metrics.bends(xy + offset, width).arc.shape == (0,)
        assert math.isnan(metrics.wavelength(xy + offset, 30.0))


def test_straight_reaches_between_bends_share_one_inflection_or_none():
    left, straight, right = np.full(50, 0.004), np.zeros(40), np.full(50, -0.004)
    opposed = from_curvature(np.concatenate([left, straight, right]), 5.0)
    alike = from_curvature(np.concatenate([left, straight, left]), 5.0)
    found = metrics.inflection_points(opposed).arc_length
    # Either end of the straight reach is as good as its middle: within one spacing of it.
    assert found.shape == (1,)
    assert 245.0 <= found[0] <= 455.0
    assert metrics.inflection_points(alike).arc_length.size == 0


def test_faint_bends_are_merged_when_the_width_is_given():
    width, step = 40.0, 5.0
    strong, faint = 0.2 / width, 0.02 / width
    wave = np.sin(np.pi * (np.arange(80) + 0.5) / 80)  # half a sine: a bend of 400 m
    pieces = [strong, -faint, faint, -strong, faint, -strong, strong]
    xy = from_curvature(np.concatenate([p * wave for p in pieces])[:-40], step)
    assert metrics.inflection_points(xy).arc_length.size == 6
    found = metrics.inflection_points(xy, width).arc_length
    # Of three crossings between the first two strong bends the middle one stands (800 m); the faint bend
    # between two bends to the right makes none; the last crossing is at 2400 m.
    assert found.size == 2
    np.testing.assert_allclose(found, [800.0, 2400.0], atol=2.0 * step)


def test_noise_makes_no_bends_when_the_width_is_given():
    width = 100.0
    clean = sine_generated(1200.0, 1.3, 8, 25.0)
    rough = clean + np.random.default_rng(5).normal(0.0, 3.0, clean.shape)
    assert metrics.inflection_points(rough).arc_length.size > 100
    found = metrics.bends(rough, width)
    assert found.arc.size == 15
    # Noise of 3 m at points 25 m apart moves inflections by a small part of a width and lengthens the line.
    assert metrics.wavelength(rough, width) == pytest.approx(1200.0, rel=0.01)
    exact = 1.3 * 2.0 * np.pi * j0(1.3) / 1200.0
    np.testing.assert_allclose(np.abs(found.curvature), exact, rtol=0.15)


@pytest.mark.parametrize("width", [None, 50.0])
def test_bends_of_a_sine_generated_curve(width):
    wavelength, angle = 1000.0, 1.5
    xy = sine_generated(wavelength, angle, 4, 5.0)
    arc = wavelength / j0(angle)
    found = metrics.bends(xy, width)
    assert found.arc.size == 7
    # Second-order errors at 5 m spacing: (2 pi h / M)^2 = 3e-4; 50 m smoothing keeps 99.98 % of this wave.
    np.testing.assert_allclose(found.arc, arc / 2.0, rtol=1e-3)
    np.testing.assert_allclose(found.chord, wavelength / 2.0, rtol=1e-3)
    np.testing.assert_allclose(found.sinuosity, 1.0 / j0(angle), rtol=1e-3)
    np.testing.assert_allclose(found.apex, arc / 2.0 * np.arange(1, 8), atol=0.5)
    peak = angle * 2.0 * np.pi / arc
    np.testing.assert_allclose(found.curvature, peak * (-1.0) ** np.arange(1, 8), rtol=1e-3)
    np.testing.assert_allclose(found.radius * np.abs(found.curvature), 1.0, rtol=1e-12)
    np.testing.assert_array_equal(found.start[1:], found.end[:-1])
    np.testing.assert_array_equal(metrics.bend_radius(xy, width), found.radius)
    np.testing.assert_array_equal(metrics.bend_sinuosity(xy, width), found.sinuosity)


def test_smoothing_passes_waves_as_documented():
    width, step = 100.0, 5.0
    for widths, kept in ((20.0, 0.999), (10.0, 0.983), (5.0, 0.813)):
        wave = 2.0 * np.pi / (widths * width) * step * (np.arange(2400) + 0.5)
        peak = 0.1 / width
        found = metrics.bends(from_curvature(peak * np.cos(wave), step), width)
        np.testing.assert_allclose(np.abs(found.curvature[3:-3]), kept * peak, rtol=0.01)


def test_wavelength_is_two_bends_and_half_of_it_one():
    xy = sine_generated(700.0, 1.2, 6, 20.0)
    # 20 m spacing on a 1,043 m arc wavelength: (2 pi h / M)^2 / 12 and less.
    assert metrics.wavelength(xy, 50.0) == pytest.approx(700.0, rel=2e-3)
    assert metrics.wavelength(xy, 50.0, half=True) == pytest.approx(350.0, rel=2e-3)


def test_wavelength_of_coarse_points_needs_no_finer_ones():
    # One point to a width, as the paper samples a 50 m channel; the cubic brings its curvature to a per cent.
    assert metrics.wavelength(sine_generated(700.0, 1.2, 6, 50.0), 50.0) == pytest.approx(700.0, rel=0.01)
    # Widths far below and far above the spacing stay finite in cost and in value.
    assert metrics.wavelength(sine_generated(700.0, 1.2, 6, 20.0), 0.01) != 0.0
    assert math.isnan(metrics.wavelength(sine_generated(700.0, 1.2, 6, 20.0), 1e5))


@pytest.mark.parametrize(
    ("width", "low", "high"), [(50.0, 314.0, 990.0), (100.0, 628.0, 2150.0), (200.0, 1256.0, 4674.0)]
)
def test_wavelength_range_reproduces_the_printed_numbers(width, low, high):
    # Printed to the metre; the 990 for 50 m is 989.4.
    assert metrics.wavelength_range(width) == pytest.approx((low, high), abs=0.6)


# ---- migration


def test_migration_is_positive_to_the_left():
    before = straight_line(1000.0, 10.0)
    left, right = (moved(straight_line(1000.0, 7.0), 0.0, north) for north in (12.0, -12.0))
    np.testing.assert_allclose(metrics.migration(before, left), 12.0, rtol=1e-12)
    np.testing.assert_allclose(metrics.migration(before, right, years=4.0), -3.0, rtol=1e-12)
    np.testing.assert_allclose(metrics.migration(before[::-1], left[::-1]), -12.0, rtol=1e-12)
    np.testing.assert_array_equal(metrics.migration(before, before), 0.0)


def test_migration_of_a_growing_bend_goes_outwards():
    before, after = circle(200.0, 500, turn=3.0), moved(circle(230.0, 700, turn=3.0), 0.0, -30.0)
    value = metrics.migration(before, after)
    # Chords 1 m long sag by 6e-4 m; the right of a left bend is its outside.
    np.testing.assert_allclose(value, -30.0, atol=1e-3)


def distance_to_line(points, line):
    """Distance from each point to the nearest point of any segment, all pairs."""
    a, d = line[:-1], np.diff(line, axis=0)
    run = np.clip(((points[:, None] - a) * d).sum(axis=2) / (d**2).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(a + run[:, :, None] * d - points[:, None], axis=2).min(axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_migration_finds_the_nearest_point_of_all_segments(seed):
    rng = np.random.default_rng(seed)
    before = noisy_line(3000.0, 20.0, 40.0, seed=seed, correlation=60.0)
    after = noisy_line(3000.0, 10.0, 40.0, seed=seed + 50, correlation=60.0)
    after = after[np.sort(np.r_[0, 300, rng.choice(np.arange(1, 300), 80, replace=False)])]
    value = metrics.migration(before, after)
    found = np.isfinite(value)
    assert found.mean() > 0.9
    np.testing.assert_allclose(np.abs(value[found]), distance_to_line(before, after)[found], rtol=1e-12)


def test_abandoned_loop_has_no_counterpart():
    before = sine_generated(1000.0, 2.0, 5, 10.0)
    x = before[:, 0]
    # Cut the whole of one wavelength, the loops on both sides of x = 2000, to a straight join.
    start, end = np.abs(x - 1750.0).argmin(), len(x) - 1 - np.abs(x[::-1] - 2250.0).argmin()
    after = np.concatenate([before[: start + 1], before[end:]])
    value = metrics.migration(before, after)
    kept = np.r_[0 : start + 1, end : len(x)]
    np.testing.assert_allclose(value[kept], 0.0, atol=1e-9)
    # All but the roots of the loop, which still lie close to the new channel.
    assert np.isnan(value[start:end]).mean() > 0.7
    assert np.nanmax(np.abs(metrics.migration(before, after, max_distance=100.0))) <= 100.0


def test_the_other_limb_of_a_bend_is_no_counterpart():
    up, down = np.linspace(0.0, 900.0, 91), np.linspace(900.0, 0.0, 91)
    turn = np.linspace(np.pi, 0.0, 20)[1:-1]
    loop = np.concatenate(
        [
            np.column_stack([np.zeros(91), up]),
            np.column_stack([30.0 + 30.0 * np.cos(turn), 900.0 + 30.0 * np.sin(turn)]),
            np.column_stack([np.full(91, 60.0), down]),
        ]
    )
    # Everything moves 40 m to the right in the plan: the first limb ends up 20 m from the old second one.
    value = metrics.migration(loop, moved(loop, 40.0, 0.0))
    first, second = value[:80], value[-80:]
    assert np.all(np.isnan(first) | (np.abs(first + 40.0) < 1e-9))
    assert np.all(np.isnan(second) | (np.abs(second - 40.0) < 1e-9))
    assert np.isfinite(first).all()


def test_points_beyond_the_other_line_have_no_counterpart():
    value = metrics.migration(straight_line(1000.0, 10.0), moved(straight_line(600.0, 10.0), 200.0, 5.0))
    np.testing.assert_allclose(value[20:81], 5.0, rtol=1e-12)
    assert np.isnan(value[:19]).all()
    assert np.isnan(value[82:]).all()


# ---- lag


def rough_curvature(count, seed):
    """A smooth random series: white noise through a Gaussian of 8 samples."""
    kernel = np.exp(-0.5 * (np.arange(-40, 41) / 8.0) ** 2)
    return np.convolve(np.random.default_rng(seed).normal(size=count), kernel, mode="same")


@pytest.mark.parametrize("shift", [237.5, 0.0, -112.5])
def test_lag_finds_a_shift_between_samples(shift):
    spacing, fine = 25.0, 8
    source = rough_curvature(16000, 2)
    curve = np.convolve(source, np.exp(-0.5 * (np.arange(-320, 321) / 64.0) ** 2), mode="same")
    moved = np.roll(curve, round(shift / spacing * fine))
    # Left bends move right, hence the minus; a parabola through a Gaussian peak of 9 samples is good to 1 %.
    found = metrics.lag(curve[::fine], -moved[::fine], spacing, max_lag=1000.0)
    assert found == pytest.approx(shift, abs=0.02 * spacing)


def test_lag_passes_over_gaps_and_noise():
    rng = np.random.default_rng(9)
    curve = rough_curvature(4000, 4)
    rate = -np.roll(curve, 12) + rng.normal(0.0, 0.5 * curve.std(), curve.size) + 3.0
    rate[rng.random(curve.size) < 0.1] = np.nan
    rate[1000:1300] = np.nan
    curve[500:520] = np.nan
    assert metrics.lag(curve, rate, 10.0, max_lag=500.0) == pytest.approx(120.0, abs=5.0)
    assert metrics.lag(curve, -rate, 10.0, max_lag=500.0) != pytest.approx(120.0, abs=50.0)


def test_lag_without_variation_is_undefined():
    assert math.isnan(metrics.lag(np.ones(50), np.ones(50), 1.0))
    assert math.isnan(metrics.lag(np.arange(50.0), np.full(50, np.nan), 1.0))


# ---- oxbow lakes


def test_oxbow_lengths_of_arrays_and_objects():
    loop = circle(100.0, 1001)
    lengths = metrics.oxbow_lengths([LINE, SimpleNamespace(xy=loop)])
    np.testing.assert_allclose(lengths, [16.0, 200.0 * np.pi], rtol=1e-5)
    assert metrics.oxbow_lengths([]).shape == (0,)


def test_lognormal_fit():
    fit = metrics.lognormal_fit([1.0, math.e**2])
    assert fit.geometric_mean == pytest.approx(math.e, rel=1e-12)
    assert fit.log_sd == pytest.approx(math.sqrt(2.0), rel=1e-12)
    assert math.isnan(metrics.lognormal_fit([3.0]).log_sd)
    sample = np.random.default_rng(0).lognormal(math.log(1000.0), 0.6, 20000)
    # Standard errors 0.6 / sqrt(20000) = 0.4 % and 0.6 / sqrt(40000) = 0.003: four of each.
    assert metrics.lognormal_fit(sample) == pytest.approx((1000.0, 0.6), rel=0.02)


# ---- measured rivers


def test_sinuosity_of_measured_rivers():
    files = sorted((data_folder("centerlines")).glob("*.csv.gz"))
    assert len(files) == 12
    value = [metrics.sinuosity(read_river(path)[0]) for path in files]
    # Published range of these reaches, to its last digit.
    assert min(value) == pytest.approx(2.24, abs=0.005)
    assert max(value) == pytest.approx(2.80, abs=0.005)


@pytest.mark.parametrize(("name", "date"), FIRST_DATES.items())
def test_bends_of_measured_rivers(name, date):
    xy, width = river(name, date)
    found = metrics.bends(xy, width)
    # Published medians of these rivers, with a tenth either way for another way to smooth: arc 9.5 to 15
    # widths, twice the chord 12.9 to 18.5 widths, peak curvature 0.22 to 0.33 over the width.
    assert 8.5 <= np.median(found.arc) / width <= 16.5
    assert 11.6 <= 2.0 * np.median(found.chord) / width <= 20.4
    assert 0.20 <= np.median(np.abs(found.curvature)) * width <= 0.37
    low, high = metrics.wavelength_range(width)
    assert low < metrics.wavelength(xy, width) < high


@pytest.mark.parametrize("name", SURVEYS)
def test_migration_of_measured_rivers(name):
    first, last, years, published, half_digit = SURVEYS[name]
    before, width = river(name, first)
    after, _ = river(name, last)
    rate = np.abs(metrics.migration(before, after, years))
    # The published medians count cutoffs with their large distances: so do these. The few points without a
    # counterpart that lie near the later channel raise the median by up to 2 %.
    counted = np.median(np.where(np.isnan(rate), np.inf, rate))
    assert published - half_digit < counted < 1.02 * published + half_digit
    # Leaving cutoffs out lowers the median by about a tenth.
    assert 0.85 * published < np.nanmedian(rate) < 1.02 * published
    assert np.isnan(rate).mean() < 0.1
    # Published: 8 to 8.5 % of the points of two of them moved by more than two widths.
    far = np.isnan(metrics.migration(before, after, years, max_distance=2.0 * width))
    assert far.mean() < 0.11


@pytest.mark.parametrize("name", SURVEYS)
def test_migration_lags_curvature_on_measured_rivers(name):
    first, last, _, _, _ = SURVEYS[name]
    before, width = river(name, first)
    after, _ = river(name, last)
    s = metrics.arc_length(before)
    even = np.arange(0.0, s[-1], 25.0)
    # Digitised from 30 m pixels: curvature is read off points a width apart.
    apart = np.arange(0.0, s[-1], width)
    coarse = np.column_stack([np.interp(apart, s, axis) for axis in before.T])
    bend = np.interp(even, apart, metrics.curvature(coarse))
    move = metrics.migration(before, after, max_distance=2.0 * width)
    rate = move[np.minimum(np.searchsorted(s, even), len(s) - 1)]
    lag = metrics.lag(bend, rate, 25.0, max_lag=12.0 * width) / width
    # Published: 2.4 to 4.3 widths over eight scenes by another method; a tenth either way.
    assert 2.16 < lag < 4.73
