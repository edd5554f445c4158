"""The parts in which each channel does a time step, as its width, its depth, its pace and the ground ask for."""

from __future__ import annotations

import warp as wp

from warpriver.kernels import schedule as kernels
from warpriver.meander.buffers import StepBuffers, StepChannels
from warpriver.meander.stages import Share, Stage
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import MeanderParams, PathMeander
from warpriver.terrain import Terrain

__all__ = ["begin_substep", "schedule_channels"]


def begin_substep(
    network: RiverNetwork,
    channels: StepChannels,
    buffers: StepBuffers,
    terrain: Terrain | None,
    params: MeanderParams | PathMeander,
) -> list[Stage]:
    """Return the stages that begin a sub-step of any solver: planned, if it is the first of a step, and dealt out.

    Args:
        network: The network.
        channels: Its channels; get ``step``.
        buffers: ``status`` may halt all that follows.
        terrain: Ground, on the network's device, or None.
        params: ``time_step``, yr, and ``slope_threshold``.
    """

    def deal_out(_: Share) -> None:
        most = channels.most
        schedule_channels(network, channels, buffers, params.time_step, channels.substep, most, channels.pace)

    return [*_plan(network, channels, buffers, terrain, params), Stage("migrate", deal_out, shared=False)]


def _plan(
    network: RiverNetwork,
    channels: StepChannels,
    buffers: StepBuffers,
    terrain: Terrain | None,
    params: MeanderParams | PathMeander,
) -> list[Stage]:
    """Return the stages that choose in how many equal parts each channel does a time step, ``channels.parts``.

    Where the ground is so steep that no point of a channel moves by more than a part g of its rate, its steps are
    longer by 1 / g; g is measured here (``channels.mobility``). ``channels.pace`` is that of the step before. The most
    parts go to ``channels.most``. Nothing changes while ``channels.substep`` says that the step is planned.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device

    def clear(_: Share) -> None:
        wp.launch(
            kernel.begin_substep,
            dim=channels.capacity,
            inputs=[channels.substep],
            outputs=[channels.mobility, channels.most, buffers.status.array],
            device=device,
        )

    def measure(share: Share) -> None:
        assert terrain is not None
        wp.launch(
            kernel.measure_mobility,
            dim=share.point_threads,
            inputs=[
                network.point_xy, channels.start, channels.form, terrain.height,
                terrain.grid(network.dtype, network.origin), params.slope_threshold, params.time_step, share.work,
                channels.limit, channels.substep,
            ],
            outputs=[channels.mobility_bits],
            device=device,
        )  # fmt: skip

    def choose(_: Share) -> None:
        wp.launch(
            kernel.plan_steps,
            dim=channels.capacity,
            inputs=[
                channels.limit, params.time_step, channels.substep, buffers.status.array, channels.mobility,
                channels.pace,
            ],
            outputs=[channels.parts, channels.most],
            device=device,
        )  # fmt: skip

    felt = [] if terrain is None or channels.mobility is None else [Stage("migrate", measure)]
    return [Stage("migrate", clear, shared=False), *felt, Stage("migrate", choose, shared=False)]


def schedule_channels(
    network: RiverNetwork,
    channels: StepChannels,
    buffers: StepBuffers,
    time_step: float,
    substep: wp.array,
    most: wp.array | None = None,
    pace: wp.array | None = None,
) -> None:
    """Set the time step of every channel in a sub-step, ``channels.step``: 0 where it rests.

    Args:
        network: The network.
        channels: Its channels.
        buffers: With ``status`` halted, nothing changes.
        time_step: The whole of it, yr.
        substep: Three int32: the number of the sub-step, how many there are, 1 where that is settled.
        most: ``channels.most``, from which the first sub-step of a step takes how many there are; or None.
        pace: ``channels.pace``, to be cleared in the first sub-step.
    """
    wp.launch(
        kernels.build(PRECISIONS[network.dtype][0]).schedule_channels,
        dim=channels.capacity,
        inputs=[channels.parts, time_step, most],
        outputs=[channels.step, pace, substep, buffers.status.array],
        device=network.device,
    )
