"""Beds of rivers in NumPy, place by place and segment by segment, written to be read."""

import numpy as np

BANK, BANK_START, FADE, AHEAD, NORM, DIG = np.tan(np.radians(35.0)), 0.15, 0.75, 2.0, 8.0, 4.0


def smoother(t):
    t = np.clip(t, 0.0, 1.0)
    return t**3 * (t * (6.0 * t - 15.0) + 10.0)


def bank_rise(away, ease):
    """Integral of a slope that grows from BANK_START to BANK as a quintic step."""
    t = np.linspace(0.0, min(away, ease), 2001)
    slope = BANK_START + (BANK - BANK_START) * smoother(t / ease)
    return np.trapezoid(slope, t) + BANK * max(away - ease, 0.0)


def soft_positive(x, soft):
    if abs(x) >= soft:
        return max(x, 0.0)
    t = x / soft + 1.0
    return soft / 16.0 * t**3 * (4.0 - t)


def section_depth(courses, i, t, share, tables):
    """Depth over its scale at a part of the width, from the tables of straight sections and of bends by lane."""
    forms, bends, lanes = tables
    at = np.linspace(0.0, 1.0, forms.shape[1])
    blend, bend, lane = ((1 - t) * v[i] + t * v[i + 1] for v in (courses.blend, courses.bend, courses.lane))
    straight = (1 - blend) * np.interp(share, at, forms[courses.form[i, 0]])
    straight += blend * np.interp(share, at, forms[courses.form[i, 1]])
    place = (lane - lanes[0]) / (lanes[1] - lanes[0])
    k = min(int(place), len(lanes) - 2)
    tilted = (1 - place + k) * np.interp(share, at, bends[k]) + (place - k) * np.interp(share, at, bends[k + 1])
    return (1 - bend) * straight + bend * tilted


def segment_cut(courses, i, limit, p, base, tables):
    a, b = courses.xy[i], courses.xy[i + 1]
    ta, tb = courses.tangent[i], courses.tangent[i + 1]
    fa, fb = (p - a) @ ta, (p - b) @ tb
    if -fa >= limit[0] or fb >= limit[1]:
        return 0.0
    if fa >= 0.0 > fb:
        t = fa / (fa - fb)
    elif fa < 0.0 < fb:
        t = fb / (fb - fa)
    else:
        t = 0.0 if fb < 0.0 else 1.0
    middle, ahead = (1 - t) * a + t * b, (1 - t) * ta + t * tb
    left = (ahead[0] * (p - middle)[1] - ahead[1] * (p - middle)[0]) / np.hypot(*ahead)
    half, depth, reach, ease, rim, water = (
        (1 - t) * v[i] + t * v[i + 1]
        for v in (
            0.5 * courses.width,
            courses.depth,
            courses.reach,
            courses.ease,
            np.maximum(courses.rim, 0.005),
            courses.water,
        )
    )
    before, after = max(-fa, 0.0), max(fb, 0.0)
    beyond = max(before, after)
    away = np.hypot(max(abs(left) - half, 0.0), beyond)
    if away >= reach:
        return 0.0
    over = base - water
    if abs(left) < half and depth > 0.0:
        over += depth * section_depth(courses, i, t, 0.5 - 0.5 * left / half, tables)
    weight = 1.0 - smoother((away / reach - FADE) / (1.0 - FADE))
    if away > 0.0:
        over -= bank_rise(away, ease)
        if (before > 0.0 and limit[0] < reach) or (after > 0.0 and limit[1] < reach):
            over -= AHEAD * beyond
            weight *= 1.0 - smoother(beyond / (limit[1] if after > 0.0 else limit[0]))
    return weight * soft_positive(over, rim)


def bed_height(courses, limits, p, base, tables):
    """Height of the bed at a place: all segments, the deepest of each group, the 8-norm of the groups, then marks."""
    course = courses.station_course
    deepest = {}
    for i in range(len(course) - 1):
        if course[i] == course[i + 1]:
            group = courses.group[course[i]]
            cut = segment_cut(courses, i, limits[i], p, base, tables)
            deepest[group] = max(deepest.get(group, 0.0), cut)
    cuts = np.array([cut for cut in deepest.values() if cut > 0.0])
    if not len(cuts):
        return base
    cut = cuts.max() * ((cuts / cuts.max()) ** NORM).sum() ** (1.0 / NORM)
    dug = raised = 0.0
    for xy, radius, depth in zip(courses.basins.xy, courses.basins.radius, courses.basins.depth, strict=True):
        r2 = ((p - xy) ** 2).sum() / radius**2
        dug = max(dug, min(depth, DIG * cut) * max(1.0 - r2, 0.0) ** 3)
    for xy, radius, height in zip(courses.rocks.xy, courses.rocks.radius, courses.rocks.height, strict=True):
        r2 = ((p - xy) ** 2).sum() / radius**2
        raised = max(raised, height * max(1.0 - r2 * r2, 0.0) ** 2)
    return min(base, base - cut - dug + raised)


def bicubic(height, cell_size, west, north, p):
    """Keys' cubic convolution of heights at the cells' centres, held at the edges."""
    x, y = (p[0] - west) / cell_size - 0.5, (north - p[1]) / cell_size - 0.5
    column, row = int(np.floor(x)), int(np.floor(y))

    def weight(d):
        d = abs(d)
        return 1.5 * d**3 - 2.5 * d**2 + 1.0 if d <= 1.0 else max(-0.5 * d**3 + 2.5 * d**2 - 4.0 * d + 2.0, -9.0)

    total = 0.0
    for i in range(row - 1, row + 3):
        for j in range(column - 1, column + 3):
            value = height[np.clip(i, 0, height.shape[0] - 1), np.clip(j, 0, height.shape[1] - 1)]
            total += weight(y - i) * weight(x - j) * value
    return total
