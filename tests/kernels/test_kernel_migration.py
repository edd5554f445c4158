"""Migration kernels against the O(n^2) twins in reference.py, closed forms, symmetries and convergence orders."""

import dataclasses
import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
import reference
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import (
    DEALS,
    REALS,
    SCALARS,
    SLABS,
    forms,
    going_on,
    nested,
    ring_flags,
    share_out,
    split,
    starts_of,
    to_device,
    unwritten,
)
from reference import Law
from scipy.integrate import quad

from warpriver.kernels import migration
from warpriver.kernels.polyline import HALT
from warpriver.meander import migration as launcher
from warpriver.meander.buffers import StepBuffers, StepChannels
from warpriver.meander.stages import run_stages
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams

# Rounding of sums over some hundred points, relative to the largest rate of the channel.
SUM_TOLERANCE = 1e-12
# A weight is a dozen operations, each off by at most half a unit in the last place.
WEIGHT_TOLERANCE = 4e-15
# One coordinate of a moved point: a few units in the last place of some kilometres.
MOVE_TOLERANCE = 4e-12
# In float32 a curvature is off by about 6e-8 / h, and the sharpest bends here have 2e-3 / m at h = 50 m: a millionth,
# times the number of terms.
SUM_TOLERANCE_32 = 2e-5
WEIGHT_TOLERANCE_32 = 4e-6
# Half a unit in the last place of 8 km in float32 is 2.4e-4 m.
MOVE_TOLERANCE_32 = 1e-3

NO_DAMPING = Law(end_damping=0.0)
# West and north edge and cell size of the ground, m.
GRID = (-9000.0, 9000.0, 120.0)
# A place in a raster of 150 cells is off by up to 1e-5 cells in float32, and slopes differ by 0.1 from cell to cell.
SLOPE_TOLERANCE = {"float64": 1e-10, "float32": 1e-4}
# Short enough for the local term to be explicit on every line here.
SHORT_STEP = 1e-4


def heading_line(heading, count, spacing, start=(0.0, 0.0)):
    """Points at even arc length on the curve of that heading(s), each step by 10-node quadrature: (count, 2)."""
    nodes, weights = np.polynomial.legendre.leggauss(10)
    s = spacing * (np.arange(count - 1)[:, None] + 0.5 * (nodes + 1.0))
    angle = heading(s)
    steps = 0.5 * spacing * np.stack([np.cos(angle) @ weights, np.sin(angle) @ weights], axis=1)
    return np.concatenate([[start], np.asarray(start) + np.cumsum(steps, axis=0)])


def meander(count, spacing=50.0, swing=1.1, wave=900.0, turn=0.0):
    """A sine-generated line with a second, incommensurate wave, so that no two bends are alike."""
    q = 2.0 * np.pi / wave
    return heading_line(lambda s: turn + swing * np.sin(q * s) + 0.3 * np.sin(0.77 * q * s), count, spacing)


def stacked_lines(seed=3, counts=(3, 4, 5, 130, 3, 3, 67, 3, 300, 6)):
    """Channels of very different lengths, on top of each other."""
    rng = np.random.default_rng(seed)
    return [
        meander(n, swing=rng.uniform(0.3, 1.5), wave=rng.uniform(600.0, 1500.0), turn=rng.uniform(0.0, 6.0))
        for n in counts
    ]


def device_law(kernel, law):
    """The struct that the kernels read."""
    struct = kernel.MigrationLaw()
    for name, value in dataclasses.asdict(law).items():
        if name != "time_step":  # each channel has its own
            setattr(struct, name, value)
    return struct


def channel_means(sections):
    """Mean width, mean depth and greatest width of each channel, (C,) each."""
    return (
        np.array([s[:, 0].mean() for s in sections]),
        np.array([s[:, 1].mean() for s in sections]),
        np.array([s[:, 0].max() for s in sections]),
    )


