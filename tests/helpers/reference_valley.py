"""Float64 twins of the surface of synthetic valleys, written to be read: every place looks at every station."""

import math

import numpy as np
from reference_terrain import pcg


def section_depth(form, y, apex, flat=0.5, exponent=2.0, threads=()):
    """Depth below top of bank in bankfull depths, at Y = 0 (left bank) to 1 (right bank)."""
    if form == 0:
        # The printed pair of equations; both are written with Y from the left bank.
        if apex <= 0.5:
            k = -math.log(2.0) / math.log(apex)
            return 4.0 * y**k * (1.0 - y**k)
        k = -math.log(2.0) / math.log(1.0 - apex)
        return 4.0 * (1.0 - y) ** k * (1.0 - (1.0 - y) ** k)
    if form == 1:
        left, right = apex * (1.0 - flat), (1.0 - apex) * (1.0 - flat)
        return float(np.interp(y, [0.0, left, 1.0 - right, 1.0], [0.0, 1.0, 1.0, 0.0])) if flat < 1.0 else 1.0
    if form == 2:
        return math.sqrt(max(1.0 - (2.0 * y - 1.0) ** 2, 0.0))
    if form == 3:
        return 1.0 - abs((y - apex) / (apex if y <= apex else 1.0 - apex)) ** exponent
    edge = 1.0 - abs(2.0 * y - 1.0) ** 32
    return edge * max(weibull(y, *thread) for thread in threads)


def weibull(y, location, scale, shape, depth):
    """Weibull density scaled so that its greatest value is ``depth``."""

    def density(t):
        return shape * t ** (shape - 1.0) * math.exp(-(t**shape)) if t > 0.0 or shape == 1.0 else 0.0

    t = (y - location) / scale
    mode = ((shape - 1.0) / shape) ** (1.0 / shape)
    return depth * density(t) / density(mode) if t >= 0.0 else 0.0


class Twin:
    """A valley as plain arrays: a list of channels, each (xy, tangent, half, form), and the lines by x."""

    def __init__(
        self, channels, table, start, step, *, bank_height=0.0, slope=0.0, reach=1.0, terraces=0, section=None
    ):
        self.channels, self.table, self.start, self.step = channels, table, start, step
        self.bank_height, self.slope, self.reach, self.terraces = bank_height, slope, reach, terraces
        self.section = section or {"form": 0}

    def line(self, x, column):
        at = self.start + self.step * np.arange(len(self.table))
        return float(np.interp(x, at, self.table[:, column]))

    def gap(self, channel, xy):
        """Least distance beyond the band of circles around the line, by many circles; and the nearest station."""
        place, _, half, _ = channel
        t = np.linspace(0.0, 1.0, 201)[:, None]
        least = math.inf
        for i in range(len(place) - 1):
            center = place[i] + t * (place[i + 1] - place[i])
            along = place[i + 1] - place[i]
            side = 0 if along[0] * (xy[1] - place[i, 1]) - along[1] * (xy[0] - place[i, 0]) >= 0.0 else 1
            radius = half[i, side] + t[:, 0] * (half[i + 1, side] - half[i, side])
            least = min(least, float((np.hypot(*(xy - center).T) - radius).min()))
        near = np.hypot(*(xy - place).T) - half.max(axis=1)
        return least, int(near.argmin())

    def bed(self, channel, xy):
        """Rise of the bed, or None outside the banks: the section that holds the place, by bisection."""
        place, tangent, half, form = channel
        ahead = ((xy - place) * tangent).sum(axis=1)
        best = None
        for i in np.flatnonzero((ahead[:-1] >= 0.0) & (ahead[1:] <= 0.0)):
            length = float(np.hypot(*(place[i + 1] - place[i])))

            def cubic(t, i=i, length=length):
                h = [2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, -2 * t**3 + 3 * t**2, t**3 - t**2]
                d = [6 * t**2 - 6 * t, 3 * t**2 - 4 * t + 1, -6 * t**2 + 6 * t, 3 * t**2 - 2 * t]
                parts = [place[i], length * tangent[i], place[i + 1], length * tangent[i + 1]]
                return sum(a * p for a, p in zip(h, parts)), sum(a * p for a, p in zip(d, parts))  # noqa: B905

            low, high = 0.0, 1.0
            for _ in range(60):
                t = 0.5 * (low + high)
                c, slope = cubic(t)
                low, high = (t, high) if (xy - c) @ slope > 0.0 else (low, t)
            c, slope = cubic(low)
            slope /= np.hypot(*slope)
            n = slope[0] * (xy[1] - c[1]) - slope[1] * (xy[0] - c[0])
            left, right = half[i] + low * (half[i + 1] - half[i])
            if -right <= n <= left and (best is None or abs(n) < best[0]):
                depth, apex, lift = form[i] + low * (form[i + 1] - form[i])
                y = (left - n) / (left + right)
                best = abs(n), lift - depth * section_depth(y=y, apex=apex, **self.section)
        return None if best is None else best[1]

    def height(self, xy):
        """Height of the ground at one place."""
        x, y = xy
        plane = self.bank_height - self.slope * x + self.line(x, 6)
        left, right = self.line(x, 0), self.line(x, 2)
        if y >= left or y <= right:
            out, edge, top = (y - left, left, self.line(x, 1)) if y >= left else (right - y, right, self.line(x, 3))
            part = min(out / max(abs(top - edge), 1e-12), 1.0)
            return plane + self.line(x, 4) + part * self.line(x, 5)
        beds = [bed for bed in (self.bed(channel, xy) for channel in self.channels) if bed is not None]
        if beds:
            return plane + min(beds)
        gaps = [self.gap(channel, xy) for channel in self.channels]
        (gap, station), channel = min(zip(gaps, self.channels, strict=True), key=lambda pair: pair[0][0])
        main, near = self.channels[0], gaps[0][1]
        off, ahead = xy - main[0][near], main[1][near]
        is_left = ahead[0] * off[1] - ahead[1] * off[0] >= 0.0
        gap = max(gap, 0.0)
        part = gap / (gap + (left - y if is_left else y - right))
        fade = (1.0 - smoothstep(gap / self.reach)) * (1.0 - part)
        return plane + self.terraced(part) * self.line(x, 4) + channel[3][station, 2] * fade

    def terraced(self, part):
        if not self.terraces:
            return part
        tread = min(math.floor(part * self.terraces), self.terraces - 1)
        return (tread + smoothstep(4.0 * (part * self.terraces - tread) - 3.0)) / self.terraces


