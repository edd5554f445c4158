"""Shortcuts between near strands of a channel: found on a grid, listed in order, weighed."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import buckets, polyline
from warpriver.kernels.channels import Work
from warpriver.kernels.status import FAULT, FAULT_SHORTCUTS_FULL, HALT, LINKS_NEEDED
from warpriver.kernels.variants import named, once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the shortcut kernels for one precision; arc lengths and what a shortcut saves are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.shortcuts_{scalar.__name__}"
    line, table = polyline.build(scalar), buckets.build(scalar)
    vec2, Form = line.vec2, line.Form
    ZERO, HALF = scalar(0.0), scalar(0.5)

    @wp.struct
    class ShortcutLaw:
        """When two points are joined: search radius and least arc in widths, cosine of the cone squared.

        ``channel_closed``: 1 for rings; without the array there are none.
        """

        radius: scalar
        min_arc: scalar
        cone: scalar
        channel_closed: wp.array[int]

    @wp.func(module=name)
    def neighbour(i: int, first: int, last: int, closed: int) -> int:
        """Point of an index that may lie one beyond an end: the end of a line, the other end of a ring."""
        if closed != 0:
            if i < first:
                return last
            if i > last:
                return first
        return wp.clamp(i, first, last)

    @wp.func(module=name)
    def tangent_at(point: wp.array[vec2], i: int, first: int, last: int, closed: int) -> vec2:
        """Direction of the line at a point, of no particular length: from the point before to the point after."""
        return point[neighbour(i + 1, first, last, closed)] - point[neighbour(i - 1, first, last, closed)]

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
        closed: int,
    ) -> bool:
        """Tell whether point i may be joined to a later point j: near, far along the channel, and in line with it.

        Strands that cross are joined at any angle. Of the two pairs of ends looked at the nearer one lies no farther
        apart than a segment is long, and either shortcut takes the crossing off the channel.
        ``tangent`` is that at i; ``radius`` in m and ``min_arc`` in points a metre serve where widths are constant.
        """
        reach = radius
        if section:
            width = HALF * (section[i][0] + section[j][0])
            apart = j - i
            if closed != 0:
                apart = wp.min(apart, last + 1 - first - apart)
            if scalar(apart) <= min_arc * width:
                return False
            reach = law.radius * width
        if not (wp.length_sq(point[j] - point[i]) < reach * reach):
            return False
        other = tangent_at(point, j, first, last, closed)
        along = wp.dot(tangent, other)
        if along * along >= law.cone * wp.length_sq(tangent) * wp.length_sq(other):
            return True
        # At the end of a line the segment beyond has no length, and crosses nothing.
        after = point[neighbour(j + 1, first, last, closed)]
        if segments_cross(point[i], point[i + 1], point[j], after):
            return True
        before = point[neighbour(i - 1, first, last, closed)]
        return segments_cross(before, point[i], point[j - 1], point[j])

    @wp.func(module=name)
    def is_in_cell(p: vec2, x: int, y: int) -> bool:
        """Tell whether a point, in cells, lies in that cell: two cells looked at may share a bucket."""
        return table.floor_int(p[0]) == x and table.floor_int(p[1]) == y

    @wp.func(module=name)
    def lowest_partner(section: wp.array[vec2], i: int, widest: scalar, min_arc: scalar) -> int:
        """First point that is far enough along the channel from point i to be joined to it."""
        if section:
            # The other point may be narrower: its width is looked at where it is found.
            return i + int(HALF * min_arc * section[i][0]) + 1
        return i + int(min_arc * widest) + 1

    @wp.func(module=name)
    def highest_partner(nearest: int, i: int, first: int, last: int, closed: int) -> int:
        """Last point that may be joined to point i: on a ring it is as far from it the other way round."""
        if closed != 0:
            return wp.min(last, 2 * i + last + 1 - first - nearest)
        return last

    @wp.func(module=name)
    def highest_first(bucket_head: wp.array[int], fields: int, bucket: int, nearest: int) -> int:
        """First point of a bucket's list; none, -1, where the highest point in it lies before ``nearest``."""
        if bucket_head[fields * bucket + fields - 1] <= nearest:
            return -1
        return bucket_head[fields * bucket] - 1

    @wp.func(module=name)
    def write_partners(
        point: wp.array[vec2],
        section: wp.array[vec2],
        point_next: wp.array[int],
        bucket_head: wp.array[int],
        first: int,
        last: int,
        closed: int,
        mask: int,
        i: int,
        form: Form,
        min_arc: scalar,
        fields: int,
        law: ShortcutLaw,
        offset: int,
        stop: int,
        link_to_io: wp.array[int],
    ) -> int:
        """List the points that point i may be joined to in ascending order from ``offset`` on; gives the end.

        As many as were counted, up to ``stop``.
        """
        here = point[i]
        radius = law.radius * form.widest
        nearest = lowest_partner(section, i, form.widest, min_arc)
        farthest = highest_partner(nearest, i, first, last, closed)
        tangent = tangent_at(point, i, first, last, closed)
        per_cell = HALF / radius
        x0 = table.floor_int(here[0] * per_cell - HALF)
        y0 = table.floor_int(here[1] * per_cell - HALF)
        end = int(offset)
        for corner in range(4):
            x = x0 + (corner & 1)
            y = y0 + (corner >> 1)
            j = highest_first(bucket_head, fields, 4 * first + table.bucket_of(x, y, mask), nearest)
            while j >= 0:
                if (
                    j >= nearest
                    and j <= farthest
                    and end < stop
                    and is_shortcut(point, section, i, j, tangent, radius, min_arc, law, first, last, closed)
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

    @wp.func(module=name)
    def first_link(share_links_sum: wp.array[wp.vec2i], k: int) -> int:
        """First shortcut of a share of the work, from the inclusive sum."""
        if k == 0:
            return 0
        return share_links_sum[k - 1][0]

    def shortcut_search(kernel_name, fields):
        """Make the search for shortcuts where a bucket has so many fields, as the search for necks is made."""
        FIELDS = fields

        @wp.func(module=name)
        def partners_of(
            point: wp.array[vec2],
            section: wp.array[vec2],
            point_next: wp.array[int],
            bucket_head: wp.array[int],
            first: int,
            last: int,
            closed: int,
            mask: int,
            i: int,
            form: Form,
            min_arc: scalar,
            law: ShortcutLaw,
        ) -> wp.vec2i:
            """Number of later points that point i may be joined to, and the last of them, 0 without any."""
            here = point[i]
            radius = law.radius * form.widest
            nearest = lowest_partner(section, i, form.widest, min_arc)
            farthest = highest_partner(nearest, i, first, last, closed)
            tangent = tangent_at(point, i, first, last, closed)
            per_cell = HALF / radius
            x0 = table.floor_int(here[0] * per_cell - HALF)
            y0 = table.floor_int(here[1] * per_cell - HALF)
            found = wp.vec2i(0, 0)
            lowest = nearest * (2 - FIELDS)
            for corner in range(4):
                x = x0 + (corner & 1)
                y = y0 + (corner >> 1)
                j = highest_first(bucket_head, FIELDS, 4 * first + table.bucket_of(x, y, mask), nearest)
                while j >= lowest:
                    if (
                        j >= nearest
                        and j <= farthest
                        and is_shortcut(point, section, i, j, tangent, radius, min_arc, law, first, last, closed)
                        and is_in_cell(point[j] * per_cell, x, y)
                    ):
                        found = wp.vec2i(found[0] + 1, wp.max(found[1], j))
                    j = point_next[j] - 1
            return found

        @wp.kernel(module=name, enable_backward=False)
        @named(kernel_name)
        def count_shortcuts(
            # network
            channel_start: wp.array[int],
            channel_form: wp.array[Form],
            channel_spacing: wp.array[scalar],
            channel_step: wp.array[scalar],
            # params
            law: ShortcutLaw,
            work: Work,
            # in
            point_moved: wp.array[vec2],
            section_moved: wp.array[vec2],
            point_next: wp.array[int],
            bucket_head: wp.array[int],
            # out
            point_links_out: wp.array[int],
            point_neck_out: wp.array[int],
            point_from_out: wp.array[int],
            share_links_out: wp.array[wp.vec2i],
            share_cut_out: wp.array[wp.vec2i],
            channel_links_out: wp.array[int],
        ):
            """Number of shortcuts that begin at each point and in each share, with the last point that one reaches.

            i and j > i are joined where |p_i - p_j| < radius, their arc is above ``min_arc``, either way round on a
            ring, and the lines along them make an angle of at most the cone: (t_i . t_j)^2 >= cos^2 |t_i|^2 |t_j|^2. At
            a neck the strands run opposite ways, so the angle is that of lines, not of arrows. Strands that cross are
            joined at any angle. Slabs have lists that descend, as for necks, and count by channel, too. Clears what the
            path is noted in; channels whose step is 0 have none.
            """
            if work.status[HALT] != 0:
                return
            k = work.first + wp.tid()
            share = line.point_range(work, channel_start, channel_form.shape[0], k)
            i = int(share[0])
            end = share[1]
            channel = int(share[2])
            links = wp.vec2i(0, 0)
            while i < end:
                first = channel_start[channel]
                last = channel_start[channel + 1] - 1
                stop = wp.min(end, last + 1)
                own = wp.vec2i(0, 0)
                if channel_step[channel] > ZERO:
                    mask = table.bucket_mask(last + 1 - first)
                    closed = line.closed_at(law.channel_closed, channel)
                    form = channel_form[channel]
                    min_arc = law.min_arc / channel_spacing[channel]
                    for j in range(i, stop):
                        found = partners_of(
                            point_moved, section_moved, point_next, bucket_head, first, last, closed, mask, j, form,
                            min_arc, law,
                        )  # fmt: skip
                        own = wp.vec2i(own[0] + found[0], wp.max(own[1], found[1]))
                        point_links_out[j] = found[0]
                        point_neck_out[j] = -1
                        point_from_out[j] = 0
                elif work.chunk > 0:
                    for j in range(i, stop):
                        point_links_out[j] = 0
                        point_neck_out[j] = -1
                        point_from_out[j] = 0
                if work.chunk == 0:
                    channel_links_out[channel] = own[0]
                links = wp.vec2i(links[0] + own[0], wp.max(links[1], own[1]))
                i = stop
                channel += 1
            share_links_out[k] = links
            share_cut_out[k] = wp.vec2i(0, 0)

        return count_shortcuts

    @wp.kernel(module=name, enable_backward=False)
    def list_shortcuts(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[Form],
        channel_spacing: wp.array[scalar],
        # params
        law: ShortcutLaw,
        work: Work,
        # in
        point_moved: wp.array[vec2],
        section_moved: wp.array[vec2],
        point_next: wp.array[int],
        bucket_head: wp.array[int],
        point_links: wp.array[int],
        channel_links: wp.array[int],
        share_links_sum: wp.array[wp.vec2i],
        # out
        point_link_out: wp.array[int],
        link_from_out: wp.array[int],
        link_to_out: wp.array[int],
        status_io: wp.array[int],
    ):
        """List all shortcuts (i, j), ascending in i and then in j, whatever the order in the grid's lists.

        A point at which any begin notes the first of them.
        """
        if work.status[HALT] != 0:
            return
        k = work.first + wp.tid()
        total = share_links_sum[share_links_sum.shape[0] - 1][0]
        if k == 0:
            status_io[LINKS_NEEDED] = total
        if total > link_to_out.shape[0]:
            wp.atomic_max(status_io, FAULT, FAULT_SHORTCUTS_FULL)
            return
        slot = first_link(share_links_sum, k)
        if share_links_sum[k][0] == slot:
            return
        fields = 1 + wp.min(work.chunk, 1)
        share = line.point_range(work, channel_start, channel_form.shape[0], k)
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            if work.chunk > 0 or channel_links[channel] > 0:
                mask = table.bucket_mask(last + 1 - first)
                closed = line.closed_at(law.channel_closed, channel)
                form = channel_form[channel]
                min_arc = law.min_arc / channel_spacing[channel]
                for j in range(i, stop):
                    if point_links[j] > 0:
                        begin = slot
                        slot = write_partners(
                            point_moved, section_moved, point_next, bucket_head, first, last, closed, mask, j, form,
                            min_arc, fields, law, begin, begin + point_links[j], link_to_out,
                        )  # fmt: skip
                        point_link_out[j] = begin
                        for m in range(begin, slot):
                            link_from_out[m] = j
            i = stop
            channel += 1

    @wp.kernel(module=name, enable_backward=False)
    def weigh_shortcuts(
        # params
        work: Work,
        # in
        point_moved: wp.array[vec2],
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.int64],
        share_links_sum: wp.array[wp.vec2i],
        link_from: wp.array[int],
        link_to: wp.array[int],
        # out
        link_saving_out: wp.array[wp.float64],
        chunk_mark_io: wp.array[wp.vec2i],
    ):
        """What each shortcut saves, the arc i .. j less its own length; marks the chunks where one begins or ends."""
        if work.status[HALT] != 0 or share_links_sum[share_links_sum.shape[0] - 1][0] > link_saving_out.shape[0]:
            return
        k = work.first + wp.tid()
        for m in range(first_link(share_links_sum, k), share_links_sum[k][0]):
            i = link_from[m]
            j = link_to[m]
            arc = line.arc_between(point_arc, chunk_offset, work.chunk, i, j)
            chord = point_moved[j] - point_moved[i]
            dx = wp.float64(chord[0])
            dy = wp.float64(chord[1])
            link_saving_out[m] = arc - wp.sqrt(dx * dx + dy * dy)
            if work.chunk > 0:
                wp.atomic_max(chunk_mark_io, i // work.chunk, wp.vec2i(1, 0))
                wp.atomic_max(chunk_mark_io, j // work.chunk, wp.vec2i(1, 0))

    return SimpleNamespace(
        vec2=vec2,
        Form=Form,
        ShortcutLaw=ShortcutLaw,
        count_shortcuts=shortcut_search("count_shortcuts", 1),
        count_shortcuts_in_chunks=shortcut_search("count_shortcuts_in_chunks", 2),
        list_shortcuts=list_shortcuts,
        weigh_shortcuts=weigh_shortcuts,
    )
