"""Inlets: the bends beyond the head of a river that enters the map, as the curvature that its head feels of them."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import channels, memory, polyline
from warpriver.kernels.status import BEGUN, HALT, NUMBER, STEPS, TOTAL
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# Waves that the curvature is made of, and the shortest and the longest of their periods, of the mean one.
WAVES, SHORTEST, LONGEST = 8, 0.6, 1.6


@once
def build(scalar):
    """Make the kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.inlets_{scalar.__name__}"
    line, past, curve = channels.build(scalar), memory.build(scalar), polyline.build(scalar)
    MigrationConstants, REACH = past.MigrationConstants, curve.REACH
    COUNT, RANGE = wp.float64(float(WAVES)), wp.float64(math.log(LONGEST / SHORTEST))
    SLOWEST = wp.float64(1.0 / LONGEST)
    TURN, SIZE = wp.float64(2.0 * math.pi), wp.float64(math.sqrt(2.0 / WAVES))

    @wp.struct
    class Inflow:
        """What enters at heads: ``curvature`` is its root mean square times the width; the time step is in yr."""

        curvature: wp.float64
        time_step: wp.float64
        seed: int

    @wp.func(module=name)
    def slow_noise(seed: int, identity: int, turns: wp.float64) -> wp.float64:
        """Sum of waves of random phases, of mean square 1, at a time in mean periods; each has its share of periods."""
        total = wp.float64(0.0)
        for k in range(WAVES):
            random = wp.rand_init(int(wp.rand_init(seed, identity)), k)
            place = (wp.float64(k) + wp.float64(wp.randf(random))) / COUNT
            phase = wp.float64(wp.randf(random))
            turned = SLOWEST * wp.exp(RANGE * place) * turns + phase
            total += wp.sin(TURN * (turned - wp.floor(turned)))
        return SIZE * total

    @wp.kernel(module=name, enable_backward=False)
    def feed_inlets(
        # network
        channels: line.Channels,
        # params
        inflow: Inflow,
        # in
        channel_identity: wp.array[int],
        channel_period: wp.array[wp.float64],
        substep: wp.array[int],
        status: wp.array[int],
        # out
        channel_inlet_out: wp.array[scalar],
    ):
        """Curvature that the head of a channel feels of the bends beyond it, 1/m, at the time of the sub-step.

        A sum of waves in time, as bends pass that a river brings with it: meanders grow downstream, and fade out below
        a head where nothing disturbs them [Weiss2022]. ``channel_period`` is the mean period in yr, 0 without inlet.
        """
        channel = wp.tid()
        if status[HALT] != 0 or channel_period[channel] == wp.float64(0.0):
            return
        part = wp.float64(substep[NUMBER]) / wp.float64(wp.max(1, substep[TOTAL]))
        time = (wp.float64(status[BEGUN] + status[STEPS]) + part) * inflow.time_step
        noise = slow_noise(inflow.seed, channel_identity[channel], time / channel_period[channel])
        channel_inlet_out[channel] = scalar(inflow.curvature * noise / wp.float64(channels.form[channel].width))

    @wp.func(module=name)
    def felt_at(points: line.Points, run: line.Run, constants: MigrationConstants, j: int) -> scalar:
        """Curvature at a point as the rate feels it, 1/m."""
        a = points.xy[j] - points.xy[j - 1]
        b = points.xy[j + 1] - points.xy[j]
        bend = curve.circle_curvature(a, b, wp.length(a), wp.length(b))
        return past.felt_curvature(bend, line.section_at(points, j, run)[0], constants)[0]

    @wp.kernel(module=name, enable_backward=False)
    def return_outflow(
        # network
        channels: line.Channels,
        points: line.Points,
        # params
        constants: MigrationConstants,
        # in
        status: wp.array[int],
        # out
        channel_inlet_out: wp.array[scalar],
    ):
        """Curvature that the head of a river feels beyond it, 1/m: what its foot feels, as if it came in again there.

        The mean by e^(-alpha z) of the felt curvature above the foot, from where the end is no longer felt on. Channels
        without inlet are left alone. A thread walks up its river as far as the memory reaches.
        """
        channel = wp.tid()
        if status[HALT] != 0 or channels.fed[channel] == 0:
            return
        bottom = int(channel)
        if channels.stems.bottom:
            bottom = channels.stems.bottom[channel]
        run = line.whole_run(channels, bottom)
        damped = int(wp.ceil(constants.end_damping * run.form.width / run.spacing))
        foot = wp.max(wp.min(run.last - damped, run.last - 1), run.first + 1)
        begin = int(foot)
        depth = scalar(0.0)
        while begin > run.first + 1 and depth < REACH:
            depth += past.segment_depth(points, run, constants, begin - 1, begin)
            begin -= 1
        upstream = scalar(0.0)
        before = scalar(0.0)
        if run.last - run.first > 1:
            before = felt_at(points, run, constants, begin)
        for j in range(begin + 1, foot + 1):
            here = felt_at(points, run, constants, j)
            q = past.decay_weights(past.segment_depth(points, run, constants, j - 1, j))
            upstream = q[0] * upstream + q[1] * before + q[2] * here
            before = here
        channel_inlet_out[channel] = upstream

    return SimpleNamespace(
        Channels=line.Channels,
        Points=line.Points,
        MigrationConstants=MigrationConstants,
        Inflow=Inflow,
        feed_inlets=feed_inlets,
        return_outflow=return_outflow,
    )