class Case:
    """Some channels, packed on a device in one precision, and both migration kernels launched on them."""

    def __init__(
        self,
        lines,
        *,
        width=50.0,
        depth=2.0,
        sections=None,
        spacing=50.0,
        resting=(),
        rings=(),
        dtype="float64",
        device="cpu",
        spare=5,
    ):
        scalar = SCALARS[dtype]
        self.resting, self.rings = resting, rings
        self.closed = ring_flags(rings, len(lines), device)
        self.kernel, self.scalar, self.device = migration.build(scalar), scalar, device
        self.lines, self.start = lines, starts_of(lines)
        self.count, self.capacity = int(self.start[-1]), int(self.start[-1]) + spare
        packed = np.full((self.capacity, 2), np.nan)
        packed[: self.count] = np.concatenate(lines)
        self.point_xy = to_device(packed, self.kernel.vec2, device)
        channels = len(lines)
        self.width = np.broadcast_to(np.float64(width), channels)
        self.depth = np.broadcast_to(np.float64(depth), channels)
        self.widest, self.section = self.width, None
        if sections is not None:
            self.width, self.depth, self.widest = channel_means(sections)
            self.section = to_device(np.concatenate([*sections, np.full((spare, 2), np.nan)]), self.kernel.vec2, device)
        self.spacing = np.broadcast_to(np.float64(spacing), channels)
        self.channel_start = to_device(self.start, wp.int32, device)
        self.form = forms(self.width, self.depth, self.widest, self.spacing, scalar, device)
        self.channel_spacing = to_device(self.spacing, scalar, device)

    def launch(self, kernel, deal, inputs, outputs):
        """Launch a kernel over the points; the inputs after the work, if any, follow a ``...``."""
        for part in share_out(deal, len(self.lines), self.capacity, self.device):
            given = [part.work if value is ... else value for value in inputs]
            wp.launch(kernel, dim=part.threads, inputs=given, outputs=outputs, device=self.device)

    def steps(self, law):
        """Time step of each channel on the device, 0 for those that rest."""
        step = np.full(len(self.lines), law.time_step)
        step[list(self.resting)] = 0.0
        return to_device(step, self.scalar, self.device)

    def areas(self, law, deal=64):
        """Area of each ring in 2^-62 of its length squared, on the device; None where there are no rings."""
        if self.closed is None:
            return None
        out = wp.zeros(len(self.lines), dtype=wp.int64, device=self.device)
        inputs = [self.point_xy, self.channel_start, self.channel_spacing, self.steps(law), self.closed, ...]
        self.launch(self.kernel.measure_rings, deal, inputs, [out])
        return out

    def rates(self, law, deal=64):
        """Rates by channel, smoothed downstream where the step asks for it; float64, 0 where a channel rests."""
        out = unwritten(self.capacity, self.scalar, self.device)
        inputs = [self.point_xy, self.section, self.channel_start, self.form, self.channel_spacing]
        inputs += [self.steps(law), self.closed, self.areas(law, deal), device_law(self.kernel, law), ...]
        self.launch(self.kernel.compute_rate, deal, inputs, [out])
        packed = out.numpy().astype(np.float64)
        for c in self.resting:
            first, stop = self.start[c : c + 2]
            assert np.isnan(packed[first:stop]).all(), "a rate of a channel at rest was written"
            packed[first:stop] = 0.0
        return self._channels(packed)

    def moved(self, law, rates, deal=64, height=None):
        """Points by channel after a step with those rates; float64. Sections must be carried along.

        With heights on ``GRID``, (rows, columns), the ground slows the move.
        """
        beyond = np.full(self.capacity - self.count, np.nan)
        rate = to_device(np.concatenate([*rates, beyond]), self.scalar, self.device)
        out = unwritten(self.capacity, self.kernel.vec2, self.device)
        section = None if self.section is None else unwritten(self.capacity, self.kernel.vec2, self.device)
        inputs = [self.point_xy, self.section, self.channel_start, self.form, self.channel_spacing]
        inputs += [
            self.steps(law),
            self.closed,
            self.areas(law, deal),
            *self.ground(height),
            device_law(self.kernel, law),
            ...,
            rate,
        ]
        pace = wp.zeros(len(self.lines), dtype=self.scalar, device=self.device)
        self.launch(self.kernel.move_points, deal, inputs, [out, section, pace])
        if section is not None:
            np.testing.assert_array_equal(section.numpy(), self.section.numpy())
        moved = self._channels(out.numpy().astype(np.float64))
        for c, (xy, after) in enumerate(
            zip(self._channels(self.point_xy.numpy().astype(np.float64)), moved, strict=True)
        ):
            # The pace is the greatest speed; the distance is that of rounded coordinates.
            farthest = np.hypot(*(after - xy).T).max() / law.time_step
            rounding = 4.0 * float(np.finfo(out.numpy().dtype).eps) * np.abs(after).max() / law.time_step
            assert pace.numpy()[c] == pytest.approx(farthest, rel=1e-5, abs=rounding), f"pace of channel {c}"
        return moved

    def ground(self, height):
        """Heights and grid as the kernels read them."""
        grid = self.kernel.RasterGrid()
        grid.west, grid.north, grid.cell_size = GRID
        grid.cells_per_meter = 1.0 / GRID[2]
        return to_device(height, wp.float64, self.device), grid

    def mobility(self, law, height, deal=64):
        """How the ground lets each channel move, (C,) of the case's precision."""
        out = wp.zeros(len(self.lines), dtype=self.scalar, device=self.device)
        inputs = [self.point_xy, self.channel_start, self.form, *self.ground(height), law.slope_threshold, ...]
        self.launch(self.kernel.measure_mobility, deal, inputs, [out])
        return out.numpy()

    def _channels(self, packed):
        assert np.isfinite(packed[: self.count]).all(), "a point was not written"
        assert np.isnan(packed[self.count :]).all(), "something was written beyond the points in use"
        return split(packed, self.start)


