"""Rings in the kernels of a step by shortest paths, among lines, against dense twins and scipy's search."""

import cutoff_case
import numpy as np
import pytest
import reference_paths as twin
import reference_rings as rings
import test_kernel_paths as pushing
import test_kernel_rings as shapes
import test_kernel_shortcuts as paths
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import DEALS, REALS, SLABS, Backwards, list_of_marks, struct_of, to_device
from path_lines import SPACING, varying_sections, wandering_line
from reference_paths import PathLaw

from warpriver.kernels import routes
from warpriver.kernels.links import Route


def mixed(seed=0):
    """Lines and rings, very short ones among them, and which are rings."""
    rng = np.random.default_rng(seed)
    lines = [wandering_line(rng, n, curl=0.3) for n in (3, 90)]
    round_ones = [shapes.wavy_ring(n, seed + n, SPACING) for n in (8, 9, 120, 12, 180)]
    return [lines[0], *round_ones[:3], lines[1], *round_ones[3:]], (1, 2, 3, 5, 6)


# ---- push


@pytest.mark.parametrize("blur", [1.5, 60.0], ids=["a short blur", "a blur of many laps"])
@pytest.mark.parametrize("varies", [False, True])
def test_push_and_shift_of_rings_match_the_twins(device, dtype, varies, blur):
    """Both recurrences closed over rings shorter and longer than they reach; one ring is inactive."""
    lines, closed = mixed(1)
    counts = [len(xy) for xy in lines]
    law = PathLaw(time_step=0.05, blur_length=blur)
    sections = varying_sections(np.random.default_rng(2), counts) if varies else None
    options = {"sections": sections, "time_step": law.time_step, "dtype": dtype, "device": device}
    case = pushing.Case(lines, rings=closed, resting=(3,), **options)
    sums, moves = (1e-11, 1e-11) if dtype == "float64" else (2e-3, 2e-3)
    awake = [c for c in closed if c != 3]
    halves = {c: twin.ring_push(lines[c], SPACING, case.widths()[c], law) for c in awake}
    after = {c: twin.ring_shift(lines[c], halves[c], SPACING, case.mean[c], case.widths()[c], law) for c in awake}
    for deal in (1, 7, 64, SLABS[0], SLABS[2]):
        found = case.pushes(law, deal)
        for c in awake:
            assert np.abs(found[c] - halves[c]).max() <= sums * np.abs(halves[c]).max(), (deal, c)
        moved, max_speed = case.shifted(law, found, deal)
        assert (moved[3] == lines[3].astype(REALS[dtype])).all() and max_speed[3] == 0.0
        for c in awake:
            np.testing.assert_allclose(moved[c], after[c], rtol=0.0, atol=moves)
            fastest = np.hypot(*(after[c] - lines[c]).T).max() / law.time_step
            assert max_speed[c] == pytest.approx(fastest, rel=1e-3 if dtype == "float32" else 1e-8)


def test_lines_among_rings_are_pushed_as_alone(device):
    lines, closed = mixed(2)
    law = PathLaw(time_step=0.05)
    case, plain = (pushing.Case(lines, rings=c, time_step=0.05, device=device) for c in (closed, ()))
    for deal in (64, SLABS[0]):
        halves, own = case.pushes(law, deal), plain.pushes(law, deal)
        moved, alone = case.shifted(law, halves, deal)[0], plain.shifted(law, own, deal)[0]
        for c in (0, 4):
            np.testing.assert_array_equal(moved[c], alone[c])


@pytest.mark.parametrize("deal", [7, 64, SLABS[0]])
def test_a_ring_may_be_pushed_from_any_of_its_points(deal):
    xy, law = shapes.wavy_ring(230, 4, SPACING), PathLaw(time_step=0.05)

    def moved(line):
        case = pushing.Case([line], rings=(0,), time_step=0.05)
        return case.shifted(law, case.pushes(law, deal), deal)[0][0]

    for shift in (1, 37, 229):
        np.testing.assert_allclose(moved(np.roll(xy, shift, axis=0)), np.roll(moved(xy), shift, axis=0), atol=1e-10)


