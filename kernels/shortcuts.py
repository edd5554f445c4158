"""Shortcuts between near strands of a channel, and the shortest path over them, down a line or round a ring."""

import functools
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import buckets, polyline
from warpriver.kernels.polyline import Work

wp.set_module_options({"enable_backward": False})


@functools.cache
def build(scalar):
    """Make the shortcut kernels for one precision; arc lengths and what a shortcut saves are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.shortcuts_{scalar.__name__}"
    line, table = polyline.build(scalar), buckets.build(scalar)
    vec2, vec4 = line.vec2, line.vec4
    ZERO, HALF = scalar(0.0), scalar(0.5)
    FAULT_SHORTCUTS_FULL = 3
    # Least number of points of a ring; half of them on either side of a ring's head are never bypassed.
    RING_POINTS = 8
    # A shortcut that saves this much is never taken.
    FORBIDDEN = wp.float64(-1.0)
    ZERO_64 = wp.float64(0.0)

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
        form: vec4,
        min_arc: scalar,
        ordered: int,
        law: ShortcutLaw,
    ) -> int:
        """Number of later points that point i may be joined to."""
        here = point[i]
        radius = law.radius * form[2]
        nearest = lowest_partner(section, i, form[2], min_arc)
        farthest = highest_partner(nearest, i, first, last, closed)
        tangent = tangent_at(point, i, first, last, closed)
        per_cell = HALF / radius
        x0 = table.floor_int(here[0] * per_cell - HALF)
        y0 = table.floor_int(here[1] * per_cell - HALF)
        found = int(0)
        for corner in range(4):
            x = x0 + (corner & 1)
            y = y0 + (corner >> 1)
            j = bucket_head[4 * first + table.bucket_of(x, y, mask)] - 1
            while j >= ordered * nearest:
                if (
                    j >= nearest
                    and j <= farthest
                    and is_shortcut(point, section, i, j, tangent, radius, min_arc, law, first, last, closed)
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
        closed: int,
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
        farthest = highest_partner(nearest, i, first, last, closed)
        tangent = tangent_at(point, i, first, last, closed)
        per_cell = HALF / radius
        x0 = table.floor_int(here[0] * per_cell - HALF)
        y0 = table.floor_int(here[1] * per_cell - HALF)
        end = int(offset)
        for corner in range(4):
            x = x0 + (corner & 1)
            y = y0 + (corner >> 1)
            j = bucket_head[4 * first + table.bucket_of(x, y, mask)] - 1
            while j >= 0:
                if (
                    j >= nearest
                    and j <= farthest
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
    def first_link(share_links_sum: wp.array[int], k: int) -> int:
        """First shortcut of a share of the work, from the inclusive sum."""
        if k == 0:
            return 0
        return share_links_sum[k - 1]

    @wp.kernel(module=name, enable_backward=False)
    def count_shortcuts(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        # params
        law: ShortcutLaw,
        work: Work,
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
        share_links_out: wp.array[int],
        channel_links_io: wp.array[int],
    ):
        """Number of shortcuts that begin at each point, in each share of the work and in each channel.

        i and j > i are joined where |p_i - p_j| < radius, their arc is above ``min_arc``, either way round on a ring,
        and the lines along them make an angle of at most the cone: (t_i . t_j)^2 >= cos^2 |t_i|^2 |t_j|^2. At a neck
        the strands run opposite ways, so the angle is that of lines, not of arrows. Strands that cross are joined at
        any angle. ``ordered`` as for necks: the lists descend. Clears what the path is noted in; channels whose step is
        0 have none.
        """
        k = work.first + wp.tid()
        share = line.point_range(work, channel_start, channel_form.shape[0], k)
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        links = int(0)
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            own = int(0)
            if channel_step[channel] > ZERO:
                mask = table.bucket_mask(last + 1 - first)
                closed = line.closed_at(law.channel_closed, channel)
                form = channel_form[channel]
                min_arc = law.min_arc / channel_spacing[channel]
                for j in range(i, stop):
                    found = partners_of(
                        point_moved, section_moved, point_next, bucket_head, first, last, closed, mask, j, form,
                        min_arc, ordered, law,
                    )  # fmt: skip
                    own += found
                    point_links_out[j] = found
                    point_neck_out[j] = -1
                    point_from_out[j] = 0
            if work.chunk == 0:
                channel_links_io[channel] = own
            elif own > 0:
                wp.atomic_add(channel_links_io, channel, own)
            links += own
            i = stop
            channel += 1
        share_links_out[k] = links

    @wp.kernel(module=name, enable_backward=False)
    def list_shortcuts(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
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
        share_links_sum: wp.array[int],
        # out
        point_link_out: wp.array[int],
        link_from_out: wp.array[int],
        link_to_out: wp.array[int],
        fault_io: wp.array[int],
    ):
        """List all shortcuts (i, j), ascending in i and then in j, whatever the order in the grid's lists.

        A point at which any begin notes the first of them.
        """
        if share_links_sum[share_links_sum.shape[0] - 1] > link_to_out.shape[0]:
            wp.atomic_max(fault_io, 0, FAULT_SHORTCUTS_FULL)
            return
        k = work.first + wp.tid()
        slot = first_link(share_links_sum, k)
        if share_links_sum[k] == slot:
            return
        share = line.point_range(work, channel_start, channel_form.shape[0], k)
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            if channel_links[channel] > 0:
                mask = table.bucket_mask(last + 1 - first)
                closed = line.closed_at(law.channel_closed, channel)
                form = channel_form[channel]
                min_arc = law.min_arc / channel_spacing[channel]
                for j in range(i, stop):
                    if point_links[j] > 0:
                        begin = slot
                        slot = write_partners(
                            point_moved, section_moved, point_next, bucket_head, first, last, closed, mask, j, form,
                            min_arc, law, begin, link_to_out,
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
        chunk_offset: wp.array[wp.float64],
        share_links_sum: wp.array[int],
        link_from: wp.array[int],
        link_to: wp.array[int],
        # out
        link_saving_out: wp.array[wp.float64],
        chunk_linked_io: wp.array[int],
    ):
        """What each shortcut saves, the arc i .. j less its own length; flags the chunks where one begins or ends."""
        if share_links_sum[share_links_sum.shape[0] - 1] > link_saving_out.shape[0]:
            return
        k = work.first + wp.tid()
        for m in range(first_link(share_links_sum, k), share_links_sum[k]):
            i = link_from[m]
            j = link_to[m]
            head = line.arc_at(point_arc, chunk_offset, work.chunk, i)
            arc = line.arc_at(point_arc, chunk_offset, work.chunk, j) - head
            chord = point_moved[j] - point_moved[i]
            dx = wp.float64(chord[0])
            dy = wp.float64(chord[1])
            link_saving_out[m] = arc - wp.sqrt(dx * dx + dy * dy)
            if work.chunk > 0:
                wp.atomic_max(chunk_linked_io, i // work.chunk, 1)
                wp.atomic_max(chunk_linked_io, j // work.chunk, 1)

    # ---- the head of a ring

    @wp.func(module=name)
    def is_linked(work: Work, chunk_linked: wp.array[int], first: int, k: int) -> bool:
        """Tell whether a shortcut may begin or end in the k-th piece of a channel that has any."""
        return work.chunk == 0 or chunk_linked[first // work.chunk + k] > 0

    @wp.func(module=name)
    def mark_ends(
        work: Work,
        point_links: wp.array[int],
        point_link: wp.array[int],
        chunk_linked: wp.array[int],
        link_to: wp.array[int],
        first: int,
        last: int,
        point_from_out: wp.array[int],
    ) -> wp.vec2i:
        """Set -1 in ``point_from`` where a shortcut of a ring ends.

        Returns the points between which no shortcut passes over the ring's first point by the shorter way: the last of
        those where one of these ends and the first where one begins; without any, the ends of the ring.
        """
        inner = wp.vec2i(first, last)
        for k in range(line.piece_count(work, first, last + 1)):
            if is_linked(work, chunk_linked, first, k):
                piece = line.piece_range(work, first, last + 1, k)
                for i in range(piece[0], piece[1]):
                    if point_links[i] > 0:
                        for m in range(point_link[i], point_link[i] + point_links[i]):
                            j = link_to[m]
                            point_from_out[j] = -1
                            if 2 * (j - i) > last + 1 - first:
                                inner = wp.vec2i(wp.max(inner[0], i), wp.min(inner[1], j))
        return inner

    @wp.func(module=name)
    def rate_stretch(begin: int, size: int, passed: int, inner: wp.vec2i, longer: int, count: int) -> int:
        """How well a stretch of a ring without ends of shortcuts serves to begin the sweep; 0: not at all.

        The longest one is best and, above all, one that no shortcut passes over by the shorter way, or else, where the
        marked point goes on, the first one below it.
        """
        if longer == 0:
            return wp.where(size >= RING_POINTS, 1, 0)
        if size >= RING_POINTS and passed <= begin and begin >= inner[0] and begin <= inner[1]:
            return size + count
        return size

    @wp.func(module=name)
    def choose_head(
        work: Work,
        point_links: wp.array[int],
        point_link: wp.array[int],
        chunk_linked: wp.array[int],
        link_to: wp.array[int],
        first: int,
        last: int,
        inner: wp.vec2i,
        longer: int,
        point_from: wp.array[int],
    ) -> int:
        """Point in the middle of the best stretch of a ring, ``rate_stretch``; its first point where there is none."""
        count = last + 1 - first
        best = int(0)
        rate = int(0)
        head = int(first)
        begin = int(first)
        lead = int(0)
        passed = int(first)
        for k in range(line.piece_count(work, first, last + 1)):
            if is_linked(work, chunk_linked, first, k):
                piece = line.piece_range(work, first, last + 1, k)
                for i in range(piece[0], piece[1]):
                    if point_links[i] > 0 or point_from[i] != 0:
                        if begin == first:
                            lead = i - first
                        elif i > begin:
                            rate = rate_stretch(begin, i - begin, passed, inner, longer, count)
                            if rate > best:
                                best = rate
                                head = (begin + i) // 2
                        begin = i + 1
                        for m in range(point_link[i], point_link[i] + point_links[i]):
                            if 2 * (link_to[m] - i) <= count:
                                passed = wp.max(passed, link_to[m])
        # The stretch across the seam, which only shortcuts from its one side to the other pass over.
        size = last + 1 - begin + lead
        if begin > last:
            rate = rate_stretch(first, size, first, inner, longer, count)
        else:
            rate = rate_stretch(begin, size, begin, inner, longer, count)
        if rate > best or (rate > 0 and longer == 0 and lead > 0):
            head = line.round_index(begin + size // 2, first, last)
        return head

    @wp.func(module=name)
    def turn_shortcuts(
        point: wp.array[vec2],
        length: wp.float64,
        work: Work,
        point_links: wp.array[int],
        point_link: wp.array[int],
        chunk_linked: wp.array[int],
        link_to: wp.array[int],
        first: int,
        last: int,
        head: int,
        longer: int,
        link_saving_io: wp.array[wp.float64],
    ):
        """Make the shortcuts of a ring that pass over its head bypass the other part of it, outside of i .. j.

        None begins or ends within four points of the head, and where the ring's first point goes on none passes over
        it.
        """
        count = last + 1 - first
        for k in range(line.piece_count(work, first, last + 1)):
            if is_linked(work, chunk_linked, first, k):
                piece = line.piece_range(work, first, last + 1, k)
                for i in range(piece[0], piece[1]):
                    if point_links[i] > 0:
                        for m in range(point_link[i], point_link[i] + point_links[i]):
                            j = link_to[m]
                            begin = line.round_index(i - head, 0, count - 1)
                            end = line.round_index(j - head, 0, count - 1)
                            if begin > end:
                                chord = point[j] - point[i]
                                dx = wp.float64(chord[0])
                                dy = wp.float64(chord[1])
                                size = wp.sqrt(dx * dx + dy * dy)
                                link_saving_io[m] = length - link_saving_io[m] - size - size
                                if longer == 0 and i > first:
                                    link_saving_io[m] = FORBIDDEN
                            lower = wp.min(begin, end)
                            upper = wp.max(begin, end)
                            if 2 * lower < RING_POINTS or 2 * (count - upper) < RING_POINTS:
                                link_saving_io[m] = FORBIDDEN

    @wp.kernel(module=name, enable_backward=False)
    def open_rings(
        # network
        channel_start: wp.array[int],
        # params
        law: ShortcutLaw,
        longer: int,
        work: Work,
        # in
        point_moved: wp.array[vec2],
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.float64],
        point_links: wp.array[int],
        point_link: wp.array[int],
        share_links_sum: wp.array[int],
        channel_links: wp.array[int],
        chunk_linked: wp.array[int],
        link_to: wp.array[int],
        # out
        link_saving_io: wp.array[wp.float64],
        point_from_io: wp.array[int],
        channel_head_out: wp.array[int],
    ):
        """Choose the head of each ring, where its route begins and ends, and turn its shortcuts so that none passes it.

        A neck divides a ring in two; of the two ways over it, from i to j and from j to i, the head leaves one. It lies
        in the middle of the longest stretch that is near no other and longer than what any neck cuts off (``longer``),
        or of the first one from the ring's first point on. Lines begin at their first point.
        """
        listed = share_links_sum[share_links_sum.shape[0] - 1] <= link_to.shape[0]
        share = line.channel_range(work, work.first + wp.tid())
        for channel in range(share[0], share[1]):
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            head = int(first)
            if listed and law.channel_closed[channel] != 0 and channel_links[channel] > 0:
                inner = mark_ends(work, point_links, point_link, chunk_linked, link_to, first, last, point_from_io)
                head = choose_head(
                    work, point_links, point_link, chunk_linked, link_to, first, last, inner, longer, point_from_io
                )
                length = line.length_of(point_moved, point_arc, chunk_offset, work.chunk, first, last, 1)
                turn_shortcuts(
                    point_moved, length, work, point_links, point_link, chunk_linked, link_to, first, last, head,
                    longer, link_saving_io,
                )  # fmt: skip
            channel_head_out[channel] = head

    # ---- the shortest path

    @wp.func(module=name)
    def sweep_links(
        work: Work,
        point_links: wp.array[int],
        point_link: wp.array[int],
        chunk_linked: wp.array[int],
        link_to: wp.array[int],
        link_saving: wp.array[wp.float64],
        first: int,
        stop: int,
        head: int,
        saved: wp.float64,
        point_from_io: wp.array[int],
        point_saving_io: wp.array[wp.float64],
    ) -> wp.float64:
        """Sweep the points first .. stop - 1 from what is saved above them; return what is saved below.

        They all lie from ``head`` on, or all before it, on a ring; then the shortcuts of a point that end from the head
        on come from there: they are looked up, the others were noted by the points where they begin.
        """
        best = wp.float64(saved)
        for k in range(line.piece_count(work, first, stop)):
            if is_linked(work, chunk_linked, first, k):
                piece = line.piece_range(work, first, stop, k)
                for i in range(piece[0], piece[1]):
                    source = int(0)
                    if i < head:
                        for m in range(point_link[i], point_link[i] + point_links[i]):
                            j = link_to[m]
                            if j >= head and point_saving_io[j] + link_saving[m] > best:
                                best = point_saving_io[j] + link_saving[m]
                                source = j + 1
                    if point_from_io[i] > 0 and point_saving_io[i] > best:
                        best = point_saving_io[i]
                        source = point_from_io[i]
                    if point_from_io[i] != 0 or source > 0:
                        point_from_io[i] = source
                        point_saving_io[i] = best
                    for m in range(point_link[i], point_link[i] + point_links[i]):
                        j = link_to[m]
                        gain = best + link_saving[m]
                        if (i >= head or j < head) and (point_from_io[j] <= 0 or gain > point_saving_io[j]):
                            point_saving_io[j] = gain
                            point_from_io[j] = i + 1
        return best

    @wp.func(module=name)
    def walk_path(
        work: Work,
        first: int,
        last: int,
        begin: int,
        stop: int,
        cursor: int,
        chunk_linked: wp.array[int],
        point_from: wp.array[int],
        point_neck_out: wp.array[int],
        chunk_necks_io: wp.array[int],
    ) -> wp.vec3i:
        """Walk the shortest path back up the points begin .. stop - 1 and note the shortcuts on it where they begin.

        Returns their number, that of their loops' points and the point that the walk has come to, which lies outside
        where a shortcut leads there.
        """
        cuts = int(0)
        points = int(0)
        at = int(wp.min(cursor, stop - 1))
        pieces = line.piece_count(work, begin, stop)
        for n in range(0, pieces):
            k = pieces - 1 - n
            piece = line.piece_range(work, begin, stop, k)
            if at >= piece[0] and at < stop and is_linked(work, chunk_linked, begin, k):
                j = wp.min(at, piece[1] - 1)
                while j >= piece[0] and j < stop:
                    if point_from[j] > 0:
                        i = point_from[j] - 1
                        point_neck_out[i] = j
                        if work.chunk > 0:
                            wp.atomic_add(chunk_necks_io, i // work.chunk, 1)
                        cuts += 1
                        points += j - i + 1
                        if i > j:
                            points += last + 1 - first
                        at = i
                        j = i
                    else:
                        j -= 1
        return wp.vec3i(cuts, points, at)

    @wp.kernel(module=name, enable_backward=False)
    def find_path(
        # network
        channel_start: wp.array[int],
        # params
        work: Work,
        # in
        channel_head: wp.array[int],
        point_links: wp.array[int],
        point_link: wp.array[int],
        share_links_sum: wp.array[int],
        channel_links: wp.array[int],
        chunk_linked: wp.array[int],
        link_to: wp.array[int],
        link_saving: wp.array[wp.float64],
        # out
        point_from_io: wp.array[int],
        point_saving_io: wp.array[wp.float64],
        point_neck_out: wp.array[int],
        chunk_necks_io: wp.array[int],
        channel_cuts_out: wp.array[int],
        channel_cut_points_out: wp.array[int],
    ):
        """Shortest path from the head of a channel to its foot, or round a ring, over its segments and shortcuts.

        Edges run downstream only, so that one sweep is enough. With A the arc length from the head, the distance to
        point i is A_i - S_i; S_j = max(S_(j-1), max over shortcuts (i, j) of S_i + saving), which changes only where
        a shortcut ends: chunks that hold no end of one are passed over. Where routes are equally short, the channel
        goes before a shortcut, and of shortcuts the one that begins farthest upstream is kept.

        A ring is swept from its head on, round to it. A shortcut is noted where it begins; the end lies before that
        where it passes over the ring's first point. Without ``channel_head`` there are only lines.
        """
        listed = share_links_sum[share_links_sum.shape[0] - 1] <= link_to.shape[0]
        share = line.channel_range(work, work.first + wp.tid())
        for channel in range(share[0], share[1]):
            cuts = int(0)
            points = int(0)
            if listed and channel_links[channel] > 0:
                first = channel_start[channel]
                stop = channel_start[channel + 1]
                head = int(first)
                if channel_head:
                    head = channel_head[channel]
                saved = sweep_links(
                    work, point_links, point_link, chunk_linked, link_to, link_saving, head, stop, head, ZERO_64,
                    point_from_io, point_saving_io,
                )  # fmt: skip
                sweep_links(
                    work, point_links, point_link, chunk_linked, link_to, link_saving, first, head, head, saved,
                    point_from_io, point_saving_io,
                )  # fmt: skip
                after = walk_path(
                    work, first, stop - 1, first, head, head - 1, chunk_linked, point_from_io, point_neck_out,
                    chunk_necks_io,
                )  # fmt: skip
                cursor = stop - 1
                if after[2] >= head:
                    cursor = after[2]
                before = walk_path(
                    work, first, stop - 1, head, stop, cursor, chunk_linked, point_from_io, point_neck_out,
                    chunk_necks_io,
                )  # fmt: skip
                cuts = after[0] + before[0]
                points = after[1] + before[1]
            channel_cuts_out[channel] = cuts
            channel_cut_points_out[channel] = points

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        ShortcutLaw=ShortcutLaw,
        count_shortcuts=count_shortcuts,
        list_shortcuts=list_shortcuts,
        weigh_shortcuts=weigh_shortcuts,
        open_rings=open_rings,
        find_path=find_path,
    )