def assert_rates(actual, expected, tolerance):
    """Each channel agrees with its twin to ``tolerance`` times its own largest rate."""
    for channel, (a, e) in enumerate(zip(actual, expected, strict=True)):
        assert np.abs(a - e).max() <= tolerance * np.abs(e).max(), f"channel {channel}"


def twin_rates(lines, law, width=50.0, depth=2.0, spacing=50.0, sections=None):
    """Unsmoothed rates by channel, from the twin."""
    channels = len(lines)
    widths = np.broadcast_to(width, channels) if sections is None else [s[:, 0] for s in sections]
    depths = np.broadcast_to(depth, channels) if sections is None else [s[:, 1] for s in sections]
    return [
        reference.migration_rate(xy, h, np.broadcast_to(w, len(xy)), np.broadcast_to(d, len(xy)), law)
        for xy, h, w, d in zip(lines, np.broadcast_to(spacing, channels), widths, depths, strict=True)
    ]


def varying_sections(lines, seed=5):
    """Width and depth that change along each line by up to a third."""
    rng = np.random.default_rng(seed)
    sections = []
    for xy in lines:
        wave = np.sin(np.arange(len(xy)) * rng.uniform(0.05, 0.4) + rng.uniform(0.0, 6.0))
        sections.append(np.stack([60.0 * (1.0 + 0.3 * wave), 2.2 * (1.0 - 0.3 * wave)], axis=1))
    return sections


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
    decay_weights = nested(migration.build(scalar).compute_rate, "sweep_rate", "decay_weights")
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
        expected.append(reference.fading_sum(rate, r) if r > 0.0 else np.concatenate([[0.0], rate[1:]]))
    rates = case.rates(law, deal)
    assert_rates(rates, expected, SUM_TOLERANCE)
    for xy, rate, moved in zip(lines, rates, case.moved(law, rates, deal), strict=True):
        twin = reference.move_points(xy, rate, 50.0, 80.0, 80.0, law)
        size = np.abs(xy).max() + np.abs(twin - xy).max()
        assert np.abs(moved - twin).max() <= 1e-15 * size + SUM_TOLERANCE * np.abs(twin - xy).max()


def test_ten_thousand_kilometres_do_not_underflow(device):
    """exp(-alpha s) is 10^(-48,000) at the far end; the mean there is that of the points nearby all the same."""
    count, spacing = 200_001, 50.0
    xy = meander(count, spacing)
    # About the origin, as the simulation holds it.
    xy -= np.round(xy.mean(axis=0))
    law = Law(time_step=SHORT_STEP, scale_upstream=0)
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
        depth = reference.optical_depths(spacing, np.full(len(piece) - 4, 2.0), law.friction)
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
    both = Law(time_step=SHORT_STEP, scale_upstream=0)
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
    rates = Case(lines, device=device).rates(law)
    moved = Case(lines, device=device).moved(law, rates)
    c, s = np.cos(0.7), np.sin(0.7)
    for image in (np.array([[c, s], [-s, c]]), np.diag([1.0, -1.0])):
        sign = np.sign(np.linalg.det(image))
        case = Case([xy @ image for xy in lines], device=device)
        image_rates = case.rates(law)
        assert_rates(image_rates, [sign * rate for rate in rates], SUM_TOLERANCE)
        for a, b in zip(case.moved(law, image_rates), moved, strict=True):
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
    params = MeanderParams(time_step=0.3)
    results = []
    for offset in ((0.0, 0.0), (512_000.0, 4_096_000.0)):
        lines = [np.round(xy * 64.0) / 64.0 + offset for xy in stacked_lines(seed=1)]
        network = RiverNetwork.from_polylines(lines, width=50.0, dtype=dtype)
        width, even = network.channel_width, np.full(len(lines), 50.0)
        channels = StepChannels(network, len(lines) + 2, mobile=False)
        channels.fill(
            network,
            form=np.column_stack([width, network.channel_depth, width, even]),
            spacing=even,
            limit=np.full((len(lines), 3), np.inf),
            nodes=np.zeros((len(lines), 2)),
        )
        channels.parts.fill_(1)
        buffers = StepBuffers(network, network.point_count, 1, 1)
        channels.deal_out(network, buffers, anew=True)
        law = launcher.migration_law(params, dtype)
        move = launcher.migrate(network, channels, buffers, None, law)
        begin = launcher.schedule(network, channels, buffers, params.time_step)
        run_stages([begin, *move], channels.whole, channels.slabs)
        results.append((buffers.point_rate.numpy(), buffers.point_moved.numpy()))
    assert np.isfinite(results[0][1]).all() and np.abs(results[0][0]).max() > 1.0
    assert (results[0][0] == results[1][0]).all()
    assert (results[0][1] == results[1][1]).all()


