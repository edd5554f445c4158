"""Float64 twins of the hydrology kernels on plain Python structures: slow, and written from the definitions.

A raster is a dictionary from (row, column) to height that holds the cells with data only; ``Raster`` knows neighbours
and outlets. Ties go to the first cell in the raster (row by row), or the first neighbour clockwise from the north.
"""

import heapq
import itertools
import math

import numpy as np
from reference_terrain import pcg

STEPS = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))
SIDES = ("north", "south", "east", "west")


class Raster:
    """Cells with data, their neighbours under the edge rules, and the outlets."""

    def __init__(self, height, edges="open", nodata="outlet", landlocked=True):
        self.shape = height.shape
        self.rules = dict.fromkeys(SIDES, edges) if isinstance(edges, str) else dict(edges)
        self.height = {rc: float(z) for rc, z in np.ndenumerate(height) if not math.isnan(z)}
        self.nodata = nodata
        self.outlets = {rc for rc in self.height if self.is_outlet(rc)}
        if landlocked:
            self.drain_landlocked()

    def at(self, row, column):
        """The cell there, around periodic sides; None beyond the others."""
        rows, columns = self.shape
        if self.rules["north"] == "periodic":
            row %= rows
        if self.rules["east"] == "periodic":
            column %= columns
        return (row, column) if 0 <= row < rows and 0 <= column < columns else None

    def neighbors(self, cell):
        """(k, cell) of the neighbours with data, clockwise from the north."""
        found = ((k, self.at(cell[0] + dr, cell[1] + dc)) for k, (dr, dc) in enumerate(STEPS))
        return [(k, n) for k, n in found if n in self.height]

    def is_outlet(self, cell):
        row, column = cell
        sides = {"north": row == 0, "south": row == self.shape[0] - 1}
        sides |= {"west": column == 0, "east": column == self.shape[1] - 1}
        if any(there and self.rules[side] == "open" for side, there in sides.items()):
            return True
        around = [self.at(row + dr, column + dc) for dr, dc in STEPS]
        return self.nodata == "outlet" and any(n is not None and n not in self.height for n in around)

    def drain_landlocked(self):
        """Every piece of ground without an outlet gets one at its lowest cell."""
        left = set(self.height)
        while left:
            piece, todo = set(), [min(left)]
            while todo:
                cell = todo.pop()
                if cell not in piece:
                    piece.add(cell)
                    todo += [n for _, n in self.neighbors(cell)]
            if not piece & self.outlets:
                self.outlets.add(min(piece, key=lambda cell: (self.height[cell], cell)))
            left -= piece

    def table(self, values, dtype=np.float64, empty=np.nan):
        """A dictionary of values as an array."""
        array = np.full(self.shape, empty, dtype)
        for cell, value in values.items():
            array[cell] = value
        return array


def step_above(height, real=np.float64):
    """Least number that drains to a height: the next one, and at least as far as from 1 to the next."""
    height = real(height)
    return float(max(np.nextafter(height, real(np.inf)), height + np.finfo(real).eps))


def no_step(height):
    """A raised cell may be as high as the one it drains to."""
    return height


def fill(raster, step=step_above):
    """Priority flood with one heap, (rows, columns)."""
    level, heap = {}, []
    for cell in raster.outlets:
        level[cell] = raster.height[cell]
        heapq.heappush(heap, (level[cell], cell))
    while heap:
        reached, cell = heapq.heappop(heap)
        for _, n in raster.neighbors(cell):
            if n not in level:
                level[n] = max(raster.height[n], step(reached))
                heapq.heappush(heap, (level[n], n))
    return raster.table(level)


def find_pits(raster):
    """Cells that are no outlets and have no lower neighbour."""
    height = raster.height
    inside = [cell for cell in height if cell not in raster.outlets]
    return [cell for cell in inside if all(height[n] >= height[cell] for _, n in raster.neighbors(cell))]


def flat_around(raster, height, pit):
    """Cells joined to a pit at its height, and whether water leaves them."""
    flat, todo, drains = {pit}, [pit], False
    while todo:
        cell = todo.pop()
        drains |= cell in raster.outlets
        for _, n in raster.neighbors(cell):
            drains |= height[n] < height[pit]
            if height[n] == height[pit] and n not in flat:
                flat.add(n)
                todo.append(n)
    return flat, drains


def cheapest_course(raster, height, flat, drained, max_depth, max_length):
    """Dijkstra from the cells of a flat pit; the course from its first cell outside to its end as (cell, level)."""
    bottom = height[next(iter(flat))]
    fall = 2.0**-50 * max(abs(bottom), 1.0)
    length, before, heap = dict.fromkeys(flat, 0.0), {}, [(0.0, cell) for cell in flat]
    heapq.heapify(heap)
    end = None
    while heap and end is None:
        cost, cell = heapq.heappop(heap)
        if cell in raster.outlets:
            end = cell
            break
        for k, n in raster.neighbors(cell):
            step = math.sqrt(2.0) if k % 2 else 1.0
            depth = height[n] - bottom
            if n in length or length[cell] + step > max_length or depth > max_depth:
                continue
            length[n], before[n] = length[cell] + step, cell
            if depth < -fall * length[n] or (depth == 0.0 and n in drained):
                end = n
                break
            heapq.heappush(heap, (cost + (max(depth, 0.0) + 2.0**-20 * step), n))
    course, slope = [], 0.0 if end is not None and height[end] == bottom else fall
    while end is not None and end not in flat:
        course.append((end, bottom - slope * length[end]))
        end = before[end]
    return course


