import itertools
import math

import numpy as np
import pytest
import warp as wp
from kernel_arrays import (
    DEALS,
    SCALARS,
    SLABS,
    UNWRITTEN,
    channels_of,
    forms,
    points_of,
    ring_flags,
    share_count,
    share_out,
    starts_of,
    status_of,
    stems_of,
    struct_of,
    to_device,
    unwritten,
    vec2_of,
)

from warpriver.kernels import collisions
from warpriver.kernels.channels import COARSEST_SPACING
from warpriver.kernels.status import CONTACTS, HALT

SPACING, WIDTH, REACH, NECK_ARC = 10.0, 12.0, 10.0, 5.0


def random_lines(rng, count):
    """Smooth random walks that cross one another."""
    lines = []
    for _ in range(count):
        n = int(rng.integers(3, 70))
        heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(rng.normal(0.0, 0.25, n))
        xy = rng.uniform(-150.0, 150.0, 2) + SPACING * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], 1), 0)
        lines.append(xy)
    return lines


def touching_pairs(lines, width, nodes, stem=()):
    """All pairs (i, j) of points of different channels, i of the lower one, that touch away from shared nodes.

    Links of a stem that follow each other count as one channel across their junction.
    """
    pairs, start = set(), starts_of(lines)
    for c in range(len(lines)):
        for d in range(c + 1, len(lines)):
            away = np.hypot(*(lines[c][:, None] - lines[d][None]).transpose(2, 0, 1))
            for i, j in np.argwhere(away < 0.5 * (width[c] + width[d])):
                arcs = [(i, len(lines[c]) - 1 - i), (j, len(lines[d]) - 1 - j)]
                reach = REACH * max(width[c], width[d])
                if any({c, d} == set(pair) for pair in itertools.pairwise(stem)):
                    reach = NECK_ARC * max(width[c], width[d])
                near = any(
                    nodes[c][a] == nodes[d][b] and SPACING * (arcs[0][a] + arcs[1][b]) < reach
                    for a in (0, 1)
                    for b in (0, 1)
                )
                if not near:
                    pairs.add((int(start[c] + i), int(start[d] + j)))
    return pairs


class Levels:
    """What the search makes of channels: points of a block, and the level of the grid that each lies in."""

    def __init__(self, width, block):
        self.sizes = [max(1, int(block * w / SPACING)) for w in width]
        longest = COARSEST_SPACING * SPACING
        slack = collisions.SLACK_SPACINGS * longest
        reach = np.array([0.5 * (w + max(block * w, longest)) + slack for w in width])
        # Each level has cells twice as wide as the one before.
        self.reach = 2.0 ** math.floor(math.log2(reach.min()))
        self.levels = [max(0, math.ceil(math.log2(r / self.reach))) for r in reach]