def test_single_precision_rates_and_moves(device):
    lines = [np.float32(xy).astype(np.float64) for xy in stacked_lines(seed=11)]
    sections = varying_sections(lines)
    for law in (Law(time_step=SHORT_STEP), Law(time_step=0.3), Law(time_step=0.3, scale_local=1)):
        wide, narrow = (Case(lines, sections=sections, dtype=d, device=device) for d in ("float64", "float32"))
        rates = wide.rates(law)
        for deal in (1, 7, 4096, *SLABS):
            assert_rates(narrow.rates(law, deal), rates, SUM_TOLERANCE_32)
        for a, b in zip(narrow.moved(law, rates), wide.moved(law, rates), strict=True):
            assert np.abs(a - b).max() <= MOVE_TOLERANCE_32


# ---- implicit smoothing


def device_roots(time_steps, width, spacing, law, factor, device="cpu"):
    kernel = migration.build(wp.float64)
    smoothing_root = nested(kernel.compute_rate, "smoothing_root")
    Struct = kernel.MigrationLaw

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(step: wp.array[wp.float64], law: Struct, width: wp.float64, spacing: wp.float64, factor: wp.float64,
                 root_out: wp.array[wp.float64]):  # fmt: skip
        i = wp.tid()
        root_out[i] = smoothing_root(width, spacing, factor, step[i], law)

    out = unwritten(len(time_steps), wp.float64, device)
    inputs = [to_device(np.array(time_steps, np.float64), wp.float64, device), device_law(kernel, law)]
    inputs += [width, spacing, factor]
    wp.launch(evaluate, dim=len(time_steps), inputs=inputs, outputs=[out], device=device)
    return out.numpy()


def test_smoothing_begins_where_the_explicit_step_rings():
    """r = 0 up to D dt / h^2 = 9/32, above it the root of c r^2 - (1 + 2 c) r + c = 0 with the least c that damps."""
    width, spacing, law = 200.0, 50.0, Law()
    limit = float(launcher.explicit_dt(width, MeanderParams()))
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


def smoothed_speed(case, law, xy, deal):
    """What both kernels together make of the rates: the speed of each inner point to its right."""
    rates = case.rates(law, deal)
    moved = case.moved(law, rates, deal)[0]
    return np.sum((moved - xy)[1:-1] * reference.right_normals(xy), axis=1) / law.time_step


@pytest.mark.parametrize("deal", DEALS)
def test_two_recurrences_solve_the_implicit_equation(deal):
    """Inside a long channel the forward run of one kernel and the backward run of the other give (I - c d2)^-1."""
    xy = meander(400)
    law = Law(time_step=0.6, end_damping=0.0)
    width = 250.0
    share = reference.implicit_share(xy, 50.0, width, law)
    r = reference.recurrence_root(share)
    assert 0.3 < r < 0.8
    expected = reference.implicit_smoothing(twin_rates([xy], law, width)[0], share)
    margin = int(np.log(1e-16) / np.log(r))  # where the ends, which are held, are forgotten
    assert 2 * margin < 200
    actual = smoothed_speed(Case([xy], width=width), law, xy, deal)
    inner = slice(margin, len(xy) - margin)
    assert np.abs(actual - expected[1:-1])[inner].max() <= SUM_TOLERANCE * np.abs(expected).max()


