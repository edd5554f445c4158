"""What a river leaves behind that it meets again: clay plugs of oxbow lakes, young bars, and unrest near cutoffs."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline, raster
from warpriver.kernels.channels import Work
from warpriver.kernels.status import BEGUN, HALT, NUMBER, STEPS, TOTAL
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# Dates are whole parts of a year, so many; what never was has the first of all.
TICKS, NEVER = 1024, -(2**31)
# After so many e-foldings what was left behind is forgotten: less than 1e-6 of it is left.
FORGOTTEN = 14.0


@once
def build(scalar):
    """Make the kernels for one precision of the positions; dates are integers in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.floodplain_{scalar.__name__}"
    line, cells = polyline.build(scalar), raster.build(scalar)
    vec2, bits, Channels, Points, Run = line.vec2, line.bits, line.Channels, line.Points, line.Run
    RasterGrid = cells.RasterGrid
    ZERO, HALF, ONE = scalar(0.0), scalar(0.5), scalar(1.0)
    ZERO_64, ONE_64, LONGEST = wp.float64(0.0), wp.float64(1.0), wp.float64(FORGOTTEN)
    TICKS_64, TICK = wp.float64(float(TICKS)), wp.float64(1.0 / TICKS)
    # Cells beyond half a width at which a bank is looked at: a channel must not see what it has just stamped itself.
    BEYOND = scalar(1.5)

    @wp.struct
    class Floodplain:
        """Dates of cells in ticks, row by row; an array is missing where nothing of that kind is remembered.

        ``river``: when a channel flowed there last; ``plug``: when a loop was cut off there; ``unrest``: of a cutoff
        nearby, earlier by as much as it is far. Each has the change of the rate at first and its time of decay, yr.
        """

        river: wp.array[int]
        plug: wp.array[int]
        unrest: wp.array[int]
        grid: RasterGrid
        rows: int
        columns: int
        bar_change: wp.float64
        bar_time: wp.float64
        plug_change: wp.float64
        plug_time: wp.float64
        unrest_change: wp.float64
        unrest_time: wp.float64

    @wp.func(module=name)
    def what_is_left(date: int, now: int, time: wp.float64) -> wp.float64:
        """Fraction e^(-age / time) that is left of something; nothing is after ``FORGOTTEN`` times."""
        if date == NEVER:
            return ZERO_64
        age = (wp.float64(now) - wp.float64(date)) * TICK / time
        if age > LONGEST:
            return ZERO_64
        return wp.exp(-wp.max(age, ZERO_64))

    @wp.func(module=name)
    def factor_of_cell(plain: Floodplain, row: int, column: int, now: int) -> wp.float64:
        """Factor of the rate in a cell: of the plug or the bar, whichever came last, and of unrest; 1 off the map."""
        if row < 0 or column < 0 or row >= plain.rows or column >= plain.columns:
            return ONE_64
        cell = row * plain.columns + column
        factor = wp.float64(1.0)
        # A river that comes back takes a plug away, and leaves a bar.
        date = int(NEVER)
        if plain.river:
            date = plain.river[cell]
        laid = int(NEVER)
        if plain.plug:
            laid = plain.plug[cell]
        if laid >= date:
            factor += plain.plug_change * what_is_left(laid, now, plain.plug_time)
        else:
            factor += plain.bar_change * what_is_left(date, now, plain.bar_time)
        if plain.unrest:
            factor = factor * (ONE_64 + plain.unrest_change * what_is_left(plain.unrest[cell], now, plain.unrest_time))
        return factor

    @wp.func(module=name)
    def factor_at(plain: Floodplain, place: vec2, now: int) -> wp.float64:
        """Factor of the rate at a place, bilinear between the centres of cells."""
        position = cells.cell_position(plain.grid, place)
        column, row = wp.floor(position[0]), wp.floor(position[1])
        u, v = wp.float64(position[0] - column), wp.float64(position[1] - row)
        i, j = int(row), int(column)
        above = (ONE_64 - u) * factor_of_cell(plain, i, j, now) + u * factor_of_cell(plain, i, j + 1, now)
        below = (ONE_64 - u) * factor_of_cell(plain, i + 1, j, now) + u * factor_of_cell(plain, i + 1, j + 1, now)
        return above + v * (below - above)

    @wp.func(module=name)
    def straightens(points: Points, run: Run, j: int, way: vec2) -> bool:
        """Tell whether a bend tighter than its width moves inward, as it has to whatever its banks are."""
        if run.closed == 0 and (j == run.first or j == run.last):
            return False
        a = points.xy[j] - line.extended_point(points.xy, j - 1, run)
        b = line.extended_point(points.xy, j + 1, run) - points.xy[j]
        width = line.section_at(points, j, run)[0]
        return (
            wp.abs(line.circle_curvature(a, b, wp.length(a), wp.length(b))) * width > ONE and wp.dot(way, b - a) > ZERO
        )

    @wp.kernel(module=name, enable_backward=False)
    def tell_date(
        # params
        time_step: wp.float64,
        # in
        substep: wp.array[int],
        status: wp.array[int],
        # out
        now_out: wp.array[int],
    ):
        """Date at the beginning of the sub-step at hand, in ticks."""
        if status[HALT] == 0:
            part = wp.float64(substep[NUMBER]) / wp.float64(wp.max(1, substep[TOTAL]))
            now_out[0] = int(wp.round((wp.float64(status[BEGUN] + status[STEPS]) + part) * time_step * TICKS_64))

    @wp.kernel(module=name, enable_backward=False)
    def scale_moves(
        # network
        channels: Channels,
        points: Points,
        # params
        plain: Floodplain,
        work: Work,
        # in
        now: wp.array[int],
        # out
        point_moved_io: wp.array[vec2],
        channel_max_speed_io: wp.array[bits],
    ):
        """Multiply the way of each point by what the bank is that it moves to: (1 + b e^(-t/T)) (1 + u e^(-t/T')).

        The bank is looked at half a width and one and a half cells ahead: a plug, a young bar, or old ground, b = 0
        [Bogoni2017]. Bends tighter than their width straighten as fast as without. Points that rest stay.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO:
                fastest = scalar(0.0)
                for j in range(run.begin, run.stop):
                    way = point_moved_io[j] - points.xy[j]
                    size = wp.length(way)
                    if size > ZERO:
                        ahead = HALF * line.section_at(points, j, run)[0] + BEYOND * plain.grid.cell_size
                        factor = scalar(factor_at(plain, points.xy[j] + (ahead / size) * way, now[0]))
                        if factor < ONE and straightens(points, run, j, way):
                            factor = scalar(1.0)
                        if factor != ONE:
                            point_moved_io[j] = points.xy[j] + factor * way
                        fastest = wp.max(fastest, factor * size / run.step)
                wp.atomic_max(channel_max_speed_io, run.channel, wp.cast(fastest, bits))

    @wp.func(module=name)
    def stamp_disc(plain: Floodplain, place: vec2, radius: scalar, date: int, cell_io: wp.array[int]):
        """Raise the dates of cells whose centres lie within a radius, and of the cell that the place lies in."""
        position = cells.cell_position(plain.grid, place)
        reach = radius * plain.grid.cells_per_meter
        own = vec2(wp.round(position[0]), wp.round(position[1]))
        for i in range(int(wp.ceil(position[1] - reach)), int(wp.floor(position[1] + reach)) + 1):
            for j in range(int(wp.ceil(position[0] - reach)), int(wp.floor(position[0] + reach)) + 1):
                if i >= 0 and j >= 0 and i < plain.rows and j < plain.columns:
                    off = vec2(scalar(j), scalar(i)) - position
                    if wp.dot(off, off) <= reach * reach:
                        wp.atomic_max(cell_io, i * plain.columns + j, date)
        if own[0] >= ZERO and own[1] >= ZERO:
            if own[0] < scalar(plain.columns) and own[1] < scalar(plain.rows):
                wp.atomic_max(cell_io, int(own[1]) * plain.columns + int(own[0]), date)

    @wp.kernel(module=name, enable_backward=False)
    def mark_courses(
        # network
        channels: Channels,
        points: Points,
        # params
        plain: Floodplain,
        work: Work,
        # in
        now: wp.array[int],
        # out
        cell_river_io: wp.array[int],
    ):
        """Date of the river in the cells that a channel covers: half a width around its points, and those between.

        Channels that rest in this sub-step are still where they were.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO:
                for j in range(run.begin, run.stop):
                    radius = HALF * line.section_at(points, j, run)[0]
                    here = points.xy[j]
                    after = here
                    if j < run.last or run.closed != 0:
                        after = line.extended_point(points.xy, j + 1, run)
                    pieces = int(wp.ceil(wp.length(after - here) / wp.max(radius, plain.grid.cell_size)))
                    for k in range(wp.max(pieces, 1)):
                        place = here + (scalar(k) / scalar(wp.max(pieces, 1))) * (after - here)
                        stamp_disc(plain, place, radius, now[0], cell_river_io)

    @wp.kernel(module=name, enable_backward=False)
    def lay_plugs(
        # params
        plain: Floodplain,
        # in
        place_xy: wp.array[vec2],
        place_radius: wp.array[scalar],
        date: int,
        # out
        cell_plug_io: wp.array[int],
    ):
        """Date of the plug in the cells that a loop covers which was cut off, disc by disc."""
        k = wp.tid()
        stamp_disc(plain, place_xy[k], place_radius[k], date, cell_plug_io)

    @wp.kernel(module=name, enable_backward=False)
    def spread_unrest(
        # params
        plain: Floodplain,
        spread: scalar,
        # in
        neck_xy: wp.array[vec2],
        neck_reach: wp.array[scalar],
        date: int,
        # out
        cell_unrest_io: wp.array[int],
    ):
        """Date of unrest around fresh cutoffs, a row of cells a thread: u e^(-d / D) is u after the time T d / D.

        ``neck_reach`` is D in m; beyond ``spread`` D nothing is felt. Of several cutoffs the one that is felt most
        counts [Schwenk2016].
        """
        n, row = wp.tid()
        position = cells.cell_position(plain.grid, neck_xy[n])
        reach = neck_reach[n] * plain.grid.cells_per_meter
        farthest = spread * reach
        i = int(wp.ceil(position[1] - farthest)) + row
        off = scalar(i) - position[1]
        if i < 0 or i >= plain.rows or off > farthest:
            return
        half = wp.sqrt(farthest * farthest - off * off)
        first = wp.max(int(wp.ceil(position[0] - half)), 0)
        last = wp.min(int(wp.floor(position[0] + half)), plain.columns - 1)
        for j in range(first, last + 1):
            away = wp.length(vec2(scalar(j) - position[0], off)) / reach
            later = wp.float64(away) * plain.unrest_time * TICKS_64
            wp.atomic_max(cell_unrest_io, i * plain.columns + j, date - int(wp.round(later)))

    return SimpleNamespace(
        vec2=vec2,
        Channels=Channels,
        Points=Points,
        Floodplain=Floodplain,
        tell_date=tell_date,
        scale_moves=scale_moves,
        mark_courses=mark_courses,
        lay_plugs=lay_plugs,
        spread_unrest=spread_unrest,
    )
