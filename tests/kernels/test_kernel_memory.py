"""Rivers in links: what ``measure_stems``, ``chain_links``, ``add_upstream`` and ``find_tails`` hand on.

Against the twins in reference_stems.py, and against the same river in one piece.
"""

import itertools

import numpy as np
import pytest
import reference
import reference_stems as twin
from kernel_arrays import DEALS
from migration_case import MOVE_TOLERANCE, SHORT_STEP, SUM_TOLERANCE, Case, heading_line, meander
from reference import Law

# Of the greatest rate: what is handed on is rounded elsewhere.
SAME_RIVER = {"float64": 1e-12, "float32": 1e-4}
CUTS = [0, 2, 4, 7, 60, 64, 66, 130, 160, 257, 259]
# Links of two rivers, and channels that are alone, in the order of the packed points.
STEMS, ALONE = ([6, 2, 0, 3], [5, 1]), (4,)


def river_in_links(cuts=CUTS, count=260, **options):
    """One river, and the same points as links that share those at their ends."""
    xy = meander(count, **options)
    return xy, [xy[a : b + 1] for a, b in itertools.pairwise(cuts)]


def uneven_links(seed=0, spacing=(50.0, 40.0, 62.0, 55.0), counts=(30, 3, 70, 12)):
    """Links along one smooth curve, each of its own spacing."""
    lines, s = [], 0.0
    for h, count in zip(spacing, counts, strict=True):
        start = lines[-1][-1] if lines else np.zeros(2)
        lines.append(heading_line(lambda z, s=s: seed + 1.1 * np.sin((z + s) / 170.0), count, h, start))
        s += h * (count - 1)
    return lines, np.array(spacing)


def packed_rivers():
    """Two rivers of links of different widths, depths and spacings, and a channel, packed in another order."""
    lines, spacing = [None] * 7, np.zeros(7)
    for seed, links in enumerate(STEMS):
        own, h = uneven_links(seed, *(((50.0, 60.0), (40, 25)) if len(links) == 2 else ()))
        for c, line, each in zip(links, own, h, strict=True):
            lines[c], spacing[c] = line, each
    lines[4], spacing[4] = meander(80, 45.0), 45.0
    width, depth = np.linspace(40.0, 90.0, 7), np.linspace(1.5, 3.0, 7)
    return lines, spacing, width, depth


@pytest.mark.parametrize("scales", [(0, 0), (0, 1), (1, 1)], ids=["none", "upstream", "whole"])
def test_links_have_the_rates_of_the_twin_however_they_are_dealt_out(device, scales):
    lines, spacing, width, depth = packed_rivers()
    law = Law(time_step=SHORT_STEP, scale_local=scales[0], scale_upstream=scales[1])
    case = Case(lines, width=width, depth=depth, spacing=spacing, stems=STEMS, device=device)
    for deal in DEALS:
        rates = case.rates(law, deal)
        for links in STEMS:
            expected = twin.migration_rates([lines[c] for c in links], spacing[links], width[links], depth[links], law)
            largest = max(np.abs(rate).max() for rate in expected)
            for c, rate in zip(links, expected, strict=True):
                assert np.abs(rates[c] - rate).max() <= SUM_TOLERANCE * largest, (deal, c)
        alone = reference.migration_rate(lines[4], 45.0, np.full(80, width[4]), np.full(80, depth[4]), law)
        assert np.abs(rates[4] - alone).max() <= SUM_TOLERANCE * np.abs(alone).max()


def test_links_whose_width_and_depth_vary(device):
    lines, spacing, _, _ = packed_rivers()
    sections = [
        np.stack([60.0 + 20.0 * np.sin(0.3 * np.arange(len(xy)) + c), 2.0 + 0.5 * np.cos(0.2 * np.arange(len(xy)))], 1)
        for c, xy in enumerate(lines)
    ]
    law = Law(time_step=SHORT_STEP)
    case = Case(lines, sections=sections, spacing=spacing, stems=STEMS, device=device)
    for deal in (1, 32, "a slab each", "uneven slabs, apart"):
        rates = case.rates(law, deal)
        for links in STEMS:
            widths, depths = ([sections[c][:, k] for c in links] for k in (0, 1))
            expected = twin.migration_rates([lines[c] for c in links], spacing[links], widths, depths, law)
            largest = max(np.abs(rate).max() for rate in expected)
            for c, rate in zip(links, expected, strict=True):
                assert np.abs(rates[c] - rate).max() <= SUM_TOLERANCE * largest, (deal, c)


@pytest.mark.parametrize("time_step", [SHORT_STEP, 0.29, 3.0])
def test_a_step_of_links_matches_the_twin(device, time_step):
    """Smoothed down and up through junctions, where the step is long enough for that."""
    lines, spacing, width, depth = packed_rivers()
    law = Law(time_step=time_step)
    case = Case(lines, width=width, depth=depth, spacing=spacing, stems=STEMS, device=device)
    for deal in (1, 7, 32, 4096, "one slab", "a slab each, apart"):
        moved = case.moved(law, case.velocities(law, deal), deal)
        for links in STEMS:
            stem, own = [lines[c] for c in links], (spacing[links], width[links])
            expected = twin.move_stem(stem, twin.migration_rates(stem, *own, depth[links], law), *own, law)
            for k, (c, after) in enumerate(zip(links, expected, strict=True)):
                # The head of a link is settled later: it is where the link upstream ends.
                inner = slice(1 if k else 0, None)
                shift = max(np.abs(after - lines[c]).max(), 1.0)
                np.testing.assert_allclose(
                    moved[c][inner], after[inner], rtol=0.0, atol=MOVE_TOLERANCE * shift, err_msg=f"{deal} {c}"
                )
                if k:
                    np.testing.assert_array_equal(moved[c][0], lines[c][0])


