"""Wandering channels on a device, for the tests of the kernels that make a step by shortest paths."""

import numpy as np
import warp as wp
from kernel_arrays import (
    SCALARS,
    channels_of,
    forms,
    points_of,
    ring_flags,
    share_out,
    split,
    starts_of,
    to_device,
    vec2_of,
)

SPACING = 10.0


def wandering_line(rng, count, curl=0.9, start=(0.0, 0.0)):
    """A line whose heading wanders: it comes close to itself often, and crosses itself."""
    heading = np.cumsum(rng.normal(0.0, curl, count - 1))
    steps = SPACING * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.concatenate([[start], np.asarray(start) + np.cumsum(steps, axis=0)])


def varying_sections(rng, counts):
    """Widths and depths that differ from point to point, by channel."""
    return [np.stack([rng.uniform(5.0, 30.0, n), np.ones(n)], axis=1) for n in counts]


class PackedLines:
    """Some channels, packed on a device in one precision."""

    def __init__(
        self,
        lines,
        *,
        width=12.0,
        sections=None,
        rings=(),
        resting=(),
        time_step=1.0,
        dtype="float64",
        device="cpu",
        spare=5,
    ):
        self.scalar, self.device, self.lines = SCALARS[dtype], device, lines
        self.start = starts_of(lines)
        self.count, self.capacity = int(self.start[-1]), int(self.start[-1]) + spare
        vec2 = vec2_of(self.scalar)
        packed = np.full((self.capacity, 2), np.nan)
        packed[: self.count] = np.concatenate(lines)
        self.xy = to_device(packed, vec2, device)
        self.mean = self.widest = np.broadcast_to(np.float64(width), len(lines))
        self.sections, self.section = sections, None
        if sections is not None:
            self.mean = np.array([s[:, 0].mean() for s in sections])
            self.widest = np.array([s[:, 0].max() for s in sections])
            self.section = to_device(np.concatenate([*sections, np.full((spare, 2), np.nan)]), vec2, device)
        self.channel_start = to_device(self.start, wp.int32, device)
        self.form = forms(self.mean, np.nan, self.widest, np.nan, self.scalar, device)
        self.spacing = to_device(np.full(len(lines), SPACING), self.scalar, device)
        step = np.full(len(lines), time_step)
        step[list(resting)] = 0.0
        self.rings, self.closed = rings, ring_flags(rings, len(lines), device)
        self.resting, self.step = resting, to_device(step, self.scalar, device)
        self.channels = channels_of(
            self.scalar, start=self.channel_start, form=self.form, spacing=self.spacing, step=self.step,
            closed=self.closed,
        )  # fmt: skip
        self.points = points_of(self.scalar, self.xy, self.section)
        # Not 0 where the status says halt.
        self.halt = 0

    def widths(self):
        """Width at each point by channel."""
        if self.sections is not None:
            return [s[:, 0] for s in self.sections]
        return [np.full(len(xy), w) for xy, w in zip(self.lines, self.mean, strict=True)]

    def launch(self, kernel, deal, inputs, outputs, *, by_channel=False):
        """Launch a kernel in one of the ways to deal points out; a ``...`` in the inputs stands for the work."""
        for part in share_out(deal, len(self.lines), self.capacity, self.device, self.halt):
            given = [part.work if value is ... else value for value in inputs]
            threads = part.channel_threads if by_channel else part.threads
            wp.launch(kernel, dim=threads, inputs=given, outputs=outputs, device=self.device)

    def by_channel(self, packed):
        """Cut a packed host array into channels."""
        return split(packed, self.start)
