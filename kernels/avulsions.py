"""Avulsions: the walk of a new course over the terrain, and the bed that is carved along it."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import raster
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# How a walk ended: on its target, on ground that rises too steeply, off the terrain, or lost after too many steps.
ARRIVED, TOO_STEEP, NO_GROUND, LOST = range(4)


@once
def build(scalar):
    """Make the kernels for one precision of the positions; heights are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.avulsions_{scalar.__name__}"
    cells = raster.build(scalar)
    vec2, RasterGrid = cells.vec2, cells.RasterGrid
    ZERO, HALF, ONE, TWO, THREE = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0))
    ZERO_64 = wp.float64(0.0)
    LEAST, MOST = wp.float32(-1.0), wp.float32(1.0)
    FAR = scalar(2.0**100)

    @wp.struct
    class Walk:
        """Constants of a walk: length of a step (m), largest turn by chance (rad), steepest rise (m/m)."""

        spacing: scalar
        jitter: scalar
        steepest: scalar

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
        course_end: wp.array2d[vec2],
        course_direction: wp.array[vec2],
        course_seed: wp.array[wp.uint32],
        # out
        course_xy_out: wp.array2d[vec2],
        course_height_out: wp.array2d[wp.float64],
        course_state_out: wp.array2d[int],
    ):
        """Walk from a = course_end[k, 0] to within a step of b = course_end[k, 1], in steps of one spacing.

        d = t u + (1 - t) d0, with u the direction to b, d0 the first direction and t = min(walked / |a - b|, 1), turned
        by chance [Paris2023, 5.2]. ``course_state_out`` gets how the walk ended, its points, the last of which is
        where it was refused. Without a terrain nothing is.
        """
        k = wp.tid()
        random = course_seed[k]
        place = course_end[k, 0]
        target = course_end[k, 1]
        first = course_direction[k]
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
                chance = scalar(wp.randf(random, LEAST, MOST))
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
        vec2=vec2, Walk=Walk, RasterGrid=RasterGrid, walk_courses=walk_courses, carve_line=carve_line
    )
