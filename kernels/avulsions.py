"""Avulsions: where banks break, the walk of a new course over the terrain, and the bed that is carved along it."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline, raster
from warpriver.kernels.channels import Work
from warpriver.kernels.status import BEGUN, CREVASSES, FAULT, NUMBER, STEPS
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# How a walk ended: on its target, on ground that rises too steeply, off the terrain, or lost after too many steps.
ARRIVED, TOO_STEEP, NO_GROUND, LOST = range(4)
# What a bank does at a point: holds, breaks, or breaks so that the channel leaves there.
HOLDS, BREAKS, LEAVES = range(3)


@once
def build(scalar):
    """Make the kernels for one precision of the positions; heights are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.avulsions_{scalar.__name__}"
    cells, line = raster.build(scalar), polyline.build(scalar)
    vec2, RasterGrid = cells.vec2, cells.RasterGrid
    Channels, Points, Run = line.Channels, line.Points, line.Run
    ZERO, HALF, ONE, TWO, THREE = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0))
    # Fraction of an integer of 32 bits, by which chances are compared.
    ALL_BITS = wp.float64(2.0**-32)
    ZERO_64, ONE_64 = wp.float64(0.0), wp.float64(1.0)
    LOW, HIGH = wp.float32(-1.0), wp.float32(1.0)
    FAR = scalar(2.0**100)

    @wp.struct
    class Walk:
        """Constants of a walk: length of a step (m), largest turn by chance (rad), steepest rise (m/m)."""

        spacing: scalar
        jitter: scalar
        steepest: scalar

    @wp.struct
    class Courses:
        """Courses to walk: from ends[k, 0] to ends[k, 1], first along the unit vector ``direction``, with seeds."""

        ends: wp.array2d[vec2]
        direction: wp.array[vec2]
        seed: wp.array[wp.uint32]

    @wp.struct
    class Breaking:
        """When banks break: minimum |w C|, hazard (1/(m yr)) or chance by the point, chance of an avulsion, step (yr).

        ``by_point`` is 1 for a chance by the point and the step, 0 for a hazard by the bend.
        """

        curvature: scalar
        rate: wp.float64
        chance: wp.float64
        avulsion: wp.float64
        time_step: wp.float64
        by_point: int
        seed: int

    @wp.func(module=name)
    def ends_a_step(work: Work, substep: wp.array[int]) -> bool:
        """Tell whether the sub-step that was just done is the last one of its step."""
        return work.status[FAULT] == 0 and substep[NUMBER] == 0

    @wp.func(module=name)
    def curvature_at(points: Points, run: Run, i: int) -> scalar:
        """Curvature at a point, of the circle through it and its neighbours; 0 at the ends of a line."""
        if run.closed == 0 and (i <= run.first or i >= run.last):
            return ZERO
        here = line.extended_point(points.xy, i, run)
        a = here - line.extended_point(points.xy, i - 1, run)
        b = line.extended_point(points.xy, i + 1, run) - here
        return line.circle_curvature(a, b, wp.length(a), wp.length(b))

    @wp.kernel(module=name, enable_backward=False)
    def measure_bends(
        # network
        channels: Channels,
        points: Points,
        # params
        breaking: Breaking,
        work: Work,
        # in
        substep: wp.array[int],
        # out
        point_bend_out: wp.array[scalar],
    ):
        """Width times curvature, w C, at the end of a step; by the bend as the mean of C over one width of channel.

        Of the points at both ends of the width a part counts, so that the mean does not jump with the spacing.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        if not ends_a_step(work, substep):
            run.stop = run.end
        while run.stop < run.end:
            run = line.next_run(channels, run)
            for i in range(run.begin, run.stop):
                width = line.section_at(points, i, run)[0]
                reach = scalar(0.0)
                if breaking.by_point == 0:
                    reach = wp.max(HALF * width / run.spacing - HALF, ZERO)
                side = int(wp.ceil(reach))
                total = scalar(0.0)
                weights = scalar(0.0)
                for k in range(-side, side + 1):
                    j = i + k
                    if run.closed != 0 or (j > run.first and j < run.last):
                        weight = wp.min(reach + ONE - scalar(wp.abs(k)), ONE)
                        total += weight * curvature_at(points, run, j)
                        weights += weight
                if weights > ZERO:
                    total = total / weights
                point_bend_out[i] = width * total

    @wp.func(module=name)
    def points_of_bend(point_bend: wp.array[scalar], run: Run, i: int) -> int:
        """Points of the bend whose apex a point is, from inflection to inflection; 0 where it is none.

        Of equal points the first one is the apex.
        """
        apex = point_bend[i]
        size = wp.abs(apex)
        count = int(1)
        j = int(i - 1)
        while j >= run.first and apex * point_bend[j] > ZERO and wp.abs(point_bend[j]) < size:
            count += 1
            j -= 1
        if j >= run.first and apex * point_bend[j] > ZERO:
            return 0
        j = int(i + 1)
        while j <= run.last and apex * point_bend[j] > ZERO and wp.abs(point_bend[j]) <= size:
            count += 1
            j += 1
        if j <= run.last and apex * point_bend[j] > ZERO:
            return 0
        return count

    @wp.kernel(module=name, enable_backward=False)
    def break_banks(
        # network
        channels: Channels,
        # params
        breaking: Breaking,
        work: Work,
        # in
        channel_identity: wp.array[int],
        point_bend: wp.array[scalar],
        substep: wp.array[int],
        # out
        point_bank_out: wp.array[int],
        status_io: wp.array[int],
    ):
        """Which banks break at the end of a step: HOLDS, BREAKS or LEAVES; ``CREVASSES`` counts those that do.

        A bend breaks with 1 - exp(-rate length dt). Chances are drawn by (seed, step, identity of the channel, place of
        the apex in it), so that they are the same however the points are dealt out. Rings hold.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        if not ends_a_step(work, substep):
            run.stop = run.end
        step = status_io[BEGUN] + status_io[STEPS]
        found = int(0)
        while run.stop < run.end:
            run = line.next_run(channels, run)
            stream = wp.rand_init(int(wp.rand_init(breaking.seed, step)), channel_identity[run.channel])
            for i in range(run.begin, run.stop):
                bank = int(HOLDS)
                if wp.abs(point_bend[i]) > breaking.curvature and run.closed == 0:
                    chance = breaking.chance
                    if breaking.by_point == 0:
                        length = wp.float64(points_of_bend(point_bend, run, i)) * wp.float64(run.spacing)
                        chance = ONE_64 - wp.exp(-breaking.rate * length * breaking.time_step)
                    random = wp.rand_init(int(stream), i - run.first)
                    if wp.float64(wp.randu(random)) * ALL_BITS < chance:
                        bank = BREAKS
                        if wp.float64(wp.randu(random)) * ALL_BITS < breaking.avulsion:
                            bank = LEAVES
                        found += 1
                point_bank_out[i] = bank
        if found > 0:
            wp.atomic_add(status_io, CREVASSES, found)

    @wp.func(module=name)
    def turned(direction: vec2, angle: scalar) -> vec2:
        """A direction, turned to the left by an angle."""
        c, s = wp.cos(angle), wp.sin(angle)
        return vec2(c * direction[0] - s * direction[1], s * direction[0] + c * direction[1])

    @wp.kernel(module=name, enable_backward=False)
    def walk_courses(
        # terrain
        cell_height: wp.array2d[wp.float64],
        grid: RasterGrid,
        # params
        walk: Walk,
        # in
        courses: Courses,
        # out
        course_xy_out: wp.array2d[vec2],
        course_height_out: wp.array2d[wp.float64],
        course_state_out: wp.array2d[int],
    ):
        """Walk from a to within a step of b, the ends of the course k, in steps of one spacing.

        d = t u + (1 - t) d0, with u the direction to b, d0 the first direction and t = min(walked / |a - b|, 1), turned
        by chance [Paris2023, 5.2]. ``course_state_out`` gets how the walk ended, its points, the last of which is
        where it was refused. Without a terrain nothing is.
        """
        k = wp.tid()
        random = courses.seed[k]
        place = courses.ends[k, 0]
        target = courses.ends[k, 1]
        first = courses.direction[k]
        whole = wp.length(target - place)
        height = wp.float64(0.0)
        if cell_height:
            height = cells.value_at(cell_height, grid, place)
        course_xy_out[k, 0] = place
        course_height_out[k, 0] = height
        state = int(LOST)
        count = int(1)
        if wp.isnan(height):
            state = NO_GROUND
        while state == LOST and count < course_xy_out.shape[1]:
            off = target - place
            left = wp.length(off)
            length = walk.spacing
            if left <= walk.spacing:
                place = target
                length = left
            else:
                t = wp.min(scalar(count - 1) * walk.spacing / whole, ONE)
                ahead = wp.normalize(t * (off / left) + (ONE - t) * first)
                chance = scalar(wp.randf(random, LOW, HIGH))
                place = place + walk.spacing * turned(ahead, walk.jitter * chance)
            after = wp.float64(0.0)
            if cell_height:
                after = cells.value_at(cell_height, grid, place)
            course_xy_out[k, count] = place
            course_height_out[k, count] = after
            count += 1
            if wp.isnan(after):
                state = NO_GROUND
            elif after - height > wp.float64(walk.steepest * length):
                state = TOO_STEEP
            elif left <= walk.spacing:
                state = ARRIVED
            height = after
        course_state_out[k, 0] = state
        course_state_out[k, 1] = count

    @wp.kernel(module=name, enable_backward=False)
    def carve_line(
        # terrain
        grid: RasterGrid,
        # params
        width: scalar,
        window: wp.vec4i,
        # in
        line_xy: wp.array[vec2],
        line_height: wp.array[wp.float64],
        # out
        cell_height_io: wp.array2d[wp.float64],
    ):
        """Lower the cells of a window to the bed along a line: over its width wholly, up to twice that less and less.

        The bed is that of the nearest point of the line, linear between its points; no cell is raised.
        """
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        here = cells.center_of_cell(grid, row, column)
        nearest = scalar(FAR)
        bed = wp.float64(0.0)
        for k in range(line_xy.shape[0] - 1):
            along = line_xy[k + 1] - line_xy[k]
            off = here - line_xy[k]
            t = wp.clamp(wp.dot(off, along) / wp.dot(along, along), ZERO, ONE)
            distance = wp.length(off - t * along)
            if distance < nearest:
                nearest = distance
                bed = line_height[k] + wp.float64(t) * (line_height[k + 1] - line_height[k])
        p = wp.clamp(nearest / (HALF * width) - ONE, ZERO, ONE)
        weight = wp.float64(ONE - p * p * (THREE - TWO * p))
        ground = cell_height_io[row, column]
        if weight > ZERO_64 and bed < ground:
            cell_height_io[row, column] = ground + weight * (bed - ground)

    return SimpleNamespace(
        vec2=vec2,
        Walk=Walk,
        Courses=Courses,
        RasterGrid=RasterGrid,
        Breaking=Breaking,
        measure_bends=measure_bends,
        break_banks=break_banks,
        walk_courses=walk_courses,
        carve_line=carve_line,
    )
