"""Carving: the water, the bed and the banks of channels at the cells of a raster, and what the ground becomes by them.

Cells are visited tile by tile, and each looks at the segments of its tile alone: what it becomes does not depend on
the order of threads. The level of the water is a mean over the places of all channels around, with weights that fall
off to 0 at their reach; the bed is the deepest of all sections that a cell lies in, which is the minimum over the
channels. Both are continuous where channels meet and inside of tight bends.
"""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import raster
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# Cells along the side of a tile.
TILE = 16
# Ends of a segment that are ends of its channel.
HEAD, FOOT = 1, 2


@once
def build(scalar):
    """Make the kernels of carving for one precision of the positions; heights are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.carving_{scalar.__name__}"
    cells = raster.build(scalar)
    vec2, RasterGrid = cells.vec2, cells.RasterGrid
    SIDE = wp.int32(TILE)
    ZERO, HALF, ONE, TWO, THREE = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0))
    TINY = scalar(1.0e-30)
    ZERO_64, HALF_64, ONE_64, TWO_64, THREE_64, NAN_64 = (wp.float64(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0, math.nan))
    # Half-widths in cells up to which the deepest part of a section is as wide as a cell, and from which it is as is.
    COARSE, FINE = scalar(2.5), scalar(6.0)
    # Distance over which levels are averaged, over that at which banks end.
    SPREAD = scalar(0.35)
    # Slope over that of the angle of repose from which ground is taken for a wall, and at which it is nothing else.
    WALL_FROM, WALL_SPAN = wp.float64(0.35), wp.float64(0.5)

    @wp.struct
    class Segments:
        """Pieces of channels, straight from one place to the next; pairs belong to both ends.

        ``tangent``: bisectors of the corners, unit vectors downstream. ``level``: of the water, m. ``cut``: height of
        the ground over the water, m, at most. ``half``: half of the width. ``bank``, ``reach``: distances at which
        banks end, and at which the wall of a deep cut ends. ``row``: of the table of sections; ``part``: weight of the
        second one. ``ends``: HEAD, FOOT.
        """

        first: wp.array[vec2]
        last: wp.array[vec2]
        first_tangent: wp.array[vec2]
        last_tangent: wp.array[vec2]
        level: wp.array[wp.vec2d]
        cut: wp.array[wp.vec2d]
        half: wp.array[vec2]
        depth: wp.array[vec2]
        bank: wp.array[vec2]
        reach: wp.array[vec2]
        row: wp.array[wp.vec2i]
        part: wp.array[vec2]
        ends: wp.array[wp.uint8]

    @wp.struct
    class Tiles:
        """Tiles that segments reach: number on the raster, ``columns`` of them a row, and the segments of each.

        ``raster``: rows and columns of cells.
        """

        number: wp.array[int]
        start: wp.array[int]
        segment: wp.array[int]
        columns: int
        raster: wp.vec2i

    @wp.func(module=name)
    def between(pair: vec2, part: scalar) -> scalar:
        """Linear between the two ends of a segment."""
        return pair[0] + part * (pair[1] - pair[0])

    @wp.func(module=name)
    def falling(part: scalar) -> scalar:
        """1 up to 0, 0 from 1 on, flat at both: 1 - 3 p^2 + 2 p^3."""
        p = wp.clamp(part, ZERO, ONE)
        return ONE - p * p * (THREE - TWO * p)

    @wp.func(module=name)
    def tile_cell(tiles: Tiles, slot: int, place: int) -> wp.vec2i:
        """Row and column of a cell of a tile."""
        tile = tiles.number[slot]
        row = (tile // tiles.columns) * SIDE + place // SIDE
        return wp.vec2i(row, (tile % tiles.columns) * SIDE + place % SIDE)

    @wp.func(module=name)
    def row_depth(section: wp.array2d[scalar], row: int, y: scalar) -> scalar:
        """Depth in greatest depths at Y = 0 at the left bank to 1 at the right one, linear in the table."""
        places = section.shape[1] - 1
        at = wp.clamp(y, ZERO, ONE) * scalar(places)
        k = wp.min(int(at), places - 1)
        return section[row, k] + (at - scalar(k)) * (section[row, k + 1] - section[row, k])

    @wp.func(module=name)
    def form_depth(segments: Segments, section: wp.array2d[scalar], s: int, part: scalar, y: scalar) -> scalar:
        """Depth in greatest depths: the two sections of a segment, blended along it."""
        weight = between(segments.part[s], part)
        rows = segments.row[s]
        above = row_depth(section, rows[0], y)
        if rows[0] == rows[1]:
            return above
        return above + weight * (row_depth(section, rows[1], y) - above)

    @wp.func(module=name)
    def section_depth(segments: Segments, section: wp.array2d[scalar], s: int, xy: vec2, cell_size: scalar) -> scalar:
        """Depth in m of the section of a segment at a place, 0 outside of it.

        A segment has the places between the bisectors of its corners. At the ends of its channel it ends round.
        """
        along = segments.last[s] - segments.first[s]
        offset = xy - segments.first[s]
        # Left of the flow > 0.
        side = (along[0] * offset[1] - along[1] * offset[0]) / wp.max(wp.length(along), TINY)
        before = wp.dot(offset, segments.first_tangent[s])
        behind = wp.dot(segments.last[s] - xy, segments.last_tangent[s])
        ends = int(segments.ends[s])
        if before < ZERO and (ends & HEAD) == 0:
            return ZERO
        if behind < ZERO and (ends & FOOT) == 0:
            return ZERO
        part = wp.max(before, ZERO) / wp.max(wp.max(before, ZERO) + wp.max(behind, ZERO), TINY)
        half = between(segments.half[s], part)
        away = wp.abs(side)
        lean = ONE
        if before < ZERO or behind < ZERO:
            away = wp.length(offset)
            if behind < ZERO:
                away = wp.length(segments.last[s] - xy)
            lean = wp.abs(side) / wp.max(away, TINY)
        if away >= half:
            return ZERO
        # A line through a cell passes its centre at half of this or less.
        across = (wp.abs(along[0]) + wp.abs(along[1])) / wp.max(wp.length(along), TINY)
        core = HALF * across * cell_size * falling((half / cell_size - COARSE) / (FINE - COARSE))
        out = HALF * wp.max(away - core, ZERO) / wp.max(half - core, TINY)
        if side > ZERO:
            out = -out
        form = form_depth(segments, section, s, part, HALF + out)
        if lean < ONE:
            form = HALF * ((ONE + lean) * form + (ONE - lean) * form_depth(segments, section, s, part, HALF - out))
        return between(segments.depth[s], part) * form

    @wp.kernel(module=name, enable_backward=False)
    def find_water(
        # network
        segments: Segments,
        tiles: Tiles,
        # terrain
        grid: RasterGrid,
        # params
        section: wp.array2d[scalar],
        # out
        level_out: wp.array2d[wp.float64],
        cut_out: wp.array2d[wp.float64],
        shape_out: wp.array2d[wp.vec3d],
    ):
        """Level of the water at the cells of tiles, the cut of the ground there, and (depth, bank, wall).

        The level is the mean over segments in reach, with weights (1 - (r / reach)^2)^2 / (1 + (r / s)^2)^4 times
        their length, s being a part of the distance at which banks end; depth and the weights of banks and walls are
        the greatest of all.
        """
        slot, place = wp.tid()
        cell = tile_cell(tiles, slot, place)
        total = wp.float64(0.0)
        level = wp.float64(0.0)
        cut = wp.float64(0.0)
        depth = scalar(0.0)
        # Parts of the way from the water's edge to where banks and walls end.
        bank, wall = scalar(1.0), scalar(1.0)
        if cell[0] < tiles.raster[0] and cell[1] < tiles.raster[1]:
            xy = cells.center_of_cell(grid, cell[0], cell[1])
            for k in range(tiles.start[slot], tiles.start[slot + 1]):
                s = tiles.segment[k]
                along = segments.last[s] - segments.first[s]
                offset = xy - segments.first[s]
                square = wp.max(wp.dot(along, along), TINY)
                part = wp.clamp(wp.dot(offset, along) / square, ZERO, ONE)
                offset = offset - part * along
                reach = between(segments.reach[s], part)
                away = wp.dot(offset, offset)
                if away < reach * reach:
                    q = ONE - away / (reach * reach)
                    end = between(segments.bank[s], part)
                    spread = ONE + away / (SPREAD * SPREAD * end * end)
                    spread = spread * spread
                    weight = wp.float64(q * q / (spread * spread) * wp.min(wp.sqrt(square), end))
                    at = wp.float64(part)
                    total += weight
                    level += weight * (segments.level[s][0] + at * (segments.level[s][1] - segments.level[s][0]))
                    cut += weight * (segments.cut[s][0] + at * (segments.cut[s][1] - segments.cut[s][0]))
                    away = wp.sqrt(away)
                    half = between(segments.half[s], part)
                    bank = wp.min(bank, (away - half) / (end - half))
                    wall = wp.min(wall, (away - half) / (reach - half))
                    if away < half + grid.cell_size:
                        depth = wp.max(depth, section_depth(segments, section, s, xy, grid.cell_size))
        if depth > ZERO:
            # Outside of a corner a bed reaches farther than the circle around it.
            bank = ZERO
            wall = ZERO
        level_out[slot, place] = NAN_64
        cut_out[slot, place] = ZERO_64
        if total > ZERO_64:
            level_out[slot, place] = level / total
            cut_out[slot, place] = cut / total
        shape_out[slot, place] = wp.vec3d(wp.float64(depth), wp.float64(falling(bank)), wp.float64(falling(wall)))

    @wp.func(module=name)
    def carved_height(
        height: wp.float64, level: wp.float64, cut: wp.float64, shape: wp.vec3d, max_cut: wp.float64
    ) -> wp.float64:
        """Height of the ground at a cell: drawn to the water's level by its weights, and below it by its depth.

        As much of the height over the water as the cut has at its channel goes by the weight of the wall, the rest by
        that of the bank: so the sides of a valley are not taken for walls of the cut. Beside the bed no more is cut
        than the limit.
        """
        over = height - level
        walled = wp.clamp(over, -cut, cut)
        lowered = shape[2] * walled + shape[1] * (over - walled)
        if shape[0] <= ZERO_64:
            lowered = wp.min(lowered, max_cut)
        return height - lowered - shape[0]

    @wp.kernel(module=name, enable_backward=False)
    def carve_cells(
        # network
        tiles: Tiles,
        # params
        max_cut: wp.float64,
        # in
        level: wp.array2d[wp.float64],
        cut: wp.array2d[wp.float64],
        shape: wp.array2d[wp.vec3d],
        # out
        cell_height_io: wp.array2d[wp.float64],
        cell_level_out: wp.array2d[wp.float64],
        cell_depth_out: wp.array2d[wp.float64],
        cell_support_out: wp.array2d[wp.uint8],
    ):
        """Carve the cells of tiles, and write level and depth of the water where there is some."""
        slot, place = wp.tid()
        cell = tile_cell(tiles, slot, place)
        if cell[0] < cell_height_io.shape[0] and cell[1] < cell_height_io.shape[1]:
            height = cell_height_io[cell[0], cell[1]]
            form = shape[slot, place]
            if form[2] > ZERO_64 and not wp.isnan(height):
                cell_support_out[cell[0], cell[1]] = wp.uint8(1)
                cell_height_io[cell[0], cell[1]] = carved_height(
                    height, level[slot, place], cut[slot, place], form, max_cut
                )
                if form[0] > ZERO_64:
                    cell_level_out[cell[0], cell[1]] = level[slot, place]
                    cell_depth_out[cell[0], cell[1]] = form[0]

    @wp.func(module=name)
    def rising(value: wp.float64) -> wp.float64:
        """0 up to 0, 1 from 1 on, flat at both."""
        p = wp.clamp(value, ZERO_64, ONE_64)
        return p * p * (THREE_64 - TWO_64 * p)

    @wp.kernel(module=name, enable_backward=False)
    def weigh_materials(
        # network
        tiles: Tiles,
        # params
        per_repose: wp.float64,
        # in
        shape: wp.array2d[wp.vec3d],
        cell_height: wp.array2d[wp.float64],
        cell_before: wp.array2d[wp.float64],
        # out
        bed_out: wp.array2d[wp.uint8],
        bank_out: wp.array2d[wp.uint8],
        wall_out: wp.array2d[wp.uint8],
    ):
        """Parts of bed, bank and wall at the cells of tiles, in 255ths; the rest of 255 is ground as it was.

        Bed lies under water. Walls are what was cut, where the ground is steep beside the angle of repose;
        ``per_repose`` is one over the rise of that from cell to cell, 1/m. Banks are the rest by their weight.
        """
        slot, place = wp.tid()
        cell = tile_cell(tiles, slot, place)
        if cell[0] < cell_height.shape[0] and cell[1] < cell_height.shape[1]:
            form = shape[slot, place]
            height = cell_height[cell[0], cell[1]]
            if form[2] > ZERO_64 and not wp.isnan(height):
                left = wp.float64(255.0)
                bed = ZERO_64
                if form[0] > ZERO_64:
                    bed = left
                steep = wp.length(cells.cell_difference(cell_height, cell[0], cell[1])) * per_repose
                changed = rising(TWO_64 * wp.abs(cell_before[cell[0], cell[1]] - height))
                wall = wp.floor((left - bed) * form[2] * changed * rising((steep - WALL_FROM) / WALL_SPAN) + HALF_64)
                bank = wp.floor((left - bed - wall) * form[1] + HALF_64)
                bed_out[cell[0], cell[1]] = wp.uint8(bed)
                wall_out[cell[0], cell[1]] = wp.uint8(wall)
                bank_out[cell[0], cell[1]] = wp.uint8(bank)

    return SimpleNamespace(
        vec2=vec2,
        RasterGrid=RasterGrid,
        Segments=Segments,
        Tiles=Tiles,
        find_water=find_water,
        carve_cells=carve_cells,
        weigh_materials=weigh_materials,
    )