@pytest.mark.parametrize("turn", [1.0, -1.0])
@pytest.mark.parametrize("count", [8, 50, 400])
def test_smoothing_leaves_a_circle_and_the_push_widens_it(turn, count):
    """Without a push it stays to rounding, however strong the smoothing; with it R grows by k w dt / R blurred."""
    radius = SPACING / (2.0 * np.sin(np.pi / count))
    xy = shapes.circle(count, radius, turn)
    for blur, strength in ((1e7, 0.35), (1e7, 10.0), (1.5, 0.35)):
        law = PathLaw(time_step=0.02, blur_length=blur, smoothing=strength, downstream_share=0.0)
        case = pushing.Case([xy], rings=(0,), time_step=0.02)
        moved = case.shifted(law, case.pushes(law))[0][0]
        wave = 2.0 - 2.0 * np.cos(2.0 * np.pi / count)
        grown = 60.0 * 12.0 * 0.02 / radius / (1.0 + (blur * 12.0 / SPACING) ** 2 * wave)
        np.testing.assert_allclose(moved, xy * (1.0 + grown / radius), rtol=0.0, atol=1e-9)


# ---- shortcuts


class RingCase(paths.Case):
    """Channels some of which are rings, and the kernels that find the routes round them."""

    def twin_shortcuts(self, radius, min_arc, cone):
        found = super().twin_shortcuts(radius, min_arc, cone)
        for c in self.rings:
            width = self.widths()[c]
            mean = 0.5 * (width[:, None] + width)
            found[c] = twin.ring_shortcuts(self.lines[c], SPACING, radius * mean, min_arc * mean, cone)
        return found

    def opened(self, pairs, saving, longer, deal):
        """Heads within their channels, what shortcuts save then, marks at their ends, and the heads on the device."""
        links, marks = self.packed_links(pairs, deal)
        links.link_saving = to_device(saving, wp.float64, self.device)
        route = struct_of(Route, point_from=self.zeros(self.capacity), channel_head=self.ints(len(self.lines)))
        inputs = [self.channels, longer, ..., self.xy, self.arcs(deal), list_of_marks(marks, self.device)]
        self.launch(routes.build(self.scalar).open_rings, deal, inputs, [links, route], by_channel=True)
        head = route.channel_head
        return head.numpy() - self.start[:-1], links.link_saving.numpy(), route.point_from, head

    def routed(self, pairs, saving, longer, deal):
        """Shortcuts on the route by channel."""
        _, save, marks, head = self.opened(pairs, saving, longer, deal)
        return self.path(pairs, save, deal, head=head, ends_at=marks)


def ring_case(seed, device="cpu", varied=False):
    rng = np.random.default_rng(seed)
    lines = [shapes.wandering_ring(rng, int(n)) for n in rng.integers(8, 160, 5)]
    lines[1:1] = [wandering_line(rng, 70)]
    sections = varying_sections(rng, [len(xy) for xy in lines]) if varied else None
    return RingCase(lines, rings=(0, 2, 3, 4, 5), sections=sections, device=device)


@pytest.mark.parametrize("varied", [False, True])
@pytest.mark.parametrize("cone", [10.0, 45.0, 90.0])
def test_shortcuts_of_rings_are_those_of_all_pairs(device, cone, varied):
    """Tangents and crossings go across the seam; neighbours across it are not joined."""
    seam = total = 0
    for seed in range(3):
        case = ring_case(seed, device, varied)
        expected = case.twin_shortcuts(1.5, 3.0, cone)
        for deal in (7, Backwards(7), SLABS[0], SLABS[2]):
            for c, pairs in enumerate(case.shortcuts(1.5, 3.0, cone, deal)):
                assert pairs.tolist() == expected[c].tolist(), (seed, deal, c)
        total += sum(len(p) for p in expected)
        plain = paths.Case.twin_shortcuts(case, 1.5, 3.0, cone)
        seam += sum(a.tolist() != b.tolist() for a, b in zip(plain, expected, strict=True))
    assert total > 50 and seam > 1


