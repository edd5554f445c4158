"""The phases of a step one by one, on a single line: what a test of one of them, or of a forced step, needs."""

import numpy as np
import warp as wp
from scipy.spatial import cKDTree

import warpriver as wr
from warpriver.kernels.polyline import CUTS_NEEDED
from warpriver.meander.buffers import StepBuffers, StepChannels
from warpriver.meander.cutoffs import cut_off
from warpriver.meander.migration import migrate, migration_law
from warpriver.meander.resampling import resample
from warpriver.meander.schedule import schedule_channels
from warpriver.meander.stages import run_stages
from warpriver.network import PRECISIONS

# Room for points beyond those at the start.
HEADROOM = 4
# A step so short that none of the local term is treated implicitly, yr.
INSTANT = 1e-9


class State:
    """One line, whose points stay as they are, with what the phases of a step need of it; the points must be even."""

    def __init__(self, xy, width, params, *, device, depth=None, spacing=None, dtype="float64"):
        """Prepare; ``spacing`` is the even spacing in m, by default the length over the number of gaps."""
        network = wr.RiverNetwork.from_polylines([xy], width=width, depth=depth, dtype=dtype, device=device)
        count = network.point_count
        if spacing is None:
            spacing = network.channel_lengths()[0] / (count - 1)
        widest = max(w.max() for w in network.point_widths())
        self.network, self.params, self.dtype = network, params, dtype
        self.buffers = StepBuffers(network, HEADROOM * count, 64, HEADROOM * count)
        self.channels = StepChannels(network, 1, mobile=False)
        self.channels.fill(
            network,
            form=np.array([[network.channel_width[0], network.channel_depth[0], widest, params.spacing]]),
            spacing=np.array([spacing]),
            # Any step counts as stable: it is done as it is asked for.
            limit=np.array([[np.inf, np.inf, widest]]),
            nodes=np.array([[0, 1]]),
        )
        self.channels.parts.fill_(1)
        self.channels.step.fill_(1.0)
        self.channels.deal_out(network, self.buffers, anew=True)
        room = wp.zeros(HEADROOM * count, dtype=PRECISIONS[dtype][1], device=device)
        wp.copy(room, network.point_xy, count=count)
        network.point_xy = room

    def run(self, stages):
        run_stages(stages, self.channels.whole, self.channels.slabs)
        self.network.point_count = int(self.network.starts()[-1])

    def migrate(self, time_step):
        law = migration_law(self.params, self.dtype)
        move = migrate(self.network, self.channels, self.buffers, None, law)
        schedule_channels(self.network, self.channels, self.buffers, time_step, self.channels.substep)
        self.run(move)

    def take_as_moved(self):
        """Let the points as they are count as moved."""
        wp.copy(self.buffers.point_moved, self.network.point_xy)


def rate_of(xy, width, params, *, device, depth=None, time_step=INSTANT, dtype="float64"):
    """Migration rate of each point as it stands, (n,) m/yr, positive to the right of the flow."""
    state = State(xy, width, params, device=device, depth=depth, dtype=dtype)
    state.migrate(time_step)
    return state.buffers.point_rate.numpy()[: len(xy)].astype(np.float64)


def curvature_of(xy, *, device):
    """Curvature as the local term of the rate has it, (n,) 1/m, left > 0: minus the rate for k w = 1, omega = -1."""
    length = float(np.hypot(*np.diff(xy, axis=0).T).sum())
    width = length / 2.0  # any that the network accepts
    params = wr.MeanderParams(migration_rate=1.0 / width, upstream_weight=0.0, sinuosity_scaling="none")
    return -rate_of(xy, width, params, device=device)


def moved(xy, width, params, time_step, *, device, depth=None):
    """Points after one move of ``time_step`` yr, before they are resampled, (n, 2) m."""
    state = State(xy, width, params, device=device, depth=depth)
    state.migrate(time_step)
    return state.buffers.point_moved.numpy()[: len(xy)] + state.network.origin


def march(xy, width, params, time_step, steps, *, device, dtype="float64"):
    """Points after ``steps`` moves of exactly ``time_step`` yr each, resampled after each, without cutoffs."""
    state = State(xy, width, params, device=device, dtype=dtype)
    for _ in range(steps):
        state.migrate(time_step)
        state.run(resample(state.network, state.channels, state.buffers))
    return state.network.polylines()[0]


def resampled(xy, width, params, *, device):
    """Points sampled evenly at ``params.spacing``, (m, 2) m."""
    state = State(xy, width, params, device=device)
    state.take_as_moved()
    state.run(resample(state.network, state.channels, state.buffers))
    return state.network.polylines()[0]


def cut(xy, width, params, spacing, *, device):
    """Cut the necks of a line: the points that remain, (m, 2) m, and the loops, a list of (k, 2) m."""
    state = State(xy, width, params, device=device, spacing=spacing)
    buffers, origin = state.buffers, state.network.origin
    state.take_as_moved()
    state.run(cut_off(state.network, state.channels, buffers, params))
    records = buffers.cut.numpy()[: buffers.read_status()[CUTS_NEEDED]]
    points = buffers.oxbow_xy.numpy() + origin
    after = buffers.point_moved.numpy()[: len(xy)] + origin
    copies = np.concatenate([[False], (np.diff(after, axis=0) == 0.0).all(axis=1)])
    return after[~copies], [points[begin : begin + count] for _, begin, count, _ in records]


def crossings(xy):
    """Pairs of segments of a line that cross, (k, 2), the earlier first."""
    a, b = xy[:-1], xy[1:]
    pair = cKDTree(0.5 * (a + b)).query_pairs(np.hypot(*(b - a).T).max(), output_type="ndarray")
    pair = np.sort(pair[abs(pair[:, 0] - pair[:, 1]) > 1], axis=1)

    def side(p, q, r):
        return (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])

    i, j = pair.T
    apart = side(a[i], b[i], a[j]) * side(a[i], b[i], b[j]) < 0.0
    return pair[apart & (side(a[j], b[j], a[i]) * side(a[j], b[j], b[i]) < 0.0)]
