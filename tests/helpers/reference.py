"""Float64 NumPy twins of the device kernels: slow and plain, written from the equations, to be read beside them.

A channel is an (n, 2) array of points here, from upstream to downstream; nothing is packed and nothing is in chunks.
"""

import dataclasses
import math

import numpy as np
import reference_terrain
from scipy.interpolate import CubicHermiteSpline


@dataclasses.dataclass(frozen=True)
class Law:
    """Constants of one migration step, named as on the device; lengths in m, times in yr."""

    time_step: float = 106.0 / 365.25
    migration_rate: float = 60.0
    reference_width: float = 0.0
    friction: float = 0.011
    memory_length: float = 0.0
    curvature_saturation: float = 0.0
    local_weight: float = -1.0
    upstream_weight: float = 2.5
    scale_local: int = 0
    scale_upstream: int = 1
    end_damping: float = 5.0
    slope_threshold: float = 0.15


def reflect_ends(xy, extra=2):
    """Continue a line by ``extra`` points at each end, as its point reflection through the end: (n + 2 extra, 2)."""
    head = 2.0 * xy[0] - xy[extra:0:-1]
    foot = 2.0 * xy[-1] - xy[-2 : -2 - extra : -1]
    return np.concatenate([head, xy, foot])


# ---- migration


def circle_curvature(xy):
    """Curvature of the circle through three points in a row, left > 0: 4 area / (product of the sides), (n - 2,)."""
    before, here, after = xy[:-2], xy[1:-1], xy[2:]
    u, v = here - before, after - before
    twice_area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    sides = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) * np.linalg.norm(after - here, axis=1)
    return np.divide(2.0 * twice_area, sides, out=np.zeros(len(sides)), where=sides > 0.0)


def curvature_and_changes(xy):
    """Curvature at every point, and its first and second difference along the line, (n,) each; it is 0 at the ends."""
    wide = circle_curvature(reflect_ends(xy, 2))
    return wide[1:-1], 0.5 * (wide[2:] - wide[:-2]), wide[:-2] - 2.0 * wide[1:-1] + wide[2:]


def decay_weights(x):
    """Weights (q, w0, w1) of a segment of optical depth x, by the integrals that define them.

    A point z e-foldings up from the lower end counts with e^(-z) dz; a linear v is there v1 + (v0 - v1) z / x.
    """
    if x == 0.0:
        return 1.0, 0.0, 0.0
    # In pieces of at most one e-folding each, which 20 nodes integrate to rounding; beyond 60 nothing counts.
    nodes, node_weights = np.polynomial.legendre.leggauss(20)
    edges = np.linspace(0.0, min(x, 60.0), int(np.ceil(min(x, 60.0))) + 1)
    half = 0.5 * np.diff(edges)[:, None]
    z = (edges[:-1, None] + half * (nodes + 1.0)).ravel()
    density = (half * node_weights).ravel() * np.exp(-z)
    return np.exp(-x), np.sum(density * (z / x)), np.sum(density * (1.0 - z / x))


def upstream_mean(value, optical_depth):
    """Weighted mean of the values upstream of every point, by the double sum over points and their segments.

    Args:
        value: (n,), linear between the points and 0 above the first.
        optical_depth: (n - 1,), of each segment.
    """
    weights = np.array([decay_weights(x) for x in optical_depth]).reshape(-1, 3)
    share = weights[:, 1] * value[:-1] + weights[:, 2] * value[1:]
    mean = np.zeros(len(value))
    for i in range(1, len(value)):
        # Optical depth between the lower end of each segment upstream and point i.
        between = np.concatenate([np.cumsum(optical_depth[1:i][::-1])[::-1], [0.0]])
        mean[i] = np.sum(share[:i] * np.exp(-between))
    return mean


def decay(width, depth, law):
    """Decay alpha of the memory, 1/m: over L widths where a length in widths is given, else over d / (2 f)."""
    return 1.0 / (law.memory_length * width) if law.memory_length > 0.0 else 2.0 * law.friction / depth


def optical_depths(spacing, width, depth, law):
    """Optical depth alpha ds of each segment of even length, alpha as the mean of both ends, (n - 1,)."""
    alpha = decay(width, depth, law)
    return 0.5 * (alpha[1:] + alpha[:-1]) * spacing


def felt_curvature(curvature, width, law):
    """c0 tanh(w C / c0) / w, which no bend exceeds by more than c0 / w; C itself without a limit."""
    c0 = law.curvature_saturation
    return c0 / width * np.tanh(width * curvature / c0) if c0 > 0.0 else curvature


