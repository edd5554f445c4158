"""Maps of what moving channels leave behind: cell by cell distances to courses in widths, and integrals over time.

A raster is cut into blocks of 32 x 32 cells, and these into tiles. The segments of a course are listed by the blocks
that they reach; a tile takes from its block's list those that may be the nearest to one of its cells. So each cell
looks at a few segments, and blocks that no channel reaches cost nothing.
"""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.covers import BANK, BAR, CHANNEL, FELT, QUANTA
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# Cells along the side of a block, of a tile and of a part of it; candidates that a tile or a part has room for.
BLOCK, TILE, PART, NEAR_LIMIT = 32, 8, 4, 64
TILES_IN_BLOCK = BLOCK // TILE


@once
def build(scalar):
    """Make the kernels for one precision of positions and distances; times are float64 and sums integers in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.splat_{scalar.__name__}"
    vec2, vec3, vec4 = (wp.types.vector(n, scalar) for n in (2, 3, 4))
    ZERO, HALF, ONE, TWO, THREE, FOUR = (scalar(v) for v in (0.0, BANK, 1.0, 2.0, 3.0, 4.0))
    # What is farther away than any channel is felt.
    FAR, REACH = scalar(FELT + 1.0), scalar(FELT)
    # Of the centres of a tile's, or a part's, cells: their middle, and half of the diagonal, in cells.
    MIDDLE, RADIUS = scalar(0.5 * (TILE - 1)), scalar(0.5 * (TILE - 1) * 2.0**0.5)
    PART_MIDDLE, PART_RADIUS = scalar(0.5 * (PART - 1)), scalar(0.5 * (PART - 1) * 2.0**0.5)
    SLACK = scalar(1.0e-9 if scalar is wp.float64 else 1.0e-4)
    # Distances whose squares differ by less are the same: those to a corner that two segments share.
    ALIKE = scalar(1.0 + (1.0e-12 if scalar is wp.float64 else 1.0e-5))
    STILL = scalar(1.0e-4 if scalar is wp.float64 else 1.0e-2)
    # A channel is taken to have passed over a cell if so many times its way exceed the distances before and after: on
    # its way it may turn.
    PASSING = scalar(3.0)
    # Most that a way bulges, in widths.
    MOST_SAG = scalar(0.1)
    YEAR = wp.float64(QUANTA)
    ZERO_64, HALF_64 = wp.float64(0.0), wp.float64(0.5)

    @wp.struct
    class Course:
        """Segments of a network at one time, in m from the centre of the raster's first cell.

        ``line``: begin, and the way to the end. ``form``: 1 / length^2, width at the begin, its change to the end,
        least width. ``depth``: depth at begin and end. ``bend``: width times curvature there; of an old course the
        distance from its end in widths. ``moved``: how far they have come since the course before, m; 0 where that is
        not known; and how far to the left of the straight way they were halfway. ``group``: where segments are those of
        several times, which of these; blocks list the segments of their own group. Empty: all blocks list all.
        """

        line: wp.array[vec4]
        form: wp.array[vec4]
        depth: wp.array[vec2]
        bend: wp.array[vec2]
        moved: wp.array[vec4]
        group: wp.array[int]

    @wp.struct
    class Grid:
        """A raster: rows, columns, cell size in m; blocks and tiles in a row of each."""

        rows: int
        columns: int
        cell_size: scalar
        block_columns: int
        block_rows: int

    @wp.struct
    class Bins:
        """Segments by blocks, and by tiles those that may be the nearest.

        ``tile`` are the tiles that are worked at, ``tile_slot`` the place of a tile among them, -1 for none. ``near``
        has a row for each: how many candidates there are, -1 for those of the whole block, and their segments.
        ``part``: the same for the part of a tile that is worked at.
        ``worked``: 1 for those whose cells a channel reaches, or did before. ``felt``: of all tiles, whether one does.
        """

        block_start: wp.array[int]
        block_segment: wp.array[int]
        tile: wp.array[int]
        tile_slot: wp.array[int]
        near: wp.array2d[int]
        part: wp.array2d[int]
        worked: wp.array[int]
        felt: wp.array[int]

    @wp.struct
    class Profile:
        """A falloff by distance in widths: its integral from 0 on and itself, at nodes from 0 to 6 widths."""

        node: wp.array[vec2]
        per_width: scalar

    @wp.struct
    class Interval:
        """From the course before to the next one; different tiles may see both at different times.

        ``tile_time``: when the former was, yr; ``tile_end``: when the latter is. ``counted``: factor of the years that
        are added up for moisture and sediment, ``extra``: years added to them. ``span``: years that the way takes as a
        whole, 0 for one that is straight.
        """

        span: wp.float64
        counted: wp.float64
        extra: wp.float64
        tile_time: wp.array[wp.float64]
        tile_end: wp.array[wp.float64]
        moisture: Profile
        sediment: Profile

    @wp.struct
    class Cells:
        """State of the cells, each array (rows, columns).

        ``offset``: distance to the course in widths, above 0 on its left. Sums over time in quanta of a year:
        ``moisture`` and ``sediment`` of the profiles, ``deep`` of that of sediment times the channel's depth in m,
        ``occupied`` of being under the channel. ``left``: when water was there last, yr. ``section``: width and depth
        of the channel there, m. ``kind``: what covered the cell last. ``inner``: width times curvature of the channel
        that left it, above 0 on the inner side of the bend; of an old course the distance from its end in widths.
        ``across``: distance to the middle of that old course, in widths. ``lobe``: thickness of crevasse deposits, m.
        """

        offset: wp.array2d[scalar]
        moisture: wp.array2d[wp.int64]
        sediment: wp.array2d[wp.int64]
        deep: wp.array2d[wp.int64]
        occupied: wp.array2d[wp.int64]
        left: wp.array2d[wp.float64]
        section: wp.array2d[wp.vec2f]
        kind: wp.array2d[wp.uint8]
        inner: wp.array2d[wp.float32]
        lobe: wp.array2d[wp.float32]
        across: wp.array2d[wp.float32]

    @wp.struct
    class Nearest:
        """The nearest segment to a place.

        ``squared``: squared distance in widths. ``cross``: distance from the segment's line in m, above 0 on its left.
        ``square``: its size. ``segment``: which, -1 for none in reach. ``part``: where along it the foot lies, 0 to 1.
        """

        squared: scalar
        square: scalar
        cross: scalar
        segment: int
        part: scalar

    # ---- distances

    @wp.func(module=name)
    def part_of(line: vec4, form: vec4, off: vec2) -> scalar:
        """Part of a segment at which the foot of a place lies, whose offset from the begin is given."""
        return wp.clamp((off[0] * line[2] + off[1] * line[3]) * form[0], ZERO, ONE)

    @wp.func(module=name)
    def squared(line: vec4, off: vec2, part: scalar) -> scalar:
        """Squared distance of a place to its foot on a segment, m2."""
        x, y = off[0] - part * line[2], off[1] - part * line[3]
        return x * x + y * y

    @wp.func(module=name)
    def squared_to(line: vec4, form: vec4, place: vec3) -> scalar:
        """Squared distance of the first two numbers of a place to a segment, m2."""
        off = vec2(place[0] - line[0], place[1] - line[1])
        return squared(line, off, part_of(line, form, off))

    @wp.func(module=name)
    def nearest_of(course: Course, segment: wp.array[int], first: int, last: int, p: vec2) -> Nearest:
        """The nearest of listed segments to a place, by distance over the width at the foot.

        At a corner two segments are equally near; the one that the place lies more squarely beside tells the side.
        """
        found = Nearest(FAR * FAR, -ONE, ZERO, -1, ZERO)
        for k in range(first, last):
            i = segment[k]
            line = course.line[i]
            form = course.form[i]
            x, y = p[0] - line[0], p[1] - line[1]
            part = wp.clamp((x * line[2] + y * line[3]) * form[0], ZERO, ONE)
            u, v = x - part * line[2], y - part * line[3]
            width = form[1] + part * form[2]
            if u * u + v * v <= found.squared * width * width * ALIKE:
                squared = (u * u + v * v) / (width * width)
                cross = (line[2] * y - line[3] * x) * wp.sqrt(form[0])
                if squared * ALIKE < found.squared or wp.abs(cross) > found.square:
                    found.square = wp.abs(cross)
                    found.cross = cross
                    found.segment = i
                    found.part = part
                found.squared = wp.min(found.squared, squared)
        return found

    @wp.func(module=name)
    def nearest_near(course: Course, bins: Bins, block: int, slot: int, p: vec2) -> Nearest:
        """The nearest segment to a place in a tile."""
        near = bins.near[slot]
        if near[0] >= 0:
            return nearest_of(course, near, 1, near[0] + 1, p)
        return nearest_of(course, bins.block_segment, bins.block_start[block], bins.block_start[block + 1], p)

    @wp.func(module=name)
    def signed_widths(found: Nearest) -> scalar:
        """Distance in widths, above 0 on the left; farther than any channel is felt where there is none in reach."""
        widths = wp.sqrt(found.squared)
        if widths >= REACH:
            return FAR
        return wp.where(found.cross < ZERO, -widths, widths)

    @wp.func(module=name)
    def choose_near(
        course: Course, segment: wp.array[int], first: int, last: int, place: vec3, near_out: wp.array[int]
    ):
        """List the segments that may be the nearest to a place within a radius of a middle, given as x, y, radius.

        That is so where the least distance in widths that the place can have is below the greatest of any other.
        """
        bound = REACH
        reached = int(0)
        for k in range(first, last):
            i = segment[k]
            form = course.form[i]
            away = squared_to(course.line[i], form, place)
            most = REACH * wp.max(form[1], form[1] + form[2]) + place[2]
            if away <= most * most:
                reached += 1
                least = bound * form[3] - place[2]
                if least > ZERO and away < least * least:
                    bound = (wp.sqrt(away) + place[2]) / form[3]
        near_out[0] = 0
        if reached == 0:
            return
        count = int(0)
        for k in range(first, last):
            chosen = segment[k]
            shape = course.form[chosen]
            limit = (bound + SLACK) * wp.max(shape[1], shape[1] + shape[2]) + place[2]
            if squared_to(course.line[chosen], shape, place) <= limit * limit:
                if count < NEAR_LIMIT:
                    near_out[count + 1] = chosen
                count += 1
        if count > NEAR_LIMIT:
            count = -1
        near_out[0] = count

    # ---- profiles

    @wp.func(module=name)
    def integral_of(profile: Profile, s: scalar) -> scalar:
        """Integral of a profile from 0 to s, in widths; odd: cubic between the nodes, with the profile as its slope."""
        place = wp.min(wp.abs(s), REACH) * profile.per_width
        k = wp.min(int(place), profile.node.shape[0] - 2)
        a, b = profile.node[k], profile.node[k + 1]
        t = place - scalar(k)
        change = b[0] - a[0]
        # Slopes at both ends beyond that of the straight way.
        p, q = a[1] / profile.per_width - change, b[1] / profile.per_width - change
        total = a[0] + t * (change + (ONE - t) * ((ONE - t) * p - t * q))
        return wp.where(s < ZERO, -total, total)

    @wp.func(module=name)
    def value_of(profile: Profile, s: scalar) -> scalar:
        """Profile at a distance in widths: the slope of ``integral_of``."""
        place = wp.min(wp.abs(s), REACH) * profile.per_width
        k = wp.min(int(place), profile.node.shape[0] - 2)
        a, b = profile.node[k], profile.node[k + 1]
        t = place - scalar(k)
        change = (b[0] - a[0]) * profile.per_width
        p, q = a[1] - change, b[1] - change
        return change + (ONE - t) * ((ONE - THREE * t) * p) - t * (TWO - THREE * t) * q

    @wp.func(module=name)
    def mean_of(profile: Profile, a: scalar, b: scalar) -> wp.float64:
        """Mean of a profile along a straight way from a distance in widths to another."""
        if wp.abs(b - a) < STILL:
            return wp.float64(value_of(profile, HALF * (a + b)))
        return wp.float64((integral_of(profile, b) - integral_of(profile, a)) / (b - a))

    # ---- cells

    @wp.func(module=name)
    def section_at(course: Course, near: Nearest) -> wp.vec2f:
        """Width and depth of the channel at the foot of a place, m."""
        depth, form = course.depth[near.segment], course.form[near.segment]
        width, deep = form[1] + near.part * form[2], depth[0] + near.part * (depth[1] - depth[0])
        return wp.vec2f(wp.float32(width), wp.float32(deep))

    @wp.func(module=name)
    def before_of(course: Course, near: Nearest, before: scalar, after: scalar) -> scalar:
        """Signed distance before, in widths, on the side from which the channel has come.

        It has passed over the place if that lies on its other side now, and it has moved far enough. Where the side
        changed otherwise, another channel has become the nearest.
        """
        if before * after >= ZERO or wp.abs(after) >= REACH:
            return before
        moved, form = course.moved[near.segment], course.form[near.segment]
        way = (moved[0] + near.part * (moved[1] - moved[0])) * PASSING
        if (wp.abs(before) + wp.abs(after)) * (form[1] + near.part * form[2]) <= way:
            return before
        return -before

    @wp.func(module=name)
    def bulge_of(course: Course, span: wp.float64, years: wp.float64, near: Nearest, way: vec2) -> vec2:
        """When the distance turns, as a part of the time, and what it is then; 0 where it goes one way only.

        Channels go on curved ways: where a bend runs along a bank it comes nearer to it between two records than at
        either. The distance is d(t) = d_0 + (d_1 - d_0) t - 4 sag t (1 - t).
        """
        nearest = wp.min(wp.abs(way[0]), wp.abs(way[1]))
        if span <= ZERO_64 or near.segment < 0 or way[0] * way[1] <= ZERO or nearest > ONE:
            return vec2(ZERO, ZERO)
        moved, form = course.moved[near.segment], course.form[near.segment]
        share = scalar(years / span)
        sag = (moved[2] + near.part * (moved[3] - moved[2])) / (form[1] + near.part * form[2]) * share * share
        sag = wp.clamp(sag, -MOST_SAG, MOST_SAG)
        if wp.abs(way[1] - way[0]) >= FOUR * wp.abs(sag):
            return vec2(ZERO, ZERO)
        part = HALF - (way[1] - way[0]) / (TWO * FOUR * sag)
        return vec2(part, way[0] + (way[1] - way[0]) * part - FOUR * sag * part * (ONE - part))

    @wp.func(module=name)
    def quanta(years: wp.float64) -> wp.int64:
        """Years in quanta, rounded."""
        return wp.int64(wp.floor(years * YEAR + HALF_64))

    @wp.func(module=name)
    def cover_cell(course: Course, near: Nearest, row: int, column: int, times: wp.vec2d, way: vec2, cells_io: Cells):
        """Note when a cell was under the channel, whose distance in widths changes from one time to the other."""
        before, after = way[0], way[1]
        years = times[1] - times[0]
        low, high = wp.min(before, after), wp.max(before, after)
        if low > HALF or high < -HALF:
            return
        share = ONE
        if high > low:
            share = (wp.min(high, HALF) - wp.max(low, -HALF)) / (high - low)
        cells_io.occupied[row, column] = cells_io.occupied[row, column] + quanta(years * wp.float64(share))
        leave = ONE
        kind = wp.uint8(CHANNEL)
        if wp.abs(after) > HALF:
            edge = wp.where(after < ZERO, -HALF, HALF)
            leave = (edge - before) / (after - before)
            kind = wp.uint8(BAR)
        cells_io.left[row, column] = times[0] + years * wp.float64(leave)
        cells_io.kind[row, column] = kind
        if near.segment >= 0:
            bend = course.bend[near.segment]
            cells_io.section[row, column] = section_at(course, near)
            turn = bend[0] + near.part * (bend[1] - bend[0])
            cells_io.inner[row, column] = wp.float32(wp.where(after < ZERO, -turn, turn))

    @wp.func(module=name)
    def advance_cell(
        course: Course, interval: Interval, times: wp.vec2d, near: Nearest, row: int, column: int, cells_io: Cells
    ):
        """Bring a cell to the end of an interval, in which its distance to the channel changes evenly."""
        after = signed_widths(near)
        before = before_of(course, near, cells_io.offset[row, column], after)
        cells_io.offset[row, column] = after
        # The side of what is out of reach is not known.
        if wp.abs(after) >= FAR:
            after = wp.where(before < ZERO, -after, after)
        begin, end = times[0], times[1]
        counted = (end - begin) * interval.counted + interval.extra
        if counted > ZERO_64:
            moist = counted * mean_of(interval.moisture, before, after)
            cells_io.moisture[row, column] = cells_io.moisture[row, column] + quanta(moist)
            laid = counted * mean_of(interval.sediment, before, after)
            if laid > ZERO_64:
                cells_io.sediment[row, column] = cells_io.sediment[row, column] + quanta(laid)
                if near.segment >= 0:
                    deep = laid * wp.float64(section_at(course, near)[1])
                    cells_io.deep[row, column] = cells_io.deep[row, column] + quanta(deep)
        part = bulge_of(course, interval.span, end - begin, near, vec2(before, after))
        left = wp.where(part[0] > ZERO, 2, 1)
        while left > 0:
            until = wp.where(left == 2, begin + (end - begin) * wp.float64(part[0]), end)
            reached = wp.where(left == 2, part[1], after)
            cover_cell(course, near, row, column, wp.vec2d(begin, until), vec2(before, reached), cells_io)
            begin = until
            before = reached
            left -= 1

    @wp.func(module=name)
    def advance_part(
        course: Course,
        interval: Interval,
        grid: Grid,
        block: int,
        slot: int,
        top: int,
        west: int,
        bins_io: Bins,
        cells_io: Cells,
    ):
        """Bring the cells of a part of a tile to the end of an interval; they look at what may be the nearest to it."""
        middle = vec3(scalar(west) + PART_MIDDLE, -(scalar(top) + PART_MIDDLE), PART_RADIUS) * grid.cell_size
        count = bins_io.near[slot, 0]
        if count >= 0:
            choose_near(course, bins_io.near[slot], 1, count + 1, middle, bins_io.part[slot])
        else:
            first, last = bins_io.block_start[block], bins_io.block_start[block + 1]
            choose_near(course, bins_io.block_segment, first, last, middle, bins_io.part[slot])
        tile = bins_io.tile[slot]
        times = wp.vec2d(interval.tile_time[tile], interval.tile_end[tile])
        part = bins_io.part[slot]
        for row in range(top, wp.min(top + PART, grid.rows)):
            for column in range(west, wp.min(west + PART, grid.columns)):
                p = vec2(scalar(column), -scalar(row)) * grid.cell_size
                found = nearest_of(course, part, 1, wp.max(part[0], 0) + 1, p)
                if part[0] < 0:
                    found = nearest_near(course, bins_io, block, slot, p)
                # Called at one place only, which lets compilers put it there: structs are passed as copies.
                advance_cell(course, interval, times, found, row, column, cells_io)

    # ---- kernels

    @wp.func(module=name)
    def blocks_of(course: Course, grid: Grid, i: int) -> wp.vec4i:
        """First and last column and row of the blocks that a segment reaches; last below first if it reaches none."""
        line, form = course.line[i], course.form[i]
        reach = REACH * wp.max(form[1], form[1] + form[2])
        size = scalar(BLOCK) * grid.cell_size
        west, east = line[0] + wp.min(line[2], ZERO) - reach, line[0] + wp.max(line[2], ZERO) + reach
        south, north = line[1] + wp.min(line[3], ZERO) - reach, line[1] + wp.max(line[3], ZERO) + reach
        # The first cell's centre is the zero; y falls with the rows. Far off, no integer holds the number.
        columns, rows = scalar(grid.block_columns), scalar(grid.block_rows)
        left, right = wp.clamp(west / size, -ONE, columns), wp.clamp(east / size, -ONE, columns)
        top, bottom = wp.clamp(-north / size, -ONE, rows), wp.clamp(-south / size, -ONE, rows)
        return wp.vec4i(
            wp.max(int(wp.floor(left)), 0),
            wp.min(int(wp.floor(right)), grid.block_columns - 1),
            wp.max(int(wp.floor(top)), 0),
            wp.min(int(wp.floor(bottom)), grid.block_rows - 1),
        )

    @wp.func(module=name)
    def is_listed(course: Course, block_group: wp.array[int], i: int, block: int) -> bool:
        """Whether a block lists a segment that reaches it."""
        if course.group.shape[0] == 0:
            return True
        return course.group[i] == block_group[block]

    @wp.kernel(module=name, enable_backward=False)
    def count_blocks(
        # in
        course: Course,
        grid: Grid,
        block_group: wp.array[int],
        # out
        segment_blocks_out: wp.array[int],
    ):
        """How many blocks list each segment."""
        i = wp.tid()
        box = blocks_of(course, grid, i)
        count = int(0)
        for row in range(box[2], box[3] + 1):
            for column in range(box[0], box[1] + 1):
                if is_listed(course, block_group, i, row * grid.block_columns + column):
                    count += 1
        segment_blocks_out[i] = count

    @wp.kernel(module=name, enable_backward=False)
    def list_blocks(
        # in
        course: Course,
        grid: Grid,
        block_group: wp.array[int],
        segment_end: wp.array[int],
        # out
        pair_block_out: wp.array[int],
        pair_segment_out: wp.array[int],
    ):
        """Pairs of a block and a segment that it lists, in the order of the segments."""
        i = wp.tid()
        box = blocks_of(course, grid, i)
        place = int(0)
        if i > 0:
            place = segment_end[i - 1]
        for row in range(box[2], box[3] + 1):
            for column in range(box[0], box[1] + 1):
                block = row * grid.block_columns + column
                if is_listed(course, block_group, i, block):
                    pair_block_out[place] = block
                    pair_segment_out[place] = i
                    place += 1

    @wp.kernel(module=name, enable_backward=False)
    def find_starts(
        # in
        pair_block: wp.array[int],
        pairs: int,
        # out
        block_start_out: wp.array[int],
    ):
        """Where the pairs of each block begin, the pairs being in order of their blocks."""
        block = wp.tid()
        low, high = int(0), int(pairs)
        while low < high:
            middle = (low + high) // 2
            if pair_block[middle] < block:
                low = middle + 1
            else:
                high = middle
        block_start_out[block] = low

    @wp.kernel(module=name, enable_backward=False)
    def advance_cells(
        # params
        grid: Grid,
        first: int,
        interval: Interval,
        # in
        course: Course,
        # out
        bins_io: Bins,
        cells_io: Cells,
    ):
        """Bring the cells of a tile to the next course: distances, sums over time, when and by what they were covered.

        d(t) goes evenly from one course to the next; the sums are those of g(d(t)) dt [Paris2023, Eqs. 8 and 9].
        """
        slot = first + wp.tid()
        tile = bins_io.tile[slot]
        tile_columns = grid.block_columns * TILES_IN_BLOCK
        top, west = (tile // tile_columns) * TILE, (tile % tile_columns) * TILE
        block = (top // BLOCK) * grid.block_columns + west // BLOCK
        middle = vec3(scalar(west) + MIDDLE, -(scalar(top) + MIDDLE), RADIUS) * grid.cell_size
        first_listed, last_listed = bins_io.block_start[block], bins_io.block_start[block + 1]
        choose_near(course, bins_io.block_segment, first_listed, last_listed, middle, bins_io.near[slot])
        felt = bins_io.near[slot, 0]
        bins_io.worked[slot] = 0
        if felt == 0 and bins_io.felt[tile] == 0:
            return
        bins_io.worked[slot] = 1
        bins_io.felt[tile] = felt
        for row in range(top, wp.min(top + TILE, grid.rows), PART):
            for column in range(west, wp.min(west + TILE, grid.columns), PART):
                advance_part(course, interval, grid, block, slot, row, column, bins_io, cells_io)

    @wp.kernel(module=name, enable_backward=False)
    def lay_courses(
        # params
        grid: Grid,
        kind: int,
        # in
        course: Course,
        segment_time: wp.array[wp.float64],
        # out
        bins_io: Bins,
        cells_io: Cells,
    ):
        """Cover the cells under courses that were given up, each at its own time, unless the channel is there now.

        With the kind ``BAR`` the courses are lobes: they add their thickness, (1 - (2 d / w)^2) of their depth.
        """
        slot = wp.tid()
        tile = bins_io.tile[slot]
        tile_columns = grid.block_columns * TILES_IN_BLOCK
        top, west = (tile // tile_columns) * TILE, (tile % tile_columns) * TILE
        block = (top // BLOCK) * grid.block_columns + west // BLOCK
        bins_io.near[slot, 0] = -1
        for row in range(top, wp.min(top + TILE, grid.rows)):
            for column in range(west, wp.min(west + TILE, grid.columns)):
                p = vec2(scalar(column), -scalar(row)) * grid.cell_size
                near = nearest_near(course, bins_io, block, slot, p)
                if near.segment >= 0 and near.squared <= HALF * HALF:
                    section = section_at(course, near)
                    if kind == BAR:
                        thick = section[1] * wp.float32(ONE - near.squared * FOUR)
                        cells_io.lobe[row, column] = wp.max(cells_io.lobe[row, column], thick)
                    elif wp.abs(cells_io.offset[row, column]) > HALF:
                        bend = course.bend[near.segment]
                        cells_io.left[row, column] = segment_time[near.segment]
                        cells_io.section[row, column] = section
                        cells_io.kind[row, column] = wp.uint8(kind)
                        cells_io.inner[row, column] = wp.float32(bend[0] + near.part * (bend[1] - bend[0]))
                        cells_io.across[row, column] = wp.float32(wp.sqrt(near.squared))

    @wp.kernel(module=name, enable_backward=False)
    def trace_points(
        # params
        grid: Grid,
        # in
        course: Course,
        bins: Bins,
        point_xy: wp.array[vec2],
        # out
        point_foot_out: wp.array[vec2],
        point_moved_out: wp.array[scalar],
        point_segment_out: wp.array[int],
    ):
        """Where points come from: the foot of each on an earlier course, how far away that is in m, on which segment.

        The nearest segment is that in widths. Out of reach, and off the raster, the segment is -1 and the way 0.
        """
        i = wp.tid()
        p = point_xy[i]
        point_foot_out[i] = p
        point_moved_out[i] = ZERO
        point_segment_out[i] = -1
        column, row = int(wp.floor(p[0] / grid.cell_size + HALF)), int(wp.floor(HALF - p[1] / grid.cell_size))
        if column >= 0 and row >= 0 and column < grid.columns and row < grid.rows:
            slot = bins.tile_slot[(row // TILE) * grid.block_columns * TILES_IN_BLOCK + column // TILE]
            if slot >= 0:
                block = (row // BLOCK) * grid.block_columns + column // BLOCK
                near = nearest_near(course, bins, block, slot, p)
                if near.squared < REACH * REACH:
                    form = course.form[near.segment]
                    line = course.line[near.segment]
                    point_foot_out[i] = vec2(line[0] + near.part * line[2], line[1] + near.part * line[3])
                    point_moved_out[i] = wp.sqrt(near.squared) * (form[1] + near.part * form[2])
                    point_segment_out[i] = near.segment

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        Course=Course,
        Grid=Grid,
        Bins=Bins,
        Profile=Profile,
        Interval=Interval,
        Cells=Cells,
        count_blocks=count_blocks,
        list_blocks=list_blocks,
        find_starts=find_starts,
        advance_cells=advance_cells,
        lay_courses=lay_courses,
        trace_points=trace_points,
    )
