"""The parts in which each channel does a time step, as its width, its depth, its pace and the ground ask for."""

from __future__ import annotations

from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.kernels import schedule as kernels

__all__ = ["begin_substep"]


def begin_substep(state: State) -> list[Stage]:
    """Return the stages that begin a sub-step of any model: planned, if it is the first of a step, and dealt out.

    Where ground and controls let no point of a channel move by more than a part g of its rate, its steps are longer by
    1 / g; g is measured here (``state.mobility``). ``state.pace`` is that of the step before. The most parts
    go to ``state.most``. The links of a stem take the same sub-steps. Nothing changes while ``state.substep`` says that
    the step is planned.
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
            outputs=[state.mobility, state.most, status],
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
            inputs=[state.limits, params.time_step, state.substep, status, state.mobility, state.pace],
            outputs=[state.parts, state.most],
            device=device,
        )

    def level(_: Share) -> None:
        assert state.stems is not None
        planned, parts = [channels, state.substep, status], state.stems.parts
        clear(parts)
        launch(kernel.gather_stems, state.channel_capacity, [*planned, state.parts], [parts], device)
        launch(kernel.level_stems, state.channel_capacity, [*planned, parts], [state.parts], device)

    def deal_out(_: Share) -> None:
        state.schedule(state.substep, state.most, state.pace)

    joined = state.stems is not None and state.stems.joined
    felt = [] if not state.is_uneven else [Stage("migrate", measure)]
    return [
        Stage("migrate", begin, shared=False),
        *felt,
        Stage("migrate", choose, shared=False),
        *([Stage("migrate", level, shared=False)] if joined else []),
        Stage("migrate", deal_out, shared=False),
    ]