def test_smoothing_keeps_a_constant_rate():
    """DC gain 1: far from the ends a circle moves as fast with as without it."""
    angle = np.arange(220) * 0.1
    xy = 500.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    law = Law(time_step=1.0, upstream_weight=0.0, end_damping=0.0)
    case = Case([xy], width=200.0, spacing=1000.0 * np.sin(0.05))
    speed = smoothed_speed(case, law, xy, 64)
    assert speed[80:-80] == pytest.approx(-60.0 * 200.0 / 500.0, rel=SUM_TOLERANCE)


def test_a_kink_alternating_from_point_to_point_halves_and_turns():
    """The shortest wave of the grid is multiplied by -1/2 in a step of any length that smoothing acts in."""
    n = 400
    small = 1e-6 * (-1.0) ** np.arange(n)
    xy = np.stack([50.0 * np.arange(n), small], axis=1)
    for time_step in (0.1, 0.5, 5.0):
        law = Law(time_step=time_step, upstream_weight=0.0, end_damping=0.0)
        case = Case([xy], width=200.0)
        moved = case.moved(law, case.rates(law))[0]
        middle = slice(150, 250)
        assert moved[middle, 1] / small[middle] == pytest.approx(-0.5, abs=1e-6)


def test_smoothing_goes_by_the_width_of_each_point(device):
    """A narrow reach is not smoothed as its wide neighbour asks for."""
    lines = stacked_lines(seed=21)
    sections = varying_sections(lines)
    law = Law(time_step=0.6)
    expected = [
        reference.fading_sum(
            reference.migration_rate(xy, 50.0, section[:, 0], section[:, 1], law),
            reference.point_roots(xy, 50.0, section[:, 0], law),
        )
        for xy, section in zip(lines, sections, strict=True)
    ]
    assert any(reference.point_roots(xy, 50.0, s[:, 0], law).any() for xy, s in zip(lines, sections, strict=True))
    case = Case(lines, sections=sections, device=device)
    for deal in DEALS:
        assert_rates(case.rates(law, deal), expected, SUM_TOLERANCE)


# ---- the move


def test_moves_match_the_twin_however_they_are_dealt_out(device):
    rng = np.random.default_rng(0)
    lines = stacked_lines(seed=12)
    sections = varying_sections(lines)
    mean_width = channel_means(sections)[0]
    rates = [rng.normal(0.0, 10.0, len(xy)) for xy in lines]
    case = Case(lines, sections=sections, device=device)
    for law in (Law(time_step=SHORT_STEP), Law(time_step=0.4), Law(time_step=0.4, scale_local=1), NO_DAMPING):
        twins = [
            reference.move_points(xy, rate, 50.0, mean_width[c], sections[c][:, 0], law)
            for c, (xy, rate) in enumerate(zip(lines, rates, strict=True))
        ]
        for deal in DEALS:
            for moved, twin in zip(case.moved(law, rates, deal), twins, strict=True):
                assert np.abs(moved - twin).max() <= MOVE_TOLERANCE


def test_a_positive_rate_moves_to_the_right_of_the_flow():
    east = np.stack([50.0 * np.arange(9), np.zeros(9)], axis=1)
    law = Law(time_step=1e-3, end_damping=0.0)
    moved = Case([east]).moved(law, [np.full(9, 2.0)])[0]
    assert moved[1:-1, 1] == pytest.approx(-0.002, rel=1e-12)
    assert (moved[:, 0] == east[:, 0]).all()


def test_ends_never_move(device, dtype):
    """To the bit, whatever the rate there, in channels of 3 points too."""
    lines = [np.asarray(xy, REALS[dtype]).astype(np.float64) for xy in stacked_lines(seed=13)]
    case = Case(lines, dtype=dtype, device=device)
    rates = [np.full(len(xy), 1e3) for xy in lines]
    for law in (Law(time_step=0.3), Law(time_step=0.3, end_damping=0.0), Law(time_step=SHORT_STEP)):
        for deal in (1, 7, 4096, *SLABS):
            for xy, moved in zip(lines, case.moved(law, rates, deal), strict=True):
                assert (moved[[0, -1]] == xy[[0, -1]]).all()


