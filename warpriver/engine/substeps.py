"""Sub-steps: how many a channel needs for a time step, by its width, its depth, its max speed and the ground."""

from __future__ import annotations

from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.kernels import schedule as kernels

__all__ = ["begin_substep"]


def begin_substep(state: State) -> list[Stage]:
    """Return the stages that begin a sub-step of any model: planned, if it is the first of a step, and dealt out.

    Where ground and controls let no point of a channel move by more than a fraction g of its rate, its steps are longer
    by 1 / g; g is measured here (``state.mobility``). ``state.max_speed`` is that of the step before. The greatest
    number of sub-steps goes to ``state.max_substeps``. The links of a stem take the same sub-steps. Nothing changes
    while ``state.substep`` says that the step is planned.
    """
    kernel, device, params = kernels.build(state.scalar), state.device, state.params
    status, channels, ground = state.status.array, state.channels(), state.ground()
    constants = kernel.StepConstants()
    constants.time_step, constants.slope_threshold = params.time_step, params.slope_threshold

    def begin(_: Share) -> None:
        launch(
            kernel.begin_substep,
            dim=state.channel_capacity,
            inputs=[state.substep],
            outputs=[state.mobility, state.max_substeps, status],
            device=device,
        )

    def measure(share: Share) -> None:
        launch(
            kernel.measure_mobility,
            dim=share.point_threads,
            inputs=[channels, state.network.point_xy, ground, constants, share.work, state.limits, state.substep],
            outputs=[state.mobility_bits],
            device=device,
        )

    def choose(_: Share) -> None:
        launch(
            kernel.plan_steps,
            dim=state.channel_capacity,
            inputs=[state.limits, params.time_step, state.substep, status, state.mobility, state.max_speed],
            outputs=[state.channel_substeps, state.max_substeps],
            device=device,
        )

    def level(_: Share) -> None:
        assert state.stems is not None
        planned, substeps = [channels, state.substep, status], state.stems.substeps
        clear(substeps)
        launch(kernel.gather_stems, state.channel_capacity, [*planned, state.channel_substeps], [substeps], device)
        launch(kernel.level_stems, state.channel_capacity, [*planned, substeps], [state.channel_substeps], device)

    def deal_out(_: Share) -> None:
        state.schedule(state.substep, state.max_substeps, state.max_speed)

    joined = state.stems is not None and state.stems.joined
    felt = [] if not state.is_uneven else [Stage("migrate", measure)]
    return [
        Stage("migrate", begin, shared=False),
        *felt,
        Stage("migrate", choose, shared=False),
        *([Stage("migrate", level, shared=False)] if joined else []),
        Stage("migrate", deal_out, shared=False),
    ]
