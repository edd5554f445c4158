"""The blend-flow tree by recursion in float64, written to be read: a place at a time, as the document states it."""

import functools
import itertools
import math

import numpy as np
from reference_terrain import lattice_gradient

from warpriver.kernels import flow_tree as kernels
from warpriver.riverscape.primitives import Merge, Primitives, Replace

cached_gradient = functools.cache(lattice_gradient)


def falloff(r):
    """Weight by distance over radius: (1 - r^2)^3."""
    return (1.0 - r * r) ** 3 if r < 1.0 else 0.0


def quintic(x):
    """Step from 0 to 1 whose first two derivatives end at 0."""
    x = min(max(x, 0.0), 1.0)
    return 6.0 * x**5 - 15.0 * x**4 + 10.0 * x**3


def upstream_share(along, blending):
    """Lambda: 1 above the lip, 0 below."""
    return 1.0 - quintic((along + blending) / (2.0 * blending))


def periodic_noise(seed, x, y, period):
    """Gradient noise whose lattice repeats itself."""
    i, j = math.floor(x), math.floor(y)
    total = 0.0
    for di in (0, 1):
        for dj in (0, 1):
            u, v = x - i - di, y - j - dj
            across, up = cached_gradient(seed, (i + di) % period, (j + dj) % period)
            total += (1.0 - quintic(abs(u))) * (1.0 - quintic(abs(v))) * (across * u + up * v)
    return math.sqrt(2.0) * total


def noise(table, at):
    """Octaves of noise, of a table's number: smooth, lively, or ridged."""
    total = 0.0
    for k in range(kernels.OCTAVES[table]):
        value = periodic_noise(16 * table + k, *(2.0**k * at), kernels.PERIOD * 2**k)
        if table == kernels.RIDGED:
            ridge = (1.0 - abs(value)) ** 2 - kernels.RIDGE_MEAN if k < kernels.RIDGED_OCTAVES else 0.0
            value = kernels.WAVE_SHARE * value + kernels.RIDGE_SHARE * ridge
        total += kernels.PERSISTENCE[table] ** k * value
    return total