class Search:
    """The kernels of the search, launched on some lines; ``resting`` are the channels whose step is 0."""

    def __init__(
        self,
        lines,
        width,
        nodes,
        deal,
        block,
        dtype,
        device,
        *,
        sections=None,
        resting=(),
        rings=(),
        stems=(),
        buckets=64,
        halt=0,
    ):
        scalar = SCALARS[dtype]
        kernel, start = collisions.build(scalar), starts_of(lines)
        count, channels = int(start[-1]), len(lines)
        grid = Levels(width, block)
        constants = struct_of(
            kernel.CollisionConstants, distance=1.0, node_reach=REACH, neck_arc=NECK_ARC, block=block, reach=grid.reach,
            level_count=max(grid.levels) + 1, level_mask=sum(1 << level for level in set(grid.levels)),
        )  # fmt: skip
        xy = to_device(np.concatenate(lines), vec2_of(scalar), device)
        section = None if sections is None else to_device(np.concatenate(sections), vec2_of(scalar), device)
        points = points_of(scalar, xy, section)
        spacing = to_device(np.full(channels, SPACING), scalar, device)
        links, owners = (unwritten(count, wp.int32, device) for _ in range(2))
        bucket = wp.zeros(4 * buckets, dtype=wp.int32, device=device)
        moves = np.full(channels, 0.3)
        moves[list(resting)] = 0.0
        step = to_device(moves, scalar, device)
        # The mean width is for lines without sections; with them only the greatest counts.
        form = forms(np.array(width) if sections is None else np.nan, 1.0, np.array(width), SPACING, scalar, device)
        table = channels_of(
            scalar, start=to_device(start, wp.int32, device), form=form, spacing=spacing, step=step,
            closed=ring_flags(rings, channels, device),
        )  # fmt: skip
        if stems:
            table.stems = stems_of(stems, channels, device)

        def launch(kernel, inputs, outputs):
            for part in share_out(deal, channels, count, device, halt):
                given = [part.work if value is ... else value for value in inputs]
                wp.launch(kernel, dim=part.threads, inputs=given, outputs=outputs, device=device)

        status = status_of({CONTACTS: UNWRITTEN}, device)
        inserted = [links, owners, bucket, status]
        launch(kernel.insert_blocks, [table, xy, constants, ...], inserted)
        assert status.numpy()[CONTACTS] == (UNWRITTEN if halt else 0), "they are counted anew"
        self.links, self.owners, self.bucket = links.numpy(), owners.numpy(), bucket.numpy().reshape(-1, 4)
        self.levels = grid.levels
        ends = to_device(np.array(nodes, np.int32), wp.vec2i, device)
        shares = share_count(deal, channels, count)
        found = unwritten(shares, wp.int32, device)
        index = collisions.BlockIndex()
        index.point_next, index.point_owner, index.bucket = links, owners, bucket
        inputs = [table, points, ends, constants, ..., index]
        # Where they are listed is not known, nor looked at, before they are counted.
        total = unwritten(shares, wp.int32, device)
        contacts = struct_of(collisions.Contacts, share_count=found, share_sum=total)
        launch(kernel.find_contacts, inputs, [contacts, status])
        self.by_share = found.numpy()
        if halt:
            assert (self.by_share == UNWRITTEN).all() and status.numpy()[CONTACTS] == UNWRITTEN
            return
        self.count = int(self.by_share.sum())
        if not isinstance(deal, int):
            assert status.numpy()[CONTACTS] == 0
            wp.launch(kernel.count_contacts, dim=1, inputs=[found], outputs=[status], device=device)
        assert status.numpy()[CONTACTS] == self.count
        total, out = to_device(np.cumsum(self.by_share), wp.int32, device), unwritten(self.count + 2, wp.vec2i, device)
        contacts.share_sum, contacts.pair = total, out
        launch(kernel.find_contacts, inputs, [contacts, status])
        assert (found.numpy() == self.by_share).all(), "what is listed is not counted again"
        assert status.numpy()[CONTACTS] == self.count
        assert (out.numpy()[self.count :] == UNWRITTEN).all()
        self.contacts = [tuple(pair) for pair in out.numpy()[: self.count].tolist()]


