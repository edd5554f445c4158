"""Resampling: points at an even spacing again, on the cubic through the moved ones."""

from __future__ import annotations

from warpriver.kernels import resampling as kernels
from warpriver.meander.buffers import StepBuffers, StepChannels
from warpriver.meander.stages import Share, Stage, launch
from warpriver.network import PRECISIONS, RiverNetwork

__all__ = ["measure", "resample"]


def measure(network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, phase: str) -> list[Stage]:
    """Return the stages that measure the arc length of ``buffers.point_moved``, into ``point_arc``.

    Args:
        network: The network whose points moved.
        channels: Its channels.
        buffers: Scratch and results; with chunks, ``chunk_offset`` is the running sum of their lengths.
        phase: Name of the verb that asks for it.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device

    def measure_arcs(share: Share) -> None:
        launch(
            kernel.measure_arcs,
            dim=share.point_threads,
            inputs=[channels.start, channels.step, share.work, buffers.point_moved],
            outputs=[buffers.point_arc, buffers.chunk_length, buffers.status.array],
            device=device,
        )

    def offset_chunks(_: Share) -> None:
        buffers.scan_lengths.run()

    return [Stage(phase, measure_arcs), *([Stage(phase, offset_chunks, shared=False)] if buffers.chunk > 0 else [])]


def resample(
    network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, keep_plan: bool = False
) -> list[Stage]:
    """Return the stages that sample the moved channels evenly and make that the network's new state.

    A channel of length L gets n = round(L / spacing asked for) segments, at least 2, of L / n each; its ends stay. A
    ring gets n points for its n segments, at least 8. A channel at rest keeps its points. Nothing is taken over when
    ``buffers.status`` tells of a fault. It does when the points do not fit into the capacity, and tells how much room
    the step needs.

    Args:
        network: Gets the new points, and ``channel_start``.
        channels: Its channels; get the new spacing.
        buffers: ``point_moved`` (and ``section_moved``) is read.
        keep_plan: The parts in which channels do a step hold for the next one, too.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    start, offset = channels.start, buffers.chunk_offset

    def count(share: Share) -> None:
        launch(
            kernel.count_samples,
            dim=share.channel_threads,
            inputs=[
                start, channels.form, channels.spacing, channels.step, channels.closed, share.work,
                buffers.point_moved, buffers.point_arc, offset,
            ],
            outputs=[channels.samples, channels.spacing_next, buffers.status.array],
            device=device,
        )  # fmt: skip

    def number(_: Share) -> None:
        channels.scan_samples.run()

    def sample(share: Share) -> None:
        launch(
            kernel.resample_points,
            dim=share.point_threads,
            inputs=[
                start, channels.spacing_next, channels.step, channels.closed, share.work, channels.start_next,
                buffers.point_moved, buffers.section_moved, buffers.point_arc, offset, buffers.status.array,
            ],
            outputs=[network.point_xy, network.point_section],
            device=device,
        )  # fmt: skip

    def commit(_: Share) -> None:
        launch(
            kernel.commit_step,
            dim=channels.capacity + 1,
            inputs=[
                buffers.point_capacity, int(keep_plan), channels.start_next, channels.spacing_next,
                buffers.share_cut_sum,
            ],
            outputs=[start, channels.spacing, channels.substep, buffers.status.array],
            device=device,
        )  # fmt: skip

    name = "resample"
    return [
        *measure(network, channels, buffers, name), Stage(name, count), Stage(name, number, shared=False),
        Stage(name, sample), Stage(name, commit, shared=False),
    ]  # fmt: skip
