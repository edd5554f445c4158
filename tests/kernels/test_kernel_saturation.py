"""Rates whose curvature saturates, and whose memory is a length in widths: twins, closed forms, orders, neutral values.

With ``curvature_saturation`` c0 a bend counts as c0 tanh(w C / c0) / w; with ``memory_length`` L it is felt over L w.
"""

import dataclasses

import numpy as np
import pytest
import reference
import reference_rings
import reference_stems
from kernel_arrays import DEALS
from migration_case import (
    SHORT_STEP,
    SUM_TOLERANCE,
    SUM_TOLERANCE_32,
    Case,
    assert_rates,
    heading_line,
    meander,
    stacked_lines,
    twin_rates,
    varying_sections,
)
from reference import Law
from test_kernel_memory import STEMS, packed_rivers
from test_kernel_rings import circle, wavy_ring

LAWS = {
    "saturation": {"curvature_saturation": 0.2},
    "length": {"memory_length": 2.5},
    "both": {"curvature_saturation": 0.15, "memory_length": 3.0, "reference_width": 70.0},
}


@pytest.mark.parametrize("options", LAWS.values(), ids=LAWS)
def test_lines_match_the_twin_with_widths_that_vary(device, options):
    lines = stacked_lines(seed=8)
    sections, law = varying_sections(lines), Law(time_step=SHORT_STEP, **options)
    expected = twin_rates(lines, law, sections=sections)
    case = Case(lines, sections=sections, device=device)
    for deal in DEALS:
        assert_rates(case.rates(law, deal), expected, SUM_TOLERANCE)


@pytest.mark.parametrize("options", LAWS.values(), ids=LAWS)
def test_single_precision(device, options):
    lines = [np.float32(xy).astype(np.float64) for xy in stacked_lines(seed=11)]
    sections, law = varying_sections(lines), Law(time_step=SHORT_STEP, **options)
    wide, narrow = (Case(lines, sections=sections, dtype=d, device=device) for d in ("float64", "float32"))
    assert_rates(narrow.rates(law), wide.rates(law), SUM_TOLERANCE_32)


@pytest.mark.parametrize("options", LAWS.values(), ids=LAWS)
def test_rings_match_the_dense_periodic_sum(device, options):
    lines = [wavy_ring(n, n) for n in (8, 9, 150, 67)]
    sections, law = varying_sections(lines), Law(time_step=SHORT_STEP, **options)
    case = Case(lines, sections=sections, rings=range(4), device=device)
    expected = [
        reference_rings.migration_rate(xy, 50.0, *section.T, law) for xy, section in zip(lines, sections, strict=True)
    ]
    for deal in DEALS:
        assert_rates(case.rates(law, deal), expected, SUM_TOLERANCE)


@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("options", LAWS.values(), ids=LAWS)
def test_links_match_the_twin_where_the_width_jumps(device, options, varying):
    lines, spacing, width, depth = packed_rivers()
    law, sections = Law(time_step=SHORT_STEP, **options), None
    widths, depths = list(width), list(depth)
    if varying:
        sections = varying_sections(lines)
        widths, depths = ([section[:, k] for section in sections] for k in (0, 1))
    case = Case(lines, width=width, depth=depth, sections=sections, spacing=spacing, stems=STEMS, device=device)
    for deal in (1, 32, "a slab each"):
        rates = case.rates(law, deal)
        for links in STEMS:
            pick = [[values[c] for c in links] for values in (lines, spacing, widths, depths)]
            expected = reference_stems.migration_rates(*pick, law)
            largest = max(np.abs(rate).max() for rate in expected)
            for c, rate in zip(links, expected, strict=True):
                assert np.abs(rates[c] - rate).max() <= SUM_TOLERANCE * largest, (deal, c)


def test_a_length_in_widths_that_is_the_one_by_friction_gives_the_same_rates(device):
    """L w = d / (2 f)."""
    lines = stacked_lines(seed=4)
    case, law = Case(lines, width=50.0, depth=2.0, device=device), Law(time_step=SHORT_STEP)
    alike = dataclasses.replace(law, memory_length=2.0 / (2.0 * law.friction) / 50.0)
    for one, other in zip(case.rates(law), case.rates(alike), strict=True):
        assert np.abs(one - other).max() <= SUM_TOLERANCE * np.abs(one).max()


