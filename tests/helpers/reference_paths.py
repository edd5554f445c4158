"""Float64 NumPy twins of the shortest-path kernels, on lines and on rings; see reference.py."""

import dataclasses

import numpy as np
import reference
import reference_rings as rings
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
    """Arc that each shortcut bypasses, in whole quanta, less its own length, (k,) m."""
    arc = reference.arc_quanta(xy) * reference.QUANTUM
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


# ---- rings


def ring_push(xy, spacing, width, law):
    """As ``compute_push``, round and round."""
    blur, smooth, share = roots(xy, spacing, width, law)
    wide = rings.wrapped(xy, 1)
    normal = reference.right_normals(wide)
    curvature = reference.circle_curvature(wide)[:, None]
    along = law.downstream_share * abs(curvature) * np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    push = (law.displacement_rate * law.time_step * width)[:, None] * (curvature * normal + along)
    pull = share[:, None] * (wide[2:] - 2.0 * wide[1:-1] + wide[:-2])
    return np.concatenate([ring_fade(push, blur), ring_fade(pull, smooth)], axis=1)


def ring_fade(value, r):
    """Both coordinates of a recurrence down a ring, (n, 2)."""
    return rings.fading_sum(value, r)


def ring_shift(xy, half, spacing, mean_width, width, law):
    """As ``shift_points``; outward goes what the smoothing pulls in the regular ring of as many points."""
    blur, smooth, _ = roots(xy, spacing, width, law)
    push = ring_fade(half[::-1, :2], blur[::-1])[::-1]
    pull = ring_fade(half[::-1, 2:], smooth[::-1])[::-1]
    c = law.smoothing * law.displacement_rate * mean_width * law.time_step / spacing**2
    radius, wave = spacing / (2.0 * np.sin(np.pi / len(xy))), 2.0 - 2.0 * np.cos(2.0 * np.pi / len(xy))
    swell = np.sign(rings.area(xy)) * radius * c * wave / (1.0 + c * wave)
    return xy + push + pull + swell * reference.right_normals(rings.wrapped(xy, 1))


def ring_shortcuts(xy, spacing, reach, min_arc, cone):
    """As ``find_shortcuts``; the arc between two points is the shorter way round."""
    n = len(xy)
    i, j = np.arange(n)[:, None], np.arange(n)[None, :]
    wide = rings.wrapped(xy, 1)
    direction = wide[2:] - wide[:-2]
    along, sizes = direction @ direction.T, (direction**2).sum(axis=1)
    cosine = np.cos(np.radians(cone)) if cone < 90.0 else 0.0
    crossing = crossing_pairs(np.concatenate([xy, xy[:1]]))
    joined = along**2 >= cosine**2 * np.outer(sizes, sizes)
    joined |= crossing | np.roll(crossing, (1, 1), axis=(0, 1))
    near = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)) < reach
    return np.argwhere(joined & near & (j > i) & (np.minimum(j - i, n - j + i) * spacing > min_arc))


def ring_head(count, pairs, longer):
    """Point at which the route round a ring begins: in the middle of a stretch without ends of shortcuts.

    With ``longer`` of the longest one; one of eight points or more that no shortcut passes over by the shorter way goes
    before all that are. Else of the first one of eight points or more, that with the first point before all.
    """
    ends, passed = np.zeros(count, bool), np.zeros(count, bool)
    ends[pairs.ravel()] = True
    for i, j in pairs:
        inside = (np.arange(count) > i) & (np.arange(count) < j)
        outside = (np.arange(count) < i) | (np.arange(count) > j)
        passed |= inside if 2 * (j - i) <= count else outside
    best, head = 0, 0
    begins = [k for k in range(count) if not ends[k] and ends[k - 1]]
    # The stretch across the seam comes last.
    for k in sorted(begins, key=lambda k: (k == 0 or not ends[k:].any(), k)):
        size = int(np.argmax(np.roll(ends, -k)))
        rank = size + count * (size >= 8 and not passed[k])
        if not longer:
            holds_first = not ends[0] and (k == 0 or not ends[k:].any())
            rank = (size >= 8) * (1 + holds_first)
        if rank > best:
            best, head = rank, (k + size // 2) % count
    return head


def ring_edges(count, pairs, head, longer):
    """Shortcuts as they run round a ring from its head: (m, 2) begin and end, and which pairs they are, (m,).

    None begins or ends within four points of the head; else one passes over the ring's first point only if the longer
    part goes on.
    """
    place = (pairs - head) % count
    edges = np.where((place[:, 0] > place[:, 1])[:, None], pairs[:, ::-1], pairs)
    place.sort(axis=1)
    allowed = (place[:, 0] >= 4) & (place[:, 1] <= count - 4)
    if not longer:
        allowed &= (edges[:, 0] < edges[:, 1]) | (edges[:, 1] == 0)
    return edges[allowed], np.flatnonzero(allowed)


def ring_chain(count, edges, saving, head):
    """As ``best_chain``, from the head of a ring round to it."""
    place = (edges - head) % count
    order = np.lexsort((place[:, 1], place[:, 0]))
    chain, gain = best_chain(count, place[order], saving[order])
    return [((i + head) % count, (j + head) % count) for i, j in chain], gain


def ring_length(xy, kept):
    """Length of the closed route that takes those shortcuts."""
    left = np.ones(len(xy), bool)
    for i, j in kept:
        left[np.arange(i + 1, j if j > i else j + len(xy)) % len(xy)] = False
    return rings.segments(xy[left]).sum()


def shortest_ring(xy, edges, starts):
    """Length of the shortest closed route once round a ring from any of those points, by a search on two laps."""
    n = len(xy)
    segments = np.stack([np.arange(n), (np.arange(n) + 1) % n], axis=1)
    every = np.concatenate([segments, edges])
    length = np.linalg.norm(xy[every[:, 1]] - xy[every[:, 0]], axis=1)
    end = np.where(every[:, 1] > every[:, 0], every[:, 1], every[:, 1] + n)
    laps = np.concatenate([np.stack([every[:, 0], end], axis=1), np.stack([every[:, 0], end], axis=1) + n])
    inside = laps[:, 1] < 2 * n
    graph = coo_array((np.tile(length, 2)[inside], laps[inside].T), shape=(2 * n, 2 * n)).tocsr()
    starts = np.atleast_1d(starts)
    return dijkstra(graph, indices=starts)[np.arange(len(starts)), starts + n].min()