def straightened(curvature, width, law):
    """What the local term straightens: the felt curvature, and with a limit all of it beyond 1 / w."""
    beyond = curvature - np.clip(curvature, -1.0 / width, 1.0 / width) if law.curvature_saturation > 0.0 else 0.0
    return felt_curvature(curvature, width, law) + beyond


def felt_bend(curvature, slope, bend, width, law):
    """Second derivative along the line of the felt curvature, by the chain rule from those of C: f' C'' + f'' C'^2."""
    c0 = law.curvature_saturation
    if c0 == 0.0:
        return bend
    x = width * curvature / c0
    return (bend - 2.0 * width / c0 * np.tanh(x) * slope**2) / np.cosh(x) ** 2


def sinuosity_factor(xy, spacing):
    """sigma^(-2/3), with sigma the length over the chord, never below 1."""
    chord = np.linalg.norm(xy[-1] - xy[0])
    return min(chord / (spacing * (len(xy) - 1)), 1.0) ** (2.0 / 3.0)


def strength_of(width, law):
    """Rate times radius of a bend: k w, with k in proportion to the width where a reference width is given."""
    relative = width / law.reference_width if law.reference_width > 0.0 else 1.0
    return law.migration_rate * relative * width


def migration_rate(xy, spacing, width, depth, law, mean_width=None):
    """Rate mu of every point before any smoothing, m/yr, positive to the right: (n,).

    mu = omega mu0 + e sigma^(-2/3) gamma (upstream mean of mu0), mu0 = k w C, or k c0 tanh(w C / c0), with C
    corrected to fourth order: minus a twelfth of its second difference; the linear quadrature takes as much off mu0.
    e fades to 0 at both ends, over a reach in mean widths of the channel, by default the mean of those given.
    """
    curvature, slope, change = curvature_and_changes(xy)
    curvature = curvature - change / 12.0
    strength, felt = strength_of(width, law), felt_curvature(curvature, width, law)
    factor = sinuosity_factor(xy, spacing)
    local = law.local_weight * (factor if law.scale_local else 1.0)
    gamma = law.upstream_weight * (factor if law.scale_upstream else 1.0)
    value = strength * (felt - felt_bend(curvature, slope, change, width, law) / 12.0)
    upstream = upstream_mean(value, optical_depths(spacing, width, depth, law))
    fade = end_weight(len(xy), spacing, law.end_damping * (np.mean(width) if mean_width is None else mean_width))
    return local * strength * straightened(curvature, width, law) + gamma * fade * upstream


def implicit_share(xy, spacing, width, law):
    """Factor c of (I - c d2): the least that keeps 1 - (16/3) b / (1 + 4 c) at or above -1/2, b = D dt / h^2."""
    diffusivity = -law.local_weight * strength_of(width, law)
    if law.scale_local:
        diffusivity *= sinuosity_factor(xy, spacing)
    b = diffusivity * law.time_step / spacing**2
    return max(0.0, ((16.0 / 3.0) * b / 1.5 - 1.0) / 4.0)


def recurrence_root(c):
    """Root r < 1 of c r^2 - (1 + 2 c) r + c = 0, so that 1 / (1 - c d2) = (1 - r)^2 / ((1 - r E)(1 - r / E))."""
    if c == 0.0:
        return 0.0
    roots = np.roots([c, -(1.0 + 2.0 * c), c])
    return float(np.min(roots.real))


def point_roots(xy, spacing, width, law):
    """Root of each point, by its own width: (n,)."""
    return np.array([recurrence_root(implicit_share(xy, spacing, w, law)) for w in np.broadcast_to(width, len(xy))])


def fading_sum(value, r):
    """u_i = (1 - r_i) v_i + r_i u_(i - 1) from u_0 = 0: the first half of the smoothing, of numbers or vectors."""
    u, r = np.zeros(value.shape), np.broadcast_to(r, len(value))
    for i in range(1, len(value)):
        u[i] = (1.0 - r[i]) * value[i] + r[i] * u[i - 1]
    return u


def implicit_smoothing(value, c):
    """Solve (I - c d2) u = v with u = 0 beyond both ends, as a dense system."""
    n = len(value)
    second_difference = np.eye(n, k=1) - 2.0 * np.eye(n) + np.eye(n, k=-1)
    return np.linalg.solve(np.eye(n) - c * second_difference, value)