def test_end_damping_is_a_smoothstep_of_the_distance_to_the_end():
    """Five widths of 60 m are six points of 50 m: t = k / 6 gives 3 t^2 - 2 t^3, from both ends."""
    count = 40
    xy = np.stack([50.0 * np.arange(count), np.zeros(count)], axis=1)
    law = Law(time_step=1e-3, end_damping=5.0)
    moved = Case([xy], width=60.0).moved(law, [np.full(count, -1e3)])[0]
    by_hand = np.array([0.0, 2.0 / 27.0, 7.0 / 27.0, 0.5, 20.0 / 27.0, 25.0 / 27.0, 1.0, 1.0])
    assert moved[:8, 1] == pytest.approx(by_hand, abs=1e-14)
    assert moved[:-9:-1, 1] == pytest.approx(by_hand, abs=1e-14)
    assert (moved[6:-6, 1] == 1.0).all()


def test_a_line_that_turns_back_on_itself_stays_finite():
    """Both neighbours of the middle point coincide: it has no normal, and does not move."""
    xy = np.array([[0.0, 0.0], [50.0, 0.0], [0.0, 0.0], [0.0, 50.0], [0.0, 100.0]])
    law = Law(time_step=1e-3, end_damping=0.0)
    case = Case([xy])
    moved = case.moved(law, case.rates(law))[0]
    assert (moved[1] == xy[1]).all()


# ---- slabs, and channels at rest


def test_the_division_into_slabs_changes_no_bit(device, dtype):
    """Rates and moves, smoothing and ground included."""
    lines = stacked_lines(seed=14)
    law, height = Law(time_step=0.6), hills()
    case = Case(lines, sections=varying_sections(lines), dtype=dtype, device=device)
    results = []
    for deal in SLABS:
        rates = case.rates(law, deal)
        results.append([np.concatenate(values) for values in (rates, case.moved(law, rates, deal, height))])
    assert np.abs(results[0][0]).max() > 1.0
    for rates, points in results[1:]:
        np.testing.assert_array_equal(rates, results[0][0])
        np.testing.assert_array_equal(points, results[0][1])


@pytest.mark.parametrize("deal", DEALS)
def test_channels_at_rest_are_passed_over(device, dtype, deal):
    """Their rates are not written and their points copied; those that move do as they do among themselves."""
    lines = stacked_lines(seed=15)
    sections, law = varying_sections(lines), Law(time_step=0.6)
    awake = Case(lines, sections=sections, dtype=dtype, device=device)
    rates = awake.rates(law, deal)
    moved = awake.moved(law, rates, deal)
    for resting in ((0, 3, 9), (1, 2, 4, 5), range(len(lines))):
        case = Case(lines, sections=sections, resting=tuple(resting), dtype=dtype, device=device)
        found = case.rates(law, deal)
        # A rate left over from another step must not count.
        points = case.moved(
            law, [np.full(len(xy), 9.0) if c in resting else found[c] for c, xy in enumerate(lines)], deal
        )
        for c, xy in enumerate(lines):
            if c in resting:
                np.testing.assert_array_equal(points[c], xy.astype(REALS[dtype]))
            else:
                np.testing.assert_array_equal(found[c], rates[c])
                np.testing.assert_array_equal(points[c], moved[c])


# ---- the ground


def hills(slope=0.3, gaps=0.1, seed=0):
    """Heights on GRID: waves of that slope at most, in a plain, with holes."""
    rng = np.random.default_rng(seed)
    row, column = np.indices((150, 150))
    wave = 12_000.0 / (2.0 * np.pi)
    x, y = GRID[2] * column, GRID[2] * row
    height = slope * wave * np.sin(x / wave) + 0.02 * y
    if gaps > 0.0:
        for i, j in rng.integers(0, 150, (int(150 * 150 * gaps / 9), 2)):
            height[i : i + 3, j : j + 3] = np.nan
    return height


def test_moves_on_the_ground_match_the_twin(device):
    rng = np.random.default_rng(0)
    lines = stacked_lines(seed=16)
    rates = [rng.normal(0.0, 10.0, len(xy)) for xy in lines]
    law, height = Law(time_step=0.4), hills()
    case = Case(lines, width=60.0, device=device)
    ground = [reference.slope_weights(xy, height, GRID, law) for xy in lines]
    everywhere = np.concatenate(ground)
    assert (everywhere == 0.0).any() and (everywhere > 0.9).any() and ((0.1 < everywhere) & (everywhere < 0.9)).any()
    for deal in DEALS:
        for c, moved in enumerate(case.moved(law, rates, deal, height)):
            twin = reference.move_points(lines[c], rates[c], 50.0, 60.0, 60.0, law, ground[c])
            assert np.abs(moved - twin).max() <= MOVE_TOLERANCE + SLOPE_TOLERANCE["float64"]


