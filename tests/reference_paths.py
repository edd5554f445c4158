"""Float64 NumPy twins of the shortest-path kernels; see reference.py."""

import dataclasses

import numpy as np
import reference
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra


@dataclasses.dataclass(frozen=True)
class PathLaw:
    """Constants of one step, named as on the device; lengths in widths, times in yr."""

    time_step: float = 106.0 / 365.25
    displacement_rate: float = 60.0
    downstream_share: float = 0.9
    blur_length: float = 1.5
    smoothing: float = 0.35
    end_damping: float = 5.0
    slope_threshold: float = 0.15


# ---- push


def tangents(xy):
    """Direction at each point, from the point before to the point after; at an end, along the one segment: (n, 2)."""
    i = np.arange(len(xy))
    return xy[np.minimum(i + 1, len(xy) - 1)] - xy[np.maximum(i - 1, 0)]


def pushes(xy, width, law):
    """Push k w (C n + phi |C| t) dt of every point, before any blur: (n, 2)."""
    wide = reference.reflect_ends(xy, 1)
    curvature = reference.circle_curvature(wide)
    normal = reference.right_normals(wide)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    size = law.displacement_rate * law.time_step * width
    return (size * curvature)[:, None] * normal + (size * law.downstream_share * abs(curvature))[:, None] * tangent


def roots(xy, spacing, width, law):
    """Roots of the blur and of the smoothing at each point, and the smoothing's share c: (n,) each."""
    share = law.smoothing * law.displacement_rate * width * law.time_step / spacing**2
    blur = np.array([reference.recurrence_root(b) for b in (law.blur_length * width / spacing) ** 2])
    return blur, np.array([reference.recurrence_root(c) for c in share]), share


def fade(value, r):
    """Both coordinates of a recurrence down the line, (n, 2)."""
    return np.stack([reference.fading_sum(column, r) for column in value.T], axis=1)


def compute_push(xy, spacing, width, law):
    """Push and pull of each point after the recurrences down the channel, (n, 4)."""
    blur, smooth, share = roots(xy, spacing, width, law)
    wide = reference.reflect_ends(xy, 1)
    pull = share[:, None] * (wide[2:] - 2.0 * wide[1:-1] + wide[:-2])
    return np.concatenate([fade(pushes(xy, width, law), blur), fade(pull, smooth)], axis=1)


def shift_points(xy, half, spacing, mean_width, width, law):
    """Points after one step, from pushes and pulls that are blurred downstream already, (n, 2)."""
    blur, smooth, _ = roots(xy, spacing, width, law)
    push = fade(half[::-1, :2], blur[::-1])[::-1]
    pull = fade(half[::-1, 2:], smooth[::-1])[::-1]
    weight = reference.end_weight(len(xy), spacing, law.end_damping * mean_width)
    moved = xy.copy()
    moved[1:-1] += (weight[:, None] * push + pull)[1:-1]
    return moved


# ---- shortcuts


def cross(u, v):
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def crossing_pairs(xy):
    """(n - 1, n - 1) bool: segments i and j of a line cross each other in their insides."""
    a, b = xy[:-1, None], xy[1:, None]
    c, d = xy[None, :-1], xy[None, 1:]
    apart = cross(b - a, c - a) * cross(b - a, d - a) < 0.0
    return apart & (cross(d - c, a - c) * cross(d - c, b - c) < 0.0)


def find_shortcuts(xy, spacing, reach, min_arc, cone):
    """All pairs (i, j) that a shortcut joins, ascending, by comparing all pairs: (k, 2) int.

    Args:
        xy: (n, 2) points.
        spacing: Distance of neighbours along the channel before the move, m.
        reach: (n, n) distance in m below which two points may be joined.
        min_arc: (n, n) distance in m; points no farther apart along the channel than this never are.
        cone: Greatest angle between the lines along the strands, deg.
    """
    n = len(xy)
    i, j = np.arange(n)[:, None], np.arange(n)[None, :]
    direction = tangents(xy)
    along = direction @ direction.T
    sizes = (direction**2).sum(axis=1)
    cosine = np.cos(np.radians(cone)) if cone < 90.0 else 0.0
    joined = along**2 >= cosine**2 * np.outer(sizes, sizes)
    crossing = crossing_pairs(xy)
    joined[:-1, :-1] |= crossing
    joined[1:, 1:] |= crossing
    near = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)) < reach
    return np.argwhere(joined & near & ((j - i) * spacing > min_arc))


def savings(xy, pairs):
    """Arc that each shortcut bypasses less its own length, (k,) m."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    i, j = pairs.T
    return arc[j] - arc[i] - np.linalg.norm(xy[j] - xy[i], axis=1)


def shortest_path(xy, pairs):
    """Shortest route from the first point to the last over neighbours and shortcuts: its length and its points."""
    n = len(xy)
    edges = np.concatenate([np.stack([np.arange(n - 1), np.arange(1, n)], axis=1), pairs])
    length = np.linalg.norm(xy[edges[:, 1]] - xy[edges[:, 0]], axis=1)
    graph = coo_array((length, edges.T), shape=(n, n)).tocsr()
    distance, before = dijkstra(graph, indices=0, return_predecessors=True)
    route = [n - 1]
    while route[-1] != 0:
        route.append(before[route[-1]])
    return distance[-1], np.array(route[::-1])


def best_chain(count, links, saving):
    """Shortcuts of the route that saves most, and how much that is; ties as on the device.

    Args:
        count: Number of points.
        links: (k, 2) pairs, ascending.
        saving: (k,) what each saves.
    """
    best, route = np.zeros(count), [[] for _ in range(count)]
    for j in range(1, count):
        best[j], route[j] = best[j - 1], route[j - 1]
        for (i, _), gain in zip(links[links[:, 1] == j], saving[links[:, 1] == j], strict=True):
            if best[i] + gain > best[j]:
                best[j], route[j] = best[i] + gain, [*route[i], (int(i), j)]
    return route[-1], best[-1]
