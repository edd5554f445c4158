"""Float64 twin of Leheny's erosion: event by event on a NumPy raster, written from the rules."""

import collections
import functools
import itertools
import math

import numpy as np
from reference_terrain import pcg

STEPS = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))


class Lots:
    """Counter-based random numbers: the state is made of two whole numbers, each draw is another round of the hash."""

    def __init__(self, seed, counter):
        self.state = pcg((seed + pcg(counter & 0xFFFFFFFF)) & 0xFFFFFFFF)

    def draw(self):
        self.state = pcg(self.state)
        return self.state

    def whole(self, count):
        return self.draw() % count

    def part(self):
        return (self.draw() >> 8) / 2.0**24


class Ground:
    """Heights in whole quanta, which of them are outlets, and who is whose neighbour."""

    def __init__(
        self,
        height,
        outlet,
        wraps=(False, False),
        four=False,
        bias=0.05,
        depth=10.0,
        threshold=2000.0,
        quantum=2.0**-21,
        base=-math.inf,
    ):
        self.height, self.outlet, self.wraps, self.four = np.array(height, np.float64), outlet, wraps, four
        self.bias, self.depth, self.threshold, self.quantum, self.base = bias, depth, threshold, quantum, base
        self.cells = [tuple(int(v) for v in rc) for rc in np.argwhere(~np.isnan(self.height))]
        self.slides = 0

    def neighbor(self, cell, k):
        """Neighbour k, around periodic sides; None beyond the others, and where there is no data."""
        if self.four and k % 2:
            return None
        found = []
        for place, step, size, wraps in zip(cell, STEPS[k], self.height.shape, self.wraps, strict=True):
            if not 0 <= place + step < size and not wraps:
                return None
            found.append((place + step) % size)
        return None if np.isnan(self.height[tuple(found)]) else tuple(found)

    def neighbors(self, cell):
        return [n for n in (self.neighbor(cell, k) for k in range(8)) if n is not None]

    def probabilities(self, cell):
        """Lower neighbours and the part of the water that each gets in the mean."""
        falls = [(n, self.height[cell] - self.height[n]) for n in self.neighbors(cell)]
        falls = [(n, fall) for n, fall in falls if fall > 0.0]
        steepest = max((fall for _, fall in falls), default=0.0)
        weights = [math.exp(self.bias * (fall - steepest)) for _, fall in falls]
        return [n for n, _ in falls], np.array(weights) / sum(weights) if weights else np.zeros(0)

    def goes_to(self, cell, part):
        lower, p = self.probabilities(cell)
        return lower[min(int(np.searchsorted(np.cumsum(p), part, side="right")), len(lower) - 1)]

    # ---- one after another

    def event(self, seed, number):
        """Rain, its way, what it takes, and the slides; returns the way."""
        lots = Lots(seed, number)
        way = [self.cells[lots.whole(len(self.cells))]]
        while not self.outlet[way[-1]]:
            way.append(self.goes_to(way[-1], lots.part()))
        self.grade(way, dict.fromkeys(way, 1))
        waiting = list(way)
        while waiting:
            cell = waiting.pop()
            for n in self.neighbors(cell):
                if self.slide(n, cell) and n not in waiting:
                    waiting.append(n)
        return way

    def grade(self, way, visits):
        """Lower the cells of a way by D a visit, the last one not below the base, the others not to the next one."""
        least = self.base
        for cell in reversed(way):
            before = self.height[cell]
            self.height[cell] = max(before - visits[cell] * self.depth, min(before, least))
            least = self.height[cell] + self.quantum

    def slide(self, high, low):
        """Lower one of two neighbours by quarters until they differ by no more than M; says whether it was."""
        moved = False
        while self.height[high] - self.height[low] > self.threshold:
            quarter = (self.height[high] - self.height[low]) / 4.0
            self.height[high] -= math.floor(quarter / self.quantum) * self.quantum
            self.slides += 1
            moved = True
        return moved

    # ---- in batches

    def walk_together(self, seed, turn_seed, numbers):
        """Ways over heights that stay, one turn a cell; then all they take; returns the ways."""
        ways = []
        for number in numbers:
            way = [self.cells[Lots(seed, number).whole(len(self.cells))]]
            while not self.outlet[way[-1]]:
                index = way[-1][0] * self.height.shape[1] + way[-1][1]
                way.append(self.goes_to(way[-1], Lots(turn_seed, index).part()))
            ways.append(way)
        visits = collections.Counter(cell for way in ways for cell in way)
        ahead = {cell: beyond for way in ways for cell, beyond in itertools.pairwise(way)}
        before = self.height.copy()

        @functools.cache
        def graded(cell):
            least = graded(ahead[cell]) + self.quantum if cell in ahead else self.base
            return max(before[cell] - visits[cell] * self.depth, min(before[cell], least))

        for cell in visits:
            self.height[cell] = graded(cell)
        return ways

    def color(self, place, axis):
        """Parity of a row or column; 2 for the last one of an odd number that wraps."""
        size = self.height.shape[axis]
        return 2 if self.wraps[axis] and size % 2 and place == size - 1 else place % 2

    def pairs(self, k, color):
        """Cells and their neighbours k of one colour."""
        axis = 1 if k == 2 else 0
        pairs = [(cell, self.neighbor(cell, k)) for cell in self.cells if self.color(cell[axis], axis) == color]
        return [(a, b) for a, b in pairs if b is not None]

    def groups(self):
        """The pairs of all groups, one after another: by direction, then by colour."""
        return [self.pairs(k, color) for k in (2, 3, 4, 5) for color in range(3)]

    def steep(self, a, b):
        return abs(self.height[a] - self.height[b]) > self.threshold

    def sweep(self, rng=None):
        """Note all pairs that are too steep, then bring them to rest group by group, in any order; says if any was."""
        noted = [[pair for pair in pairs if self.steep(*pair)] for pairs in self.groups()]
        for pairs in noted:
            if rng is not None:
                rng.shuffle(pairs)
            for a, b in pairs:
                if not self.slide(a, b):
                    self.slide(b, a)
        return any(noted)

    # ---- what must hold

    def pits(self):
        return [c for c in self.cells if not self.outlet[c] and not len(self.probabilities(c)[0])]

    def largest_difference(self):
        return max(abs(self.height[c] - self.height[n]) for c in self.cells for n in self.neighbors(c))
