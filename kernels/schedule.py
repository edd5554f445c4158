"""In how many sub-steps each channel does a time step, and which of them it takes."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import ground as grounds
from warpriver.kernels import polyline
from warpriver.kernels.channels import Work
from warpriver.kernels.status import (
    CONTACTS,
    CREVASSES,
    DONE,
    FAULT,
    GOAL,
    HALT,
    NUMBER,
    PLANNED,
    STEPS,
    SUBSTEPS,
    TOTAL,
    TOUCH,
)
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the planning kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.schedule_{scalar.__name__}"
    line, land = polyline.build(scalar), grounds.build(scalar)
    vec2, bits, Channels, Ground = line.vec2, line.bits, line.Channels, land.Ground
    ZERO, ONE, TWO = (scalar(v) for v in (0.0, 1.0, 2.0))
    # A channel with a point this free to move counts as free: it asks for a tenth more sub-steps at most.
    FREE = scalar(0.9)
    # Any other than none.
    ANY = scalar(1.0e-30)
    # Rounding of a step that divides evenly must not add a sub-step; far too many still fit an integer.
    SLACK, MAX_SUBSTEPS = scalar(1.0 - (1.0e-12 if scalar is wp.float64 else 1.0e-6)), scalar(1.0e6)

    @wp.struct
    class Limits:
        """Longest sub-steps of a channel on flat ground, yr, and its smallest width, m; no width, no channel.

        In ``travel`` the tightest bend moves by less than a width, in ``growth`` the waves of the channel stay true.
        """

        travel: scalar
        growth: scalar
        width: scalar

    @wp.struct
    class StepConstants:
        """Constants of a simulation: its time step in yr, and the slope from which on no point moves."""

        time_step: scalar
        slope_threshold: scalar

    @wp.kernel(module=name, enable_backward=False)
    def begin_substep(
        # in
        substep: wp.array[int],
        # out
        channel_mobility_out: wp.array[scalar],
        max_substeps_out: wp.array[int],
        status_io: wp.array[int],
    ):
        """Halt this sub-step and those after it where the host is needed first, or clear what is planned anew.

        The host is needed after a fault, when as many steps are done as it requested, and when channels have come
        to touch in a sub-step of the batch, which it joins, or banks to break.
        """
        channel = wp.tid()
        touch = status_io[DONE] > 0 and (status_io[CONTACTS] > 0 or status_io[CREVASSES] > 0)
        if touch or status_io[FAULT] != 0 or status_io[STEPS] >= status_io[GOAL] or status_io[HALT] != 0:
            # Every thread comes to the same answer, whether it sees this or not.
            if channel == 0 and status_io[HALT] == 0:
                status_io[HALT] = 1
                if touch:
                    status_io[HALT] = TOUCH
        elif substep[PLANNED] == 0:
            if channel_mobility_out:
                channel_mobility_out[channel] = ZERO
            if channel == 0:
                max_substeps_out[0] = 0

    @wp.func(module=name)
    def maximum_substeps(limits: Limits, time_step: scalar) -> scalar:
        """Sub-steps that a channel may need, with its tightest bends and on flat ground; see ``plan_steps``."""
        return time_step / wp.min(limits.travel, limits.growth) * SLACK

    @wp.kernel(module=name, enable_backward=False)
    def measure_mobility(
        # network
        channels: Channels,
        point_xy: wp.array[vec2],
        # terrain
        ground: Ground,
        # params
        constants: StepConstants,
        work: Work,
        # in
        channel_limits: wp.array[Limits],
        substep: wp.array[int],
        # out
        channel_mobility_io: wp.array[bits],
    ):
        """Greatest mobility of any point of a channel: 1 where one lies on nearly flat ground, 0 where all are held.

        Controls can make it more than 1. A channel that would do the step in one piece even on flat ground counts as
        free as soon as any point can move.
        Numbers from 0 on are in the order of their bits, of which a GPU finds the greatest without a loop.
        """
        if substep[PLANNED] != 0:
            return
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            highest = scalar(0.0)
            enough = FREE
            freest = scalar(1.0)
            if ground.steering.highest:
                freest = scalar(ground.steering.highest[0])
            whole = maximum_substeps(channel_limits[run.channel], constants.time_step)
            if whole <= ONE:
                enough = ANY
            # Where controls might ask for more sub-steps, all points are looked at.
            searched = whole * freest > ONE and freest > ONE
            i = int(run.begin)
            while i < run.stop and (highest < enough or searched):
                highest = land.raised_mobility(ground, point_xy[i], constants.slope_threshold, highest)
                if highest >= enough:
                    highest = wp.max(highest, ONE)
                i += 1
            wp.atomic_max(channel_mobility_io, run.channel, wp.cast(highest, bits))

    @wp.kernel(module=name, enable_backward=False)
    def plan_steps(
        # network
        channel_limits: wp.array[Limits],
        # params
        time_step: scalar,
        # in
        substep: wp.array[int],
        status: wp.array[int],
        channel_mobility: wp.array[scalar],
        channel_max_speed: wp.array[scalar],
        # out
        channel_substeps_out: wp.array[int],
        max_substeps_io: wp.array[int],
    ):
        """Number of equal sub-steps of each channel, and the maximum of them.

        Where ground and controls let no point move by more than a fraction g, sub-steps are longer by 1 / g. The max
        speed of the step before tells how fast the bends that there are do move: by half a width in a sub-step at most.
        """
        channel = wp.tid()
        if substep[PLANNED] != 0 or status[HALT] != 0:
            return
        limits = channel_limits[channel]
        mobility = scalar(1.0)
        if channel_mobility:
            mobility = channel_mobility[channel]
        substeps = int(0)
        if mobility > ZERO and limits.width > ZERO:
            travel = wp.min(mobility / limits.travel, TWO * channel_max_speed[channel] / limits.width)
            needed = time_step * wp.max(mobility / limits.growth, travel) * SLACK
            substeps = wp.max(1, int(wp.ceil(wp.min(needed, MAX_SUBSTEPS))))
        channel_substeps_out[channel] = substeps
        wp.atomic_max(max_substeps_io, 0, substeps)

    @wp.kernel(module=name, enable_backward=False)
    def gather_stems(
        # network
        channels: Channels,
        # in
        substep: wp.array[int],
        status: wp.array[int],
        channel_substeps: wp.array[int],
        # out
        stem_parts_io: wp.array[int],
    ):
        """Maximum number of sub-steps of the links of each stem, at its top."""
        channel = wp.tid()
        if substep[PLANNED] == 0 and status[HALT] == 0:
            wp.atomic_max(stem_parts_io, channels.stems.top[channel], channel_substeps[channel])

    @wp.kernel(module=name, enable_backward=False)
    def level_stems(
        # network
        channels: Channels,
        # in
        substep: wp.array[int],
        status: wp.array[int],
        stem_parts: wp.array[int],
        # out
        channel_substeps_io: wp.array[int],
    ):
        """Let all links of a stem that move at all take the same sub-steps: a junction moves with both of its own."""
        channel = wp.tid()
        if substep[PLANNED] == 0 and status[HALT] == 0 and channel_substeps_io[channel] > 0:
            channel_substeps_io[channel] = stem_parts[channels.stems.top[channel]]

    @wp.kernel(module=name, enable_backward=False)
    def schedule_channels(
        # network
        channel_substeps: wp.array[int],
        # params
        time_step: scalar,
        # in
        max_substeps: wp.array[int],
        # out
        channel_step_out: wp.array[scalar],
        channel_max_speed_out: wp.array[scalar],
        substep_io: wp.array[int],
        status_io: wp.array[int],
    ):
        """Time step in yr of each channel in a sub-step, 0 where it rests: n of the N sub-steps are its own, evenly.

        substep = (number of this one, N, 1 once the step is planned). Every channel that moves at all does so in the
        first; the max speeds begin anew there, if they are given.
        """
        channel = wp.tid()
        if status_io[HALT] != 0:
            return
        number = substep_io[NUMBER]
        total = substep_io[TOTAL]
        if max_substeps and number == 0:
            # The greatest number that a channel needs; where the step was planned before, it is the same.
            total = wp.max(1, max_substeps[0])
        if channel == 0:
            substep_io[TOTAL] = total
            substep_io[PLANNED] = 1
            status_io[SUBSTEPS] = total
        substeps = wp.min(channel_substeps[channel], total)
        step = scalar(0.0)
        if (number * substeps) % total < substeps:
            step = time_step / scalar(substeps)
        channel_step_out[channel] = step
        if channel_max_speed_out and number == 0:
            channel_max_speed_out[channel] = ZERO

    return SimpleNamespace(
        vec2=vec2,
        Limits=Limits,
        StepConstants=StepConstants,
        begin_substep=begin_substep,
        measure_mobility=measure_mobility,
        plan_steps=plan_steps,
        gather_stems=gather_stems,
        level_stems=level_stems,
        schedule_channels=schedule_channels,
    )
