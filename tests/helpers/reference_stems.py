"""Float64 NumPy twins of rivers whose links go on as one through junctions: see reference.py, which they build on.

A stem is a list of links here, each an (n, 2) array of points from upstream to downstream; the last point of a link is
the first one of the next.
"""

import numpy as np
import reference


def join_links(lines):
    """Points of a stem, each junction once: (n, 2); and the index of the first point of each link in them."""
    first = np.concatenate([[0], np.cumsum([len(line) - 1 for line in lines])[:-1]])
    return np.concatenate([lines[0], *(line[1:] for line in lines[1:])]), first


def split_links(values, lines):
    """Values at the points of a stem, by link: those at a junction belong to both."""
    first = join_links(lines)[1]
    return [values[a : a + len(line)] for a, line in zip(first, lines, strict=True)]


def by_segment(values, lines):
    """One value a link, or one a point of each link, at the upper and the lower end of each segment of the stem."""
    spread = [np.broadcast_to(value, len(line)) for value, line in zip(values, lines, strict=True)]
    return np.concatenate([v[:-1] for v in spread]), np.concatenate([v[1:] for v in spread])


def curvature_and_bend(xy, spacing):
    """Curvature at every point of a line of uneven spacing, and its first and second derivative along the line.

    A circle through three points with segments a and b has the curvature at (b - a) / 3 beyond the middle one, plus
    (a^2 + a b + b^2) / 36 times its second derivative. The parabola through three such values gives both here.

    Args:
        xy: (n, 2) points; the line goes on straight beyond both ends, as its point reflection.
        spacing: (n - 1,) length of each segment.
    """
    k = reference.circle_curvature(reference.reflect_ends(xy, 2))
    h = np.concatenate([spacing[1::-1], spacing, spacing[-1:-3:-1]])
    a, b = h[:-1], h[1:]
    place = np.concatenate([[0.0], np.cumsum(h)])
    at = place[1:-1] + (b - a) / 3.0
    curvature, slope, bend = np.zeros(len(xy)), np.zeros(len(xy)), np.zeros(len(xy))
    for i in range(len(xy)):
        x, y = at[i : i + 3] - place[i + 2], k[i : i + 3]
        parabola = np.polyfit(x / h.mean(), y, 2)
        bend[i] = 2.0 * parabola[0] / h.mean() ** 2
        slope[i] = parabola[1] / h.mean()
        curvature[i] = parabola[2] - (a**2 + a * b + b**2)[i + 1] / 36.0 * bend[i]
    return curvature, slope, bend


def migration_rates(lines, spacing, widths, depths, law):
    """Rate of every point of a stem before any smoothing, by link; see ``reference.migration_rate``.

    What the bends of a link leave in the upstream mean goes on in the next one; it fades at both ends of the stem.
    Width and depth jump at a junction: each segment has those of its own link, and the local term the mean of both
    there. The sinuosity is the stem's.

    Args:
        lines: The links.
        spacing: Spacing of each.
        widths: Width of each, one or one a point.
        depths: Depths, alike.
        law: Constants.
    """
    xy, _ = join_links(lines)
    h = by_segment(spacing, lines)[0]
    curvature, slope, bend = curvature_and_bend(xy, h)
    width = by_segment(widths, lines)
    strength = [np.array(reference.strength_of(w, law)) for w in width]
    ends = slice(0, -1), slice(1, None)
    local_push, value = [], []
    for s, w, e in zip(strength, width, ends, strict=True):
        local_push.append(s * reference.straightened(curvature[e], w, law))
        lost = h**2 / 12.0 * reference.felt_bend(curvature[e], slope[e], bend[e], w, law)
        value.append(s * (reference.felt_curvature(curvature[e], w, law) - lost))
    depth = by_segment(depths, lines)
    optical = 0.5 * h * sum(reference.decay(w, d, law) for w, d in zip(width, depth, strict=True))
    weights = np.array([reference.decay_weights(x) for x in optical])
    share = weights[:, 1] * value[0] + weights[:, 2] * value[1]
    mean = np.zeros(len(xy))
    for i in range(1, len(xy)):
        between = np.concatenate([np.cumsum(optical[1:i][::-1])[::-1], [0.0]])
        mean[i] = np.sum(share[:i] * np.exp(-between))
    factor = stem_factor(lines, spacing)
    local = law.local_weight * (factor if law.scale_local else 1.0)
    gamma = law.upstream_weight * (factor if law.scale_upstream else 1.0)
    both = np.concatenate([local_push[0][:1], 0.5 * (local_push[0][1:] + local_push[1][:-1]), local_push[1][-1:]])
    fade = stem_end_weights(lines, spacing, widths, law.end_damping)
    return split_links(local * both + gamma * fade * mean, lines)


def stem_factor(lines, spacing):
    """sigma^(-2/3) of a stem: its length, that of all links, over the chord from its head to its foot."""
    length = sum((len(line) - 1) * h for line, h in zip(lines, spacing, strict=True))
    return min(np.linalg.norm(lines[-1][-1] - lines[0][0]) / length, 1.0) ** (2.0 / 3.0)


def join_values(values):
    """Values at the points of links as those of the stem, (n,)."""
    return join_links([value[:, None] for value in values])[0][:, 0]


def smooth_velocities(lines, rates, spacing, widths, factor, law):
    """Velocities smoothed down the stem and up again, (n, 2); 0 at both ends. A junction belongs to the link above."""
    xy, h = join_links(lines)[0], by_segment(spacing, lines)[0]
    values = np.zeros(xy.shape)
    values[1:-1] = stem_normals(xy, h) * join_values(rates)[1:-1, None]
    roots = []
    for rate, h, width in zip(rates, spacing, widths, strict=True):
        for w in np.broadcast_to(width, len(rate))[(1 if roots else 0) :]:
            diffusivity = -law.local_weight * reference.strength_of(w, law) * (factor if law.scale_local else 1.0)
            b = diffusivity * law.time_step / h**2
            roots.append(reference.recurrence_root(max(0.0, ((16.0 / 3.0) * b / 1.5 - 1.0) / 4.0)))
    smoothed = reference.fading_sum(values, roots)
    return reference.fading_sum(np.concatenate([[[0.0, 0.0]], smoothed[-2::-1]]), roots[::-1])[::-1]


def stem_end_weights(lines, spacing, widths, damping):
    """Smoothstep of the distance along the stem to each end over ``damping`` widths of the link there, (n,)."""
    h = by_segment(spacing, lines)[0]
    arc = np.concatenate([[0.0], np.cumsum(h)])
    weight = np.ones(len(arc))
    for away, width in ((arc, widths[0]), (arc[-1] - arc, widths[-1])):
        t = np.minimum(away / (damping * np.mean(width)), 1.0) if damping > 0.0 else np.ones(len(arc))
        weight = np.minimum(weight, 3.0 * t**2 - 2.0 * t**3)
    return weight


def stem_normals(xy, spacing):
    """Unit normals to the right at the inner points, by the parabola through three points so far apart: (n - 2, 2)."""
    segment = np.diff(xy, axis=0)
    ratio = (spacing[1:] / spacing[:-1])[:, None]
    tangent = segment[:-1] * ratio + segment[1:] / ratio
    return np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1, keepdims=True)


def move_stem(lines, rates, spacing, widths, law):
    """Points after one step, by link, from rates before any smoothing: junctions move, both ends of the stem stay."""
    factor = stem_factor(lines, spacing)
    smoothed = smooth_velocities(lines, rates, spacing, widths, factor, law)
    moved, _ = join_links(lines)
    moved[1:-1] += law.time_step * smoothed[1:-1]
    return split_links(moved, lines)
