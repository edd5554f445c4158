"""Shortcuts between near strands of a channel: found on a grid, listed in order, weighed."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import buckets, polyline
from warpriver.kernels.channels import Work
from warpriver.kernels.cuts import Cuts
from warpriver.kernels.links import Links, Route
from warpriver.kernels.polyline import Arcs
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
    wp.set_module_options({"max_unroll": 1}, module=name)
    line, table = polyline.build(scalar), buckets.build(scalar)
    vec2, Channels, Points, Run = line.vec2, line.Channels, line.Points, line.Run
    PointTable, Reach = table.PointTable, table.Reach
    ZERO, HALF = scalar(0.0), scalar(0.5)

    @wp.func(module=name)
    def neighbour(i: int, run: Run) -> int:
        """Point of an index that may lie one beyond an end: the end of a line, the other end of a ring."""
        if run.closed != 0:
            if i < run.first:
                return run.last
            if i > run.last:
                return run.first
        return wp.clamp(i, run.first, run.last)

    @wp.func(module=name)
    def tangent_at(point: wp.array[vec2], i: int, run: Run) -> vec2:
        """Direction of the line at a point, of no particular length: from the point before to the point after."""
        return point[neighbour(i + 1, run)] - point[neighbour(i - 1, run)]

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
        moved: Points, near: PointTable, cone: scalar, run: Run, reach: Reach, i: int, tangent: vec2, j: int
    ) -> bool:
        """Tell whether point i may be joined to a later point j: near, far along the channel, and in line with it.

        Strands that cross are joined at any angle. Of the two pairs of ends looked at the nearer one lies no farther
        apart than a segment is long, and either shortcut takes the crossing off the channel.
        ``tangent`` is that at i.
        """
        radius = reach.radius
        if moved.section:
            width = HALF * (moved.section[i][0] + moved.section[j][0])
            apart = j - i
            if run.closed != 0:
                apart = wp.min(apart, run.last + 1 - run.first - apart)
            if scalar(apart) <= reach.min_arc * width:
                return False
            radius = near.distance * width
        if not (wp.length_sq(moved.xy[j] - moved.xy[i]) < radius * radius):
            return False
        other = tangent_at(moved.xy, j, run)
        along = wp.dot(tangent, other)
        if along * along >= cone * wp.length_sq(tangent) * wp.length_sq(other):
            return True
        # At the end of a line the segment beyond has no length, and crosses nothing.
        after = moved.xy[neighbour(j + 1, run)]
        if segments_cross(moved.xy[i], moved.xy[i + 1], moved.xy[j], after):
            return True
        before = moved.xy[neighbour(i - 1, run)]
        return segments_cross(before, moved.xy[i], moved.xy[j - 1], moved.xy[j])

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
    def highest_partner(nearest: int, i: int, run: Run) -> int:
        """Last point that may be joined to point i: on a ring it is as far from it the other way round."""
        if run.closed != 0:
            return wp.min(run.last, 2 * i + run.last + 1 - run.first - nearest)
        return run.last

    @wp.func(module=name)
    def highest_first(bucket_head: wp.array[int], fields: int, bucket: int, nearest: int) -> int:
        """First point of a bucket's list; none, -1, where the highest point in it lies before ``nearest``."""
        if bucket_head[fields * bucket + fields - 1] <= nearest:
            return -1
        return bucket_head[fields * bucket] - 1

    @wp.func(module=name)
    def write_partners(
        moved: Points,
        near: PointTable,
        cone: scalar,
        run: Run,
        reach: Reach,
        i: int,
        fields: int,
        offset: int,
        links_io: Links,
    ) -> int:
        """List the points that point i may be joined to in ascending order from ``offset`` on; gives the end.

        As many as were counted.
        """
        here = moved.xy[i]
        nearest = lowest_partner(moved.section, i, run.form.widest, reach.min_arc)
        farthest = highest_partner(nearest, i, run)
        tangent = tangent_at(moved.xy, i, run)
        x0 = table.floor_int(here[0] * reach.per_cell - HALF)
        y0 = table.floor_int(here[1] * reach.per_cell - HALF)
        end = int(offset)
        stop = offset + links_io.point_links[i]
        for corner in range(4):
            x = x0 + (corner & 1)
            y = y0 + (corner >> 1)
            bucket = reach.first + table.bucket_of(x, y, reach.mask)
            j = highest_first(near.bucket_head, fields, bucket, nearest)
            while j >= 0:
                if (
                    j >= nearest
                    and j <= farthest
                    and end < stop
                    and is_shortcut(moved, near, cone, run, reach, i, tangent, j)
                    and is_in_cell(moved.xy[j] * reach.per_cell, x, y)
                ):
                    slot = int(end)
                    while slot > offset and links_io.link_to[slot - 1] > j:
                        links_io.link_to[slot] = links_io.link_to[slot - 1]
                        slot -= 1
                    links_io.link_to[slot] = j
                    end += 1
                j = near.point_next[j] - 1
        return end

    @wp.func(module=name)
    def first_link(share_links_sum: wp.array[wp.vec2i], k: int) -> int:
        """First shortcut of a slab or chunk, from the running sum."""
        if k == 0:
            return 0
        return share_links_sum[k - 1][0]

    def shortcut_search(kernel_name, fields):
        """Make the search for shortcuts where a bucket has so many fields, as the search for necks is made."""
        FIELDS = fields

        @wp.func(module=name)
        def partners_of(moved: Points, near: PointTable, cone: scalar, run: Run, reach: Reach, i: int) -> wp.vec2i:
            """Number of later points that point i may be joined to, and the last of them, 0 without any."""
            here = moved.xy[i]
            nearest = lowest_partner(moved.section, i, run.form.widest, reach.min_arc)
            farthest = highest_partner(nearest, i, run)
            tangent = tangent_at(moved.xy, i, run)
            x0 = table.floor_int(here[0] * reach.per_cell - HALF)
            y0 = table.floor_int(here[1] * reach.per_cell - HALF)
            found = wp.vec2i(0, 0)
            lowest = nearest * (2 - FIELDS)
            for corner in range(4):
                x = x0 + (corner & 1)
                y = y0 + (corner >> 1)
                bucket = reach.first + table.bucket_of(x, y, reach.mask)
                j = highest_first(near.bucket_head, FIELDS, bucket, nearest)
                while j >= lowest:
                    if (
                        j >= nearest
                        and j <= farthest
                        and is_shortcut(moved, near, cone, run, reach, i, tangent, j)
                        and is_in_cell(moved.xy[j] * reach.per_cell, x, y)
                    ):
                        found = wp.vec2i(found[0] + 1, wp.max(found[1], j))
                    j = near.point_next[j] - 1
            return found

        @wp.kernel(module=name, enable_backward=False)
        @named(kernel_name)
        def count_shortcuts(
            # network
            channels: Channels,
            # params
            cone: scalar,
            work: Work,
            # in
            moved: Points,
            near: PointTable,
            # out
            links_out: Links,
            route_out: Route,
            cuts_out: Cuts,
        ):
            """Number of shortcuts that begin at each point and in each share, with the last point that one reaches.

            i and j > i are joined where |p_i - p_j| < radius, their arc is above ``min_arc``, either way round on a
            ring, and the lines along them make an angle of at most the cone: (t_i . t_j)^2 >= cos^2 |t_i|^2 |t_j|^2. At
            a neck the strands run opposite ways, so the angle is that of lines, not of arrows; ``cone`` is cos^2.
            Strands that cross are joined at any angle. Slabs have lists that descend, as for necks, and count by
            channel, too. Clears what the path is noted in; inactive channels have none.
            """
            if work.status[HALT] != 0:
                return
            k = work.first + wp.tid()
            links = wp.vec2i(0, 0)
            run = line.begin_runs(channels, work, k)
            while run.stop < run.end:
                run = line.next_run(channels, run)
                own = wp.vec2i(0, 0)
                if run.step > ZERO:
                    reach = table.reach_in(near, run)
                    for j in range(run.begin, run.stop):
                        found = partners_of(moved, near, cone, run, reach, j)
                        own = wp.vec2i(own[0] + found[0], wp.max(own[1], found[1]))
                        links_out.point_links[j] = found[0]
                        cuts_out.point_neck[j] = -1
                        route_out.point_from[j] = 0
                elif work.chunk > 0:
                    for j in range(run.begin, run.stop):
                        links_out.point_links[j] = 0
                        cuts_out.point_neck[j] = -1
                        route_out.point_from[j] = 0
                if work.chunk == 0:
                    links_out.channel_links[run.channel] = own[0]
                links = wp.vec2i(links[0] + own[0], wp.max(links[1], own[1]))
            links_out.share_links[k] = links
            cuts_out.share_cut[k] = wp.vec2i(0, 0)

        return count_shortcuts

    @wp.kernel(module=name, enable_backward=False)
    def list_shortcuts(
        # network
        channels: Channels,
        # params
        cone: scalar,
        work: Work,
        # in
        moved: Points,
        near: PointTable,
        # out
        links_io: Links,
        status_io: wp.array[int],
    ):
        """List all shortcuts (i, j), ascending in i and then in j, whatever the order in the grid's lists.

        A point at which any begin notes the first of them.
        """
        if work.status[HALT] != 0:
            return
        k = work.first + wp.tid()
        total = links_io.share_links_sum[links_io.share_links_sum.shape[0] - 1][0]
        if k == 0:
            status_io[LINKS_NEEDED] = total
        if total > links_io.link_to.shape[0]:
            wp.atomic_max(status_io, FAULT, FAULT_SHORTCUTS_FULL)
            return
        slot = first_link(links_io.share_links_sum, k)
        if links_io.share_links_sum[k][0] == slot:
            return
        fields = 1 + wp.min(work.chunk, 1)
        run = line.begin_runs(channels, work, k)
        while run.stop < run.end:
            run = line.next_run(channels, run)
            linked = work.chunk > 0
            if work.chunk == 0:
                linked = links_io.channel_links[run.channel] > 0
            if linked:
                reach = table.reach_in(near, run)
                for j in range(run.begin, run.stop):
                    if links_io.point_links[j] > 0:
                        begin = slot
                        slot = write_partners(moved, near, cone, run, reach, j, fields, begin, links_io)
                        links_io.point_link[j] = begin
                        for m in range(begin, slot):
                            links_io.link_from[m] = j

    @wp.kernel(module=name, enable_backward=False)
    def weigh_shortcuts(
        # params
        work: Work,
        # in
        point_moved: wp.array[vec2],
        arcs: Arcs,
        # out
        links_io: Links,
        chunk_mark_io: wp.array[wp.vec2i],
    ):
        """What each shortcut saves, the arc i .. j less its own length; marks the chunks where one begins or ends."""
        total = links_io.share_links_sum[links_io.share_links_sum.shape[0] - 1][0]
        if work.status[HALT] != 0 or total > links_io.link_saving.shape[0]:
            return
        k = work.first + wp.tid()
        for m in range(first_link(links_io.share_links_sum, k), links_io.share_links_sum[k][0]):
            i = links_io.link_from[m]
            j = links_io.link_to[m]
            arc = line.arc_from(arcs, line.arc_place(arcs, i), j)
            chord = point_moved[j] - point_moved[i]
            dx = wp.float64(chord[0])
            dy = wp.float64(chord[1])
            links_io.link_saving[m] = arc - wp.sqrt(dx * dx + dy * dy)
            if work.chunk > 0:
                wp.atomic_max(chunk_mark_io, i // work.chunk, wp.vec2i(1, 0))
                wp.atomic_max(chunk_mark_io, j // work.chunk, wp.vec2i(1, 0))

    return SimpleNamespace(
        vec2=vec2,
        PointTable=PointTable,
        count_shortcuts=shortcut_search("count_shortcuts", 1),
        count_shortcuts_in_chunks=shortcut_search("count_shortcuts_in_chunks", 2),
        list_shortcuts=list_shortcuts,
        weigh_shortcuts=weigh_shortcuts,
    )
