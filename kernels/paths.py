"""Meanders by shortest paths: the push and its smoothing, the shortcuts between near strands, the shortest route."""

import functools
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import buckets, polyline, raster

wp.set_module_options({"enable_backward": False})


@functools.cache
def build(scalar):
    """Make the shortest-path kernels for one precision; arc lengths and what a shortcut saves are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.paths_{scalar.__name__}"
    line, cells, grid = polyline.build(scalar), raster.build(scalar), buckets.build(scalar)
    vec2, vec4 = line.vec2, line.vec4
    ZERO, HALF, ONE = scalar(0.0), scalar(0.5), scalar(1.0)
    FAULT_SHORTCUTS_FULL = 3

    @wp.struct
    class PathLaw:
        """Scalars of one step, from ``PathMeander``; lengths in widths, times in yr."""

        time_step: scalar
        displacement_rate: scalar
        downstream_share: scalar
        blur_length: scalar
        smoothing: scalar
        end_damping: scalar
        slope_threshold: scalar

    @wp.struct
    class ShortcutLaw:
        """When two points are joined: search radius and least arc in widths, cosine of the cone squared."""

        radius: scalar
        min_arc: scalar
        cone: scalar

    # ---- push

    @wp.func(module=name)
    def blur_root(width: scalar, spacing: scalar, law: PathLaw) -> scalar:
        """Root of the recurrences that blur the push over the blur length."""
        points = law.blur_length * width / spacing
        return line.recurrence_root(points * points)

    @wp.func(module=name)
    def diffusion_number(width: scalar, spacing: scalar, law: PathLaw) -> scalar:
        """D dt / h^2 of the smoothing, D = S k w."""
        return law.smoothing * law.displacement_rate * width * law.time_step / (spacing * spacing)

    @wp.func(module=name)
    def push_at(before: vec2, here: vec2, after: vec2, width: scalar, law: PathLaw) -> vec2:
        """Push of a point in one step: k w (C n + phi |C| t) dt, n to the right of the flow, t down it."""
        a = here - before
        b = after - here
        curvature = line.circle_curvature(a, b, wp.length(a), wp.length(b))
        normal = line.right_normal(before, after)
        tangent = vec2(-normal[1], normal[0])
        size = law.displacement_rate * law.time_step * width
        return (size * curvature) * normal + (size * law.downstream_share * wp.abs(curvature)) * tangent

    @wp.func(module=name)
    def sweep_push(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        form: vec4,
        spacing: scalar,
        law: PathLaw,
        first: int,
        last: int,
        begin: int,
        stop: int,
        point_push_out: wp.array[vec4],
    ):
        """Pushes of the points begin .. stop - 1 of one channel, by one run down it from where the past has faded."""
        width = form[0]
        widest = form[2]
        r_blur = blur_root(widest, spacing, law)
        c_pull = diffusion_number(widest, spacing, law)
        r_pull = line.recurrence_root(c_pull)
        warm = wp.max(first, begin - wp.max(line.recurrence_reach(r_blur), line.recurrence_reach(r_pull)))
        before = line.extended_point(point_xy, warm - 1, first, last)
        here = point_xy[warm]
        push = vec2(ZERO, ZERO)
        pull = vec2(ZERO, ZERO)
        for j in range(warm, stop):
            after = line.extended_point(point_xy, j + 1, first, last)
            if point_section:
                width = point_section[j][0]
                r_blur = blur_root(width, spacing, law)
                c_pull = diffusion_number(width, spacing, law)
                r_pull = line.recurrence_root(c_pull)
            push = (ONE - r_blur) * push_at(before, here, after, width, law) + r_blur * push
            pull = ((ONE - r_pull) * c_pull) * ((after - here) - (here - before)) + r_pull * pull
            if j == first:
                push = vec2(ZERO, ZERO)
                pull = vec2(ZERO, ZERO)
            if j >= begin:
                point_push_out[j] = vec4(push[0], push[1], pull[0], pull[1])
            before = here
            here = after

    @wp.kernel(module=name, enable_backward=False)
    def compute_push(
        # network
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        # params
        law: PathLaw,
        chunk: int,
        # out
        point_push_out: wp.array[vec4],
    ):
        """Push by the curvature and pull towards the neighbours' mean, both blurred downstream: (push, pull) in m.

        push = k w (C n + phi |C| t) dt; pull = c d2 p, c = S k w dt / h^2. Half of (1 - (b w)^2 d2/ds2)^-1 push and of
        (1 - c d2)^-1 pull is done here, the way down the channel; ``shift_points`` does the other half.
        """
        channel_count = channel_form.shape[0]
        i = wp.tid() * chunk
        end = wp.min(i + chunk, channel_start[channel_count])
        if i >= end:
            return
        channel = line.channel_at(channel_start, channel_count, i)
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            form = channel_form[channel]
            sweep_push(
                point_xy, point_section, form, channel_spacing[channel], law, first, last, i, stop, point_push_out
            )
            i = stop
            channel += 1

    @wp.func(module=name)
    def sweep_shift(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        point_push: wp.array[vec4],
        cell_height: wp.array2d[wp.float64],
        raster_grid: cells.RasterGrid,
        form: vec4,
        spacing: scalar,
        law: PathLaw,
        first: int,
        last: int,
        begin: int,
        stop: int,
        point_moved_out: wp.array[vec2],
    ):
        """Move the points begin .. stop - 1 of one channel, running up it."""
        r_blur = blur_root(form[2], spacing, law)
        r_pull = line.recurrence_root(diffusion_number(form[2], spacing, law))
        top = wp.min(last, stop - 1 + wp.max(line.recurrence_reach(r_blur), line.recurrence_reach(r_pull)))
        push = vec2(ZERO, ZERO)
        pull = vec2(ZERO, ZERO)
        for k in range(0, top - begin + 1):
            j = top - k
            if point_section:
                width = point_section[j][0]
                r_blur = blur_root(width, spacing, law)
                r_pull = line.recurrence_root(diffusion_number(width, spacing, law))
            both = point_push[j]
            push = (ONE - r_blur) * vec2(both[0], both[1]) + r_blur * push
            pull = (ONE - r_pull) * vec2(both[2], both[3]) + r_pull * pull
            if j == last:
                push = vec2(ZERO, ZERO)
                pull = vec2(ZERO, ZERO)
            if j < stop:
                moved = point_xy[j]
                if j > first and j < last:
                    shift = line.end_weight(j, first, last, spacing, law.end_damping * form[0]) * push + pull
                    if cell_height:
                        shift = cells.slope_weight(cell_height, raster_grid, moved, law.slope_threshold) * shift
                    moved = moved + shift
                point_moved_out[j] = moved

    @wp.kernel(module=name, enable_backward=False)
    def shift_points(
        # network
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        # terrain
        cell_height: wp.array2d[wp.float64],
        raster_grid: cells.RasterGrid,
        # params
        law: PathLaw,
        chunk: int,
        # in
        point_push: wp.array[vec4],
        # out
        point_moved_out: wp.array[vec2],
    ):
        """Finish the blur upstream and move: p += g (e push + pull); the two ends of a channel stay.

        e fades to 0 at both ends of a channel, g with the slope of the terrain, if there is one.
        """
        channel_count = channel_form.shape[0]
        i = wp.tid() * chunk
        end = wp.min(i + chunk, channel_start[channel_count])
        if i >= end:
            return
        channel = line.channel_at(channel_start, channel_count, i)
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            sweep_shift(
                point_xy, point_section, point_push, cell_height, raster_grid, channel_form[channel],
                channel_spacing[channel], law, first, last, i, stop, point_moved_out,
            )  # fmt: skip
            i = stop
            channel += 1

    # ---- shortcuts

    @wp.func(module=name)
    def tangent_at(point: wp.array[vec2], i: int, first: int, last: int) -> vec2:
        """Direction of the line at a point, of no particular length: from the point before to the point after."""
        return point[wp.min(i + 1, last)] - point[wp.max(i - 1, first)]

    @wp.func(module=name)
    def side_of(a: vec2, b: vec2, p: vec2) -> scalar:
        """Twice the area of the triangle a b p: above 0 to the left of the line from a to b."""
        return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])

    @wp.func(module=name)
    def segments_cross(a: vec2, b: vec2, c: vec2, d: vec2) -> bool:
        """Tell whether the segments from a to b and from c to d cross; touching is not crossing."""
        return side_of(a, b, c) * side_of(a, b, d) < ZERO and side_of(c, d, a) * side_of(c, d, b) < ZERO

    @wp.func(module=name)
    def is_shortcut(
        point: wp.array[vec2],
        section: wp.array[vec2],
        i: int,
        j: int,
        tangent: vec2,
        radius: scalar,
        min_arc: scalar,
        law: ShortcutLaw,
        first: int,
        last: int,
    ) -> bool:
        """Tell whether point i may be joined to a later point j: near, far along the channel, and in line with it.

        Strands that cross are joined at any angle. Of the two pairs of ends looked at the nearer one lies no farther
        apart than a segment is long, and either shortcut takes the crossing off the channel.
        ``tangent`` is that at i; ``radius`` in m and ``min_arc`` in points a metre serve where widths are constant.
        """
        reach = radius
        if section:
            width = HALF * (section[i][0] + section[j][0])
            if scalar(j - i) <= min_arc * width:
                return False
            reach = law.radius * width
        if not (wp.length_sq(point[j] - point[i]) < reach * reach):
            return False
        other = tangent_at(point, j, first, last)
        along = wp.dot(tangent, other)
        if along * along >= law.cone * wp.length_sq(tangent) * wp.length_sq(other):
            return True
        if j < last and segments_cross(point[i], point[i + 1], point[j], point[j + 1]):
            return True
        return i > first and segments_cross(point[i - 1], point[i], point[j - 1], point[j])

    @wp.func(module=name)
    def is_in_cell(p: vec2, x: int, y: int) -> bool:
        """Tell whether a point, in cells, lies in that cell: two cells looked at may share a bucket."""
        return grid.floor_int(p[0]) == x and grid.floor_int(p[1]) == y

    @wp.func(module=name)
    def lowest_partner(section: wp.array[vec2], i: int, widest: scalar, min_arc: scalar) -> int:
        """First point that is far enough along the channel from point i to be joined to it."""
        if section:
            # The other point may be narrower: its width is looked at where it is found.
            return i + int(HALF * min_arc * section[i][0]) + 1
        return i + int(min_arc * widest) + 1

    @wp.func(module=name)
    def partners_of(
        point: wp.array[vec2],
        section: wp.array[vec2],
        point_next: wp.array[int],
        bucket_head: wp.array[int],
        first: int,
        last: int,
        mask: int,
        i: int,
        form: vec4,
        min_arc: scalar,
        ordered: int,
        law: ShortcutLaw,
    ) -> int:
        """Number of later points that point i may be joined to."""
        here = point[i]
        radius = law.radius * form[2]
        nearest = lowest_partner(section, i, form[2], min_arc)
        tangent = tangent_at(point, i, first, last)
        per_cell = HALF / radius
        x0 = grid.floor_int(here[0] * per_cell - HALF)
        y0 = grid.floor_int(here[1] * per_cell - HALF)
        found = int(0)
        for corner in range(4):
            x = x0 + (corner & 1)
            y = y0 + (corner >> 1)
            j = bucket_head[4 * first + grid.bucket_of(x, y, mask)] - 1
            while j >= ordered * nearest:
                if (
                    j >= nearest
                    and is_shortcut(point, section, i, j, tangent, radius, min_arc, law, first, last)
                    and is_in_cell(point[j] * per_cell, x, y)
                ):
                    found += 1
                j = point_next[j] - 1
        return found

    @wp.func(module=name)
    def write_partners(
        point: wp.array[vec2],
        section: wp.array[vec2],
        point_next: wp.array[int],
        bucket_head: wp.array[int],
        first: int,
        last: int,
        mask: int,
        i: int,
        form: vec4,
        min_arc: scalar,
        law: ShortcutLaw,
        offset: int,
        link_to_io: wp.array[int],
    ) -> int:
        """List the points that point i may be joined to in ascending order from ``offset`` on; gives the end."""
        here = point[i]
        radius = law.radius * form[2]
        nearest = lowest_partner(section, i, form[2], min_arc)
        tangent = tangent_at(point, i, first, last)
        per_cell = HALF / radius
        x0 = grid.floor_int(here[0] * per_cell - HALF)
        y0 = grid.floor_int(here[1] * per_cell - HALF)
        end = int(offset)
        for corner in range(4):
            x = x0 + (corner & 1)
            y = y0 + (corner >> 1)
            j = bucket_head[4 * first + grid.bucket_of(x, y, mask)] - 1
            while j >= 0:
                if (
                    j >= nearest
                    and is_shortcut(point, section, i, j, tangent, radius, min_arc, law, first, last)
                    and is_in_cell(point[j] * per_cell, x, y)
                ):
                    slot = int(end)
                    while slot > offset and link_to_io[slot - 1] > j:
                        link_to_io[slot] = link_to_io[slot - 1]
                        slot -= 1
                    link_to_io[slot] = j
                    end += 1
                j = point_next[j] - 1
        return end

    @wp.kernel(module=name, enable_backward=False)
    def count_shortcuts(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        # params
        law: ShortcutLaw,
        chunk: int,
        ordered: int,
        # in
        point_moved: wp.array[vec2],
        section_moved: wp.array[vec2],
        point_next: wp.array[int],
        bucket_head: wp.array[int],
        # out
        point_links_out: wp.array[int],
        point_neck_out: wp.array[int],
        point_from_out: wp.array[int],
        chunk_links_out: wp.array[int],
        chunk_ends_out: wp.array[int],
        chunk_necks_out: wp.array[int],
    ):
        """Number of shortcuts that begin at each point and in each chunk; clears what the later kernels fill.

        i and j > i are joined where |p_i - p_j| < radius, their arc is above ``min_arc`` and the lines along them make
        an angle of at most the cone: (t_i . t_j)^2 >= cos^2 |t_i|^2 |t_j|^2. At a neck the strands run opposite ways,
        so the angle is that of lines, not of arrows. Strands that cross are joined at any angle. ``ordered`` as for
        necks: the lists descend.
        """
        channel_count = channel_form.shape[0]
        k = wp.tid()
        i = k * chunk
        end = wp.min(i + chunk, channel_start[channel_count])
        links = int(0)
        channel = int(0)
        if i < end:
            channel = line.channel_at(channel_start, channel_count, i)
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            mask = grid.bucket_mask(last + 1 - first)
            form = channel_form[channel]
            min_arc = law.min_arc / channel_spacing[channel]
            for j in range(i, stop):
                found = partners_of(
                    point_moved, section_moved, point_next, bucket_head, first, last, mask, j, form, min_arc,
                    ordered, law,
                )  # fmt: skip
                links += found
                point_links_out[j] = found
                point_neck_out[j] = -1
                point_from_out[j] = 0
            i = stop
            channel += 1
        chunk_links_out[k] = links
        chunk_ends_out[k] = 0
        chunk_necks_out[k] = 0

    @wp.kernel(module=name, enable_backward=False)
    def list_shortcuts(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        # params
        law: ShortcutLaw,
        chunk: int,
        # in
        point_moved: wp.array[vec2],
        section_moved: wp.array[vec2],
        point_next: wp.array[int],
        bucket_head: wp.array[int],
        point_links: wp.array[int],
        chunk_links_sum: wp.array[int],
        # out
        link_from_out: wp.array[int],
        link_to_out: wp.array[int],
        fault_io: wp.array[int],
    ):
        """List all shortcuts (i, j), ascending in i and then in j, whatever the order in the grid's lists."""
        k = wp.tid()
        if chunk_links_sum[chunk_links_sum.shape[0] - 1] > link_to_out.shape[0]:
            wp.atomic_max(fault_io, 0, FAULT_SHORTCUTS_FULL)
            return
        slot = int(0)
        if k > 0:
            slot = chunk_links_sum[k - 1]
        if chunk_links_sum[k] == slot:
            return
        channel_count = channel_form.shape[0]
        i = k * chunk
        end = wp.min(i + chunk, channel_start[channel_count])
        channel = line.channel_at(channel_start, channel_count, i)
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            mask = grid.bucket_mask(last + 1 - first)
            form = channel_form[channel]
            min_arc = law.min_arc / channel_spacing[channel]
            for j in range(i, stop):
                if point_links[j] > 0:
                    begin = slot
                    slot = write_partners(
                        point_moved, section_moved, point_next, bucket_head, first, last, mask, j, form, min_arc, law,
                        begin, link_to_out,
                    )  # fmt: skip
                    for m in range(begin, slot):
                        link_from_out[m] = j
            i = stop
            channel += 1

    @wp.kernel(module=name, enable_backward=False)
    def weigh_shortcuts(
        # params
        chunk: int,
        # in
        point_moved: wp.array[vec2],
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.float64],
        chunk_links_sum: wp.array[int],
        link_from: wp.array[int],
        link_to: wp.array[int],
        # out
        link_saving_out: wp.array[wp.float64],
        chunk_ends_io: wp.array[int],
    ):
        """What each shortcut saves, the arc that it bypasses less its own length; flags the chunks where one ends."""
        k = wp.tid()
        begin = int(0)
        if k > 0:
            begin = chunk_links_sum[k - 1]
        end = chunk_links_sum[k]
        if chunk_links_sum[chunk_links_sum.shape[0] - 1] > link_saving_out.shape[0]:
            return
        for m in range(begin, end):
            i = link_from[m]
            j = link_to[m]
            head = line.arc_at(point_arc, chunk_offset, chunk, i)
            arc = line.arc_at(point_arc, chunk_offset, chunk, j) - head
            chord = point_moved[j] - point_moved[i]
            dx = wp.float64(chord[0])
            dy = wp.float64(chord[1])
            link_saving_out[m] = arc - wp.sqrt(dx * dx + dy * dy)
            wp.atomic_max(chunk_ends_io, j // chunk, 1)

    # ---- the shortest path

    @wp.func(module=name)
    def walk_path(
        chunk: int,
        begin: int,
        stop: int,
        chunk_ends: wp.array[int],
        point_from: wp.array[int],
        point_neck_out: wp.array[int],
        chunk_necks_io: wp.array[int],
    ) -> wp.vec2i:
        """Walk the shortest path back up a channel and note the shortcuts on it; number of them and of loop points."""
        cuts = int(0)
        points = int(0)
        cursor = int(stop - 1)
        top = (stop - 1) // chunk
        for m in range(0, top - begin // chunk + 1):
            k = top - m
            if chunk_ends[k] > 0 and k * chunk <= cursor:
                high = wp.min(cursor, (k + 1) * chunk - 1)
                low = wp.max(begin, k * chunk)
                for n in range(0, high - low + 1):
                    j = high - n
                    if j <= cursor and point_from[j] > 0:
                        i = point_from[j] - 1
                        point_neck_out[i] = j
                        wp.atomic_add(chunk_necks_io, i // chunk, 1)
                        cuts += 1
                        points += j - i + 1
                        cursor = i
        return wp.vec2i(cuts, points)

    @wp.kernel(module=name, enable_backward=False)
    def find_path(
        # network
        channel_start: wp.array[int],
        # params
        chunk: int,
        # in
        point_links: wp.array[int],
        chunk_links: wp.array[int],
        chunk_links_sum: wp.array[int],
        chunk_ends: wp.array[int],
        link_to: wp.array[int],
        link_saving: wp.array[wp.float64],
        # out
        point_from_io: wp.array[int],
        point_saving_io: wp.array[wp.float64],
        point_neck_out: wp.array[int],
        chunk_necks_out: wp.array[int],
        channel_cuts_out: wp.array[int],
        channel_cut_points_out: wp.array[int],
    ):
        """Shortest path from the head of a channel to its foot over its own segments and its shortcuts.

        Edges run downstream only, so that one sweep is enough. With A the arc length from the head, the distance to
        point i is A_i - S_i; S_j = max(S_(j-1), max over shortcuts (i, j) of S_i + saving), which changes only where
        a shortcut ends: chunks that hold no end of one are passed over. Where routes are equally short, the channel
        goes before a shortcut, and of shortcuts the one that begins farthest upstream is kept.
        """
        channel = wp.tid()
        channel_cuts_out[channel] = 0
        channel_cut_points_out[channel] = 0
        total = chunk_links_sum[chunk_links_sum.shape[0] - 1]
        if total == 0 or total > link_to.shape[0]:
            return
        first = channel_start[channel]
        stop = channel_start[channel + 1]
        saved = wp.float64(0.0)
        for k in range(first // chunk, (stop - 1) // chunk + 1):
            if chunk_links[k] > 0 or chunk_ends[k] > 0:
                link = chunk_links_sum[k] - chunk_links[k]
                for i in range(k * chunk, wp.min(stop, (k + 1) * chunk)):
                    links = point_links[i]
                    if i >= first:
                        if point_from_io[i] > 0:
                            if point_saving_io[i] > saved:
                                saved = point_saving_io[i]
                            else:
                                point_from_io[i] = 0
                        for m in range(link, link + links):
                            j = link_to[m]
                            gain = saved + link_saving[m]
                            if point_from_io[j] == 0 or gain > point_saving_io[j]:
                                point_saving_io[j] = gain
                                point_from_io[j] = i + 1
                    link += links
        found = walk_path(chunk, first, stop, chunk_ends, point_from_io, point_neck_out, chunk_necks_out)
        channel_cuts_out[channel] = found[0]
        channel_cut_points_out[channel] = found[1]

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        PathLaw=PathLaw,
        ShortcutLaw=ShortcutLaw,
        RasterGrid=cells.RasterGrid,
        compute_push=compute_push,
        shift_points=shift_points,
        count_shortcuts=count_shortcuts,
        list_shortcuts=list_shortcuts,
        weigh_shortcuts=weigh_shortcuts,
        find_path=find_path,
    )