@pytest.mark.parametrize(
    "height",
    [hills(), hills(gaps=0.6), hills(0.0), hills(0.0) + 0.3 * GRID[2] * np.arange(150), np.full((150, 150), np.nan)],
    ids=["hills", "holes", "flat", "steep", "no ground"],
)
def test_mobility_is_that_of_the_freest_point(device, dtype, height):
    """In every way to deal the points out, to the bit; channels partly off the ground and short ones among them."""
    rng = np.random.default_rng(17)
    lines = []
    for n in (3, 3, 4, 3, 5, 90, 3, 200, 3, 3, 3, 4, 150, 3):
        x, y = rng.uniform(-9000.0, 9000.0, 2)
        lines.append(meander(n, turn=rng.uniform(0.0, 6.0)) + [x, y])
    lines.append(np.array([[9500.0, 0.0], [9550.0, 0.0], [9600.0, 0.0]]))
    law = Law(slope_threshold=0.25)
    case = Case(lines, dtype=dtype, device=device)
    twins = np.array([reference.mobility(xy, height, GRID, law) for xy in lines])
    found = case.mobility(law, height)
    np.testing.assert_allclose(found, twins, atol=SLOPE_TOLERANCE[dtype], rtol=0.0)
    np.testing.assert_array_equal(found == 0.0, twins == 0.0)
    np.testing.assert_array_equal(found == 1.0, twins == 1.0)
    assert found[-1] == 0.0, "off the ground"
    for deal in DEALS:
        np.testing.assert_array_equal(case.mobility(law, height, deal), found)


def test_the_hills_hold_channels_of_all_kinds():
    """Else the test above would not see some."""
    law = Law(slope_threshold=0.25)
    places = np.random.default_rng(1).uniform(-9000.0, 9000.0, (300, 1, 2))
    found = np.array([reference.mobility(xy, hills(), GRID, law) for xy in places])
    assert all(((low < found) & (found < high)).any() for low, high in ((-1.0, 0.01), (0.1, 0.8), (0.99, 1.1)))
    assert not ((0.9 <= found) & (found < 1.0)).any()


# ---- sub-steps


def planned(limit, pace, mobility, time_step, dtype, device, before=0):
    """Parts of each channel's time step, and the most of them, ``before`` at least."""
    scalar = SCALARS[dtype]
    kernel = migration.build(scalar)
    mobility, pace = (
        None if v is None else to_device(np.array(v, np.float64), scalar, device) for v in (mobility, pace)
    )
    limits = to_device(np.array(limit, np.float64), kernel.vec3, device)
    parts, most = unwritten(len(limit), wp.int32, device), to_device([before], wp.int32, device)
    inputs = [limits, time_step, mobility, pace]
    wp.launch(kernel.plan_steps, dim=len(limit), inputs=inputs, outputs=[parts, most], device=device)
    return parts.numpy().tolist(), int(most.numpy()[0])


@pytest.mark.parametrize(
    ("status", "contacts", "halts"),
    [
        ((0, 0, 0), 0, False), ((0, 0, 3), 0, False), ((0, 0, 0), 2, False), ((0, 0, 3), 2, True), ((1, 0, 0), 0, True),
        ((0, 1, 2), 0, True),
    ],
)  # fmt: skip
def test_a_fault_and_contacts_halt_what_is_to_follow(device, status, contacts, halts):
    """Contacts that the host knows of, from before the first sub-step of a row, do not; steps and paces stay then."""
    kernel = migration.build(wp.float64)
    out, pace = unwritten(3, wp.float64, device), to_device(np.ones(3), wp.float64, device)
    state = to_device([*status, 0, 0], wp.int32, device)
    inputs = [to_device([1, 1, 1], wp.int32, device), 0.3, to_device([0, 1], wp.int32, device)]
    inputs += [to_device([0, contacts], wp.int32, device)]
    wp.launch(kernel.schedule_channels, dim=3, inputs=inputs, outputs=[out, pace, state], device=device)
    assert state.numpy()[HALT] == halts
    if halts:
        assert np.isnan(out.numpy()).all() and (pace.numpy() == 1.0).all()
    else:
        assert (out.numpy() == 0.3).all() and (pace.numpy() == 0.0).all()


