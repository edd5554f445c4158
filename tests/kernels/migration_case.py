"""Channels on a device, and the migration kernels launched on them."""

import dataclasses

import numpy as np
import pytest
import reference
import warp as wp
from kernel_arrays import (
    SCALARS,
    bits_of,
    channels_of,
    forms,
    ground_of,
    points_of,
    ring_flags,
    share_out,
    split,
    starts_of,
    stems_of,
    struct_of,
    structs,
    to_device,
    unwritten,
)

from warpriver.kernels import memory, migration, schedule

# Rounding of sums over some hundred points, relative to the largest rate of the channel.
SUM_TOLERANCE = 1e-12
# One coordinate of a moved point: a few units in the last place of some kilometres.
MOVE_TOLERANCE = 4e-12
# In float32 a curvature is off by about 6e-8 / h, and the sharpest bends here have 2e-3 / m at h = 50 m: a millionth,
# times the number of terms.
SUM_TOLERANCE_32 = 2e-5
# Half a unit in the last place of 8 km in float32 is 2.4e-4 m.
MOVE_TOLERANCE_32 = 1e-3

# West and north edge and cell size of the ground, m.
GRID = (-9000.0, 9000.0, 120.0)
# A place in a raster of 150 cells is off by up to 1e-5 cells in float32, and slopes differ by 0.1 from cell to cell.
SLOPE_TOLERANCE = {"float64": 1e-10, "float32": 1e-4}
# Short enough for the local term to be explicit on every line here.
SHORT_STEP = 1e-4


def heading_line(heading, count, spacing, start=(0.0, 0.0)):
    """Points at even arc length on the curve of that heading(s), each step by 10-node quadrature: (count, 2)."""
    nodes, weights = np.polynomial.legendre.leggauss(10)
    s = spacing * (np.arange(count - 1)[:, None] + 0.5 * (nodes + 1.0))
    angle = heading(s)
    steps = 0.5 * spacing * np.stack([np.cos(angle) @ weights, np.sin(angle) @ weights], axis=1)
    return np.concatenate([[start], np.asarray(start) + np.cumsum(steps, axis=0)])


def meander(count, spacing=50.0, swing=1.1, wave=900.0, turn=0.0):
    """A sine-generated line with a second, incommensurate wave, so that no two bends are alike."""
    q = 2.0 * np.pi / wave
    return heading_line(lambda s: turn + swing * np.sin(q * s) + 0.3 * np.sin(0.77 * q * s), count, spacing)


def stacked_lines(seed=3, counts=(3, 4, 5, 130, 3, 3, 67, 3, 300, 6)):
    """Channels of very different lengths, on top of each other."""
    rng = np.random.default_rng(seed)
    return [
        meander(n, swing=rng.uniform(0.3, 1.5), wave=rng.uniform(600.0, 1500.0), turn=rng.uniform(0.0, 6.0))
        for n in counts
    ]


def device_constants(kernel, law):
    """The struct that the kernels read."""
    members = dataclasses.asdict(law)
    del members["time_step"]  # each channel has its own
    members["freest"] = 1.0
    return struct_of(kernel.MigrationConstants, **members)


def memory_of(scalar, channels, device):
    """What links hand on, with room for so many channels."""
    kernel = memory.build(scalar)
    kinds = {"end": kernel.vec3, "fade": kernel.vec4, "start": kernel.vec3, "back": kernel.vec3}
    kinds["tail"] = kernel.vec2
    arrays = {name: unwritten(channels, kind, device) for name, kind in kinds.items()}
    structs = {name: wp.zeros(channels, dtype=kind, device=device) for name, kind in
               (("terms", kernel.Terms), ("ends", kernel.Ends))}  # fmt: skip
    return struct_of(kernel.Memory, **arrays, **structs)


def channel_means(sections):
    """Mean width, mean depth and greatest width of each channel, (C,) each."""
    return (
        np.array([s[:, 0].mean() for s in sections]),
        np.array([s[:, 1].mean() for s in sections]),
        np.array([s[:, 0].max() for s in sections]),
    )


