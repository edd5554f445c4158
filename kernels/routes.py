"""The shortest path over the shortcuts of a channel, down a line or round a ring."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
from warpriver.kernels.channels import RING_POINTS, Marks, Work
from warpriver.kernels.polyline import Links
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels of routes for one precision; arc lengths and what a shortcut saves are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.routes_{scalar.__name__}"
    line = polyline.build(scalar)
    vec2 = line.vec2
    # A shortcut that saves this much is never taken.
    FORBIDDEN = wp.float64(-1.0)
    ZERO_64 = wp.float64(0.0)

    # ---- the head of a ring

    @wp.func(module=name)
    def mark_ends(
        work: Work,
        point_links: wp.array[int],
        point_link: wp.array[int],
        marks: Marks,
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
        for k in range(line.piece_count(work, marks, first, last + 1)):
            piece = line.piece_range(work, marks, first, last + 1, k)
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
        marks: Marks,
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
        for k in range(line.piece_count(work, marks, first, last + 1)):
            piece = line.piece_range(work, marks, first, last + 1, k)
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
            head = line.old_round_index(begin + size // 2, first, last)
        return head

    @wp.func(module=name)
    def turn_shortcuts(
        point: wp.array[vec2],
        length: wp.float64,
        work: Work,
        point_links: wp.array[int],
        point_link: wp.array[int],
        marks: Marks,
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
        for k in range(line.piece_count(work, marks, first, last + 1)):
            piece = line.piece_range(work, marks, first, last + 1, k)
            for i in range(piece[0], piece[1]):
                if point_links[i] > 0:
                    for m in range(point_link[i], point_link[i] + point_links[i]):
                        j = link_to[m]
                        begin = line.old_round_index(i - head, 0, count - 1)
                        end = line.old_round_index(j - head, 0, count - 1)
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
                        # Half a least ring on either side of the head is never bypassed.
                        if 2 * lower < RING_POINTS or 2 * (count - upper) < RING_POINTS:
                            link_saving_io[m] = FORBIDDEN

    @wp.kernel(module=name, enable_backward=False)
    def open_rings(
        # network
        channel_start: wp.array[int],
        channel_closed: wp.array[int],
        # params
        longer: int,
        work: Work,
        # in
        point_moved: wp.array[vec2],
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.int64],
        point_links: wp.array[int],
        point_link: wp.array[int],
        share_links_sum: wp.array[wp.vec2i],
        channel_links: wp.array[int],
        marks: Marks,
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
        listed = share_links_sum[share_links_sum.shape[0] - 1][0] <= link_to.shape[0]
        share = line.channel_range(work, work.first + wp.tid())
        for channel in range(share[0], share[1]):
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            head = int(first)
            linked = line.piece_count(work, marks, first, last + 1) > 0
            if work.chunk == 0:
                linked = channel_links[channel] > 0
            if listed and channel_closed[channel] != 0 and linked:
                inner = mark_ends(work, point_links, point_link, marks, link_to, first, last, point_from_io)
                head = choose_head(
                    work, point_links, point_link, marks, link_to, first, last, inner, longer, point_from_io
                )
                length = line.length_of(point_moved, point_arc, chunk_offset, work.chunk, first, last, 1)
                turn_shortcuts(
                    point_moved, length, work, point_links, point_link, marks, link_to, first, last, head,
                    longer, link_saving_io,
                )  # fmt: skip
            channel_head_out[channel] = head

    # ---- the shortest path

    @wp.func(module=name)
    def sweep_links(
        work: Work,
        marks: Marks,
        links: Links,
        first: int,
        stop: int,
        head: int,
        inner: wp.vec2i,
        saved: wp.float64,
        point_from_io: wp.array[int],
        point_saving_io: wp.array[wp.float64],
    ) -> wp.float64:
        """Sweep the points first .. stop - 1 from what is saved above them; return what is saved below.

        They all lie from ``head`` on, or all before it, on a ring; then the shortcuts of a point that end from the head
        on come from there: they are looked up, the others were noted by the points where they begin. Shortcuts that
        end before inner[0] or begin from inner[1] on are not of these points' route.
        """
        best = wp.float64(saved)
        for k in range(line.piece_count(work, marks, first, stop)):
            piece = line.piece_range(work, marks, first, stop, k)
            for i in range(piece[0], piece[1]):
                source = int(0)
                if i < head:
                    for m in range(links.point_link[i], links.point_link[i] + links.point_links[i]):
                        j = links.link_to[m]
                        if j >= head and point_saving_io[j] + links.link_saving[m] > best:
                            best = point_saving_io[j] + links.link_saving[m]
                            source = j + 1
                if i >= inner[0]:
                    if point_from_io[i] > 0 and point_saving_io[i] > best:
                        best = point_saving_io[i]
                        source = point_from_io[i]
                    if point_from_io[i] != 0 or source > 0:
                        point_from_io[i] = source
                        point_saving_io[i] = best
                if i < inner[1]:
                    for m in range(links.point_link[i], links.point_link[i] + links.point_links[i]):
                        j = links.link_to[m]
                        gain = best + links.link_saving[m]
                        if (i >= head or j < head) and (point_from_io[j] <= 0 or gain > point_saving_io[j]):
                            point_saving_io[j] = gain
                            point_from_io[j] = i + 1
        return best

    @wp.func(module=name)
    def walk_path(
        work: Work,
        marks: Marks,
        share: int,
        ring_points: int,
        begin: int,
        stop: int,
        cursor: int,
        point_from: wp.array[int],
        point_neck_out: wp.array[int],
        share_cut_io: wp.array[wp.vec2i],
    ) -> int:
        """Walk the shortest path back up the points begin .. stop - 1 and note the shortcuts on it where they begin.

        Returns the point that the walk has come to, which lies outside where a shortcut leads there.
        ``ring_points``: those of a ring; 0 on a line.
        """
        at = int(wp.min(cursor, stop - 1))
        pieces = line.piece_count(work, marks, begin, stop)
        for n in range(0, pieces):
            k = pieces - 1 - n
            piece = line.piece_range(work, marks, begin, stop, k)
            if at >= piece[0] and at < stop:
                j = wp.min(at, piece[1] - 1)
                while j >= piece[0] and j < stop:
                    if point_from[j] > 0:
                        i = point_from[j] - 1
                        point_neck_out[i] = j
                        points = j - i + 1
                        if i > j:
                            points += ring_points
                        wp.atomic_add(share_cut_io, line.share_of(work, share, i), wp.vec2i(1, points))
                        at = i
                        j = i
                    else:
                        j -= 1
        return at

    @wp.func(module=name)
    def cluster_end(links: Links, link: int, total: int) -> int:
        """Last point of the cluster of shortcuts that begins with one: none of them reaches beyond it."""
        reach = links.link_to[link]
        m = int(link + 1)
        while m < total and links.link_from[m] < reach:
            reach = wp.max(reach, links.link_to[m])
            m += 1
        return reach

    @wp.func(module=name)
    def route_line(
        work: Work,
        marks: Marks,
        share: int,
        links: Links,
        first: int,
        last: int,
        point_from_io: wp.array[int],
        point_saving_io: wp.array[wp.float64],
        point_neck_out: wp.array[int],
        share_cut_io: wp.array[wp.vec2i],
    ):
        """Find the route from one point of a line to a later one that no shortcut passes over, and note it.

        What ends in the first point or begins in the last is of the routes above and below.
        """
        sweep_links(
            work, marks, links, first, last + 1, first,
            wp.vec2i(first + 1, last), ZERO_64, point_from_io, point_saving_io,
        )  # fmt: skip
        walk_path(work, marks, share, 0, first + 1, last + 1, last, point_from_io, point_neck_out, share_cut_io)

    @wp.func(module=name)
    def route_ring(
        work: Work,
        marks: Marks,
        share: int,
        head: int,
        links: Links,
        first: int,
        last: int,
        point_from_io: wp.array[int],
        point_saving_io: wp.array[wp.float64],
        point_neck_out: wp.array[int],
        share_cut_io: wp.array[wp.vec2i],
    ):
        """Find the route from the head of a ring round to it, and note it."""
        inner, size = wp.vec2i(first, last + 1), last + 1 - first
        saved = sweep_links(
            work, marks, links, head, last + 1, head, inner, ZERO_64,
            point_from_io, point_saving_io,
        )  # fmt: skip
        sweep_links(
            work, marks, links, first, head, head, inner, saved,
            point_from_io, point_saving_io,
        )  # fmt: skip
        cursor = walk_path(
            work, marks, share, size, first, head, head - 1, point_from_io, point_neck_out, share_cut_io
        )  # fmt: skip
        if cursor < head:
            cursor = last
        walk_path(work, marks, share, size, head, last + 1, cursor, point_from_io, point_neck_out, share_cut_io)

    @wp.kernel(module=name, enable_backward=False)
    def find_path(
        # network
        channel_start: wp.array[int],
        # params
        work: Work,
        # in
        channel_closed: wp.array[int],
        channel_head: wp.array[int],
        channel_links: wp.array[int],
        share_links_sum: wp.array[wp.vec2i],
        marks: Marks,
        links: Links,
        # out
        point_from_io: wp.array[int],
        point_saving_io: wp.array[wp.float64],
        point_neck_out: wp.array[int],
        share_cut_io: wp.array[wp.vec2i],
    ):
        """Shortest path from the head of a channel to its foot, or round a ring, over its segments and shortcuts.

        Edges run downstream only, so that one sweep is enough. With A the arc length from the head, the distance to
        point i is A_i - S_i; S_j = max(S_(j-1), max over shortcuts (i, j) of S_i + saving), which changes only where
        a shortcut ends: chunks that hold no end of one are passed over. Where routes are equally short, the channel
        goes before a shortcut, and of shortcuts the one that begins farthest upstream is kept.

        A slab takes its channels one by one. A chunk takes the rings and the clusters of shortcuts that begin in it: a
        point that no shortcut passes over is on the route of a line, whatever lies above and below.

        A ring is swept from its head on, round to it. A shortcut is noted where it begins; the end lies before that
        where it passes over the ring's first point. Without ``channel_closed`` there are only lines.
        """
        k = work.first + wp.tid()
        total = share_links_sum[share_links_sum.shape[0] - 1][0]
        if total > links.link_to.shape[0]:
            return
        share = line.point_range(work, channel_start, channel_start.shape[0] - 1, k)
        i = int(share[0])
        channel = int(share[2])
        link = int(0)
        reach = int(0)
        if k > 0 and work.chunk > 0:
            link = share_links_sum[k - 1][0]
            reach = share_links_sum[k - 1][1]
        while i < share[1]:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            closed = line.closed_at(channel_closed, channel)
            linked = work.chunk > 0
            if work.chunk == 0:
                linked = channel_links[channel] > 0
            if linked and closed != 0:
                if i == first:
                    route_ring(
                        work, marks, k, channel_head[channel], links, first, last, point_from_io, point_saving_io,
                        point_neck_out, share_cut_io,
                    )  # fmt: skip
            elif linked and work.chunk == 0:
                route_line(
                    work, marks, k, links, first, last, point_from_io, point_saving_io, point_neck_out, share_cut_io
                )
            while work.chunk > 0 and link < share_links_sum[k][0] and links.link_from[link] <= last:
                if closed == 0 and links.link_from[link] >= reach:
                    route_line(
                        work, marks, k, links, links.link_from[link], cluster_end(links, link, total), point_from_io,
                        point_saving_io, point_neck_out, share_cut_io,
                    )  # fmt: skip
                reach = wp.max(reach, links.link_to[link])
                link += 1
            i = last + 1
            channel += 1

    return SimpleNamespace(vec2=vec2, open_rings=open_rings, find_path=find_path)
