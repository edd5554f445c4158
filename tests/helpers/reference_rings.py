"""Float64 NumPy twins for rings: channels whose last point is joined to the first, which is not repeated."""

import numpy as np
import reference
from scipy.interpolate import CubicHermiteSpline

# Points that a ring has at least.
RING_POINTS = 8


def wrapped(values, extra):
    """A ring's values continued by ``extra`` at each end, which may be more than there are, (n + 2 extra, ...)."""
    return values[np.arange(-extra, len(values) + extra) % len(values)]


def segments(xy):
    """Length of the segment after each point, (n,); the last one closes the ring."""
    return np.linalg.norm(np.roll(xy, -1, axis=0) - xy, axis=1)


def area(xy):
    """Area that a ring encloses, m2, positive where it turns left."""
    after = np.roll(xy, -1, axis=0)
    return 0.5 * np.sum(xy[:, 0] * after[:, 1] - after[:, 0] * xy[:, 1])


def roundness(xy, spacing):
    """sigma^(-2/3), sigma the length of a ring over the circumference of the circle of the same area, never below 1."""
    return min(2.0 * np.sqrt(np.pi * abs(area(xy))) / (spacing * len(xy)), 1.0) ** (2.0 / 3.0)


def upstream_mean(value, optical_depth):
    """Weighted mean of the values upstream of every point, round and round the ring without end, (n,).

    Args:
        value: (n,), linear between the points.
        optical_depth: (n,), of the segment after each point.
    """
    n = len(value)
    weights = np.array([reference.decay_weights(x) for x in optical_depth])
    share = weights[:, 1] * value + weights[:, 2] * np.roll(value, -1)
    # All laps before add up to a geometric series.
    laps = -1.0 / np.expm1(-optical_depth.sum())
    mean = np.zeros(n)
    for i in range(n):
        upstream = np.arange(i - 1, i - 1 - n, -1) % n
        between = np.concatenate([[0.0], np.cumsum(optical_depth[upstream])[:-1]])
        mean[i] = laps * np.sum(share[upstream] * np.exp(-between))
    return mean


def migration_rate(xy, spacing, width, depth, law):
    """As ``reference.migration_rate``."""
    curvature = reference.circle_curvature(wrapped(xy, 2))
    change, slope = curvature[:-2] - 2.0 * curvature[1:-1] + curvature[2:], 0.5 * (curvature[2:] - curvature[:-2])
    curvature = curvature[1:-1] - change / 12.0
    strength, felt = reference.strength_of(width, law), reference.felt_curvature(curvature, width, law)
    factor = roundness(xy, spacing)
    local = law.local_weight * (factor if law.scale_local else 1.0)
    gamma = law.upstream_weight * (factor if law.scale_upstream else 1.0)
    alpha = np.broadcast_to(reference.decay(width, depth, law), len(xy))
    optical_depth = 0.5 * (alpha + np.roll(alpha, -1)) * spacing
    value = strength * (felt - reference.felt_bend(curvature, slope, change, width, law) / 12.0)
    bent = reference.straightened(curvature, width, law)
    return local * strength * bent + gamma * upstream_mean(value, optical_depth)


def roots(xy, spacing, width, law):
    """Root of the smoothing at each point, by its own width, (n,)."""
    if law.scale_local:
        # The twin for lines scales by its own sinuosity; a weight takes the place of the factor.
        law = type(law)(**{**vars(law), "scale_local": 0, "local_weight": law.local_weight * roundness(xy, spacing)})
    return np.array([reference.recurrence_root(reference.implicit_share(xy, spacing, w, law)) for w in width])


def fading_sum(value, r):
    """u_i = (1 - r_i) v_i + r_i u_(i - 1) round the ring, as a dense system, of vectors: (n, 2)."""
    n = len(value)
    before = np.roll(np.eye(n), -1, axis=1)  # row i picks i - 1
    return np.linalg.solve(np.eye(n) - r[:, None] * before, (1.0 - r)[:, None] * value)


def velocities(xy, rate):
    """Rate times the normal to the right of the flow: (n, 2)."""
    return reference.right_normals(wrapped(xy, 1)) * rate[:, None]


