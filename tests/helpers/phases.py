"""The phases of a step one by one, on a single line: what a test of one of them, or of a forced step, needs."""

import numpy as np
import warp as wp
from plain import plain_params

import warpriver as wr
from warpriver.engine import state as engine
from warpriver.kernels.status import CUTS_NEEDED
from warpriver.meander.cutoffs import CutOff
from warpriver.meander.migration import Migrate
from warpriver.meander.resampling import Resample

# Room for points beyond those at the start.
HEADROOM = 4


def any_step(width, depth, params):
    """Any step counts as stable: it is done as it is asked for."""
    return np.full(width.shape, np.inf), np.full(width.shape, np.inf)


class State:
    """One line, whose points stay as they are, with what the phases of a step need of it; the points must be even."""

    def __init__(self, xy, width, params, *, device, depth=None, spacing=None, dtype="float64"):
        """Prepare; ``spacing`` is the even spacing in m, by default the length over the number of gaps."""
        network = wr.RiverNetwork.from_polylines([xy], width=width, depth=depth, dtype=dtype, device=device)
        count = network.point_count
        if spacing is None:
            spacing = network.channel_lengths()[0] / (count - 1)
        self.network, self.mover, self.cutter, self.sampler = network, Migrate(), CutOff(), Resample()
        phases = (self.mover, self.cutter, self.sampler)
        self.inner = engine.State(network, params, None, phases, any_step)
        self.inner.begin()
        self.inner.allocate_points(HEADROOM * count)
        self.inner.assign(self.inner.spacing, np.array([spacing]))
        self.inner.channel_substeps.fill_(1)
        self.inner.step.fill_(1.0)
        self.inner.begin_batch(steps=0)

    def run(self, phase):
        """Run the stages of one phase."""
        self.inner.run(phase.stages(self.inner))
        self.network.point_count = int(self.network.starts()[-1])

    def migrate(self, time_step):
        """Move all points over a time step, yr."""
        self.inner.params = self.inner.params.replace(time_step=time_step)
        self.inner.schedule(self.inner.substep)
        self.run(self.mover)

    def take_as_moved(self):
        """Let the points as they are count as moved."""
        wp.copy(self.inner.point_moved, self.network.point_xy)


def rate_of(xy, width, params, *, device, depth=None, dtype="float64"):
    """Migration rate of each point by the law alone, (n,) m/yr, positive to the right of the flow; no end is damped."""
    network = wr.RiverNetwork.from_polylines([xy], width=width, depth=depth, dtype=dtype, device=device)
    return wr.meander.migration_rate(network, params.replace(end_damping=0.0))[0]


def curvature_of(xy, *, device):
    """Curvature as the local term of the rate has it, (n,) 1/m, left > 0: minus the rate for k w = 1, omega = -1."""
    length = float(np.hypot(*np.diff(xy, axis=0).T).sum())
    width = length / 2.0  # any that the network accepts
    params = plain_params(migration_rate=1.0 / width, upstream_weight=0.0, sinuosity_scaling="none")
    return -rate_of(xy, width, params, device=device)


def moved(xy, width, params, time_step, *, device, depth=None):
    """Points after one move of ``time_step`` yr, before they are resampled, (n, 2) m."""
    state = State(xy, width, params, device=device, depth=depth)
    state.migrate(time_step)
    return state.inner.point_moved.numpy()[: len(xy)] + state.network.origin


def march(xy, width, params, time_step, steps, *, device, dtype="float64"):
    """Points after ``steps`` moves of exactly ``time_step`` yr each, resampled after each, without cutoffs."""
    state = State(xy, width, params, device=device, dtype=dtype)
    for _ in range(steps):
        state.migrate(time_step)
        state.run(state.sampler)
    return state.network.polylines()[0]


def resampled(xy, width, params, *, device):
    """Points sampled evenly at ``params.spacing``, (m, 2) m."""
    state = State(xy, width, params, device=device)
    state.take_as_moved()
    state.run(state.sampler)
    return state.network.polylines()[0]


def cut(xy, width, params, spacing, *, device):
    """Cut the necks of a line: the points that remain, (m, 2) m, and the loops, a list of (k, 2) m."""
    state = State(xy, width, params, device=device, spacing=spacing)
    loops, origin = state.cutter.loops, state.network.origin
    state.take_as_moved()
    state.run(state.cutter)
    records = loops.cut.numpy()[: state.inner.read_status()[CUTS_NEEDED]]
    points = loops.oxbow_xy.numpy() + origin
    after = state.inner.point_moved.numpy()[: len(xy)] + origin
    copies = np.concatenate([[False], (np.diff(after, axis=0) == 0.0).all(axis=1)])
    return after[~copies], [points[begin : begin + count] for _, begin, count, _ in records.tolist()]
