"""Channels as kernels take them, and how their points are dealt out to the threads of a launch."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.status import HALT
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# A channel of few points may be sampled by so much more coarsely than its target spacing.
COARSEST_SPACING = 1.25
# Minimum number of points of a ring, when it is made and when a loop is cut off it.
RING_POINTS = 8
# Edge of the map at the foot of a channel: none, one that runs north and south, one that runs west and east.
EDGE_NONE, EDGE_NORTH_SOUTH, EDGE_WEST_EAST = 0, 1, 2


@wp.struct
class Work:
    """How the points of a network are dealt out to the threads of a launch.

    A thread takes a *slab*, the whole channels slab_channel[k] .. slab_channel[k + 1] - 1, or, where ``chunk`` is not
    0, that many consecutive points. ``first`` is the slab or chunk of the launch's first thread. Where ``status`` says
    halt, there is nothing to do.
    """

    status: wp.array[int]
    slab_channel: wp.array[int]
    chunk: int
    first: int


@wp.struct
class Stems:
    """Which channels follow each other as the links of one river, by channel; missing where none do.

    ``upper`` and ``lower`` are the links next to a channel, -1 where there is none; ``top`` and ``bottom`` the first
    and the last one of its stem. ``length`` is that of a stem, at its top (see ``measure_stems``). ``held`` is 1 where
    the foot of a channel is a locked point, which does not move; it is missing where there is none.
    """

    upper: wp.array[int]
    lower: wp.array[int]
    top: wp.array[int]
    bottom: wp.array[int]
    length: wp.array[wp.int64]
    held: wp.array[int]


@once
def build(scalar):
    """Make the structs and functions of channels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.channels_{scalar.__name__}"
    vec2 = wp.types.vector(2, scalar)

    @wp.struct
    class Form:
        """Size of a channel between edits, m: mean width and depth, greatest width, target spacing of its points."""

        width: scalar
        depth: scalar
        widest: scalar
        target_spacing: scalar

    @wp.struct
    class Channels:
        """The channels of a network, whose points lie end to end.

        ``start`` has their offsets and the number of points. ``spacing`` is that of the points in m, ``step`` the time
        step in yr, 0 for a channel that is inactive. ``closed`` is 1 for a ring, and ``area`` what it encloses (see
        ``measure_rings``); both are missing where a network has no rings. ``edge`` tells of the edge of the map along
        which the foot of a channel slides, and is missing where none does. ``fed`` is 1 for a channel whose head feels
        bends beyond it, and ``inlet`` what it feels of them, 1/m; both are missing where none does.
        """

        start: wp.array[int]
        form: wp.array[Form]
        spacing: wp.array[scalar]
        step: wp.array[scalar]
        closed: wp.array[int]
        area: wp.array[wp.int64]
        edge: wp.array[int]
        fed: wp.array[int]
        inlet: wp.array[scalar]
        stems: Stems

    @wp.struct
    class Points:
        """Points of channels, m, with width and depth where these vary along channels; else ``section`` is missing."""

        xy: wp.array[vec2]
        section: wp.array[vec2]

    @wp.struct
    class Run:
        """Points begin .. stop - 1 of one channel, which a thread takes together, and what the channel is.

        The channel has the points first .. last. ``upper`` and ``lower`` are the links that go on from it upstream and
        downstream, -1 for none, ``head`` and ``foot`` their points at the junctions, which lie where its own ends do,
        ``head_first`` and ``foot_last`` the ones at their other ends. ``end`` is where the last run of the thread
        ends.
        """

        channel: int
        first: int
        last: int
        closed: int
        edge: int
        upper: int
        lower: int
        head: int
        foot: int
        head_first: int
        foot_last: int
        form: Form
        spacing: scalar
        step: scalar
        begin: int
        stop: int
        end: int

    @wp.func(module=name)
    def channel_at(channel_start: wp.array[int], point: int) -> int:
        """Channel that owns a point: the last one that starts at or before it."""
        low = int(0)
        high = channel_start.shape[0] - 1
        while high - low > 1:
            middle = (low + high) // 2
            if channel_start[middle] <= point:
                low = middle
            else:
                high = middle
        return low

    @wp.func(module=name)
    def begin_runs(channels: Channels, work: Work, k: int) -> Run:
        """The empty run before the first one of a slab or chunk: ``while run.stop < run.end``, take the next one."""
        run = Run()
        run.stop = 0
        run.end = 0
        if work.status[HALT] == 0:
            if work.chunk == 0:
                run.channel = work.slab_channel[k] - 1
                run.stop = channels.start[run.channel + 1]
                run.end = channels.start[work.slab_channel[k + 1]]
            else:
                count = channels.start.shape[0] - 1
                run.stop = k * work.chunk
                run.end = wp.min(run.stop + work.chunk, channels.start[count])
                if run.stop < run.end:
                    run.channel = channel_at(channels.start, run.stop) - 1
        return run

    @wp.func(module=name)
    def whole_run(channels: Channels, channel: int) -> Run:
        """All points of a channel."""
        run = Run()
        run.channel = channel
        run.first = channels.start[channel]
        run.last = channels.start[channel + 1] - 1
        run.closed = 0
        if channels.closed:
            run.closed = channels.closed[channel]
        run.edge = EDGE_NONE
        if channels.edge:
            run.edge = channels.edge[channel]
        run.upper = -1
        run.lower = -1
        run.head = -1
        run.foot = -1
        if channels.stems.upper:
            run.upper = channels.stems.upper[channel]
            run.lower = channels.stems.lower[channel]
            if run.upper >= 0:
                run.head = channels.start[run.upper + 1] - 1
                run.head_first = channels.start[run.upper]
            if run.lower >= 0:
                run.foot = channels.start[run.lower]
                run.foot_last = channels.start[run.lower + 1] - 1
        run.form = channels.form[channel]
        run.spacing = channels.spacing[channel]
        run.step = channels.step[channel]
        run.begin = run.first
        run.stop = run.last + 1
        run.end = run.stop
        return run

    @wp.func(module=name)
    def foot_held(channels: Channels, channel: int) -> bool:
        """Tell whether the foot of a channel is a locked point; -1 stands for no channel."""
        if channels.stems.held:
            return channel >= 0 and channels.stems.held[wp.max(channel, 0)] != 0
        return False

    @wp.func(module=name)
    def is_fed(channels: Channels, channel: int) -> bool:
        """Tell whether the head of a channel feels bends beyond it."""
        if channels.fed:
            return channels.fed[channel] != 0
        return False

    @wp.func(module=name)
    def next_run(channels: Channels, run: Run) -> Run:
        """The run after another one: of the next channel."""
        after = whole_run(channels, run.channel + 1)
        after.begin = run.stop
        after.stop = wp.min(run.end, after.stop)
        after.end = run.end
        return after

    @wp.func(module=name)
    def channel_range(work: Work, k: int) -> wp.vec2i:
        """Channels (first, stop) of a thread that works on whole channels: those of its slab, or one."""
        if work.status[HALT] != 0:
            return wp.vec2i(0, 0)
        if work.chunk == 0:
            return wp.vec2i(work.slab_channel[k], work.slab_channel[k + 1])
        return wp.vec2i(k, k + 1)

    @wp.func(module=name)
    def section_at(points: Points, i: int, run: Run) -> vec2:
        """Width and depth at a point: its own where they vary along the channel, else the channel's."""
        if points.section:
            return points.section[i]
        return vec2(run.form.width, run.form.depth)

    @wp.func(module=name)
    def round_index(i: int, run: Run) -> int:
        """Point of a ring that an index beyond either end comes round to."""
        count = run.last - run.first + 1
        away = (i - run.first) % count
        if away < 0:
            away += count
        return run.first + away

    return SimpleNamespace(
        vec2=vec2,
        Form=Form,
        Channels=Channels,
        Points=Points,
        Run=Run,
        channel_at=channel_at,
        begin_runs=begin_runs,
        next_run=next_run,
        whole_run=whole_run,
        foot_held=foot_held,
        is_fed=is_fed,
        channel_range=channel_range,
        section_at=section_at,
        round_index=round_index,
    )
