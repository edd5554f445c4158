"""Channels on a device, and the kernels of a cutoff launched on them, one by one; lists of channels in and out."""

import dataclasses

import numpy as np
import reference
import reference_rings
import warp as wp
from kernel_arrays import (
    SCALARS,
    UNWRITTEN,
    by_fours,
    forms,
    list_of_marks,
    ring_flags,
    running_marks,
    share_count,
    share_of_points,
    share_out,
    split,
    starts_of,
    status_of,
    to_device,
    unwritten,
)

from warpriver.kernels import cutoffs
from warpriver.kernels.status import CUT_POINTS, CUT_POINTS_NEEDED, CUTS, CUTS_NEEDED, DONE, FAULT

SPACING = 10.0
FAULT_OXBOWS_FULL = 2
# What the memory of a cut holds where there is no neck: a link of the grid's lists.
STALE = 3


def wandering_line(rng, count, curl=0.9, start=(0.0, 0.0)):
    """A line whose heading wanders: it comes close to itself often, crosses itself, and lies on both sides of zero."""
    heading = np.cumsum(rng.normal(0.0, curl, count - 1))
    steps = SPACING * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.concatenate([[start], np.asarray(start) + np.cumsum(steps, axis=0)])


def tangled_neck(rng, n):
    """Later end of the neck at each of n points, -1 if none: knots of all kinds side by side and over each other."""
    neck = np.full(n, -1)
    at = 0
    while at < n - 3:
        size = int(rng.integers(3, max(4, n // 3)))
        stop = min(n, at + size)
        kind = rng.choice(["hairpin", "row", "chain", "fan", "pair", "nothing"])
        i = np.arange(at, stop)
        if kind == "hairpin":  # each within the one before
            inner = i[: len(i) // 2]
            neck[inner] = at + stop - 1 - inner
        elif kind == "row":  # each over the next
            neck[i[:-2]] = np.minimum(i[:-2] + int(rng.integers(2, 9)), stop - 1)
        elif kind == "chain":  # from end to end
            ends = i[:: int(rng.integers(2, 6))]
            neck[ends[:-1]] = ends[1:]
        elif kind == "fan":  # all to one point
            neck[i[:-2]] = stop - 1
        elif kind == "pair":
            neck[at] = stop - 1
        # The next knot begins where this one ends, or inside of it.
        at = stop - 1 if rng.random() < 0.7 else int(rng.integers(at + 1, stop))
    if rng.random() < 0.3:  # one very long neck over all of them, or over most
        first = int(rng.integers(0, max(1, n // 4)))
        neck[first] = n - 1 - int(rng.integers(0, max(1, n // 4)))
        neck[first] = max(neck[first], first + 2)
    return neck


@dataclasses.dataclass
class Cut:
    """What is left of channels and of the loops cut off them; ``points`` by channel."""

    points: list
    records: np.ndarray
    loops: np.ndarray
    loop_sections: np.ndarray | None
    fault: int


class Case:
    """Some channels on a device, and the kernels of a cutoff, one method each.

    A cut is a pair (i, j) of points of a channel; on a ring j may lie before i, where a loop goes round, and
    (i, j, True) cuts off what lies outside of i .. j.
    """

    def __init__(
        self,
        lines,
        *,
        width=12.0,
        sections=None,
        cutoff=1.0,
        min_arc=3.0,
        resting=(),
        rings=(),
        longer=0,
        halt=0,
        dtype="float64",
        device="cpu",
        spare=5,
    ):
        self.resting, self.rings, self.longer, self.halt = resting, rings, longer, halt
        self.closed = ring_flags(rings, len(lines), device)
        self.scalar = SCALARS[dtype]
        self.kernel, self.device, self.lines = cutoffs.build(self.scalar), device, lines
        self.cutoff, self.min_arc, self.start = cutoff, min_arc, starts_of(lines)
        self.count, self.capacity = int(self.start[-1]), int(self.start[-1]) + spare
        packed = np.full((self.capacity, 2), np.nan)
        packed[: self.count] = np.concatenate(lines)
        self.packed = packed
        self.width = np.broadcast_to(np.float64(width), len(lines))
        self.sections, self.section = sections, None
        if sections is not None:
            self.width = np.array([s[:, 0].max() for s in sections])
            filled = np.concatenate([*sections, np.full((spare, 2), np.nan)])
            self.section = to_device(filled, self.kernel.vec2, device)
        self.channel_start = to_device(self.start, wp.int32, device)
        # Only the greatest width is for the cutoffs; the mean of a varying one would be wrong here.
        self.form = forms(np.nan, np.nan, self.width, np.nan, self.scalar, device)
        self.channel_spacing = to_device(np.full(len(lines), SPACING), self.scalar, device)
        step = np.full(len(lines), 0.3)
        step[list(resting)] = 0.0
        self.channel_step = to_device(step, self.scalar, device)

    # ---- launching

    def launch(self, kernel, deal, inputs, outputs):
        """Launch a kernel over the points; ``...`` stands for the work among the inputs."""
        for part in share_out(deal, len(self.lines), self.capacity, self.device, self.halt):
            given = [part.work if value is ... else value for value in inputs]
            wp.launch(kernel, dim=part.threads, inputs=given, outputs=outputs, device=self.device)

    def shares(self, deal):
        return share_count(deal, len(self.lines), self.capacity)

    def chunks(self, deal):
        """Number of chunks; slabs have none, and arrays of one element for them."""
        return self.shares(deal) if isinstance(deal, int) else 1

    def neck_marks(self, point_neck, deal):
        """Which chunks hold necks, and the last point that one of them reaches, (chunks, 2)."""
        marks = np.zeros((self.chunks(deal), 2), int)
        if isinstance(deal, int):
            i = np.flatnonzero(point_neck[: self.count] >= 0)
            marks[i // deal, 0] = 1
            np.maximum.at(marks[:, 1], i // deal, point_neck[i])
        return marks

    def marks(self, point_neck, deal):
        """Running sum of the marks and the list of marked chunks, on the device; slabs look at neither."""
        if not isinstance(deal, int):
            return unwritten(1, wp.vec2i, self.device), list_of_marks(None, self.device)
        marks = self.neck_marks(point_neck, deal)
        return running_marks(marks, self.device), list_of_marks(marks[:, 0], self.device)

    # ---- finding

    def linked(self, deal=64):
        """Grid of the points: (next, head) on the device; with chunks a bucket has two fields."""
        points = to_device(self.packed, self.kernel.vec2, self.device)
        after = unwritten(self.capacity, wp.int32, self.device)
        head = wp.zeros((8 if isinstance(deal, int) else 4) * self.capacity, dtype=wp.int32, device=self.device)
        if not isinstance(deal, int):
            # A slab empties the table of its own channels.
            head.fill_(UNWRITTEN)
        inputs = [self.channel_start, self.form, self.channel_step, self.cutoff, ..., points]
        self.launch(self.kernel.insert_points, deal, inputs, [after, by_fours(head), head])
        return after, head

    def find(self, deal):
        """What the search for necks writes, on the host: necks, marks and cuts of the shares, necks of the channels."""
        after, head = self.linked(deal)
        points = to_device(self.packed, self.kernel.vec2, self.device)
        out = [
            unwritten(self.capacity, wp.int32, self.device),
            unwritten(self.chunks(deal), wp.vec2i, self.device),
            unwritten(self.shares(deal), wp.vec2i, self.device),
            unwritten(len(self.lines), wp.int32, self.device),
        ]
        inputs = [self.channel_start, self.form, self.channel_spacing, self.channel_step, self.closed, self.cutoff]
        inputs += [self.min_arc, ..., points, self.section, after, head]
        search = self.kernel.find_necks_in_chunks if isinstance(deal, int) else self.kernel.find_necks
        self.launch(search, deal, inputs, out)
        return [array.numpy() for array in out]

    def necks(self, deal=64):
        """First later neighbour of each point by channel, numbered within the channel; checks marks and counts.

        In slabs the necks of a channel at rest are not written; they count as none here.
        """
        found, marks, cuts, channel_necks = self.find(deal)
        assert (found[self.count :] == UNWRITTEN).all() and (cuts == 0).all()
        for c in self.resting:
            first, stop = self.start[c : c + 2]
            left = -1 if isinstance(deal, int) else UNWRITTEN
            assert (found[first:stop] == left).all(), "a channel at rest was searched"
            found[first:stop] = -1
        assert (found[: self.count] >= -1).all()
        by_channel = split(found, self.start)
        if isinstance(deal, int):
            assert marks.tolist() == self.neck_marks(found, deal).tolist()
            assert (channel_necks == UNWRITTEN).all()
        else:
            assert (marks == UNWRITTEN).all()
            assert channel_necks.tolist() == [int((n >= 0).sum()) for n in by_channel]
        return [np.where(n >= 0, n - a, -1) for n, a in zip(by_channel, self.start[:-1], strict=True)]

    def twin_necks(self):
        """The same by comparing all pairs."""
        necks = []
        for c, xy in enumerate(self.lines):
            width = np.full(len(xy), self.width[c]) if self.sections is None else self.sections[c][:, 0]
            mean = 0.5 * (width[:, None] + width)
            find = reference_rings.find_necks if c in self.rings else reference.find_necks
            necks.append(find(xy, SPACING, self.cutoff * mean, self.min_arc * mean))
        return necks

    # ---- selecting

    def packed_necks(self, necks, deal):
        """Necks that are numbered within their channels, in the packed array: (capacity,) on the host."""
        point_neck = np.full(self.capacity, UNWRITTEN)
        for c, (first, neck) in enumerate(zip(self.start[:-1], necks, strict=True)):
            own = np.where(neck >= 0, neck + first, -1)
            if c in self.resting:
                # Slabs leave what an earlier step has found; chunks clear it.
                own = np.full(len(neck), -1 if isinstance(deal, int) else self.start[c + 1] - 1)
            point_neck[first : first + len(neck)] = own
        return point_neck

    def channel_necks(self, necks, deal):
        """Number of necks of each channel, on the device; chunks do not look at it."""
        counts = [0 if c in self.resting else (neck >= 0).sum() for c, neck in enumerate(necks)]
        if isinstance(deal, int):
            counts = np.full(len(necks), UNWRITTEN)
        return to_device(counts, wp.int32, self.device)

    def kept(self, point_cut, point_neck):
        """Cuts by channel, from the array that tells where the loop ends at every point with a neck."""
        kept = []
        for c, (first, stop) in enumerate(zip(self.start[:-1], self.start[1:], strict=True)):
            own = []
            for i in np.flatnonzero(point_neck[first:stop] >= 0) if c not in self.resting else ():
                j = int(point_cut[first + i])
                if j < -1:
                    own.append((int(i), -2 - j - int(first), True))
                elif j >= 0:
                    own.append((int(i), j - int(first)))
            kept.append(own)
        return kept

    def loop_sizes(self, kept):
        """Number of points of each loop, ends included, by channel."""
        sizes = []
        for xy, cuts in zip(self.lines, kept, strict=True):
            own = [(i, j) if len(outer) == 0 else (j, i) for i, j, *outer in cuts]
            # On a ring a loop may go round to an earlier point.
            sizes.append([(foot - head) % len(xy) + 1 for head, foot in own])
        return sizes

    def by_share(self, kept, deal):
        """Number of cuts that begin in each slab or chunk, and their points, (shares, 2)."""
        share, counts = share_of_points(deal, self.start), np.zeros((self.shares(deal), 2), int)
        for first, cuts, sizes in zip(self.start[:-1], kept, self.loop_sizes(kept), strict=True):
            for (i, *_), size in zip(cuts, sizes, strict=True):
                counts[share[first + i]] += [1, size]
        return counts

    def selected(self, necks, deal=64):
        """Cuts kept of the necks given, by channel; checks what is written, and the counts by share."""
        point_neck = self.packed_necks(necks, deal)
        cuts = unwritten(self.capacity, wp.int32, self.device)
        counts = wp.zeros(self.shares(deal), dtype=wp.vec2i, device=self.device)
        inputs = [self.channel_start, self.closed, self.longer, ..., self.channel_necks(necks, deal)]
        inputs += [*self.marks(point_neck, deal), to_device(point_neck, wp.int32, self.device)]
        self.launch(self.kernel.select_cuts, deal, inputs, [cuts, counts])
        point_cut = cuts.numpy()
        necked = np.zeros(self.capacity, bool)
        for c, (first, neck) in enumerate(zip(self.start[:-1], necks, strict=True)):
            necked[first : first + len(neck)] = (neck >= 0) & (c not in self.resting)
        assert (point_cut[~necked] == UNWRITTEN).all() and (point_cut[necked] != UNWRITTEN).all()
        kept = self.kept(point_cut, point_neck)
        assert counts.numpy().tolist() == self.by_share(kept, deal).tolist()
        return kept

    # ---- cutting

    def cut(self, kept, deal=64, cut_capacity=None, oxbow_capacity=None, done=0, before=(0, 0), necks=None):
        """Make those cuts; checks where each begins and ends, and what the status tells.

        ``done`` sub-steps left ``before`` cuts and loop points in the buffers. ``necks``: those of which ``kept`` were
        chosen; by default these.
        """
        if necks is None:
            necks = [np.full(len(xy), -1) for xy in self.lines]
            for neck, cuts in zip(necks, kept, strict=True):
                for i, *_ in cuts:
                    neck[i] = i + 1
        point_neck = self.packed_necks(necks, deal)
        point_cut = np.where(point_neck == -1, STALE, -1)
        for c in self.resting:
            point_cut[self.start[c] : self.start[c + 1]] = STALE
        for first, cuts in zip(self.start[:-1], kept, strict=True):
            for i, j, *outer in cuts:
                point_cut[first + i] = -2 - first - j if outer else first + j
        counts = self.by_share(kept, deal)
        total = counts.sum(axis=0)
        cut_capacity = before[0] + total[0] + 3 if cut_capacity is None else cut_capacity
        oxbow_capacity = before[1] + total[1] + 3 if oxbow_capacity is None else oxbow_capacity
        records, spans = (unwritten(int(cut_capacity), kind, self.device) for kind in (wp.vec4i, wp.vec2i))
        loops = unwritten(int(oxbow_capacity), self.kernel.vec2, self.device)
        loop_sections = None
        if self.section is not None:
            loop_sections = unwritten(int(oxbow_capacity), self.kernel.vec2, self.device)
        points = to_device(self.packed, self.kernel.vec2, self.device)
        state = {DONE: done, CUTS: before[0], CUT_POINTS: before[1], CUTS_NEEDED: -1, CUT_POINTS_NEEDED: -1}
        status = status_of(state, self.device)
        shares = [to_device(v, wp.vec2i, self.device) for v in (counts, np.cumsum(counts, axis=0))]
        given = [to_device(v, wp.int32, self.device) for v in (point_neck, point_cut)]
        inputs = [self.channel_start, ..., self.channel_necks(necks, deal), *shares, *given, self.section]
        outputs = [records, spans, loops, loop_sections, points, status]
        self.launch(self.kernel.record_cuts, deal, inputs, outputs)
        inputs = [self.channel_start, ..., *shares, records, spans, self.section, status]
        self.launch(self.kernel.save_loops, deal, inputs, [loops, loop_sections, points])
        after, found = points.numpy(), status.numpy()
        assert np.isnan(after[self.count :]).all()
        needed = [-1, -1] if self.halt else total.tolist()
        assert found[[CUTS_NEEDED, CUT_POINTS_NEEDED]].tolist() == needed, "told, whether there is room or not"
        assert found[[DONE, CUTS, CUT_POINTS]].tolist() == [done, *before]
        if found[FAULT] == 0 and not self.halt:
            self.assert_spans(spans.numpy(), kept, before[0])
        else:
            assert (spans.numpy() == UNWRITTEN).all()
        loop_sections = None if loop_sections is None else loop_sections.numpy()
        return Cut(split(after, self.start), records.numpy(), loops.numpy(), loop_sections, int(found[FAULT]))

    def assert_spans(self, spans, kept, slot):
        """First and last point of each loop; a loop that goes round has but the point where it is noted."""
        assert (spans[:slot] == UNWRITTEN).all()
        for first, cuts in zip(self.start[:-1], kept, strict=True):
            for i, j, *outer in cuts:
                round_it = bool(outer) or j < i
                assert spans[slot].tolist() == [first + i, first + (i if round_it else j)]
                slot += 1
        assert (spans[slot:] == UNWRITTEN).all()

    def twin_cut(self, c, kept, values=None):
        """Points left of a channel, and its loops, by cutting one by one; or ``values`` in place of the points."""
        values = self.lines[c] if values is None else values
        if c not in self.rings:
            return reference.cut_necks(values, kept)
        # A loop that goes round from i to j is what lies outside of j .. i.
        outside = [(i, j, bool(outer)) if outer or i < j else (j, i, True) for i, j, *outer in kept]
        return reference_rings.cut_necks(values, outside)


def assert_same_necks(actual, expected):
    for channel, (a, e) in enumerate(zip(actual, expected, strict=True)):
        assert a.tolist() == e.tolist(), f"channel {channel}"


def assert_cuts(case, kept, deal, necks=None):
    """Records, loops, sections and the copies left behind are those of cutting one by one, in order."""
    result = case.cut(kept, deal, necks=necks)
    assert result.fault == 0
    slot = offset = 0
    for c, cuts in enumerate(kept):
        expected, loops = case.twin_cut(c, cuts)
        np.testing.assert_array_equal(result.points[c], expected)
        carried = loops if case.sections is None else case.twin_cut(c, cuts, case.sections[c])[1]
        for loop, section in zip(loops, carried, strict=True):
            assert result.records[slot].tolist() == [c, offset, len(loop), 0]
            np.testing.assert_array_equal(result.loops[offset : offset + len(loop)], loop)
            if case.sections is not None:
                np.testing.assert_array_equal(result.loop_sections[offset : offset + len(loop)], section)
            slot, offset = slot + 1, offset + len(loop)
    assert (result.records[slot:] == UNWRITTEN).all() and np.isnan(result.loops[offset:]).all()
    return result
