"""Chute cutoffs: bends across whose bars a flood cuts a chute, which becomes the channel."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
from warpriver.kernels.channels import Work
from warpriver.kernels.cuts import Cuts
from warpriver.kernels.status import BEGUN, HALT, NUMBER, STEPS
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernel for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.chutes_{scalar.__name__}"
    line = polyline.build(scalar)
    vec2, Channels, Points, Run = line.vec2, line.Channels, line.Points, line.Run
    ZERO, HALF = scalar(0.0), scalar(0.5)
    ONE_64, ALL_BITS = wp.float64(1.0), wp.float64(2.0**-32)

    @wp.struct
    class Chutes:
        """Which bends may be cut: hazard (1/yr), least length over chord, longest chord and shortest arc (widths)."""

        rate: wp.float64
        winding: scalar
        longest: scalar
        min_arc: scalar
        seed: int

    @wp.func(module=name)
    def turn_at(points: Points, run: Run, i: int, apart: int) -> scalar:
        """Cross product of the ways from a point a width upstream to it, and on to one a width downstream; left > 0."""
        a = points.xy[i] - points.xy[wp.max(i - apart, run.first)]
        b = points.xy[wp.min(i + apart, run.last)] - points.xy[i]
        return a[0] * b[1] - a[1] * b[0]

    @wp.func(module=name)
    def end_of_bend(points: Points, run: Run, chutes: Chutes, i: int) -> int:
        """Last point of the bend that begins at point i, if it may be cut, else -1.

        A bend goes from one change of the turn, as felt over two widths, to the next one. It may be cut where it winds
        enough, its chord is short enough, and it is longer than a neck's least arc.
        """
        width = line.section_at(points, i, run)[0]
        apart = int(width / run.spacing + HALF)
        apart = wp.max(apart, 1)
        if i < run.first + apart or i >= run.last - apart:
            return -1
        turn = turn_at(points, run, i, apart)
        if turn * turn_at(points, run, i - 1, apart) > ZERO or turn == ZERO:
            return -1
        j = int(i + 1)
        while j < run.last - apart and turn_at(points, run, j, apart) * turn > ZERO:
            j += 1
        if j >= run.last - apart:
            return -1
        arc = scalar(j - i) * run.spacing
        chord = wp.length(points.xy[j] - points.xy[i])
        if chord > chutes.longest * width or arc < chutes.winding * chord or arc <= chutes.min_arc * width:
            return -1
        return j

    @wp.kernel(module=name, enable_backward=False)
    def find_chutes(
        # network
        channels: Channels,
        moved: Points,
        # params
        chutes: Chutes,
        work: Work,
        # in
        channel_identity: wp.array[int],
        substep: wp.array[int],
        # out
        cuts_io: Cuts,
        chunk_mark_io: wp.array[wp.vec2i],
    ):
        """Let bends be cut by chance, 1 - e^(-rate dt) each, as necks from their first to their last point.

        Long bends across whose bars floods flow are cut so, not at a neck [Grenfell2014]. Chances are drawn by (seed,
        step, sub-step, identity of the channel, place in it). Points that have a neck keep it; rings have no chutes.
        """
        k = work.first + wp.tid()
        if work.status[HALT] != 0:
            return
        step = work.status[BEGUN] + work.status[STEPS]
        stream = wp.rand_init(int(wp.rand_init(chutes.seed, step)), substep[NUMBER])
        run = line.begin_runs(channels, work, k)
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO and run.closed == 0:
                own = wp.rand_init(int(stream), channel_identity[run.channel])
                chance = ONE_64 - wp.exp(-chutes.rate * wp.float64(run.step))
                for i in range(run.begin, run.stop):
                    random = wp.rand_init(int(own), i - run.first)
                    if cuts_io.point_neck[i] < 0 and wp.float64(wp.randu(random)) * ALL_BITS < chance:
                        end = end_of_bend(moved, run, chutes, i)
                        if end >= 0:
                            cuts_io.point_neck[i] = end
                            if work.chunk == 0:
                                cuts_io.channel_necks[run.channel] += 1
                            else:
                                mark = chunk_mark_io[k]
                                chunk_mark_io[k] = wp.vec2i(1, wp.max(mark[1], end))

    return SimpleNamespace(
        vec2=vec2, Channels=Channels, Points=Points, Chutes=Chutes, find_chutes=find_chutes, end_of_bend=end_of_bend
    )
