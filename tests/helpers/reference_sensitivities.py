"""Float64 NumPy twins of the kernels of sensitivities; written so that complex numbers go through.

The derivative of a function f of real numbers is Im f(x + i e d) / e for a tiny e, to all digits: that is what the
tangents, which the kernels carry along term by term, are held against.
"""

import dataclasses

import numpy as np

# Of an imaginary step: its square is lost in rounding.
TINY = 1e-30


@dataclasses.dataclass(frozen=True)
class RateLaw:
    """Constants that are the same everywhere; lengths in widths."""

    local_weight: float = -1.0
    upstream_weight: float = 2.5
    scale_local: int = 0
    scale_upstream: int = 0
    end_damping: float = 5.0


def length(v):
    """Length of vectors, which complex ones have as well: the root of the sum of squares."""
    return np.sqrt(v[..., 0] ** 2 + v[..., 1] ** 2)


def curvature(xy):
    """Curvature of the circle through three points in a row, 0 at both ends."""
    a, b = xy[1:-1] - xy[:-2], xy[2:] - xy[1:-1]
    inner = 2.0 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / (length(a) * length(b) * length(a + b))
    return np.concatenate([[0.0], inner, [0.0]])


def strength(xy, section, saturation):
    """Strength of bends, m times 1/m: section[:, 1] c0 tanh(w C / c0) / w."""
    bend, width = curvature(xy), section[:, 0]
    counted = np.array(
        [c if s == 0.0 else s * np.tanh(w * c / s) / w for c, s, w in zip(bend, saturation, width, strict=True)]
    )
    return section[:, 1] * counted


def upstream_mean(value, depth):
    """Weighted mean of what lies upstream of each point, by the double sum over points and segments above them."""
    q = np.exp(-depth)
    share = (1.0 - q) / depth
    segment = (share - q) * value[:-1] + (1.0 - share) * value[1:]
    mean = [0.0]
    for i in range(1, len(value)):
        mean.append(sum(segment[j] * np.exp(-depth[j + 1 : i].sum()) for j in range(i)))
    return np.array(mean)


def felt(count, spacing, reach):
    """Smoothstep of the distance to the nearer end."""
    i = np.arange(count)
    t = np.minimum(np.minimum(i, count - 1 - i) * spacing / reach, 1.0) if reach else np.ones(count)
    return t * t * (3.0 - 2.0 * t)


def velocity(xy, section, law, constants, mean_width, arc):
    """Velocity of each point of a line, (n, 2) m/yr, of which both ends are held; ``arc`` is its length, m."""
    chord = length((xy[-1] - xy[0]).real)
    sinuosity = min(chord / arc, 1.0) ** (2.0 / 3.0)
    local = constants.local_weight * (sinuosity if constants.scale_local else 1.0)
    upstream = constants.upstream_weight * (sinuosity if constants.scale_upstream else 1.0)
    value = strength(xy, section, law[:, 2])
    decay = 1.0 / (law[:, 1] * section[:, 2])
    depth = 0.5 * length(np.diff(xy, axis=0)) * (decay[1:] + decay[:-1])
    fade = felt(len(xy), arc / (len(xy) - 1), constants.end_damping * mean_width)
    rate = law[:, 0] * (local * value + upstream * fade * upstream_mean(value, depth))
    across = xy[2:] - xy[:-2]
    normal = np.stack([across[:, 1], -across[:, 0]], axis=1) / length(across)[:, None]
    moved = np.zeros(xy.shape, xy.dtype)
    moved[1:-1] = rate[1:-1, None] * normal
    return moved


def velocity_change(xy, change, section, law, seed, constants, mean_width, arc):
    """Derivative of ``velocity`` where points move by ``change`` and the logarithms of the law by ``seed``."""
    there = velocity(xy + 1j * TINY * change, section, law * np.exp(1j * TINY * seed), constants, mean_width, arc)
    return there.imag / TINY


def even_places(quanta):
    """First of four points, and their weights, for as many even places along a line; ``quanta`` is its running sum."""
    arc = (quanta - quanta[0]).astype(np.float64)
    count = len(arc)
    first, weights = np.zeros(count, int), np.zeros((count, 4))
    for i in range(count):
        target = np.rint(i / (count - 1) * arc[-1])
        below = min(int(np.searchsorted(arc, target, side="right")) - 1, count - 2)
        first[i] = min(max(below - 1, 0), count - 4)
        t = arc[first[i] : first[i] + 4] - target
        for m in range(4):
            others = np.delete(t, m)
            weights[i, m] = np.prod(others / (others - t[m]))
    weights[0], weights[-1] = [1, 0, 0, 0], [0, 0, 0, 1]
    return first, weights