def expected_contacts(lines, pairs, width, block, resting=()):
    """First touching pair of each block, with partners of a higher level, or of its own and a higher number.

    Of two channels one must be active.
    """
    start, grid = starts_of(lines), Levels(width, block)
    first = {}
    for i, j in sorted(pairs | {(j, i) for i, j in pairs}):
        c, d = (int(np.searchsorted(start, k, side="right")) - 1 for k in (i, j))
        if (grid.levels[c], c) < (grid.levels[d], d) and not (c in resting and d in resting):
            first.setdefault((c, (i - int(start[c])) // grid.sizes[c]), (i, j))
    return [first[key] for key in sorted(first)]


def crossing_lines(seed):
    """Lines, a width for each, of which some are much wider, and nodes of which none is shared."""
    rng = np.random.default_rng(seed)
    lines = random_lines(rng, int(rng.integers(2, 9)))
    width = rng.uniform(5.0, 30.0, len(lines)) * rng.choice([1.0, 1.0, 4.0], len(lines))
    return lines, width.tolist(), [(2 * c, 2 * c + 1) for c in range(len(lines))]


# Lengths of blocks, in widths.
BLOCKS = [0.1, 1.5, 16.0]


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("deal", DEALS)
def test_contacts_are_those_of_all_pairs(deal, block, device):
    """Each block lists its first touching point, with the first partner of that point."""
    levels, count = set(), 0
    for seed in range(12):
        lines, width, nodes = crossing_lines(seed)
        pairs = touching_pairs(lines, width, nodes)
        expected = expected_contacts(lines, pairs, width, block)
        found = Search(lines, width, nodes, deal, block, "float64", device, buckets=1 << 16)
        assert found.contacts == expected
        levels |= set(Levels(width, block).levels)
        count += len(expected)
    assert count > 30 and len(levels) > 1


@pytest.mark.parametrize("deal", [1, 64, "one slab", "a slab each"])
def test_across_a_junction_links_of_a_stem_touch_as_one_channel_does(deal, device):
    """Nearer to it than a tributary may; a third channel that ends there keeps its distance."""
    found = {}
    for stem in ((), (0, 1)):
        pairs = 0
        for seed in range(20):
            rng = np.random.default_rng(seed)
            # A tight loop through the junction, and a brook into it.
            turn = np.cumsum(np.where(np.abs(np.arange(60) - 30) < 6, 0.62, 0.0) + rng.normal(0.0, 0.02, 60))
            loop = SPACING * np.cumsum(np.stack([np.cos(turn), np.sin(turn)], axis=1), axis=0)
            brook = loop[30] + SPACING * np.arange(20, -1, -1)[:, None] * [np.cos(turn[30]), np.sin(turn[30])]
            lines, nodes = [loop[:31], loop[30:], brook], [(0, 1), (1, 2), (3, 1)]
            expected = expected_contacts(lines, touching_pairs(lines, [WIDTH] * 3, nodes, stem), [WIDTH] * 3, 1.5)
            stems = [list(stem)] if stem else []
            search = Search(lines, [WIDTH] * 3, nodes, deal, 1.5, "float64", device, buckets=1 << 12, stems=stems)
            assert search.contacts == expected
            pairs += len(expected)
        found[stem] = pairs
    assert found[0, 1] > found[()], "and it does"


@pytest.mark.parametrize("deal", DEALS)
def test_of_two_that_touch_one_must_not_be_at_rest(deal, device):
    count = 0
    for seed in range(24):
        lines, width, nodes = crossing_lines(seed)
        pairs = touching_pairs(lines, width, nodes)
        resting = np.flatnonzero(np.random.default_rng(100 + seed).random(len(lines)) < 0.5).tolist()
        found = Search(lines, width, nodes, deal, 1.5, "float64", device, resting=resting, buckets=1 << 16)
        assert found.contacts == expected_contacts(lines, pairs, width, 1.5, resting)
        start = starts_of(lines)
        count += sum(int(np.searchsorted(start, i, side="right")) - 1 in resting for i, _ in found.contacts)
        everyone = Search(lines, width, nodes, deal, 1.5, "float64", device, resting=range(len(lines)))
        assert everyone.contacts == []
    assert count > 10, "one that is inactive finds one that moves"


@pytest.mark.parametrize("deal", [1, 64, *SLABS[:2]])
def test_a_halted_step_searches_nothing(deal, device):
    """And counts nothing anew: the host has not seen the contacts before yet."""
    lines, width, nodes = crossing_lines(3)
    found = Search(lines, width, nodes, deal, 1.5, "float64", device, halt=1)
    assert (found.bucket == 0).all() and (found.links == UNWRITTEN).all()
    count = collisions.build(wp.float64).count_contacts
    for halt, contacts in ((1, 5), (0, 9)):
        status = status_of({HALT: halt, CONTACTS: 5}, device)
        counts = to_device([2, 0, 7], wp.int32, device)
        wp.launch(count, dim=1, inputs=[counts], outputs=[status], device=device)
        assert status.numpy()[CONTACTS] == contacts


def test_the_table_holds_every_block_once_and_the_range_of_its_channels(device, dtype):
    """In every way to deal the points out; in order where one thread fills it."""
    for seed in range(6):
        lines, width, nodes = crossing_lines(seed)
        start, sizes = starts_of(lines), Levels(width, 1.5).sizes
        resting = [c for c in range(len(lines)) if c % 2]
        spans = zip(start[:-1].tolist(), start[1:].tolist(), sizes, strict=True)
        first = [j for a, b, size in spans for j in range(a, b, size)]
        owner = {j: int(np.searchsorted(start, j, side="right")) - 1 for j in first}
        for deal in DEALS:
            found = Search(lines, width, nodes, deal, 1.5, dtype, device, resting=resting, buckets=64)
            held = []
            for head, high, low, moves in found.bucket.tolist():
                members, j = [], head - 1
                while j >= 0:
                    members.append(j)
                    j = int(found.links[j]) - 1
                held += members
                assert (high > 0) == (low > 0) == bool(members)
                channels = [owner[j] for j in members]
                assert moves == any(c not in resting for c in channels)
                if members:
                    assert (high - 1, 2**31 - 1 - low) == (max(channels), min(channels))
                    assert found.owners[members].tolist() == [c * 32 + found.levels[c] for c in channels]
                if device == "cpu" and not str(deal).endswith(("apart", "backwards")):
                    assert members == sorted(members, reverse=True)
            assert sorted(held) == first
            others = np.setdiff1d(np.arange(start[-1]), first)
            assert (found.links[others] == UNWRITTEN).all() and (found.owners[others] == UNWRITTEN).all()


@pytest.mark.parametrize("deal", [7, 4096, *SLABS])
def test_contacts_do_not_depend_on_the_table_or_the_order_of_its_lists(deal, device, dtype):
    """A table of so few buckets that cells of all levels share them, and sections by point."""
    for seed in range(12):
        lines, width, nodes = crossing_lines(seed)
        sections = [np.full((len(xy), 2), w) for xy, w in zip(lines, width, strict=True)]
        plain = Search(lines, width, nodes, 64, 1.5, dtype, device, buckets=1 << 16).contacts
        for buckets in (1, 2, 64, 1024):
            crowded = Search(lines, width, nodes, deal, 1.5, dtype, device, sections=sections, buckets=buckets)
            assert crowded.contacts == plain


@pytest.mark.parametrize("ends", ["feet", "foot and head", "head and foot", "heads"])
def test_no_contact_near_an_end_that_two_channels_share(ends, device, dtype):
    """Of two lines that run side by side, whichever ends of theirs count as one node.

    They share a head where the upper one is so short that its two nodes count as one.
    """
    c, d = {"feet": (1, 1), "foot and head": (1, 0), "head and foot": (0, 1), "heads": (0, 0)}[ends]
    along = SPACING * np.arange(30.0)[:, None] * [1.0, 0.0]
    lines = [along, along + [0.0, 0.5 * WIDTH]]
    # The shared end lies in the west.
    lines = [xy[::-1] if end == 1 else xy for xy, end in zip(lines, (c, d), strict=True)]
    nodes = np.arange(4).reshape(2, 2)
    nodes[1, d] = nodes[0, c]
    width = [WIDTH, WIDTH]
    pairs = touching_pairs(lines, width, nodes.tolist())
    arcs = np.array(sorted(pairs)) - [0, 30]
    arcs = np.where([c, d], 29 - arcs, arcs)
    # Ten widths are twelve points: each pair, opposite or neighbours, is twelve or more away from the node.
    assert arcs.sum(axis=1).min() == 12
    found = Search(lines, width, nodes.tolist(), 64, 0.1, dtype, device)
    assert found.contacts == expected_contacts(lines, pairs, width, 0.1)
    assert 0 < found.count < 30


def test_points_near_a_shared_node_do_not_touch(device, dtype):
    """Two tributaries at 15 degrees and the channel below them: nothing within ten widths of their node counts."""
    angle = np.radians(7.5)
    away = SPACING * np.arange(40)[::-1, None]
    left, right = away * [-np.sin(angle), np.cos(angle)], away * [np.sin(angle), np.cos(angle)]
    below = SPACING * np.arange(40)[:, None] * [0.0, -1.0]
    nodes = [(0, 2), (1, 2), (2, 3)]
    lines, width = [left, right, below], [WIDTH] * 3
    assert Search(lines, width, nodes, 64, 2.0, dtype, device).contacts == []
    apart = [(0, 4), (1, 5), (2, 3)]
    assert Search(lines, width, apart, 64, 2.0, dtype, device).count > 0