@pytest.mark.parametrize("scales", [(0, 0), (0, 1), (1, 1)], ids=["none", "upstream", "whole"])
@pytest.mark.parametrize("time_step", [SHORT_STEP, 2.0])
def test_a_river_in_links_has_the_rates_of_one_piece(device, dtype, scales, time_step):
    """Links of two segments among them: the memory of a bend goes through several of them."""
    xy, lines = river_in_links()
    law = Law(time_step=time_step, scale_local=scales[0], scale_upstream=scales[1])
    whole = Case([xy], dtype=dtype, device=device)
    links = Case(lines, stems=[list(range(len(lines)))], dtype=dtype, device=device)
    for deal in DEALS:
        one = whole.velocities(law, deal)[0]
        many = links.velocities(law, deal)
        assert np.abs(twin.join_links(many)[0] - one).max() <= SAME_RIVER[dtype] * np.abs(one).max(), deal
        for upper, lower in itertools.pairwise(many):
            assert np.abs(upper[-1] - lower[0]).max() <= SAME_RIVER[dtype] * np.abs(one).max(), (
                "a junction has one rate"
            )
        after, moved = whole.moved(law, [one], deal)[0], links.moved(law, many, deal)
        joined = np.concatenate([moved[0], *(line[1:] for line in moved[1:])])
        np.testing.assert_allclose(joined, after, rtol=0.0, atol=1e-9 if dtype == "float64" else 5e-3)


def test_end_damping_goes_on_through_short_links(device):
    """Over five widths: the first and the last links are two segments long, and have widths of their own."""
    _, lines = river_in_links()
    width = np.full(len(lines), 50.0)
    width[0], width[-1] = 80.0, 30.0
    case = Case(lines, width=width, stems=[list(range(len(lines)))], device=device)
    free, damped = (
        case.rates(Law(time_step=SHORT_STEP, local_weight=0.0, end_damping=damping)) for damping in (0.0, 5.0)
    )
    weight = twin.stem_end_weights(lines, np.full(len(lines), 50.0), width, 5.0)
    largest = max(np.abs(rate).max() for rate in free)
    error = twin.join_values(damped) - weight * twin.join_values(free)
    assert np.abs(error).max() <= SUM_TOLERANCE * largest
    assert 0.0 < twin.split_links(weight, lines)[2][1] < 1.0, "it reaches into the third link"


def test_an_inactive_link_hands_on_its_own_bends_and_no_more(device):
    """It is held by the ground for a whole step: what lies farther upstream counts as straight, as at a source."""
    _, lines = river_in_links([0, 60, 64, 180, 259])
    law = Law(time_step=SHORT_STEP, scale_upstream=0)
    case = Case(lines, stems=[[0, 1, 2, 3]], resting=(0, 1), device=device)
    shape = [50.0] * 4, [50.0] * 4, [2.0] * 4
    full = twin.migration_rates(lines, *shape, law)
    # What link 0 has left at its foot, and its optical depth from there on.
    left = twin.migration_rates(lines, *shape, Law(local_weight=0.0, scale_upstream=0))[0][-1]
    optical = 2.0 * law.friction / 2.0 * 50.0
    for deal in (7, "a slab each"):
        rates = case.rates(law, deal, felt=(1,))
        for c, first in ((2, 4), (3, 120)):
            expected = full[c] - left * np.exp(-optical * (first + np.arange(len(lines[c]))))
            assert np.abs(rates[c] - expected).max() <= SUM_TOLERANCE * np.abs(full[2]).max()
    assert abs(left * np.exp(-4.0 * optical)) > 0.01 * np.abs(full[2]).max(), "it would be seen"


def test_curvature_at_a_junction_converges_where_the_spacing_jumps(device):
    """By a fourth, as links that are short may be sampled: at second order at least."""
    errors = []
    for refine in (1, 2, 4):
        h = np.array([50.0, 40.0]) / refine
        lines, _ = uneven_links(0.0, h, (30 * refine + 1, 30 * refine + 1))
        law = Law(time_step=SHORT_STEP, upstream_weight=0.0)
        rates = Case(lines, spacing=h, stems=[[0, 1]], device=device).rates(law)
        error = 0.0
        for k, rate in enumerate(rates):
            s = k * 1500.0 + h[k] * np.arange(len(rate))
            exact = -60.0 * 50.0 * 1.1 / 170.0 * np.cos(s / 170.0)
            near = slice(-4, None) if k == 0 else slice(0, 4)
            error = max(error, np.abs(rate - exact)[near].max())
        errors.append(error)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.9).all(), errors