def carve_pits(raster, max_depth=math.inf, max_length=math.inf):
    """Heights after carving, (rows, columns), and the cells that were cut; lengths in cells."""
    height, cut, shut_in = dict(raster.height), set(), set()
    pits = sorted(find_pits(raster), key=lambda cell: (raster.height[cell], cell))
    drained = set(height) - set(pits)
    for pit in pits:
        flat, drains = flat_around(raster, height, pit)
        (drained if drains else shut_in).update(flat)
    for pit in pits:
        if pit in shut_in:
            flat, drains = flat_around(raster, height, pit)
            shut_in -= flat
            if drains:
                drained |= flat
                continue
            for cell, level in cheapest_course(raster, height, flat, drained, max_depth, max_length):
                if level < height[cell]:
                    height[cell] = level
                    cut.add(cell)
    return raster.table(height), cut


def carve(raster, max_depth=math.inf, max_length=math.inf):
    """Heights after carving and filling what is left, (rows, columns)."""
    carved = Raster(carve_pits(raster, max_depth, max_length)[0], raster.rules, raster.nodata)
    carved.outlets = raster.outlets
    return fill(carved)


def receivers(raster, four=False, seed=None):
    """Index of the steepest lower neighbour, (rows, columns); own at outlets and pits, -1 without data.

    Of equal slopes the first counts, or, with a seed, the one with the largest hash.
    """
    to = {}
    for cell, z in raster.height.items():
        best, steepest, most = cell, 0.0, 0
        for k, n in raster.neighbors(cell) if cell not in raster.outlets else []:
            slope = (z - raster.height[n]) * (math.sqrt(0.5) if k % 2 else 1.0)
            lot = 0 if seed is None else mixed(mixed(seed, cell[0] * raster.shape[1] + cell[1]), k)
            if not (four and k % 2) and (slope, lot) > (steepest, most) and slope > 0.0:
                best, steepest, most = n, slope, lot
        to[cell] = best[0] * raster.shape[1] + best[1]
    return raster.table(to, np.int32, -1)


def mixed(first, second):
    """Random bits made of two whole numbers."""
    return pcg((first + pcg(second)) & 0xFFFFFFFF)


def courses(receiver):
    """For each cell with data, the cells from it down to where its water ends, by flat index."""
    to = receiver.reshape(-1)
    for start in np.flatnonzero(to >= 0):
        course = [start]
        while to[course[-1]] != course[-1]:
            course.append(to[course[-1]])
        yield start, course


def course_length(course, columns):
    """Length of a course of flat indices in cells, from its end upwards."""
    length = 0.0
    for a, b in list(itertools.pairwise(course))[::-1]:
        length += math.sqrt(2.0) if a // columns != b // columns and a % columns != b % columns else 1.0
    return length


def d8_cells(receiver):
    """Cells that drain through each, counted course by course."""
    cells = np.where(receiver < 0, np.nan, 0.0)
    for _, course in courses(receiver):
        for cell in course:
            cells.flat[cell] += 1.0
    return cells


def multiple_flow(raster, exponent):
    """Cells that drain through each by Freeman's shares, the highest cell first."""
    cells = dict.fromkeys(raster.height, 1.0)
    for cell in sorted(raster.height, key=raster.height.get, reverse=True):
        slope = {}
        for k, n in raster.neighbors(cell) if cell not in raster.outlets else []:
            s = (raster.height[cell] - raster.height[n]) * (math.sqrt(0.5) if k % 2 else 1.0)
            if s > 0.0:
                slope[k, n] = s
        power = {kn: (s / max(slope.values())) ** exponent for kn, s in slope.items()}
        for (_, n), p in power.items():
            cells[n] += cells[cell] * p / sum(power.values())
    return raster.table(cells)


def lengths(receiver):
    """Length in cells of the course down from each cell, and of the longest course down to it."""
    columns = receiver.shape[1]
    down = np.where(receiver < 0, np.nan, 0.0)
    up = down.copy()
    for start, course in courses(receiver):
        down.flat[start] = course_length(course, columns)
        for k, cell in enumerate(course):
            up.flat[cell] = max(up.flat[cell], course_length(course[: k + 1], columns))
    return down, up


def first_value(receiver, fixed, value):
    """Value of the first fixed cell down the course from each cell, NaN if there is none."""
    found = np.full(receiver.shape, np.nan)
    for start, course in courses(receiver):
        hits = [cell for cell in course if fixed.flat[cell]]
        if hits:
            found.flat[start] = value.flat[hits[0]]
    return found


# ---- rasters to try


def random_rules(rng):
    """Edge rules of the four sides; opposite ones are periodic together."""
    pairs = [("open", "open"), ("closed", "closed"), ("periodic", "periodic"), ("open", "closed"), ("closed", "open")]
    north, south = pairs[rng.integers(len(pairs))]
    east, west = pairs[rng.integers(len(pairs))]
    return {"north": north, "south": south, "east": east, "west": west}


def random_heights(rng, largest=9):
    """Whole numbers with many ties, or real ones of some scale; with or without gaps, above or below zero."""
    shape = rng.integers(2, largest, 2)
    height = rng.integers(0, rng.integers(2, 9), shape).astype(np.float64) - rng.integers(0, 4)
    if rng.random() < 0.4:
        height = rng.normal(size=shape) * 10.0 ** rng.integers(-3, 4)
    if rng.random() < 0.5:
        height[rng.random(shape) < rng.uniform(0.0, 0.5)] = np.nan
    if np.isnan(height).all():
        height[0, 0] = 1.0
    return height