class Case:
    """Some channels, packed on a device in one precision, and both migration kernels launched on them."""

    def __init__(
        self,
        lines,
        *,
        width=50.0,
        depth=2.0,
        sections=None,
        spacing=50.0,
        resting=(),
        rings=(),
        stems=(),
        dtype="float64",
        device="cpu",
        spare=5,
    ):
        scalar = SCALARS[dtype]
        self.resting, self.rings = resting, rings
        self.closed = ring_flags(rings, len(lines), device)
        self.kernel, self.scalar, self.device = migration.build(scalar), scalar, device
        self.lines, self.start = lines, starts_of(lines)
        self.count, self.capacity = int(self.start[-1]), int(self.start[-1]) + spare
        packed = np.full((self.capacity, 2), np.nan)
        packed[: self.count] = np.concatenate(lines)
        self.point_xy = to_device(packed, self.kernel.vec2, device)
        channels = len(lines)
        self.width = np.broadcast_to(np.float64(width), channels)
        self.depth = np.broadcast_to(np.float64(depth), channels)
        self.widest, self.section = self.width, None
        if sections is not None:
            self.width, self.depth, self.widest = channel_means(sections)
            self.section = to_device(np.concatenate([*sections, np.full((spare, 2), np.nan)]), self.kernel.vec2, device)
        self.spacing = np.broadcast_to(np.float64(spacing), channels)
        self.channel_start = to_device(self.start, wp.int32, device)
        self.form = forms(self.width, self.depth, self.widest, self.spacing, scalar, device)
        self.channel_spacing = to_device(self.spacing, scalar, device)
        self.points = points_of(scalar, self.point_xy, self.section)
        self.stems = stems_of(stems, channels, device)
        self.memory = memory_of(scalar, channels, device) if stems else self.kernel.Memory()

    def launch(self, kernel, deal, inputs, outputs):
        """Launch a kernel over the points; the inputs after the work, if any, follow a ``...``."""
        for part in share_out(deal, len(self.lines), self.capacity, self.device):
            given = [part.work if value is ... else value for value in inputs]
            wp.launch(kernel, dim=part.threads, inputs=given, outputs=outputs, device=self.device)

    def channels(self, law, deal=64):
        """The channels with their time steps, 0 for the inactive ones, and the areas of rings."""
        step = np.full(len(self.lines), law.time_step)
        step[list(self.resting)] = 0.0
        channels = channels_of(
            self.scalar, start=self.channel_start, form=self.form, spacing=self.channel_spacing,
            step=to_device(step, self.scalar, self.device), closed=self.closed,
        )  # fmt: skip
        if self.closed is not None:
            channels.area = wp.zeros(len(self.lines), dtype=wp.int64, device=self.device)
            self.launch(self.kernel.measure_rings, deal, [channels, self.point_xy, ...], [channels.area])
        if self.stems is not None:
            channels.stems = self.stems
            self.stems.length.zero_()
            self.launch_once("measure_stems", [channels], [self.stems.length])
        return channels

    def launch_once(self, name, inputs, outputs):
        """Launch a kernel of the memory over the channels, once and not dealt out."""
        work = share_out("one slab", len(self.lines), self.capacity, self.device)[0].work
        given = [work if value is ... else value for value in inputs]
        kernel = getattr(memory.build(self.scalar), name)
        wp.launch(kernel, dim=len(self.lines), inputs=given, outputs=outputs, device=self.device)

    def velocities(self, law, deal=64, felt=()):
        """Velocities by channel, smoothed downstream where the step asks for it; float64, 0 where it is inactive.

        Those of the inactive channels that are ``felt`` by an active one downstream are computed all the same.
        """
        return self._written(self._compute(law, deal), felt)

    def rates(self, law, deal=64, felt=()):
        """Rates by channel, of a step so short that nothing is smoothed; otherwise as ``velocities``."""
        velocity, out = self._compute(law, deal), unwritten(self.capacity, self.scalar, self.device)
        inputs = [self.channels(law, deal), self.point_xy, ..., velocity]
        self.launch(self.kernel.resolve_rate, deal, inputs, [out])
        return self._written(out, felt)

    def _compute(self, law, deal):
        """Velocities on the device, with what comes from upstream."""
        out = unwritten(self.capacity, self.kernel.vec2, self.device)
        channels, constants = self.channels(law, deal), device_constants(self.kernel, law)
        self.launch(self.kernel.compute_velocity, deal, [channels, self.points, constants, ...], [out, self.memory])
        if self.stems is not None:
            self.launch_once("chain_links", [channels, constants, ...], [self.memory])
            for part in share_out(deal, len(self.lines), self.capacity, self.device):
                self._add_upstream(channels, constants, part, out)
        return out

    def _add_upstream(self, channels, constants, part, velocity):
        """Let a share of the channels add what enters them to their velocities."""
        wp.launch(
            memory.build(self.scalar).add_upstream,
            dim=part.channel_threads,
            inputs=[channels, self.points, constants, part.work],
            outputs=[self.memory, velocity],
            device=self.device,
        )

    def _written(self, out, felt):
        """Values of points by channel, which those of inactive channels must not have."""
        packed = out.numpy().astype(np.float64)
        for c in set(self.resting) - set(felt):
            first, stop = self.start[c : c + 2]
            assert np.isnan(packed[first:stop]).all(), "a rate of an inactive channel was written"
            packed[first:stop] = 0.0
        return self._channels(packed)

    def moved(self, law, velocities, deal=64, height=None):
        """Points by channel after a step with those velocities; float64. Sections must be carried along.

        With heights on ``GRID``, (rows, columns), the ground slows the move.
        """
        beyond = np.full((self.capacity - self.count, 2), np.nan)
        rate = to_device(np.concatenate([*velocities, beyond]), self.kernel.vec2, self.device)
        out = unwritten(self.capacity, self.kernel.vec2, self.device)
        section = None if self.section is None else unwritten(self.capacity, self.kernel.vec2, self.device)
        constants, ground = device_constants(self.kernel, law), ground_of(self.scalar, height, GRID, self.device)
        channels = self.channels(law, deal)
        if self.stems is not None:
            # The terms of the links, and that nothing enters them: the velocities are complete.
            self._compute(law, deal)
            self.memory.start.zero_()
            for part in share_out(deal, len(self.lines), self.capacity, self.device):
                self._add_upstream(channels, constants, part, rate)
            self.launch_once("find_tails", [channels, ...], [self.memory])
        velocities = struct_of(self.kernel.Velocities, point=rate, tail=self.memory.tail)
        inputs = [channels, self.points, ground, constants, ..., velocities]
        max_speed = wp.zeros(len(self.lines), dtype=self.scalar, device=self.device)
        self.launch(self.kernel.move_points, deal, inputs, [points_of(self.scalar, out, section), bits_of(max_speed)])
        if section is not None:
            np.testing.assert_array_equal(section.numpy(), self.section.numpy())
        moved = self._channels(out.numpy().astype(np.float64))
        for c, (xy, after) in enumerate(
            zip(self._channels(self.point_xy.numpy().astype(np.float64)), moved, strict=True)
        ):
            # The max speed is that of the fastest point; the distance is that of rounded coordinates.
            farthest = np.hypot(*(after - xy).T).max() / law.time_step
            rounding = 4.0 * float(np.finfo(out.numpy().dtype).eps) * np.abs(after).max() / law.time_step
            assert max_speed.numpy()[c] == pytest.approx(farthest, rel=1e-5, abs=rounding), f"max speed of channel {c}"
        return moved

    def mobility(self, law, height, deal=64, planned=0, limit=0.0):
        """How the ground lets each channel move, (C,) of the case's precision; 0 where the step is planned before."""
        out = wp.zeros(len(self.lines), dtype=self.scalar, device=self.device)
        kernel = schedule.build(self.scalar)
        limits = structs(np.full((3, len(self.lines)), limit), kernel.Limits, self.device)
        constants = struct_of(kernel.StepConstants, time_step=law.time_step, slope_threshold=law.slope_threshold)
        ground, substep = (
            ground_of(self.scalar, height, GRID, self.device),
            to_device([0, 1, planned], int, self.device),
        )
        inputs = [self.channels(law), self.point_xy, ground, constants, ..., limits, substep]
        self.launch(kernel.measure_mobility, deal, inputs, [bits_of(out)])
        return out.numpy()

    def _channels(self, packed):
        assert np.isfinite(packed[: self.count]).all(), "a point was not written"
        assert np.isnan(packed[self.count :]).all(), "something was written beyond the points in use"
        return split(packed, self.start)