@pytest.mark.parametrize("longer", [0, 1])
def test_routes_round_rings_are_as_short_as_scipys(device, longer):
    """Heads, what is saved, and the length of the route by a search on two laps, to 1e-12; some loops hold the seam."""
    across = several = kept_all = 0
    for seed in range(8):
        case = ring_case(seed, device)
        pairs = case.twin_shortcuts(1.5, 3.0, 45.0)
        for deal in (7, 64, SLABS[0], SLABS[2]):
            saving = case.weighed(pairs, deal)
            heads, turned, *_ = case.opened(pairs, saving, longer, deal)
            kept = case.routed(pairs, saving, longer, deal)
            first = 0
            for c, (xy, links) in enumerate(zip(case.lines, pairs, strict=True)):
                own = slice(first, first + len(links))
                first += len(links)
                if c not in case.rings:
                    assert heads[c] == 0 and (turned[own] == saving[own]).all()
                    continue
                if len(links) == 0:
                    assert kept[c] == []
                    continue
                assert heads[c] == twin.ring_head(len(xy), links, longer), (seed, deal, c)
                edges, which = twin.ring_edges(len(xy), links, heads[c], longer)
                forbidden = np.delete(turned[own], which)
                assert (forbidden < 0.0).all(), "never taken"
                for (i, j), gain in zip(edges, turned[own][which], strict=True):
                    around = rings.rounded_segments(xy)[np.arange(i, j if j > i else j + len(xy)) % len(xy)].sum()
                    assert gain == pytest.approx(around - np.hypot(*(xy[j] - xy[i])), abs=1e-10)
                length = twin.shortest_ring(xy, edges, heads[c])
                assert abs(twin.ring_length(xy, kept[c]) - length) <= 1e-12 * length
                assert {tuple(e) for e in kept[c]} <= {tuple(e) for e in edges.tolist()}
                across += sum(i > j for i, j in kept[c])
                assert longer or all(j == 0 for i, j in kept[c] if i > j), "the first point goes on"
                several += len(kept[c]) > 1
                kept_all += len(kept[c])
    assert kept_all > 100 and several > 10 and across > 5


def test_where_no_shortcut_passes_over_the_head_the_route_is_the_shortest_of_all():
    """Of every closed route once round over shortcuts that bypass the shorter part, from wherever it begins."""
    rng = np.random.default_rng(0)
    case = RingCase([shapes.wandering_ring(rng, 120) * 1.6 for _ in range(40)], rings=tuple(range(40)))
    pairs = case.twin_shortcuts(1.5, 3.0, 45.0)
    saving = case.weighed(pairs, 64)
    heads, kept, found = case.opened(pairs, saving, 1, 64)[0], case.routed(pairs, saving, 1, 64), 0
    for xy, links, head, own in zip(case.lines, pairs, heads, kept, strict=True):
        shorter = np.where((2 * (links[:, 1] - links[:, 0]) <= len(xy))[:, None], links, links[:, ::-1])
        size = (shorter[:, 1] - shorter[:, 0]) % len(xy)
        if len(links) == 0 or (((head - shorter[:, 0]) % len(xy)) < size).any():
            continue
        length = twin.shortest_ring(xy, shorter, np.arange(len(xy)))
        assert twin.ring_length(xy, own) == pytest.approx(length, rel=1e-12)
        found += 1
    assert found >= 10


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.one_of(st.integers(8, 40), st.integers(8, 200)), min_size=1, max_size=4),
    deal=st.one_of(st.integers(1, 50), st.sampled_from(DEALS)),
    seed=st.integers(0, 2**32 - 1),
    density=st.one_of(st.none(), st.floats(0.0, 0.1)),
    longer=st.integers(0, 1),
)
def test_any_links_of_rings_with_ties_give_the_twins_route(counts, deal, seed, density, longer):
    """Whole-number savings, so that ties abound; what is turned saves as little. Some of the channels are lines."""
    rng = np.random.default_rng(seed)
    # Points on a line there and back: whole lengths, and chords that are taken off again below.
    lines = [np.stack([SPACING * np.minimum(np.arange(n), n - np.arange(n)), np.zeros(n)], axis=1) for n in counts]
    closed = rng.random(len(counts)) < 0.8
    case, pairs, given_saving, expected = RingCase(lines, rings=tuple(np.flatnonzero(closed))), [], [], []
    for c, (xy, n) in enumerate(zip(lines, counts, strict=True)):
        links = paths.tangled_links(rng, n)
        if density is not None:
            links = np.argwhere(np.triu(rng.random((n, n)) < density, 2)).reshape(-1, 2)
        gain = rng.integers(0, 4, len(links)).astype(float)
        saving, head = gain.copy(), 0
        if not closed[c]:
            expected.append(twin.best_chain(n, links, gain)[0])
        elif len(links):
            head = twin.ring_head(n, links, longer)
            edges, which = twin.ring_edges(n, links, head, longer)
            turned = ((links - head) % n)[:, 0] > ((links - head) % n)[:, 1]
            chord = np.abs(xy[links[:, 1], 0] - xy[links[:, 0], 0])
            saving = np.where(turned, rings.segments(xy).sum() - gain - 2.0 * chord, gain)
            expected.append(twin.ring_chain(n, edges, gain[which], head)[0])
        else:
            expected.append([])
        pairs.append(links)
        given_saving.append(saving)
    if sum(len(p) for p in pairs) == 0 or not closed.any():
        return
    kept = case.routed(pairs, np.concatenate(given_saving), longer, deal)
    assert [sorted(k) for k in kept] == [sorted(e) for e in expected]


