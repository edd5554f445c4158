"""Float64 twin of the kernels on flats, on plain Python structures: a march on Python's heap, cell by cell.

The raster is a ``reference_hydrology.Raster`` whose heights are a surface without depressions. Members of a flat are
listed breadth first from its first cell in the raster, neighbours clockwise from the north.
"""

import heapq
import math

import reference_hydrology as reference

SHORES, EXITS = "shores", "exits"


class Flat:
    """A flat, and which of the cells around it are shores and exits."""

    def __init__(self, raster, members, pits):
        self.raster, self.members = raster, members
        self.level = raster.height[members[0]]
        around = {n for cell in members for _, n in raster.neighbors(cell)} - set(members)
        level = {n for n in around if raster.height[n] == self.level}
        self.inner = {n for n in level if n not in raster.outlets and n not in pits}
        self.exits = self.inner or {n for n in level if n in raster.outlets}

    def around(self, cell):
        """All eight (k, cell); None for walls."""
        known = dict(self.raster.neighbors(cell))
        return [(k, known.get(k)) for k in range(8)]

    def is_seed(self, begin, cell):
        if begin == EXITS:
            return cell in self.exits
        outlet = bool(self.inner) and cell in self.raster.outlets
        return cell is None or self.raster.height[cell] > self.level or outlet


def flats(raster):
    """All flats, in the order of their first cells."""
    pits, listed, found = set(reference.find_pits(raster)), set(), []
    for first in sorted(pits):
        if first in listed:
            continue
        members = [first]
        listed.add(first)
        for cell in members:
            for _, n in raster.neighbors(cell):
                if n in pits and n not in listed and raster.height[n] == raster.height[first]:
                    listed.add(n)
                    members.append(n)
        found.append(Flat(raster, members, pits))
    return found


def way_between(straight, diagonal, cost):
    """Least of straight + s (diagonal - straight) + cost sqrt(1 + s^2) over s in 0 .. 1, and its s."""
    if math.isinf(diagonal):
        return straight + cost, 0.0
    fall = straight - diagonal
    if fall >= cost * math.sqrt(0.5):
        return diagonal + cost * math.sqrt(2.0), 1.0
    if fall <= 0.0:
        return straight + cost, 0.0
    sine = fall / cost
    cosine = math.sqrt(1.0 - sine * sine)
    return straight + cost * cosine, sine / cosine


def march(flat, begin, cost, toll=0.0):
    """Length, (straight neighbour, turn), crossing of each member that is reached, in the order of arrival."""
    number = {cell: i for i, cell in enumerate(flat.members)}
    best, done, heap = {}, {}, []

    def known(cell, n):
        if n in number:
            return done[n][0] if n in done else math.inf
        return toll * cost[cell] if flat.is_seed(begin, n) else math.inf

    def offer(cell, toward):
        near = dict(flat.around(cell))
        if toward % 2:
            sides = [((toward + 1) % 8, -1), ((toward - 1) % 8, 1)]
        else:
            sides = [(toward, -1), (toward, 1)]
        for straight, turn in sides:
            a, b = known(cell, near[straight]), known(cell, near[(straight + turn) % 8])
            if math.isinf(a) and math.isinf(b):
                continue
            length, crossing = way_between(a, b, cost[cell])
            if cell not in best or length < best[cell][0]:
                best[cell] = (length, (straight, turn), crossing)
                heapq.heappush(heap, (length, number[cell], cell))

    for cell in flat.members:
        for k, n in flat.around(cell):
            if n not in number and flat.is_seed(begin, n):
                offer(cell, k)
    while heap:
        length, _, cell = heapq.heappop(heap)
        if cell in done or length > best[cell][0]:
            continue
        done[cell] = best[cell]
        for k, n in flat.around(cell):
            if n in number and n not in done:
                offer(n, (k + 4) % 8)
    return done


def lead(flat, ways):
    """Receiver of each member, from the ways to the exits."""
    receiver, gathered = {}, dict.fromkeys(flat.members, 1)
    drift, largest = dict.fromkeys(flat.members, 0.0), dict.fromkeys(flat.members, 0)
    for cell, (_, (straight, turn), crossing) in reversed(ways.items()):
        near = dict(flat.around(cell))
        rise = turn / math.sqrt(1.0 + crossing * crossing)
        ends = [(near[straight], drift[cell] - rise * crossing)]
        if crossing > 0.0:
            ends.append((near[(straight + turn) % 8], drift[cell] + rise * (1.0 - crossing)))
        n, moved = ends[-1] if crossing == 1.0 else min(ends, key=lambda end: abs(end[1]))
        receiver[cell] = n
        if n in gathered:
            gathered[n] += gathered[cell]
            if gathered[cell] > largest[n]:
                largest[n], drift[n] = gathered[cell], moved
    return receiver