def end_weight(count, spacing, reach):
    """Smoothstep of each point's distance along the channel to its nearer end, 1 from ``reach`` on, (count,)."""
    i = np.arange(count)
    away = np.minimum(i, count - 1 - i) * spacing
    t = np.ones(count) if reach == 0.0 else np.minimum(away / reach, 1.0)
    return 3.0 * t**2 - 2.0 * t**3


def right_normals(xy):
    """Unit normals to the right of the flow at the inner points, by the chord between both neighbours: (n - 2, 2)."""
    chord = xy[2:] - xy[:-2]
    size = np.linalg.norm(chord, axis=1, keepdims=True)
    right = np.stack([chord[:, 1], -chord[:, 0]], axis=1)
    return np.divide(right, size, out=np.zeros_like(right), where=size > 0.0)


def velocities(xy, rate):
    """Rate times the normal to the right of the flow, at the ends that of the line's reflection: (n, 2)."""
    return right_normals(reflect_ends(xy, 1)) * rate[:, None]


def slope_weights(xy, height, grid, law):
    """Factor g of every point: 1 on flat ground, 0 from the threshold on and where there is no ground, (n,)."""
    slope = np.array([np.hypot(*reference_terrain.gradient_at(height, grid, p)) for p in xy])
    t = np.minimum(np.nan_to_num(slope, nan=np.inf) / law.slope_threshold, 1.0)
    return 1.0 - 3.0 * t**2 + 2.0 * t**3


def mobility(xy, height, grid, law):
    """Greatest factor g of a channel's points; a channel with a point freer than 0.9 counts as free, 1."""
    greatest = slope_weights(xy, height, grid, law).max()
    return 1.0 if greatest >= 0.9 else greatest


def step_count(travel, carried, width, max_speed, mobility, time_step):
    """Equal parts of a time step: no part longer than its limits allow; 0 where nothing moves."""
    if mobility == 0.0 or width == 0.0:
        return 0
    as_found = math.inf if max_speed == 0.0 else 0.5 * width / max_speed
    allowed = min(carried / mobility, max(travel / mobility, as_found))
    # A millionth of slack: a step that divides evenly is not rounded up to one part more.
    return min(max(1, math.ceil(time_step / allowed * (1.0 - 1e-6))), 1_000_000) if allowed > 0.0 else 1_000_000


def own_substeps(parts, total):
    """Which of ``total`` sub-steps a channel takes that needs ``parts``: the first at or after each even share."""
    return [math.ceil(j * total / parts) for j in range(parts)]


def move_points(xy, velocity, spacing, width, law, ground=1.0):
    """Points after one step, from velocities v smoothed downstream already: p + v g dt, both ends held; ground = g."""
    r = point_roots(xy, spacing, width, law)
    smoothed = fading_sum(velocity[::-1], r[::-1])[::-1] * np.reshape(ground, (-1, 1))
    moved = xy.copy()
    moved[1:-1] += smoothed[1:-1] * law.time_step
    held = np.broadcast_to(1.0 - np.asarray(ground), len(xy))
    return moved + held[:, None] * straightening(xy, spacing, np.broadcast_to(width, len(xy)), law)


def straightening(xy, spacing, width, law):
    """How far points go in a step where the line turns on less than its width: D dt / l^2 d2p, 1/4 d2p at most.

    The second difference d2p is over the points that are diffused past in the step, n each way, and fewer near the
    ends; l = n h. The line turns where |d2p| / l^2 > 1 / w.
    """
    diffused = -law.local_weight * strength_of(width, law) * law.time_step
    farthest = 1 + int(2.0 * np.sqrt(diffused.max()) / spacing)
    away = np.zeros(xy.shape)
    for i in range(1, len(xy) - 1):
        n = min(farthest, i, len(xy) - 1 - i)
        bent = xy[i - n] - 2.0 * xy[i] + xy[i + n]
        if np.hypot(*bent) * width[i] > (n * spacing) ** 2:
            away[i] = min(diffused[i] / (n * spacing) ** 2, 0.25) * bent
    return away


# ---- cutoffs


def find_necks(xy, spacing, reach, min_arc):
    """First later point within reach of each point, -1 if none, by comparing all pairs: (n,) int.

    Args:
        xy: (n, 2) points.
        spacing: Distance of neighbours along the channel before the move, m.
        reach: (n, n) distance in m below which two points join.
        min_arc: (n, n) distance in m; points no farther apart along the channel than this never join.
    """
    neck = np.full(len(xy), -1)
    for i in range(len(xy)):
        for j in range(i + 1, len(xy)):
            if (j - i) * spacing > min_arc[i, j] and np.hypot(*(xy[j] - xy[i])) < reach[i, j]:
                neck[i] = j
                break
    return neck