@pytest.mark.parametrize(
    ("pairs", "longer", "head", "route"),
    [
        # A neck across the seam: the shorter part holds the first point; it is cut off, or goes on.
        ([(8, 52)], 1, 30, [(52, 8)]),
        ([(8, 52)], 0, 0, [(8, 52)]),
        # What lies between three lobes is on the longer side of every neck.
        ([(5, 15), (25, 35), (45, 55)], 1, 20, [(5, 15), (25, 35), (45, 55)]),
        # But a sliver between them is not: then the longest lobe goes on.
        ([(1, 20), (21, 39), (41, 59)], 1, 11, [(20, 1)]),
        # Two banks side by side all along: the end that is free of any neck goes on.
        ([(i, 60 - i) for i in range(2, 25)], 1, 30, [(36, 24)]),
        # Twice round: no point is free, and the first one keeps four on either side; of like routes the upstream one.
        ([(i, i + 30) for i in range(30)], 1, 0, [(4, 34)]),
        # The first point is the neck's own: the stretch below it tells which part goes on, and nothing passes over it.
        ([(0, 30)], 0, 15, [(30, 0)]),
        ([(0, 30), (0, 31), (1, 30)], 0, 16, [(30, 0)]),
        # Loops that end and begin at one point, across the seam.
        ([(0, 12), (0, 40)], 1, 26, [(0, 12), (40, 0)]),
    ],
)
@pytest.mark.parametrize("deal", [7, SLABS[0]])
def test_routes_by_hand(pairs, longer, head, route, deal):
    """Rings of 60 points, there and back on a line, so that all lengths are whole; a shortcut has no length."""
    place = np.minimum(np.arange(60), 60 - np.arange(60))
    case = RingCase([SPACING * np.stack([place, np.zeros(60)], axis=1)], rings=(0,))
    links = np.array(sorted(pairs))
    chord = SPACING * np.abs(place[links[:, 1]] - place[links[:, 0]])
    # What goes round from i to j saves its arc, and the other way the rest, once chords are made good.
    turned = np.diff((links - head) % 60, axis=1)[:, 0] < 0
    saving = SPACING * (links[:, 1] - links[:, 0]) - 2.0 * chord * turned
    heads, *_ = case.opened([links], saving, longer, deal)
    assert heads[0] == head == twin.ring_head(60, links, longer)
    assert case.routed([links], saving, longer, deal)[0] == route


@pytest.mark.parametrize("deal", [1, 7, 64, Backwards(7), *SLABS[:2]])
def test_loops_that_go_round_the_seam_are_cut(device, deal):
    """The point where one ends may be that where the next one begins."""
    rng = np.random.default_rng(9)
    lines = [shapes.wandering_ring(rng, 60), wandering_line(rng, 20), shapes.wandering_ring(rng, 50)]
    case = cutoff_case.Case(lines, rings=(0, 2), device=device)
    result = cutoff_case.assert_cuts(case, [[(5, 12), (30, 40), (50, 5)], [(3, 9)], [(0, 9), (40, 0)]], deal)
    sizes, channels = (result.records[:6, k].tolist() for k in (2, 0))
    assert sizes == [8, 11, 16, 7, 10, 11] and channels == [0, 0, 0, 1, 2, 2]
    np.testing.assert_array_equal(result.points[0][np.arange(50, 65) % 60], np.tile(lines[0][50], (15, 1)))