def scheduled(parts, time_step, total, dtype, device):
    """Step of each channel in each sub-step, (total, C); the paces are cleared in the first."""
    scalar = SCALARS[dtype]
    kernel = migration.build(scalar)
    steps = []
    for k in range(total):
        out, pace = unwritten(len(parts), scalar, device), to_device(np.ones(len(parts)), scalar, device)
        number = to_device([k, total], wp.int32, device)
        inputs, status = [to_device(parts, wp.int32, device), time_step, number, None], going_on(device)
        wp.launch(kernel.schedule_channels, dim=len(parts), inputs=inputs, outputs=[out, pace, status], device=device)
        assert (pace.numpy() == (k > 0)).all()
        steps.append(out.numpy())
        wp.launch(kernel.schedule_channels, dim=len(parts), inputs=inputs, outputs=[out, None, status], device=device)
    return np.array(steps)


def test_parts_of_a_step_match_the_twin(device, dtype):
    rng = np.random.default_rng(18)
    time_step, count = 0.29, 400
    limit = np.stack([*10.0 ** rng.uniform(-3.0, 1.0, (2, count)), rng.uniform(1.0, 90.0, count)], axis=1)
    pace, mobility = 10.0 ** rng.uniform(-3.0, 3.0, count), rng.uniform(0.0, 1.0, count)
    mobility[::7], limit[5::9] = 0.0, 0.0
    pace[3::11], limit[4::13, :2] = np.inf, np.inf
    for g in (mobility, None):
        twin = [
            reference.step_count(*row, v, 1.0 if g is None else g[c], time_step)
            for c, (row, v) in enumerate(zip(limit, pace, strict=True))
        ]
        assert planned(limit, pace, g, time_step, dtype, device) == (twin, max(twin))
        assert planned(limit, pace, g, time_step, dtype, device, before=max(twin) + 5)[1] == max(twin) + 5
        assert max(twin) > 50 and min(twin) == 0


def test_a_step_that_divides_evenly_is_not_divided_further(device, dtype):
    def parts(limit, pace, mobility=1.0, time_step=0.29):
        return planned([limit], [pace], [mobility], time_step, dtype, device)[0][0]

    for time_step in (0.29, 106.0 / 365.25, 3.0):
        for n in (1, 2, 3, 7, 10, 49, 333, 5000):
            for limit, pace in (
                ((np.inf, time_step / n, 9.0), 0.0),  # waves
                ((time_step / n, np.inf, 9.0), np.inf),  # the tightest bend
                ((0.0 * n + 1e-9, np.inf, 9.0), 4.5 * n / time_step),  # bends as they are: half a width a part
            ):
                assert parts(limit, pace, time_step=time_step) == n
                shorter = (limit[0] * (1.0 - 1e-5), limit[1] * (1.0 - 1e-5), limit[2])
                assert parts(shorter, pace * (1.0 + 1e-5), time_step=time_step) == n + 1
            assert parts((np.inf, 0.25 * time_step / n, 9.0), 0.0, 0.25, time_step) == n
    assert parts((np.inf, np.inf, 9.0), 0.0) == 1
    assert parts((1e-30, 1e-30, 9.0), np.inf) == 1_000_000
    assert parts((1e-30, 1e-30, 9.0), np.inf, 0.0) == parts((0.0, 0.0, 0.0), 0.0) == 0


@pytest.mark.parametrize("total", [1, 2, 3, 7, 12, 60, 97])
def test_every_channel_takes_its_own_sub_steps(device, dtype, total):
    """Of N sub-steps n for each n up to N, the first always, evenly spread, and together the time step."""
    time_step = 0.29
    asked = np.arange(total + 3)  # 0: held by the ground; of more than N only N are taken
    for steps in (scheduled(asked, time_step, total, dtype, device),):
        for n, column in zip(asked, steps.T, strict=True):
            parts = min(int(n), total)
            own = np.flatnonzero(column > 0.0)
            assert own.tolist() == reference.own_substeps(parts, total)
            assert (column[np.setdiff1d(np.arange(total), own)] == 0.0).all()
            if parts == 0:
                continue
            assert own[0] == 0 and set(np.diff([*own, total])) <= {total // parts, -(-total // parts)}
            assert (column[own] == column[0]).all()
            # The time step and its part are rounded once each.
            rounding = float(np.finfo(REALS[dtype]).eps)
            assert math.fsum(column[own].tolist()) == pytest.approx(time_step, rel=rounding)
