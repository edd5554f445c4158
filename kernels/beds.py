"""River beds: what courses, basins and rocks cut out of the ground, at any places [Peytavie2019, Sec. 5.2]."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import raster, steps
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# Side of a block of cells of the index, in cells.
BLOCK = 16
# Slope of banks: the greatest, degrees, and that at the water's edge. Part of the reach at which what is cut fades.
STEEPEST_BANK, GENTLEST_BANK, FADES = 35.0, 0.15, 0.75
# Kinds of marks on the bed.
BASIN, ROCK, OBSTACLE = 0, 1, 2


@once
def build(scalar):
    """Make the kernels of river beds for one precision; heights are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.beds_{scalar.__name__}"
    smooth_steps = steps.build(scalar)
    cells = raster.build(scalar)
    vec2, vec3, vec4 = (wp.types.vector(n, scalar) for n in (2, 3, 4))
    RasterGrid = cells.RasterGrid
    ZERO, HALF, ONE, TWO, THREE = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0))
    SIXTEENTH = scalar(0.0625)
    HALF_64, NAN_64 = wp.float64(0.5), wp.float64(math.nan)
    TINY, HALF_ROOT = scalar(1.0e-12), scalar(math.sqrt(0.5))
    # A bank rises by BANK_START at the water's edge, and then ever more up to BANK (35 degrees).
    BANK, BANK_START = scalar(math.tan(math.radians(STEEPEST_BANK))), scalar(GENTLEST_BANK)
    # Part of the reach at which what is cut begins to fade out; slope that stands ahead of a section's ends.
    FADE, AHEAD = scalar(FADES), scalar(2.0)
    # Exponent of the norm that rounds where two rivers cut.
    NORM, ROOT = scalar(8.0), scalar(0.125)
    # Share of the depth that must be cut before a basin is dug.
    DIG = scalar(4.0)

    @wp.struct
    class Stations:
        """Stations of all courses, and the forms of sections.

        ``line``: place and unit tangent. ``water``: level, m. ``section``: half width, scale of depth, reach of the
        banks, length over which they become steep, m.
        ``shape``: weight of the second form, weight of the bend, its lane as a row of the table, softness of the
        rim, m.
        ``form``: two rows of ``form_depth``. ``segment``: of the segment from each station on: what it reaches beyond
        its two ends, m, and the square of what it reaches from its first one. ``group``: of the same.
        """

        line: wp.array[vec4]
        water: wp.array[wp.float64]
        section: wp.array[vec4]
        shape: wp.array[vec4]
        form: wp.array[wp.vec2i]
        segment: wp.array[vec3]
        group: wp.array[int]
        form_depth: wp.array2d[scalar]
        bend_depth: wp.array2d[scalar]

    @wp.struct
    class Marks:
        """Basins, rocks, obstacles: centre and radius in m, and depth, height over the bed, or elevation of the top."""

        place: wp.array[vec4]
        kind: wp.array[int]

    @wp.struct
    class Index:
        """Which segments and marks a place may meet: a sparse grid of blocks of cells.

        ``block``: number of each block, -1 where nothing is. ``cell_start``: offsets of the cells' segments, by group,
        and ``mark_start`` of their marks.
        """

        west: scalar
        south: scalar
        per_cell: scalar
        block: wp.array2d[int]
        cell_start: wp.array[int]
        cell_segment: wp.array[int]
        mark_start: wp.array[int]
        cell_mark: wp.array[int]

    @wp.struct
    class Window:
        """Cells of a raster: centre of the first in the north-west, relative to the stations' zero, and size."""

        west: scalar
        north: scalar
        cell_size: scalar

    @wp.func(module=name)
    def cubic_weights(t: wp.float64) -> wp.vec4d:
        """Weights of four values at -1, 0, 1, 2 for the cubic between the middle ones [Keys1981]."""
        a, b = t * t, t * t * t
        return wp.vec4d(
            HALF_64 * (a + a - t - b),
            HALF_64 * (b + b + b - a - a - a - a - a) + wp.float64(1.0),
            HALF_64 * (t + a + a + a + a - b - b - b),
            HALF_64 * (b - a),
        )

    @wp.func(module=name)
    def base_height(height: wp.array2d[wp.float64], grid: RasterGrid, xy: vec2) -> wp.float64:
        """Height of the ground at a place: bicubic between the cells' centres, bilinear beside missing ones; or NaN."""
        position = cells.cell_position(grid, xy)
        if not cells.is_inside(height, position):
            return NAN_64
        column, row = int(wp.floor(position[0])), int(wp.floor(position[1]))
        wx = cubic_weights(wp.float64(position[0] - scalar(column)))
        wy = cubic_weights(wp.float64(position[1] - scalar(row)))
        total = wp.float64(0.0)
        for i in range(4):
            line = height[wp.clamp(row + i - 1, 0, height.shape[0] - 1)]
            across = wp.float64(0.0)
            for j in range(4):
                across += wx[j] * line[wp.clamp(column + j - 1, 0, height.shape[1] - 1)]
            total += wy[i] * across
        if wp.isnan(total):
            return cells.value_at(height, grid, xy)
        return total

    @wp.func(module=name)
    def table_depth(table: wp.array2d[scalar], row: int, place: scalar) -> scalar:
        """Linear look-up in a row of a table; ``place`` is that of a column."""
        k = wp.min(int(place), table.shape[1] - 2)
        line = table[row]
        return line[k] + (place - scalar(k)) * (line[k + 1] - line[k])

    @wp.func(module=name)
    def section_depth(stations: Stations, i: int, t: scalar, share: scalar) -> scalar:
        """Depth over its scale at a part of the width from the left bank, t of the way to the next station."""
        shape = (ONE - t) * stations.shape[i] + t * stations.shape[i + 1]
        form = stations.form[i]
        place = share * scalar(stations.form_depth.shape[1] - 1)
        depth = table_depth(stations.form_depth, form[0], place)
        if shape[0] > ZERO:
            depth += shape[0] * (table_depth(stations.form_depth, form[1], place) - depth)
        if shape[1] > ZERO:
            k = wp.min(int(shape[2]), stations.bend_depth.shape[0] - 2)
            below = table_depth(stations.bend_depth, k, place)
            tilted = below + (shape[2] - scalar(k)) * (table_depth(stations.bend_depth, k + 1, place) - below)
            depth += shape[1] * (tilted - depth)
        return depth

    @wp.func(module=name)
    def bank_rise(away: scalar, ease: scalar) -> scalar:
        """Rise of a bank over the water's edge: gentle there, and at most 35 degrees from ``ease`` on."""
        t = wp.min(away / ease, ONE)
        # Integral of the quintic step.
        eased = ease * t * t * t * t * (t * (t - THREE) + TWO + HALF) + (away - t * ease)
        return BANK_START * away + (BANK - BANK_START) * eased

    @wp.func(module=name)
    def soft_positive(x: scalar, soft: scalar) -> scalar:
        """max(0, x), rounded where abs(x) < soft with two continuous derivatives; nowhere below it."""
        if x <= -soft:
            return ZERO
        if x >= soft:
            return x
        t = x / soft + ONE
        return soft * SIXTEENTH * t * t * t * (TWO + TWO - t)

    @wp.func(module=name)
    def segment_place(a: vec4, b: vec4, fa: scalar, fb: scalar, xy: vec2) -> vec4:
        """Place beside a segment: part of the way, distance to the left, and beyond the two ends.

        The sections at both ends bound it. Between them t = f_a / (f_a - f_b) with f = (p - x) . tangent: the fans of
        neighbours meet in their section, on both sides of a bend.
        """
        t = scalar(0.0)
        if fa >= ZERO and fb < ZERO:
            t = fa / (fa - fb)
        elif fa < ZERO and fb > ZERO:
            t = fb / (fb - fa)
        elif fb >= ZERO:
            t = scalar(1.0)
        m = a + t * (b - a)
        size = wp.max(wp.sqrt(m[2] * m[2] + m[3] * m[3]), TINY)
        left = ((xy[1] - m[1]) * m[2] - (xy[0] - m[0]) * m[3]) / size
        return vec4(t, left, wp.max(-fa, ZERO), wp.max(fb, ZERO))

    @wp.func(module=name)
    def segment_cut(stations: Stations, i: int, xy: vec2, base: wp.float64, deepest: scalar) -> scalar:
        """Depth of what a segment cuts out of ground of that height at a place, m; 0 where it is below ``deepest``."""
        limit = stations.segment[i]
        a = stations.line[i]
        x, y = xy[0] - a[0], xy[1] - a[1]
        if x * x + y * y >= limit[2]:
            return ZERO
        b = stations.line[i + 1]
        fa = (xy[0] - a[0]) * a[2] + (xy[1] - a[1]) * a[3]
        fb = (xy[0] - b[0]) * b[2] + (xy[1] - b[1]) * b[3]
        if -fa >= limit[0] or fb >= limit[1]:
            return ZERO
        first, second = stations.section[i], stations.section[i + 1]
        level, below = stations.water[i], stations.water[i + 1]
        soft_a, soft_b = stations.shape[i][3], stations.shape[i + 1][3]
        if scalar(base - wp.min(level, below)) + wp.max(first[1], second[1]) + wp.max(soft_a, soft_b) <= deepest:
            return ZERO
        at = segment_place(a, b, fa, fb, xy)
        t = at[0]
        section = (ONE - t) * first + t * second
        half, reach = section[0], section[2]
        beyond = wp.max(at[2], at[3])
        outside = wp.max(wp.abs(at[1]) - half, ZERO)
        away = wp.sqrt(outside * outside + beyond * beyond)
        if away >= reach:
            return ZERO
        over = scalar(base - (level + wp.float64(t) * (below - level)))
        if wp.abs(at[1]) < half and section[1] > ZERO:
            over += section[1] * section_depth(stations, i, t, HALF - HALF * at[1] / half)
        weight = ONE - smooth_steps.quintic_step((away / reach - FADE) / (ONE - FADE))
        if away > ZERO:
            over -= bank_rise(away, section[3])
            # Ends of a line have banks; within one what lies ahead of a segment is that of the next.
            if (at[2] > ZERO and limit[0] < reach) or (at[3] > ZERO and limit[1] < reach):
                over -= AHEAD * beyond
                limited = limit[0]
                if at[3] > ZERO:
                    limited = limit[1]
                weight *= ONE - smooth_steps.quintic_step(beyond / limited)
        return weight * soft_positive(over, soft_a + t * (soft_b - soft_a))

    @wp.func(module=name)
    def index_cell(index: Index, xy: vec2) -> int:
        """Cell of the index that a place lies in; -1 where nothing is near."""
        column = int(wp.floor((xy[0] - index.west) * index.per_cell))
        row = int(wp.floor((xy[1] - index.south) * index.per_cell))
        if column < 0 or row < 0:
            return -1
        u, v = column // BLOCK, row // BLOCK
        if v >= index.block.shape[0] or u >= index.block.shape[1]:
            return -1
        block = index.block[v, u]
        if block < 0:
            return -1
        return (block * BLOCK + row - v * BLOCK) * BLOCK + column - u * BLOCK

    @wp.func(module=name)
    def river_cut(stations: Stations, index: Index, cell: int, xy: vec2, base: wp.float64) -> scalar:
        """What all courses cut at a place, m: the deepest of each group, and of the groups the 8-norm."""
        greatest = scalar(0.0)
        norm = scalar(0.0)
        deepest = scalar(0.0)
        group = int(-1)
        end = index.cell_start[cell + 1]
        for k in range(index.cell_start[cell], end + 1):
            segment = int(-1)
            own = int(-2)
            if k < end:
                segment = index.cell_segment[k]
                own = stations.group[segment]
            if own != group:
                if deepest > greatest:
                    norm = norm * wp.pow(greatest / deepest, NORM) + ONE
                    greatest = deepest
                elif deepest > ZERO:
                    norm += wp.pow(deepest / greatest, NORM)
                group = own
                deepest = ZERO
            if k < end:
                deepest = wp.max(deepest, segment_cut(stations, segment, xy, base, deepest))
        if norm > ONE:
            greatest = greatest * wp.pow(norm, ROOT)
        return greatest

    @wp.func(module=name)
    def mark_distance(marks: Marks, mark: int, xy: vec2) -> scalar:
        """Square of the distance from the centre of a mark over its radius."""
        place = marks.place[mark]
        x, y = (xy[0] - place[0]) / place[2], (xy[1] - place[1]) / place[2]
        return x * x + y * y

    @wp.func(module=name)
    def bed_height(stations: Stations, marks: Marks, index: Index, xy: vec2, base: wp.float64) -> wp.float64:
        """Height of the bed at a place whose ground has a height: cut by courses and basins, rocks set in."""
        cell = index_cell(index, xy)
        if cell < 0 or wp.isnan(base):
            return base
        cut = river_cut(stations, index, cell, xy, base)
        first, end = index.mark_start[cell], index.mark_start[cell + 1]
        bed = base
        if cut > ZERO:
            dug = scalar(0.0)
            raised = scalar(0.0)
            for k in range(first, end):
                mark = index.cell_mark[k]
                r2 = mark_distance(marks, mark, xy)
                if r2 < ONE:
                    size = marks.place[mark][3]
                    if marks.kind[mark] == BASIN:
                        # g(r) = (1 - r^2)^3.
                        g = ONE - r2
                        dug = wp.max(dug, wp.min(size, DIG * cut) * g * g * g)
                    elif marks.kind[mark] == ROCK:
                        # Steep sides and a round top.
                        g = ONE - r2 * r2
                        raised = wp.max(raised, size * g * g)
            bed = wp.min(base, base - wp.float64(cut + dug - raised))
        floor = bed
        for k in range(first, end):
            mark = index.cell_mark[k]
            if marks.kind[mark] == OBSTACLE:
                r2 = mark_distance(marks, mark, xy)
                if r2 < ONE:
                    # As high as it is said to be, also over the ground.
                    share = wp.float64(ONE - r2 * r2)
                    bed = wp.max(bed, floor + (wp.float64(marks.place[mark][3]) - floor) * share * share)
        return bed

    @wp.kernel(module=name, enable_backward=False)
    def evaluate_points(
        # terrain
        height: wp.array2d[wp.float64],
        grid: RasterGrid,
        # params
        stations: Stations,
        marks: Marks,
        index: Index,
        # in
        point_xy: wp.array[vec2],
        # out
        point_height_out: wp.array[wp.float64],
        point_base_out: wp.array[wp.float64],
    ):
        """Height of the bed, and of the ground without it, at any places."""
        i = wp.tid()
        base = base_height(height, grid, point_xy[i])
        point_base_out[i] = base
        point_height_out[i] = bed_height(stations, marks, index, point_xy[i], base)

    @wp.kernel(module=name, enable_backward=False)
    def evaluate_cells(
        # terrain
        height: wp.array2d[wp.float64],
        grid: RasterGrid,
        # params
        stations: Stations,
        marks: Marks,
        index: Index,
        window: Window,
        # out
        cell_height_out: wp.array2d[wp.float64],
    ):
        """Height of the bed at the centres of a raster's cells."""
        row, column = wp.tid()
        xy = vec2(window.west + scalar(column) * window.cell_size, window.north - scalar(row) * window.cell_size)
        cell_height_out[row, column] = bed_height(stations, marks, index, xy, base_height(height, grid, xy))

    @wp.kernel(module=name, enable_backward=False)
    def sample_ground(
        # terrain
        height: wp.array2d[wp.float64],
        grid: RasterGrid,
        # in
        point_xy: wp.array[vec2],
        # out
        point_height_out: wp.array[wp.float64],
    ):
        """Height of the ground that beds are cut into, at any places."""
        i = wp.tid()
        point_height_out[i] = base_height(height, grid, point_xy[i])

    @wp.kernel(module=name, enable_backward=False)
    def locate_points(
        # params
        stations: Stations,
        index: Index,
        # in
        point_xy: wp.array[vec2],
        course_wet: wp.array[wp.uint8],
        # out
        point_segment_out: wp.array[int],
        point_place_out: wp.array[vec3],
    ):
        """Segment of the wet course whose bank is nearest, or farthest where a place is in the water; -1 for none.

        With it the part of the way, the distance to the left of the line, and that beyond the water's edge, m.
        """
        i = wp.tid()
        xy = point_xy[i]
        best = int(-1)
        found = vec3(ZERO, ZERO, ZERO)
        cell = index_cell(index, xy)
        if cell >= 0:
            for k in range(index.cell_start[cell], index.cell_start[cell + 1]):
                segment = index.cell_segment[k]
                if course_wet[segment] != wp.uint8(0):
                    a, b = stations.line[segment], stations.line[segment + 1]
                    fa = (xy[0] - a[0]) * a[2] + (xy[1] - a[1]) * a[3]
                    fb = (xy[0] - b[0]) * b[2] + (xy[1] - b[1]) * b[3]
                    at = segment_place(a, b, fa, fb, xy)
                    limit = stations.segment[segment]
                    if at[2] < limit[0] and at[3] < limit[1]:
                        t = at[0]
                        half = stations.section[segment][0] * (ONE - t) + stations.section[segment + 1][0] * t
                        edge = wp.abs(at[1]) - half + wp.max(at[2], at[3])
                        if best < 0 or edge < found[2]:
                            best = segment
                            found = vec3(t, at[1], edge)
        point_segment_out[i] = best
        point_place_out[i] = found

    @wp.func(module=name)
    def slab_cells(
        stations: Stations,
        i: int,
        across: scalar,
        ahead: vec2,
        per_cell: scalar,
        first: int,
        segment_cell_out: wp.array[wp.vec2i],
    ) -> int:
        """Number of cells of the index that a segment may reach; they are written from ``first`` on, if it is >= 0."""
        a, b = stations.line[i], stations.line[i + 1]
        size = ONE / per_cell
        slack = size * HALF_ROOT
        # The sections at both ends, a little beyond them.
        low = vec2(wp.min(a[0] - ahead[0], b[0] - ahead[1]), wp.min(a[1] - ahead[0], b[1] - ahead[1]))
        high = vec2(wp.max(a[0] + ahead[0], b[0] + ahead[1]), wp.max(a[1] + ahead[0], b[1] + ahead[1]))
        aside = across * wp.max(wp.abs(a[3]), wp.abs(b[3])) + slack
        upward = across * wp.max(wp.abs(a[2]), wp.abs(b[2])) + slack
        left, right = int(wp.floor((low[0] - aside) * per_cell)), int(wp.floor((high[0] + aside) * per_cell))
        bottom, top = int(wp.floor((low[1] - upward) * per_cell)), int(wp.floor((high[1] + upward) * per_cell))
        reach = across + wp.max(ahead[0], ahead[1]) + HALF * wp.length(vec2(b[0] - a[0], b[1] - a[1])) + slack
        count = int(0)
        for row in range(bottom, top + 1):
            for column in range(left, right + 1):
                x, y = (scalar(column) + HALF) * size, (scalar(row) + HALF) * size
                fa = (x - a[0]) * a[2] + (y - a[1]) * a[3]
                fb = (x - b[0]) * b[2] + (y - b[1]) * b[3]
                if fa > -ahead[0] - slack and fb < ahead[1] + slack:
                    if wp.length(vec2(x - HALF * (a[0] + b[0]), y - HALF * (a[1] + b[1]))) < reach:
                        if first >= 0:
                            segment_cell_out[first + count] = wp.vec2i(column, row)
                        count += 1
        return count

    @wp.kernel(module=name, enable_backward=False)
    def list_cells(
        # params
        stations: Stations,
        per_cell: scalar,
        # in
        segment: wp.array[int],
        segment_across: wp.array[scalar],
        segment_ahead: wp.array[vec2],
        segment_first: wp.array[int],
        # out
        segment_count_out: wp.array[int],
        segment_cell_out: wp.array[wp.vec2i],
    ):
        """Count the cells that each segment may reach, and list them from its ``segment_first`` on; -1: only count."""
        k = wp.tid()
        segment_count_out[k] = slab_cells(
            stations, segment[k], segment_across[k], segment_ahead[k], per_cell, segment_first[k], segment_cell_out
        )

    return SimpleNamespace(
        vec2=vec2,
        vec3=vec3,
        vec4=vec4,
        Stations=Stations,
        Marks=Marks,
        Index=Index,
        Window=Window,
        evaluate_points=evaluate_points,
        evaluate_cells=evaluate_cells,
        sample_ground=sample_ground,
        locate_points=locate_points,
        list_cells=list_cells,
    )
