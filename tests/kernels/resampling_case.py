"""Lines, their arcs and samples, as the resampling kernels take them, and a case that runs these."""

import dataclasses

import numpy as np
import pytest
import reference
import warp as wp
from kernel_arrays import (
    SCALARS,
    arcs_of,
    channels_of,
    forms,
    points_of,
    ring_flags,
    share_count,
    share_out,
    split,
    starts_of,
    status_of,
    stems_of,
    to_device,
    unwritten,
)

from warpriver.kernels import resampling
from warpriver.kernels.status import (
    CUT_POINTS,
    CUT_POINTS_NEEDED,
    CUTS,
    CUTS_NEEDED,
    DONE,
    FAULT,
    GOAL,
    HALT,
    POINTS,
    POINTS_NEEDED,
    STATUS_SIZE,
    STEPS,
)

# A length within rounding of half a quantum may be rounded to either side.
QUANTA_TOLERANCE = 1
ARC_TOLERANCE = 1e-9
POINT_TOLERANCE = 1e-9
# A float32 coordinate of a few km is off by 2.4e-4 m at most; the cubic combines a few of them.
POINT_TOLERANCE_32 = 2e-3
FAULT_NOT_FINITE, FAULT_POINTS_FULL = 1, 4
# What a spacing is before a step.
SPACING_BEFORE = 123.0


def smooth_line(rng, count, spacing=50.0):
    """Points a bit unevenly spaced on a winding line, as a move leaves them."""
    s = np.cumsum(spacing * rng.uniform(0.85, 1.15, count))
    heading = rng.uniform(0.0, 6.0) + 1.2 * np.sin(s / rng.uniform(120.0, 250.0) + rng.uniform(0.0, 6.0))
    steps = np.diff(s)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)[1:]
    return np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)]) + rng.uniform(-500.0, 500.0, 2)


def as_quanta(arc):
    """Arc lengths in m as the whole numbers of quanta that they are."""
    quanta = arc / reference.QUANTUM
    assert (quanta == np.rint(quanta)).all()
    return quanta.astype(np.int64)


def with_copies(xy, pairs):
    """The line as cutoffs leave it: the points i .. j - 1 of each pair stand at point i."""
    return reference.cut_necks(xy, pairs)[0]


@dataclasses.dataclass
class Sampled:
    """What all kernels together made of the lines of a case; ``points`` and ``sections`` by channel."""

    points: list
    sections: list | None
    spacing: np.ndarray
    start: np.ndarray
    fault: int
    needed: int
    raw: np.ndarray
    done: int