def jump_flood(gap, known, strides, nowhere=2**31 - 1):
    """Rounds of jump flooding: each node takes the station of least gap that it or a node ``stride`` away knows.

    Args:
        gap: (rows, columns, stations) from each node to each station.
        known: (rows, columns) station that a node knows.
        strides: One a round.
    """
    rows, columns = known.shape
    for stride in strides:
        told = known.copy()
        for i in range(rows):
            for j in range(columns):
                near = [(i + a * stride, j + b * stride) for a in (-1, 0, 1) for b in (-1, 0, 1)]
                inside = [(a, b) for a, b in near if 0 <= a < rows and 0 <= b < columns]
                stations = [known[at] for at in inside if known[at] != nowhere]
                told[i, j] = min(stations, key=lambda k: (gap[i, j, k], k), default=nowhere)
        known = told
    return known


def smoothstep(part):
    p = min(max(part, 0.0), 1.0)
    return p * p * (3.0 - 2.0 * p)


def objects_in_cell(seed, i, j, count):
    """Five random numbers, 0 to 1, of each object drawn in a lattice cell: chance, x, y, size, direction."""

    def init(first, second):
        return pcg((first + pcg(second & 0xFFFFFFFF)) & 0xFFFFFFFF)

    state = init(seed, init(seed, init(i, j)))
    drawn = []
    for _ in range(count):
        row = []
        for _ in range(5):
            state = pcg(state)
            row.append((state >> 8) / 2.0**24)
        drawn.append(row)
    return drawn


def objects_height(row, seed, xy, gap):
    """Height of the objects of one field at a place; ``row`` as in the kernels' table."""
    is_log, place, cell, count, chance, least, spread, tall, length, fade = row
    weight = {0: smoothstep(-gap / fade), 1: smoothstep(gap / fade), 2: 1.0}[int(place)]
    i, j = math.floor(xy[0] / cell), math.floor(xy[1] / cell)
    highest = 0.0
    for a in (-1, 0, 1):
        for b in (-1, 0, 1):
            for odds, u, v, size, turn in objects_in_cell(seed, i + a, j + b, int(count)):
                if odds >= chance:
                    continue
                off = np.array([xy[0] - (i + a + u) * cell, xy[1] - (j + b + v) * cell])
                radius = least * math.exp(spread * size)
                distance = math.hypot(*off)
                if is_log:
                    c, s = math.cos(math.pi * turn), math.sin(math.pi * turn)
                    beyond = max(abs(off[0] * c + off[1] * s) - 0.5 * length, 0.0)
                    distance = math.hypot(beyond, off[1] * c - off[0] * s)
                if distance < radius:
                    highest = max(highest, weight * tall * math.sqrt(radius**2 - distance**2))
    return highest