def assert_rates(actual, expected, tolerance):
    """Each channel agrees with its twin to ``tolerance`` times its own largest rate."""
    for channel, (a, e) in enumerate(zip(actual, expected, strict=True)):
        assert np.abs(a - e).max() <= tolerance * np.abs(e).max(), f"channel {channel}"


def twin_rates(lines, law, width=50.0, depth=2.0, spacing=50.0, sections=None):
    """Unsmoothed rates by channel, from the twin."""
    channels = len(lines)
    widths = np.broadcast_to(width, channels) if sections is None else [s[:, 0] for s in sections]
    depths = np.broadcast_to(depth, channels) if sections is None else [s[:, 1] for s in sections]
    return [
        reference.migration_rate(xy, h, np.broadcast_to(w, len(xy)), np.broadcast_to(d, len(xy)), law)
        for xy, h, w, d in zip(lines, np.broadcast_to(spacing, channels), widths, depths, strict=True)
    ]


def varying_sections(lines, seed=5):
    """Width and depth that change along each line by up to a third."""
    rng = np.random.default_rng(seed)
    sections = []
    for xy in lines:
        wave = np.sin(np.arange(len(xy)) * rng.uniform(0.05, 0.4) + rng.uniform(0.0, 6.0))
        sections.append(np.stack([60.0 * (1.0 + 0.3 * wave), 2.2 * (1.0 - 0.3 * wave)], axis=1))
    return sections


def hills(slope=0.3, gaps=0.1, seed=0):
    """Heights on GRID: waves of that slope at most, in a plain, with holes."""
    rng = np.random.default_rng(seed)
    row, column = np.indices((150, 150))
    wave = 12_000.0 / (2.0 * np.pi)
    x, y = GRID[2] * column, GRID[2] * row
    height = slope * wave * np.sin(x / wave) + 0.02 * y
    if gaps > 0.0:
        for i, j in rng.integers(0, 150, (int(150 * 150 * gaps / 9), 2)):
            height[i : i + 3, j : j + 3] = np.nan
    return height