def rotation(angle):
    """Matrix that turns to the left."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def drift_direction(offset):
    """Direction in the noise that the water drifts in."""
    across, up = kernels.DRIFT[::-1] if offset & 1 else kernels.DRIFT
    return np.array([-across if offset & 2 else across, -up if offset & 65536 else up])


def noise_place(row, off, time):
    """The warp w^-1 about the centre, turned and moved to where in the noise the primitive begins."""
    offset = int(row.offset[0])
    begin = np.array([offset & 65535, offset >> 16]) * kernels.PERIOD / 65536.0
    velocity = row.velocity[0]
    speed = math.hypot(*velocity)
    along = velocity / speed if speed > 0.0 else np.array([1.0, 0.0])
    to = drift_direction(offset)
    angle = math.atan2(to[1], to[0]) - math.atan2(along[1], along[0])
    if row.kind[0] == kernels.VORTEX:
        shear, spin, _ = row.shape[0]
        warped = rotation(-(shear * math.hypot(*off) / row.radius[0] + spin * time)) @ off
    else:
        warped = off - time * velocity
    return rotation(angle) @ warped / row.wavelength[0] + begin


def leaf(row, place, time):
    """Weight, its square, still level, waves, velocity, foam of one primitive."""
    off = place - row.center[0]
    weight = falloff(math.hypot(*off) / row.radius[0])
    kind, amplitude, foam = int(row.kind[0]), row.amplitude[0], row.effervescence[0]
    velocity, (first, second, third) = row.velocity[0], row.shape[0]
    level = row.level[0] + row.gradient[0] @ off
    at = noise_place(row, off, time)
    if kind in (kernels.CALM, kernels.RIPPLE, kernels.TURBULENT):
        value = noise(kind, at)
        waves, foam = value, foam * (1.0 + kernels.CREST * value)
    elif kind == kernels.VORTEX:
        waves = noise(kernels.RIDGED, at)
        foam = foam * (1.0 + kernels.CREST * waves)
        velocity = velocity + second * np.array([-off[1], off[0]])
        level -= third * weight
    elif kind == kernels.ECHO:
        normal = np.array([math.cos(first), math.sin(first)])
        mirrored = off - 2.0 * (off @ normal - second) * normal
        waves = 0.5 * (noise(kernels.SMOOTH, at) + noise(kernels.SMOOTH, noise_place(row, mirrored, time)))
    else:
        along = off @ velocity / math.hypot(*velocity) - (third if kind == kernels.CASCADE else 0.0)
        share = upstream_share(along, second)
        rough = (1.0 - share) * noise(kernels.RIDGED, at)
        waves = share * kernels.UPSTREAM * noise(kernels.SMOOTH, at) + rough
        foam = (1.0 - share) * foam * (1.0 + kernels.CREST * rough)
        if kind == kernels.CASCADE:
            level += first * (share - 0.5)
        else:
            level += 0.5 * first * math.cos(2.0 * math.pi * along / third)
    return weight, weight**2, level, amplitude * waves, velocity, min(max(foam, 0.0), 1.0)


def mixed(a, b, contrast):
    """Merge: means by weight; waves over the root of the sum of squares where contrast is kept."""
    if a[0] == 0.0 or b[0] == 0.0:
        return b if a[0] == 0.0 else a
    weight, square = a[0] + b[0], a[1] + b[1]
    still, velocity, foam = ((a[0] * a[k] + b[0] * b[k]) / weight for k in (2, 4, 5))
    if contrast:
        waves = (math.sqrt(a[1]) * a[3] + math.sqrt(b[1]) * b[3]) / math.sqrt(square)
    else:
        waves = (a[0] * a[3] + b[0] * b[3]) / weight
    return weight, square, still, waves, velocity, foam


def replaced(a, b, contrast):
    """Replace A by B: (1 - m) A + m B, m = min(1, alpha_B), with the weight of A."""
    m = min(1.0, b[0])
    if a[0] == 0.0 or m == 0.0:
        return a
    still, waves, velocity, foam = ((1.0 - m) * a[k] + m * b[k] for k in (2, 3, 4, 5))
    if contrast:
        waves /= math.hypot(1.0 - m, m)
    return a[0], a[1], still, waves, velocity, foam


def surface(tree, place, time, contrast=True):
    """(Weight, its square, still level, waves, velocity, foam) of a tree at a place; weight 0 where nothing is."""
    nothing = (0.0, 0.0, math.nan, 0.0, np.zeros(2), 0.0)
    if isinstance(tree, Replace):
        under, over = (surface(node, place, time, contrast) for node in (tree.under, tree.over))
        return replaced(under, over, contrast)
    parts = []
    if isinstance(tree, Merge):
        parts = [surface(child, place, time, contrast) for child in tree.children]
    elif isinstance(tree, Primitives):
        near = np.flatnonzero(((tree.center - place) ** 2).sum(axis=1) < tree.radius**2)
        parts = [leaf(tree[[k]], place, time) for k in near]
    return functools.reduce(lambda a, b: mixed(a, b, contrast), parts, nothing)


def evaluate(tree, places, time, contrast=True):
    """Arrays of elevation, still level, velocity, foam and weight at places."""
    found = [surface(tree, np.asarray(p), time, contrast) for p in places]
    weight, _, still, waves, velocity, foam = (np.array(column) for column in zip(*found, strict=True))
    return still + waves, still, velocity, foam, weight


def nearest_on_line(line, place):
    """Distance to the nearest place on a line, and how far along the line that is."""
    best, before = (math.inf, 0.0), 0.0
    for a, b in itertools.pairwise(line):
        length = math.hypot(*(b - a))
        share = min(max((place - a) @ (b - a) / length**2, 0.0), 1.0)
        best = min(best, (math.hypot(*(place - a - share * (b - a))), before + share * length))
        before += length
    return best


def carried_foam(foam, velocity, source, size, step, kept):
    """Foam of the cells after a step: from half a step back the velocity, from a whole one the foam."""
    rows, columns = foam.shape
    out = np.empty_like(foam)
    for row, column in np.ndindex(rows, columns):
        u, v = velocity[row, column]
        i = min(max(math.floor(row + 0.5 * step * v / size + 0.5), 0), rows - 1)
        j = min(max(math.floor(column - 0.5 * step * u / size + 0.5), 0), columns - 1)
        u, v = velocity[i, j]
        y, x = row + step * v / size, column - step * u / size
        total = 0.0
        for a in (math.floor(y), math.floor(y) + 1):
            for b in (math.floor(x), math.floor(x) + 1):
                if 0 <= a < rows and 0 <= b < columns:
                    total += (1.0 - abs(y - a)) * (1.0 - abs(x - b)) * foam[a, b]
        out[row, column] = min(max(total * kept + source[row, column] * step, 0.0), 1.0)
    return out