def move_points(xy, velocity, r, law):
    """Points after one step, from velocities smoothed downstream already and the roots; nothing is held."""
    return xy + law.time_step * fading_sum(velocity[::-1], r[::-1])[::-1]


def find_necks(xy, spacing, reach, min_arc):
    """As ``reference.find_necks``; the distance along the ring is the shorter way round."""
    n = len(xy)
    neck = np.full(n, -1)
    for i in range(n):
        for j in range(i + 1, n):
            arc = min(j - i, n - j + i) * spacing
            if arc > min_arc[i, j] and np.hypot(*(xy[j] - xy[i])) < reach[i, j]:
                neck[i] = j
                break
    return neck


def select_cuts(neck, longer):
    """Cuts of a step, each (i, j, outer): the points i .. j are cut off or, where ``outer``, those outside of them.

    On a walk down the ring; every cut leaves eight points at least. With ``longer`` the longer part goes on: where that
    is the inside, all that lies outside goes as one loop, and only loops inside are cut after it.
    """
    kept, left, cursor, limit = [], len(neck), 0, len(neck)
    for i, j in enumerate(neck.tolist()):
        if j < 0 or i < cursor or j > limit:
            continue
        inside, outside = j - i, left - (j - i)
        if not longer or inside <= outside:
            if outside >= RING_POINTS:
                kept.append((i, j, False))
                left, cursor = outside, j
        elif limit == len(neck) and inside >= RING_POINTS:
            kept, left, cursor, limit = [(i, j, True)], inside, i, j
    return kept


def cut_necks(xy, kept):
    """Ring after its loops were pulled together, and the loops with both their ends."""
    after, loops = xy.copy(), []
    for i, j, outer in kept:
        index = np.arange(j, i + len(xy) + 1) % len(xy) if outer else np.arange(i, j + 1)
        loops.append(xy[index])
        after[index[:-1]] = xy[index[0]]
    return after, loops


def rounded_segments(xy):
    """Lengths of the segments in whole quanta, but for the one that closes the ring: (n,) m."""
    h = segments(xy)
    return np.append(reference.segment_quanta(h[:-1]) * reference.QUANTUM, h[-1])


def resample(xy, spacing, section=None):
    """As ``reference.resample``: even points on the closed cubic, the first one where the ring's first point is."""
    kept = [i for i in range(len(xy)) if i == 0 or (xy[i] != xy[i - 1]).any()]
    while (xy[kept[-1]] == xy[0]).all():
        kept.pop()
    points, n = xy[kept], len(kept)
    h = segments(points)
    arc = np.concatenate([[0.0], np.cumsum(rounded_segments(points))])
    length = arc[-1]
    wide = points[np.arange(-2, n + 3) % n]
    t = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(wide, axis=0), axis=1))])
    t -= t[2]
    tangent = reference.three_point_tangents(t, wide)
    la, lb = np.diff(t)[1:-2], np.diff(t)[2:-1]
    bend = 2.0 * (np.diff(tangent, axis=0)[1:] / lb[:, None] - np.diff(tangent, axis=0)[:-1] / la[:, None])
    corrected = tangent[1:-1] - (la * lb / 6.0)[:, None] * bend / (la + lb)[:, None]
    curve = CubicHermiteSpline(t[2:-2], wide[2:-2], corrected)
    count = max(RING_POINTS, int(np.floor(length / spacing + 0.5)))
    target = length / count * np.arange(count)
    if section is not None:
        closed = np.concatenate([section[kept], section[kept][:1]])
        section = np.stack([np.interp(target, arc, c) for c in closed.T], axis=1)
    return curve(np.interp(target, arc, np.concatenate([[0.0], np.cumsum(h)]))), section, length / count


def smooth(xy, weight, closed=True):
    """One pass p += w ((p_before + p_after) / 2 - p); the ends of a line stay."""
    change = weight * (0.5 * (np.roll(xy, 1, axis=0) + np.roll(xy, -1, axis=0)) - xy)
    if not closed:
        change[[0, -1]] = 0.0
    return xy + change
