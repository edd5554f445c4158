"""The surface of a synthetic valley: the section of the channel, the floor between bank and edge, the valley sides.

Places are in the frame of the valley: x along its axis from the upstream end, y to the left. Heights above the plane
that slopes with top of bank are called rises; the channel's are below 0.
"""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import noise, sections, steps
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# Columns of the table of valley lines by x: y of the floor's and the top's edges, their rises, and how far the long
# profile lies above the plane of top of bank.
LEFT_FLOOR, LEFT_TOP, RIGHT_FLOOR, RIGHT_TOP, FLOOR_RISE, TOP_RISE, BEND = range(7)
# Columns of the table of strewn objects.
IS_LOG, PLACE, CELL, COUNT, CHANCE, MIN_RADIUS, SPREAD, HEIGHT, LENGTH, FADE = range(10)
# A place in a lattice that no station has been brought to.
NOWHERE = 2**31 - 1


@once
def build(scalar):
    """Make the kernels of synthetic valleys for one precision; heights that are written are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.valley_{scalar.__name__}"
    # Unrolled, loops within loops take five times as long to compile, and run slower: registers spill.
    wp.set_module_options({"max_unroll": 1}, module=name)
    smooth_steps = steps.build(scalar)
    field, section = noise.build(scalar), sections.build(scalar)
    vec2, vec3, vec4, vec7 = (wp.types.vector(n, scalar) for n in (2, 3, 4, 7))
    ZERO, HALF, ONE, TWO, THREE, FOUR, SIX = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0))
    PI = scalar(math.pi)
    NOTHING = wp.float64(math.nan)
    TINY, FAR = scalar(1.0e-12), scalar(2.0**100)
    # A place is tried as one of the channel up to this fraction of a half-width beyond the banks' envelope; stations
    # count as passed one by one while each brings this fraction of their distance.
    SLACK = scalar(0.1)
    # Stations that a search may be off before another start is worth a try; how far those around a cell may lie apart
    # to be looked through; how far a search goes in single steps.
    SAME, MAX_SPREAD, MAX_STEPS = 12, 256, 64

    @wp.struct
    class Surface:
        """A valley on the device.

        Lines of all channels lie end to end, cut by ``channel_start``; the first is the main one.
        ``station_half``: half-widths to the left and right, m. ``station_form``: bankfull depth (m), place a of the
        maximum depth (0 left bank, 1 right), rise of top of bank (m).
        ``valley_line``: by x, ``lines_per_meter`` of them from ``line_start`` on. ``bank_height``: height of top of
        bank at x = 0, m. ``lift_reach``: distance from the bank over which the rise of top of bank fades, m. There is
        no ground upstream of ``begin`` and downstream of ``end``, m.
        """

        channel_start: wp.array[int]
        station_xy: wp.array[vec2]
        station_tangent: wp.array[vec2]
        station_half: wp.array[vec2]
        station_form: wp.array[vec3]
        valley_line: wp.array[vec7]
        section_thread: wp.array[vec4]
        object_table: wp.array2d[scalar]
        object_seed: wp.array[int]
        section_form: int
        terraces: int
        flat: scalar
        exponent: scalar
        line_start: scalar
        lines_per_meter: scalar
        bank_height: wp.float64
        slope: scalar
        lift_reach: scalar
        begin: scalar
        end: scalar

    @wp.struct
    class Lattice:
        """Coarse places that know the station nearest to them; its corner is that of minimum x and maximum y.

        ``cell_station``: for the cell down and right of each node a station near all of it, or -1 where the nodes
        around it know stations of different bends.
        """

        rows: int
        columns: int
        corner: vec2
        step: scalar
        node_station: wp.array[int]
        cell_station: wp.array[int]

    @wp.struct
    class Grid:
        """The raster in the valley's frame: the centre of its cell 0, 0, and its turn against the axis."""

        corner: vec2
        cell_size: scalar
        cosine: scalar
        sine: scalar

    @wp.struct
    class Frame:
        """Where the valley lies on the map: place of its zero, m, and the turn of its axis against east."""

        x: wp.float64
        y: wp.float64
        cosine: wp.float64
        sine: wp.float64

    @wp.func(module=name)
    def unreached() -> scalar:
        """FAR, for a variable that changes: Warp would change the constant with it."""
        return FAR

    @wp.func(module=name)
    def cross(a: vec2, b: vec2) -> scalar:
        """Area that a and b span; above 0 where b points to the left of a."""
        return a[0] * b[1] - a[1] * b[0]

    @wp.func(module=name)
    def section_depth(surface: Surface, y: scalar, apex: scalar) -> scalar:
        """Depth below top of bank in bankfull depths, at Y = 0 at the left bank to 1 at the right one."""
        return section.depth_at(surface.section_form, y, apex, surface.flat, surface.exponent, surface.section_thread)

    @wp.func(module=name)
    def station_gap(surface: Surface, xy: vec2, i: int) -> scalar:
        """Distance to a station less its wider half: the measure by which stations are near."""
        half = surface.station_half[i]
        return wp.length(xy - surface.station_xy[i]) - wp.max(half[0], half[1])

    @wp.func(module=name)
    def nearest_station(surface: Surface, xy: vec2, begin: int, first: int, last: int) -> int:
        """Station first .. last of the smallest gap, reached downhill from ``begin``: leaps along the line, then steps.

        Each leap goes as far as the place lies ahead of the station, as on a straight line.
        """
        i = wp.clamp(begin, first, last)
        gap = station_gap(surface, xy, i)
        spacing = wp.length(surface.station_xy[first + 1] - surface.station_xy[first])
        for _leap in range(4):
            ahead = wp.dot(xy - surface.station_xy[i], surface.station_tangent[i]) / spacing
            j = wp.clamp(i + int(wp.round(ahead)), first, last)
            trial = station_gap(surface, xy, j)
            if j == i or trial >= gap:
                break
            i = j
            gap = trial
        for _step in range(MAX_STEPS):
            j = wp.min(i + 1, last)
            trial = station_gap(surface, xy, j)
            if trial >= gap:
                j = wp.max(i - 1, first)
                trial = station_gap(surface, xy, j)
            if trial >= gap:
                break
            i = j
            gap = trial
        return i

    @wp.func(module=name)
    def segment_gap(surface: Surface, xy: vec2, i: int) -> scalar:
        """Distance beyond the bank of the band around segment i, whose half-width is linear along it; inside < 0."""
        a = surface.station_xy[i]
        along = surface.station_xy[i + 1] - a
        length = wp.max(wp.length(along), TINY)
        along = along / length
        off = xy - a
        x, y = wp.dot(off, along), cross(along, off)
        left, right = surface.station_half[i], surface.station_half[i + 1]
        r0, r1 = left[1], right[1]
        if y >= ZERO:
            r0, r1 = left[0], right[0]
        y = wp.abs(y)
        lean = wp.clamp((r1 - r0) / length, -HALF, HALF)
        # The circle that touches the place is not the one abreast of it where the band widens.
        t = wp.clamp(x + y * lean / wp.sqrt(ONE - lean * lean), ZERO, length)
        return wp.sqrt((x - t) * (x - t) + y * y) - (r0 + (r1 - r0) * t / length)

    @wp.func(module=name)
    def line_at(surface: Surface, i: int, t: scalar) -> vec4:
        """Place and derivative by t of the cubic through stations i and i + 1 with their tangents."""
        p0, p1 = surface.station_xy[i], surface.station_xy[i + 1]
        length = wp.length(p1 - p0)
        m0, m1 = length * surface.station_tangent[i], length * surface.station_tangent[i + 1]
        u = ONE - t
        place = (ONE + TWO * t) * u * u * p0 + t * u * u * m0 + t * t * (THREE - TWO * t) * p1 - t * t * u * m1
        slope = SIX * t * u * (p1 - p0) + u * (ONE - THREE * t) * m0 + t * (THREE * t - TWO) * m1
        return vec4(place[0], place[1], slope[0], slope[1])

    @wp.func(module=name)
    def channel_rise(surface: Surface, xy: vec2, near: int, first: int, last: int) -> vec2:
        """Rise of the bed at a place and distance to the banks, inside < 0; FAR outside and beyond the line's ends.

        The station abreast of the place is the one in whose section it lies: (p - c) . c' = 0 on the cubic.
        """
        i = wp.min(near, last - 1)
        for _step in range(MAX_STEPS):
            if wp.dot(xy - surface.station_xy[i], surface.station_tangent[i]) < ZERO:
                i -= 1
                if i < first:
                    return vec2(FAR, FAR)
            elif wp.dot(xy - surface.station_xy[i + 1], surface.station_tangent[i + 1]) > ZERO:
                i += 1
                if i >= last:
                    return vec2(FAR, FAR)
            else:
                break
        before = wp.dot(xy - surface.station_xy[i], surface.station_tangent[i])
        after = wp.dot(xy - surface.station_xy[i + 1], surface.station_tangent[i + 1])
        drop = wp.max(before - after, TINY)
        t = wp.clamp(before / drop, ZERO, ONE)
        # c' is by t, the tangents by length.
        drop = drop * wp.length(surface.station_xy[i + 1] - surface.station_xy[i])
        for _round in range(3):
            c = line_at(surface, i, t)
            t = wp.clamp(t + ((xy[0] - c[0]) * c[2] + (xy[1] - c[1]) * c[3]) / drop, ZERO, ONE)
        c = line_at(surface, i, t)
        ahead = wp.normalize(vec2(c[2], c[3]))
        n = cross(ahead, vec2(xy[0] - c[0], xy[1] - c[1]))
        half = surface.station_half[i] + t * (surface.station_half[i + 1] - surface.station_half[i])
        if n > half[0] or n < -half[1]:
            return vec2(FAR, FAR)
        form = surface.station_form[i] + t * (surface.station_form[i + 1] - surface.station_form[i])
        depth = form[0] * section_depth(surface, (half[0] - n) / (half[0] + half[1]), form[1])
        return vec2(form[2] - depth, -wp.min(half[0] - n, half[1] + n))

    @wp.func(module=name)
    def valley_line_at(surface: Surface, x: scalar) -> vec7:
        """The lines of the valley at x, linear between those of the table, constant beyond its ends."""
        last = surface.valley_line.shape[0] - 1
        at = wp.clamp((x - surface.line_start) * surface.lines_per_meter, ZERO, scalar(last))
        k = wp.min(int(at), last - 1)
        t = at - scalar(k)
        return (ONE - t) * surface.valley_line[k] + t * surface.valley_line[k + 1]

    @wp.func(module=name)
    def terraced(surface: Surface, fraction: scalar) -> scalar:
        """Fraction of the floor's rise at a fraction of the way from the bank to its edge: even, or in treads."""
        if surface.terraces == 0:
            return fraction
        at = fraction * scalar(surface.terraces)
        tread = wp.min(wp.floor(at), scalar(surface.terraces - 1))
        # A riser takes the last quarter of each step.
        return (tread + smooth_steps.cubic_step(FOUR * (at - tread) - THREE)) / scalar(surface.terraces)

    @wp.func(module=name)
    def object_height(surface: Surface, xy: vec2, kind: int, i: int, j: int) -> scalar:
        """Maximum height at a place of the objects of one field that are centred in its lattice cell i, j."""
        highest = scalar(0.0)
        state = wp.rand_init(surface.object_seed[kind], int(field.lattice_hash(surface.object_seed[kind], i, j)))
        for _object in range(int(surface.object_table[kind, COUNT])):
            chance = scalar(wp.randf(state))
            x = (scalar(i) + scalar(wp.randf(state))) * surface.object_table[kind, CELL]
            y = (scalar(j) + scalar(wp.randf(state))) * surface.object_table[kind, CELL]
            radius = surface.object_table[kind, MIN_RADIUS] * wp.exp(
                surface.object_table[kind, SPREAD] * scalar(wp.randf(state))
            )
            angle = PI * scalar(wp.randf(state))
            off = vec2(xy[0] - x, xy[1] - y)
            distance = wp.length(off)
            if surface.object_table[kind, IS_LOG] > HALF:
                along = wp.abs(off[0] * wp.cos(angle) + off[1] * wp.sin(angle))
                beyond = wp.max(along - HALF * surface.object_table[kind, LENGTH], ZERO)
                across = off[1] * wp.cos(angle) - off[0] * wp.sin(angle)
                distance = wp.sqrt(beyond * beyond + across * across)
            if chance < surface.object_table[kind, CHANCE] and distance < radius:
                top = surface.object_table[kind, HEIGHT] * wp.sqrt(radius * radius - distance * distance)
                highest = wp.max(highest, top)
        return highest

    @wp.func(module=name)
    def objects_height(surface: Surface, xy: vec2, gap: scalar) -> scalar:
        """Height of what is strewn at a place; it fades towards the banks that bound its field."""
        highest = scalar(0.0)
        for kind in range(surface.object_seed.shape[0]):
            place = surface.object_table[kind, PLACE]
            weight = smooth_steps.cubic_step(gap / surface.object_table[kind, FADE])
            if place < HALF:
                weight = smooth_steps.cubic_step(-gap / surface.object_table[kind, FADE])
            elif place > scalar(1.5):
                weight = ONE
            if weight > ZERO:
                size = surface.object_table[kind, CELL]
                i, j = int(wp.floor(xy[0] / size)), int(wp.floor(xy[1] / size))
                for k in range(9):
                    height = object_height(surface, xy, kind, i + k // 3 - 1, j + k % 3 - 1)
                    highest = wp.max(highest, weight * height)
        return highest

    @wp.func(module=name)
    def side_rise(line: vec7, y: scalar) -> scalar:
        """Rise beyond the floor's edges: straight up to the top's edge and level behind it; FAR between the edges."""
        edge = unreached()
        top = unreached()
        if y >= line[LEFT_FLOOR]:
            edge = y - line[LEFT_FLOOR]
            top = line[LEFT_TOP] - line[LEFT_FLOOR]
        elif y <= line[RIGHT_FLOOR]:
            edge = line[RIGHT_FLOOR] - y
            top = line[RIGHT_FLOOR] - line[RIGHT_TOP]
        if edge == FAR:
            return FAR
        return line[FLOOR_RISE] + wp.clamp(edge / wp.max(top, TINY), ZERO, ONE) * line[TOP_RISE]

    @wp.func(module=name)
    def floor_rise(surface: Surface, line: vec7, y: scalar, gap: scalar, lift: scalar, left: bool) -> scalar:
        """Rise between bank and floor's edge, at ``gap`` from the bank: grows with gap / (gap + distance to the edge).

        The rise ``lift`` of top of bank over the plane fades on the way.
        """
        rest = line[LEFT_FLOOR] - y
        if not left:
            rest = y - line[RIGHT_FLOOR]
        fraction = gap / wp.max(gap + rest, TINY)
        fading = (ONE - smooth_steps.cubic_step(gap / surface.lift_reach)) * (ONE - fraction)
        return terraced(surface, fraction) * line[FLOOR_RISE] + lift * fading

    @wp.func(module=name)
    def lattice_node(lattice: Lattice, xy: vec2) -> vec2:
        """Column and row of a place of the valley's frame in the lattice, as fractions."""
        return vec2((xy[0] - lattice.corner[0]) / lattice.step, (lattice.corner[1] - xy[1]) / lattice.step)

    @wp.func(module=name)
    def known_station(
        lattice: Lattice, node_station: wp.array[int], channel: int, k: int, row: int, column: int
    ) -> int:
        """What the k-th of the sixteen nodes around a cell of the lattice knows; beyond the rim, what the rim knows."""
        i = wp.clamp(row + k // 4 - 1, 0, lattice.rows - 1)
        j = wp.clamp(column + k % 4 - 1, 0, lattice.columns - 1)
        return node_station[(channel * lattice.rows + i) * lattice.columns + j]

    @wp.func(module=name)
    def searched_station(surface: Surface, lattice: Lattice, xy: vec2, channel: int) -> int:
        """Station of a channel with the smallest gap to a place: the best that is found from the nodes around it.

        Sixteen of them, unless they agree: four would miss a bend that is nearest only between them, and leave a step
        in the ground there.
        """
        first, last = surface.channel_start[channel], surface.channel_start[channel + 1] - 1
        at = lattice_node(lattice, xy)
        column = wp.clamp(int(wp.floor(at[0])), 0, lattice.columns - 1)
        row = wp.clamp(int(wp.floor(at[1])), 0, lattice.rows - 1)
        agreed = lattice.cell_station[(channel * lattice.rows + row) * lattice.columns + column]
        if agreed >= 0:
            return nearest_station(surface, xy, agreed, first, last)
        best = int(-1)
        least = unreached()
        low = int(0)
        high = int(0)
        for k in range(16):
            begin = known_station(lattice, lattice.node_station, channel, k, row, column)
            # Stations that a search has passed on its way to the best lead there again.
            if best < 0 or begin < low - SAME or begin > high + SAME:
                found = nearest_station(surface, xy, begin, first, last)
                gap = station_gap(surface, xy, found)
                if found == best:
                    low = wp.min(low, begin)
                    high = wp.max(high, begin)
                elif gap < least:
                    least = gap
                    best = found
                    low = wp.min(begin, found)
                    high = wp.max(begin, found)
        return best

    @wp.func(module=name)
    def inner_rise(surface: Surface, lattice: Lattice, line: vec7, xy: vec2) -> vec2:
        """Rise between the floor's edges and distance beyond the nearest bank: the deepest channel, else the floor."""
        deepest = unreached()
        gap = unreached()
        lift = scalar(0.0)
        left = bool(False)
        for c in range(surface.channel_start.shape[0] - 1):
            first, last = surface.channel_start[c], surface.channel_start[c + 1] - 1
            i = searched_station(surface, lattice, xy, c)
            if c == 0:
                left = cross(surface.station_tangent[i], xy - surface.station_xy[i]) >= ZERO
            own = wp.min(segment_gap(surface, xy, wp.max(i - 1, first)), segment_gap(surface, xy, wp.min(i, last - 1)))
            half = surface.station_half[i]
            if own < SLACK * wp.max(half[0], half[1]):
                bed = channel_rise(surface, xy, i, first, last)
                deepest = wp.min(deepest, bed[0])
                own = wp.where(bed[0] < FAR, bed[1], own)
            if own < gap:
                gap = own
                form = surface.station_form[i]
                lift = form[2]
        if deepest < FAR:
            return vec2(deepest, gap)
        return vec2(floor_rise(surface, line, xy[1], wp.max(gap, ZERO), lift, left), gap)

    @wp.func(module=name)
    def surface_height(surface: Surface, lattice: Lattice, xy: vec2) -> wp.float64:
        """Height of the ground, m: channels and floor, else the valley sides; NaN beyond the ends of the reach."""
        if xy[0] < surface.begin or xy[0] > surface.end:
            return NOTHING
        line = valley_line_at(surface, xy[0])
        rise = vec2(side_rise(line, xy[1]), FAR)
        if rise[0] == FAR:
            rise = inner_rise(surface, lattice, line, xy)
        top = rise[0] + objects_height(surface, xy, rise[1]) + line[BEND] - surface.slope * xy[0]
        return surface.bank_height + wp.float64(top)

    @wp.kernel(module=name, enable_backward=False)
    def mark_stations(
        # params
        surface: Surface,
        lattice: Lattice,
        # out
        node_station_io: wp.array[int],
    ):
        """Bring each station to the node of the lattice that is nearest to it; of several the first stays."""
        i = wp.tid()
        channel = int(0)
        while surface.channel_start[channel + 1] <= i:
            channel += 1
        at = lattice_node(lattice, surface.station_xy[i])
        column = wp.clamp(int(wp.round(at[0])), 0, lattice.columns - 1)
        row = wp.clamp(int(wp.round(at[1])), 0, lattice.rows - 1)
        wp.atomic_min(node_station_io, (channel * lattice.rows + row) * lattice.columns + column, i)

    @wp.kernel(module=name, enable_backward=False)
    def spread_stations(
        # params
        surface: Surface,
        lattice: Lattice,
        # in
        node_station: wp.array[int],
        stride: int,
        # out
        node_station_out: wp.array[int],
    ):
        """Take over the nearest of the stations that the nodes ``stride`` away know: jump flooding [Rong2006]."""
        channel, row, column = wp.tid()
        xy = lattice.corner + lattice.step * vec2(scalar(column), -scalar(row))
        best = int(NOWHERE)
        least = unreached()
        for k in range(9):
            i, j = row + (k // 3 - 1) * stride, column + (k % 3 - 1) * stride
            if i >= 0 and j >= 0 and i < lattice.rows and j < lattice.columns:
                station = node_station[(channel * lattice.rows + i) * lattice.columns + j]
                if station != NOWHERE:
                    gap = station_gap(surface, xy, station)
                    if gap < least or (gap == least and station < best):
                        least = gap
                        best = station
        node_station_out[(channel * lattice.rows + row) * lattice.columns + column] = best

    @wp.func(module=name)
    def falls_ahead(surface: Surface, xy: vec2, low: int, high: int) -> bool:
        """Whether a place falls behind, from station to station, all the way from ``low`` to ``high``.

        Then its distance to the line has one minimum there, whatever station a search begins at.
        """
        ahead = wp.dot(xy - surface.station_xy[low], surface.station_tangent[low])
        for i in range(low + 1, high + 1):
            here = wp.dot(xy - surface.station_xy[i], surface.station_tangent[i])
            if ahead - here < SLACK * wp.length(surface.station_xy[i] - surface.station_xy[i - 1]):
                return False
            ahead = here
        return True

    @wp.kernel(module=name, enable_backward=False)
    def settle_cells(
        # params
        surface: Surface,
        lattice: Lattice,
        # in
        node_station: wp.array[int],
        # out
        cell_station_out: wp.array[int],
    ):
        """Give each cell of the lattice one station to search from, or -1 where it needs those of all nodes around it.

        One is enough where every place of the cell has one nearest station among those that the nodes around know:
        where its corners do, since (p - c) . t is linear in p.
        """
        channel, row, column = wp.tid()
        low = known_station(lattice, node_station, channel, 0, row, column)
        high = known_station(lattice, node_station, channel, 0, row, column)
        for k in range(1, 16):
            station = known_station(lattice, node_station, channel, k, row, column)
            low = wp.min(low, station)
            high = wp.max(high, station)
        settled = (low + high) // 2
        if high - low > MAX_SPREAD:
            settled = -1
        if settled >= 0:
            low = wp.max(low - 2, surface.channel_start[channel])
            high = wp.min(high + 2, surface.channel_start[channel + 1] - 1)
            for k in range(4):
                corner = vec2(scalar(column + k % 2), -scalar(row + k // 2))
                if not falls_ahead(surface, lattice.corner + lattice.step * corner, low, high):
                    settled = -1
        cell_station_out[(channel * lattice.rows + row) * lattice.columns + column] = settled

    @wp.kernel(module=name, enable_backward=False)
    def evaluate_cells(
        # params
        surface: Surface,
        lattice: Lattice,
        grid: Grid,
        # out
        cell_height_out: wp.array2d[wp.float64],
    ):
        """Heights at the cells' centres of a raster: every cell finds the stations abreast of it [Brown2014]."""
        row, column = wp.tid()
        x, y = grid.cell_size * scalar(column), -grid.cell_size * scalar(row)
        xy = grid.corner + vec2(grid.cosine * x - grid.sine * y, grid.sine * x + grid.cosine * y)
        cell_height_out[row, column] = surface_height(surface, lattice, xy)

    @wp.kernel(module=name, enable_backward=False)
    def evaluate_points(
        # params
        surface: Surface,
        lattice: Lattice,
        # in
        point_xy: wp.array[vec2],
        # out
        point_height_out: wp.array[wp.float64],
    ):
        """Heights at any places, as those of cells."""
        i = wp.tid()
        point_height_out[i] = surface_height(surface, lattice, point_xy[i])

    @wp.func(module=name)
    def section_place(surface: Surface, i: int, y: scalar) -> vec2:
        """Place of a section at Y: x' = x - n dy/ds, y' = y + n dx/ds [Brown2014], eqs 1 and 2."""
        half = surface.station_half[i]
        ahead = surface.station_tangent[i]
        n = half[0] - y * (half[0] + half[1])
        return surface.station_xy[i] + n * vec2(-ahead[1], ahead[0])

    @wp.func(module=name)
    def on_map(frame: Frame, xy: vec2, height: wp.float64) -> wp.vec3d:
        """Absolute place of a place of the valley, with its height."""
        x, y = wp.float64(xy[0]), wp.float64(xy[1])
        east = frame.x + frame.cosine * x - frame.sine * y
        return wp.vec3d(east, frame.y + frame.sine * x + frame.cosine * y, height)

    @wp.kernel(module=name, enable_backward=False)
    def lay_sections(
        # params
        surface: Surface,
        frame: Frame,
        # in
        first: int,
        column_first: int,
        column_count: int,
        # out
        node_xyz_out: wp.array2d[wp.vec3d],
    ):
        """Nodes of the curvilinear grid in the channel, even from the left bank to the right one.

        z = top of bank - d(n) [Brown2014], eq. 18.
        """
        row, column = wp.tid()
        i = first + row
        y = scalar(column) / scalar(column_count - 1)
        half, form = surface.station_half[i], surface.station_form[i]
        xy = section_place(surface, i, y)
        depth = scalar(0.0)
        if column > 0 and column < column_count - 1:
            depth = form[0] * section_depth(surface, y, form[1])
        gap = -wp.min(y, ONE - y) * (half[0] + half[1])
        rise = form[2] - depth + objects_height(surface, xy, gap)
        line = valley_line_at(surface, xy[0])
        height = surface.bank_height + wp.float64(rise + line[BEND] - surface.slope * xy[0])
        node_xyz_out[row, column_first + column] = on_map(frame, xy, height)

    @wp.kernel(module=name, enable_backward=False)
    def lay_sides(
        # params
        surface: Surface,
        lattice: Lattice,
        frame: Frame,
        # in
        first: int,
        floor_count: int,
        side_count: int,
        # out
        node_xyz_out: wp.array2d[wp.vec3d],
    ):
        """Nodes of the curvilinear grid beside the channel: to the floor's edge abreast of a station, then to the top.

        A section that is tilted reaches past the ends of the reach, where there is no ground: the height is held.
        """
        row, k = wp.tid()
        i = first + row
        column = floor_count + side_count - 1 - (k // 2)
        line = valley_line_at(surface, surface.station_xy[i][0])
        bank = section_place(surface, i, ZERO)
        edge = vec2(surface.station_xy[i][0], line[LEFT_FLOOR])
        top = vec2(surface.station_xy[i][0], line[LEFT_TOP])
        if k % 2 == 1:
            column = node_xyz_out.shape[1] - floor_count - side_count + (k // 2)
            bank = section_place(surface, i, ONE)
            edge = vec2(surface.station_xy[i][0], line[RIGHT_FLOOR])
            top = vec2(surface.station_xy[i][0], line[RIGHT_TOP])
        out = k // 2 + 1
        xy = bank + (scalar(out) / scalar(floor_count)) * (edge - bank)
        if out > floor_count:
            xy = edge + (scalar(out - floor_count) / scalar(side_count)) * (top - edge)
        held = vec2(wp.clamp(xy[0], surface.begin, surface.end), xy[1])
        node_xyz_out[row, column] = on_map(frame, xy, surface_height(surface, lattice, held))

    return SimpleNamespace(
        Surface=Surface,
        Lattice=Lattice,
        Grid=Grid,
        Frame=Frame,
        mark_stations=mark_stations,
        spread_stations=spread_stations,
        settle_cells=settle_cells,
        evaluate_cells=evaluate_cells,
        evaluate_points=evaluate_points,
        lay_sections=lay_sections,
        lay_sides=lay_sides,
    )