class Case:
    """Some moved channels on a device; each kernel has its method, and ``sampled`` runs them all."""

    def __init__(
        self,
        lines,
        *,
        spacing=50.0,
        sections=None,
        resting=(),
        rings=(),
        stems=(),
        dtype="float64",
        device="cpu",
        spare=5,
    ):
        self.resting, self.rings = resting, rings
        self.scalar = SCALARS[dtype]
        self.kernel, self.device, self.lines = resampling.build(self.scalar), device, lines
        self.start = starts_of(lines)
        self.count, self.capacity = int(self.start[-1]), int(self.start[-1]) + spare
        self.asked = np.broadcast_to(np.float64(spacing), len(lines))
        self.sections = sections
        beyond = np.full((spare, 2), np.nan)
        self.point_moved = to_device(np.concatenate([*lines, beyond]), self.kernel.vec2, device)
        section = None
        if sections is not None:
            section = to_device(np.concatenate([*sections, beyond]), self.kernel.vec2, device)
        self.moved = points_of(self.scalar, self.point_moved, section)
        step = np.full(len(lines), 0.3)
        step[list(resting)] = 0.0
        # Of the form only the target spacing is for these kernels.
        self.members = {
            "start": to_device(self.start, wp.int32, device),
            "form": forms(np.nan, np.nan, np.nan, self.asked, self.scalar, device),
            "spacing": to_device(np.full(len(lines), SPACING_BEFORE), self.scalar, device),
            "step": to_device(step, self.scalar, device),
            "closed": ring_flags(rings, len(lines), device),
        }
        if stems:
            self.members["stems"] = stems_of(stems, len(lines), device)
        self.channels = channels_of(self.scalar, **self.members)

    def launch(self, kernel, dim, inputs, outputs):
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)

    def launch_points(self, kernel, deal, capacity, inputs, outputs, halt=0, status=None):
        """Launch a kernel over that many points; ``...`` stands for the work among the inputs."""
        for part in share_out(deal, len(self.lines), capacity, self.device, halt, status):
            self.launch(kernel, part.threads, [part.work if value is ... else value for value in inputs], outputs)

    def measured(self, deal, status=None, halt=0):
        """Arc lengths in the chunks or along the channels, and the length of each chunk, both on the device."""
        arc = unwritten(self.capacity, wp.float64, self.device)
        length = unwritten(share_count(deal, len(self.lines), self.capacity), wp.int64, self.device)
        status = status_of({}, self.device) if status is None else status
        inputs = [self.channels, ..., self.point_moved]
        self.launch_points(self.kernel.measure_arcs, deal, self.capacity, inputs, [arc, length, status], halt)
        return arc, length

    def arcs(self, deal, status=None):
        """Arc lengths of the points from their channels' heads, in quanta, by channel."""
        arc, length = (a.numpy() for a in self.measured(deal, status))
        arc = as_quanta(arc[: self.count])
        if isinstance(deal, int):
            arc += (np.cumsum(length) - length)[np.arange(self.count) // deal]
        return [own - own[0] for own in split(arc, self.start)]

    def counted(self, deal, arcs, status):
        """Points and even spacing of each channel, both on the device."""
        samples = unwritten(len(self.lines), wp.int32, self.device)
        spacing = unwritten(len(self.lines), self.scalar, self.device)
        for part in share_out(deal, len(self.lines), self.capacity, self.device):
            inputs = [self.channels, part.work, self.point_moved, arcs]
            self.launch(self.kernel.count_samples, part.channel_threads, inputs, [samples, spacing, status])
        return samples, spacing

    def sampled(self, deal=64, capacity=None, fault=0, substep=(2, 5), halt=0, goal=1, keep_plan=0):
        """All kernels in a row, into new arrays of that capacity (by default just what is needed and 4 more)."""
        channels = len(self.lines)
        state = {FAULT: fault, HALT: halt, GOAL: goal, POINTS: -1, POINTS_NEEDED: -1}
        state |= {STATUS_SIZE: -1, STATUS_SIZE + 1: -1}
        # What the sub-steps before have cut off, and what this one has.
        state |= {CUTS: 2, CUT_POINTS: 30, CUTS_NEEDED: channels, CUT_POINTS_NEEDED: 10 * channels}
        status = status_of(state, self.device, row=1)
        arc, length = self.measured(deal, status)
        offset = unwritten(len(length), wp.int64, self.device)
        if isinstance(deal, int):
            offset = to_device(np.cumsum(length.numpy()), wp.int64, self.device)
        arcs = arcs_of(deal, arc, offset)
        samples, spacing = self.counted(deal, arcs, status)
        start_next = to_device(np.concatenate([[0], np.cumsum(samples.numpy())]), wp.int32, self.device)
        needed = int(start_next.numpy()[-1])
        capacity = needed + 4 if capacity is None else capacity
        points = unwritten(capacity, self.kernel.vec2, self.device)
        sections = None if self.sections is None else unwritten(capacity, self.kernel.vec2, self.device)
        new = channels_of(self.scalar, **self.members | {"start": start_next, "spacing": spacing})
        inputs, sampled = [self.channels, ..., new, self.moved, arcs], points_of(self.scalar, points, sections)
        self.launch_points(self.kernel.resample_points, deal, capacity, inputs, [sampled], status=status)
        start_out = to_device(self.start, wp.int32, self.device)
        spacing_out = to_device(np.full(channels, SPACING_BEFORE), self.scalar, self.device)
        count = to_device([*substep, 1], wp.int32, self.device)
        outputs = [start_out, spacing_out, count, status]
        self.launch(self.kernel.commit_step, channels + 1, [capacity, keep_plan, start_next, spacing], outputs)
        raw, start = points.numpy().astype(np.float64), start_out.numpy()
        by_channel = split(raw, start_next.numpy())
        if sections is not None:
            sections = split(sections.numpy().astype(np.float64), start_next.numpy())
        done, total, planned = count.numpy().tolist()
        assert total == substep[1]
        found = status.numpy()
        fault, counted, steps = found[[FAULT, DONE, STEPS]].tolist()
        assert found[STATUS_SIZE:].tolist() == (list(substep) if counted else [-1, -1])
        taken = fault == 0 and not halt
        assert steps == (counted and done == 0) and planned == (keep_plan if steps else 1)
        assert counted == (taken and goal > 0) and done == (substep[0] + counted) % total
        assert found[[CUTS, CUT_POINTS]].tolist() == [2 + counted * channels, 30 + counted * 10 * channels]
        assert found[[CUTS_NEEDED, CUT_POINTS_NEEDED]].tolist() == [channels, 10 * channels]
        assert found[POINTS] == (needed if taken else -1)
        if not taken:
            assert start.tolist() == self.start.tolist() and (spacing_out.numpy() == SPACING_BEFORE).all()
        told = not halt and fault in (0, FAULT_POINTS_FULL)
        assert found[POINTS_NEEDED] == (needed if told else -1), "told, whether there is room or not"
        return Sampled(by_channel, sections, spacing_out.numpy(), start, fault, needed, raw, done)

    def twins(self):
        sections = [None] * len(self.lines) if self.sections is None else self.sections
        return [
            reference.resample(xy, s, section) for xy, s, section in zip(self.lines, self.asked, sections, strict=True)
        ]


def assert_sampled(case, deal, tolerance=POINT_TOLERANCE):
    """Points, sections, counts and spacings are the twin's; the ends are the moved ends to the bit."""
    actual = case.sampled(deal)
    assert actual.fault == 0
    assert np.isnan(actual.raw[actual.needed :]).all()
    start = [0]
    for c, (xy, (points, section, spacing)) in enumerate(zip(case.lines, case.twins(), strict=True)):
        assert len(actual.points[c]) == len(points), f"channel {c}"
        error = np.abs(actual.points[c] - points).max()
        assert error <= tolerance, f"channel {c}: {error}"
        assert (actual.points[c][[0, -1]] == xy[[0, -1]]).all(), f"channel {c}"
        assert actual.spacing[c] == pytest.approx(spacing, abs=tolerance)
        if section is not None:
            error = np.abs(actual.sections[c] - section).max(axis=1)
            assert error.max() <= tolerance, f"channel {c}: section {error.argmax()} off by {error.max()}"
        start.append(start[-1] + len(points))
    assert actual.start.tolist() == start
    return actual