def select_cuts(neck):
    """Necks (i, j) kept on a walk down the channel: the first one met, then the first from its end on, and so forth."""
    kept, i = [], 0
    while i < len(neck):
        if neck[i] >= 0:
            kept.append((i, int(neck[i])))
            i = int(neck[i])
        else:
            i += 1
    return kept


def cut_necks(xy, kept):
    """Line after its loops were pulled onto the points where they begin, and the loops with both their ends."""
    after, loops = xy.copy(), []
    for i, j in kept:
        loops.append(xy[i : j + 1].copy())
        after[i:j] = xy[i]
    return after, loops


# ---- resampling

# Arc lengths are whole numbers of this, m: sums of them are exact.
QUANTUM = 2.0**-32


def segment_quanta(length):
    """Lengths in m as whole numbers of quanta, halves to even."""
    return np.rint(length / QUANTUM).astype(np.int64)


def arc_quanta(xy):
    """Arc length of each point of a line from the first one, in quanta: (n,) int64."""
    segments = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    return np.concatenate([[0], np.cumsum(segment_quanta(segments))])


def distinct_points(xy):
    """Indices of the points left when each run of copies counts once: its first, but the channel's last point stays."""
    kept = [0]
    for i in range(1, len(xy) - 1):
        if (xy[i] != xy[kept[-1]]).any():
            kept.append(i)
    if len(kept) > 1 and (xy[kept[-1]] == xy[-1]).all():
        kept.pop()
    return np.array([*kept, len(xy) - 1])


def sample_count(length, spacing):
    """Number of points for a length: round(length / spacing) segments, halves up, and at least 2."""
    return max(2, int(np.floor(length / spacing + 0.5))) + 1


def three_point_tangents(t, xy):
    """Derivative at each inner point of the parabola through it and its neighbours: (n - 2, 2)."""
    tangents = []
    for k in range(1, len(t) - 1):
        a, b, c = t[k - 1 : k + 2]
        slopes = np.array([(b - c) / ((a - b) * (a - c)), 1 / (b - a) + 1 / (b - c), (b - a) / ((c - a) * (c - b))])
        tangents.append(slopes @ xy[k - 1 : k + 2])
    return np.array(tangents)


def cubic_through(xy):
    """The C1 cubic through distinct points, by chord length: Hermite with tangents of fourth order.

    A three-point tangent is off by (la lb / 6) p''', and p''' is the second derivative of the tangents themselves. The
    line is extended by its point reflection at both ends.
    """
    count = len(xy)
    if count == 2:  # the reflection of a single segment has one inner point on each side only
        wide = xy[0] + np.arange(-2, 4)[:, None] * (xy[1] - xy[0])
    else:
        wide = reflect_ends(xy, 2)
    t = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(wide, axis=0), axis=1))])
    t -= t[2]
    tangent = three_point_tangents(t, wide)
    la, lb = np.diff(t)[1:-2], np.diff(t)[2:-1]
    bend = 2.0 * (np.diff(tangent, axis=0)[1:] / lb[:, None] - np.diff(tangent, axis=0)[:-1] / la[:, None])
    third = bend / (la + lb)[:, None]
    corrected = tangent[1:-1] - (la * lb / 6.0)[:, None] * third
    return CubicHermiteSpline(t[2:-2], xy, corrected), t[2:-2]


def resample(xy, spacing, section=None):
    """Even points on the cubic through a moved line, copies skipped; with it the sections, linear in between.

    Where a point lies on its segment is told by arc lengths in whole quanta.

    Returns:
        Points (m, 2), sections (m, 2) or None, and the even spacing.
    """
    kept = distinct_points(xy)
    curve, t = cubic_through(xy[kept])
    arc = arc_quanta(xy[kept]) * QUANTUM
    count = sample_count(arc[-1], spacing)
    target = np.linspace(0.0, arc[-1], count)
    points = curve(np.interp(target, arc, t))
    points[0], points[-1] = xy[0], xy[-1]
    if section is not None:
        section = np.stack([np.interp(target, arc, column) for column in section[kept].T], axis=1)
    return points, section, arc[-1] / (count - 1)
