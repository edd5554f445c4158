"""Float64 twin of the splat kernels: every cell looks at every segment, and falloffs are integrated in closed form."""

import numpy as np

FAR, REACH, HALF = 7.0, 6.0, 0.5


def distances(line, section, xy):
    """Distance of places to the nearest segment in widths, with its sign, its index, and where along it the foot lies.

    line: (S, 4) begin and end; section: (S, 4) width and depth of both; xy: (n, 2).
    """
    a, b = line[:, :2], line[:, 2:]
    way = b - a
    size = np.maximum((way**2).sum(axis=1), 1e-30)
    off = xy[:, None] - a
    part = np.clip((off * way).sum(axis=2) / size, 0.0, 1.0)
    away = np.hypot(*np.moveaxis(off - part[..., None] * way, 2, 0))
    ratio = away / (section[:, 0] + part * (section[:, 2] - section[:, 0]))
    cross = (way[:, 0] * off[..., 1] - way[:, 1] * off[..., 0]) / np.sqrt(size)
    least = ratio.min(axis=1, keepdims=True)
    # Of those that are equally near, the one that the place lies most squarely beside.
    square = np.where(ratio**2 <= least**2 * (1.0 + 1e-12), np.abs(cross), -1.0)
    which = square.argmax(axis=1)
    rows = np.arange(len(xy))
    least = least[:, 0]
    signed = np.where(cross[rows, which] < 0.0, -least, least)
    return np.where(least < REACH, signed, FAR), which, part[rows, which]


def moisture(s):
    return np.clip(1.0 - (s / 6.0) ** 2, 0.0, None) ** 3


def sediment(s):
    q = np.abs(s)
    t = np.where(q < HALF, q / HALF, np.clip((4.0 - q) / 3.5, 0.0, 1.0))
    return t * t * (3.0 - 2.0 * t)


def moisture_integral(s):
    q = np.clip(s, -6.0, 6.0)
    return q - q**3 / 36.0 + 0.6 * q**5 / 1296.0 - q**7 / (7.0 * 46656.0)


def sediment_integral(s):
    q = np.minimum(np.abs(s), 4.0)
    rise, fall = np.minimum(q / HALF, 1.0), np.clip((q - HALF) / 3.5, 0.0, 1.0)
    area = HALF * (rise**3 - 0.5 * rise**4) + 3.5 * (fall - fall**3 + 0.5 * fall**4)
    return np.sign(s) * area


def mean(falloff, integral, a, b):
    far = np.abs(b - a) > 1e-6
    step = np.where(far, b - a, 1.0)
    return np.where(far, (integral(b) - integral(a)) / step, falloff(0.5 * (a + b)))


def bulge(before, after, sag):
    """When a way before + (after - before) t - 4 sag t (1 - t) turns, and what it is then; 0 where it does not."""
    sag = np.clip(sag, -0.1, 0.1)
    near = np.minimum(np.abs(before), np.abs(after)) <= 1.0
    turns = (before * after > 0.0) & near & (np.abs(after - before) < 4.0 * np.abs(sag)) & (np.abs(after) < REACH)
    part = np.where(turns, 0.5 - (after - before) / np.where(turns, 8.0 * sag, 1.0), 0.0)
    return part, before + (after - before) * part - 4.0 * sag * part * (1.0 - part)


class Cells:
    """Cells of a raster that courses are led over, as (rows * columns,) arrays."""

    def __init__(self, shape, cell_size, origin):
        row, column = (index.ravel() for index in np.indices(shape))
        self.xy = np.stack([origin[0] + (column + 0.5) * cell_size, origin[1] - (row + 0.5) * cell_size], axis=1)
        self.offset = np.full(len(self.xy), FAR)
        self.left = np.full(len(self.xy), -1e30)
        self.moisture, self.sediment, self.occupied = (np.zeros(len(self.xy)) for _ in range(3))
        self.last = None

    def advance(self, line, section, time, sag=None):
        after, which, part = distances(line, section, self.xy)
        before, years, way = self.offset.copy(), 0.0, np.zeros(len(self.xy))
        if self.last is not None:
            years = time - self.last[2]
            moved = np.stack([self.way(line[:, ends]) for ends in (slice(0, 2), slice(2, 4))], axis=1)
            way = 3.0 * (moved[which, 0] + part * (moved[which, 1] - moved[which, 0]))
        width = section[which, 0] + part * (section[which, 2] - section[which, 0])
        other = (before * after < 0.0) & (np.abs(after) < REACH)
        passed = (np.abs(before) + np.abs(after)) * width <= way
        before = np.where(other & ~passed, -before, before)
        self.offset = after
        after = np.where((np.abs(after) >= FAR) & (before < 0.0), -after, after)
        self.moisture += years * mean(moisture, moisture_integral, before, after)
        self.sediment += years * mean(sediment, sediment_integral, before, after)
        if sag is not None:
            part, turn = bulge(before, after, (sag[which, 0] + part * (sag[which, 1] - sag[which, 0])) / width)
            self.cover(before, np.where(part > 0.0, turn, before), time - years, years * part)
            before, years = np.where(part > 0.0, turn, before), years * (1.0 - part)
        self.cover(before, after, time - years, years)
        self.last = line, section, time

    def cover(self, before, after, begin, years):
        """Note when cells were under a channel whose distance changes evenly; none where no time passes."""
        low, high = np.minimum(before, after), np.maximum(before, after)
        there = (low <= HALF) & (high >= -HALF) & ((years > 0.0) | (self.last is None))
        length = np.where(high > low, high - low, 1.0)
        share = np.where(high > low, (np.minimum(high, HALF) - np.maximum(low, -HALF)) / length, 1.0)
        self.occupied += np.where(there, years * share, 0.0)
        out = np.abs(after) > HALF
        leave = np.where(
            out & there, (np.copysign(HALF, after) - before) / np.where(out & there, after - before, 1.0), 1.0
        )
        self.left = np.where(there, begin + years * leave, self.left)

    def way(self, xy):
        """How far places lie from the course before, m; 0 where that is out of reach, or off the raster."""
        line, section, _ = self.last
        signed, which, part = distances(line, section, xy)
        width = section[which, 0] + part * (section[which, 2] - section[which, 0])
        (west, south), (east, north) = self.xy.min(axis=0), self.xy.max(axis=0)
        half = 0.5 * (np.unique(self.xy[:, 0])[1] - west)
        inside = (xy[:, 0] >= west - half) & (xy[:, 0] < east + half)
        inside &= (xy[:, 1] > south - half) & (xy[:, 1] <= north + half)
        return np.where((np.abs(signed) < REACH) & inside, np.abs(signed) * width, 0.0)