@pytest.mark.parametrize("radius", [100.0, 400.0, 20_000.0])
def test_a_ring_grows_at_the_closed_form(device, radius):
    """All round R' = (omega + gamma) k c0 tanh(w / (R c0)), outward, whatever the memory."""
    law = Law(time_step=SHORT_STEP, scale_upstream=0, curvature_saturation=0.2, memory_length=2.5)
    xy = circle(300, radius)
    spacing = reference_rings.segments(xy).mean()
    (rate,) = Case([xy], spacing=spacing, rings=[0], device=device).rates(law)
    assert rate == pytest.approx(1.5 * 60.0 * 0.2 * np.tanh(50.0 / radius / 0.2), rel=1e-9)


@pytest.mark.parametrize("radius", [20.0, 35.0])
def test_a_ring_tighter_than_its_width_grows_less(device, radius):
    """R' = k ((omega + gamma) c0 tanh(w / (R c0)) + omega (w / R - 1)): what exceeds 1 / w straightens as ever."""
    law = Law(time_step=SHORT_STEP, scale_upstream=0, curvature_saturation=0.2, memory_length=2.5)
    xy = circle(100, radius)
    (rate,) = Case([xy], spacing=reference_rings.segments(xy).mean(), rings=[0], device=device).rates(law)
    assert rate == pytest.approx(60.0 * (1.5 * 0.2 * np.tanh(50.0 / radius / 0.2) - (50.0 / radius - 1.0)), rel=1e-9)


def test_a_bend_fades_over_so_many_widths_whatever_the_depth(device):
    bend = meander(40)
    foot = bend[-1] + np.arange(1, 101)[:, None] * np.array([50.0, 0.0])
    law = Law(time_step=SHORT_STEP, scale_upstream=0, memory_length=3.0)
    for width, depth in ((50.0, 2.0), (80.0, 0.1)):
        rate = Case([np.concatenate([bend, foot])], width=width, depth=depth, device=device).rates(law)[0][45:-4]
        z = 50.0 * np.arange(len(rate)) / (3.0 * width)
        assert (rate * np.exp(z))[:45] == pytest.approx(rate[0], rel=1e-9)


def test_slight_bends_are_those_of_the_law_without_saturation(device):
    """c0 tanh(x / c0) = x (1 - (x / c0)^2 / 3 ...): w C of at most 1e-4 c0 leaves the theory of small waves alone."""
    xy = heading_line(lambda s: 4e-5 * np.sin(2.0 * np.pi / 600.0 * s), 200, 50.0)
    case, law = Case([xy], device=device), Law(time_step=SHORT_STEP)
    felt = dataclasses.replace(law, curvature_saturation=0.2)
    (plain,), (saturated,) = case.rates(law), case.rates(felt)
    assert np.abs(saturated - plain).max() <= 1e-8 / 3.0 * np.abs(plain).max()


def test_the_upstream_rate_of_saturated_bends_converges_at_fourth_order(device):
    """Against the mean of the exact curvature: tanh has second derivatives of its own, which the quadrature takes off.

    Bends of w C up to .41, twice c0.
    """
    length, q, swing = 8000.0, 2.0 * np.pi / 1000.0, 1.3
    law = Law(
        time_step=SHORT_STEP, local_weight=0.0, upstream_weight=1.0, scale_upstream=0, curvature_saturation=0.2,
        memory_length=2.5, end_damping=0.0,
    )  # fmt: skip
    fine = np.linspace(0.0, 60.0, 60_001)  # e-foldings
    errors = []
    for count in (101, 201, 401):
        spacing = length / (count - 1)
        xy = heading_line(lambda s: swing * np.sin(q * s), count, spacing)
        s = spacing * np.arange(count)
        at = (s > 3000.0) & (s < length - 500.0)
        curvature = swing * q * np.cos(q * (s[at, None] - 125.0 * fine))
        felt = 60.0 * 0.2 * np.tanh(50.0 * curvature / 0.2)
        # The head, 24 e-foldings up and more, is straight in the kernel.
        exact = np.trapezoid(felt * np.exp(-fine), fine, axis=1)
        errors.append(np.abs(Case([xy], spacing=spacing, device=device).rates(law)[0][at] - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 3.6).all(), errors


def test_felt_curvature_of_the_twin_is_odd_and_bounded():
    law = Law(curvature_saturation=0.2)
    curvature = np.linspace(-1.0, 1.0, 101)
    felt = reference.felt_curvature(curvature, 50.0, law)
    assert np.abs(felt).max() <= 0.2 / 50.0 and (felt == -felt[::-1]).all() and (np.diff(felt) >= 0.0).all()
