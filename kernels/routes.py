"""The shortest path over the shortcuts of a channel, down a line or round a ring."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import cuts, polyline
from warpriver.kernels.channels import RING_POINTS, Work
from warpriver.kernels.cuts import Cuts, Marks
from warpriver.kernels.links import Links, Route
from warpriver.kernels.polyline import Arcs
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels of routes for one precision; arc lengths and what a shortcut saves are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.routes_{scalar.__name__}"
    line, chosen = polyline.build(scalar), cuts.build(scalar)
    vec2, Channels, Run = line.vec2, line.Channels, line.Run
    # A shortcut that saves this much is never taken.
    FORBIDDEN = wp.float64(-1.0)

    # ---- the head of a ring

    @wp.func(module=name)
    def mark_ends(work: Work, marks: Marks, links: Links, run: Run, point_from_out: wp.array[int]) -> wp.vec2i:
        """Set -1 in ``point_from`` where a shortcut of a ring ends.

        Returns the points between which no shortcut passes over the ring's first point by the shorter way: the last of
        those where one of these ends and the first where one begins; without any, the ends of the ring.
        """
        inner = wp.vec2i(run.first, run.last)
        for k in range(chosen.piece_count(work, marks, run.first, run.last + 1)):
            piece = chosen.piece_range(work, marks, run.first, run.last + 1, k)
            for i in range(piece[0], piece[1]):
                if links.point_links[i] > 0:
                    for m in range(links.point_link[i], links.point_link[i] + links.point_links[i]):
                        j = links.link_to[m]
                        point_from_out[j] = -1
                        if 2 * (j - i) > run.last + 1 - run.first:
                            inner = wp.vec2i(wp.max(inner[0], i), wp.min(inner[1], j))
        return inner

    @wp.func(module=name)
    def rate_stretch(begin: int, size: int, passed: int, inner: wp.vec2i, longer: int, count: int) -> int:
        """How well a stretch of a ring without ends of shortcuts serves to begin the sweep; 0: not at all.

        The longest one is best and, above all, one that no shortcut passes over by the shorter way, or else, where the
        marked point goes on, the first one downstream of it.
        """
        if longer == 0:
            return wp.where(size >= RING_POINTS, 1, 0)
        if size >= RING_POINTS and passed <= begin and begin >= inner[0] and begin <= inner[1]:
            return size + count
        return size

    @wp.func(module=name)
    def choose_head(
        work: Work, marks: Marks, links: Links, run: Run, inner: wp.vec2i, longer: int, point_from: wp.array[int]
    ) -> int:
        """Point in the middle of the best stretch of a ring, ``rate_stretch``; its first point where there is none."""
        first = run.first
        last = run.last
        count = last + 1 - first
        best = int(0)
        rate = int(0)
        head = int(first)
        begin = int(first)
        lead = int(0)
        passed = int(first)
        for k in range(chosen.piece_count(work, marks, first, last + 1)):
            piece = chosen.piece_range(work, marks, first, last + 1, k)
            for i in range(piece[0], piece[1]):
                if links.point_links[i] > 0 or point_from[i] != 0:
                    if begin == first:
                        lead = i - first
                    elif i > begin:
                        rate = rate_stretch(begin, i - begin, passed, inner, longer, count)
                        if rate > best:
                            best = rate
                            head = (begin + i) // 2
                    begin = i + 1
                    for m in range(links.point_link[i], links.point_link[i] + links.point_links[i]):
                        if 2 * (links.link_to[m] - i) <= count:
                            passed = wp.max(passed, links.link_to[m])
        # The stretch across the seam, which only shortcuts from its one side to the other pass over.
        size = last + 1 - begin + lead
        if begin > last:
            rate = rate_stretch(first, size, first, inner, longer, count)
        else:
            rate = rate_stretch(begin, size, begin, inner, longer, count)
        if rate > best or (rate > 0 and longer == 0 and lead > 0):
            head = line.round_index(begin + size // 2, run)
        return head

    @wp.func(module=name)
    def turn_shortcuts(
        point: wp.array[vec2],
        length: wp.float64,
        work: Work,
        marks: Marks,
        run: Run,
        head: int,
        longer: int,
        links_io: Links,
    ):
        """Make the shortcuts of a ring that pass over its head bypass the other arc of it, outside of i .. j.

        None begins or ends within four points of the head, and where the ring's first point goes on none passes over
        it.
        """
        count = run.last + 1 - run.first
        for k in range(chosen.piece_count(work, marks, run.first, run.last + 1)):
            piece = chosen.piece_range(work, marks, run.first, run.last + 1, k)
            for i in range(piece[0], piece[1]):
                if links_io.point_links[i] > 0:
                    for m in range(links_io.point_link[i], links_io.point_link[i] + links_io.point_links[i]):
                        j = links_io.link_to[m]
                        # Both from the head on.
                        begin = i - head + wp.where(i < head, count, 0)
                        end = j - head + wp.where(j < head, count, 0)
                        if begin > end:
                            chord = point[j] - point[i]
                            dx = wp.float64(chord[0])
                            dy = wp.float64(chord[1])
                            size = wp.sqrt(dx * dx + dy * dy)
                            links_io.link_saving[m] = length - links_io.link_saving[m] - size - size
                            if longer == 0 and i > run.first:
                                links_io.link_saving[m] = FORBIDDEN
                        lower = wp.min(begin, end)
                        upper = wp.max(begin, end)
                        # Half a smallest ring on either side of the head is never bypassed.
                        if 2 * lower < RING_POINTS or 2 * (count - upper) < RING_POINTS:
                            links_io.link_saving[m] = FORBIDDEN

    @wp.kernel(module=name, enable_backward=False)
    def open_rings(
        # network
        channels: Channels,
        # params
        longer: int,
        work: Work,
        # in
        point_moved: wp.array[vec2],
        arcs: Arcs,
        marks: Marks,
        # out
        links_io: Links,
        route_io: Route,
    ):
        """Choose the head of each ring, where its route begins and ends, and turn its shortcuts so that none passes it.

        A neck divides a ring in two; of the two ways over it, from i to j and from j to i, the head leaves one. It lies
        in the middle of the longest stretch that is near no other and longer than what any neck cuts off (``longer``),
        or of the first one from the ring's first point on. Lines begin at their first point.
        """
        listed = links_io.share_links_sum[links_io.share_links_sum.shape[0] - 1][0] <= links_io.link_to.shape[0]
        share = line.channel_range(work, work.first + wp.tid())
        for channel in range(share[0], share[1]):
            run = line.whole_run(channels, channel)
            head = int(run.first)
            linked = chosen.piece_count(work, marks, run.first, run.last + 1) > 0
            if work.chunk == 0:
                linked = links_io.channel_links[channel] > 0
            if listed and run.closed != 0 and linked:
                inner = mark_ends(work, marks, links_io, run, route_io.point_from)
                head = choose_head(work, marks, links_io, run, inner, longer, route_io.point_from)
                length = line.length_of(point_moved, arcs, run)
                turn_shortcuts(point_moved, length, work, marks, run, head, longer, links_io)
            route_io.channel_head[channel] = head

    # ---- the shortest path

    @wp.struct
    class Course:
        """What a route is sought on: the points first .. stop - 1 of a line, or a ring, from its ``head`` round to it.

        ``closed`` is 1 for a ring. What ends in the first point of a line or begins in the last is of other routes.
        """

        first: int
        stop: int
        head: int
        closed: int

    @wp.func(module=name)
    def sweep_links(
        work: Work,
        marks: Marks,
        links: Links,
        course: Course,
        begin: int,
        stop: int,
        saved: wp.float64,
        route_io: Route,
    ) -> wp.float64:
        """Sweep the points begin .. stop - 1 from what is saved above them; return what is saved below.

        They all lie from the head on, or all before it; then the shortcuts of a point that end from the head on come
        from there: they are looked up, the others were noted by the points where they begin.
        """
        best = wp.float64(saved)
        head = course.head
        first_end = course.first + 1 - course.closed
        stop_begin = course.stop - 1 + course.closed
        for k in range(chosen.piece_count(work, marks, begin, stop)):
            piece = chosen.piece_range(work, marks, begin, stop, k)
            for i in range(piece[0], piece[1]):
                source = int(0)
                if i < head:
                    for m in range(links.point_link[i], links.point_link[i] + links.point_links[i]):
                        j = links.link_to[m]
                        if j >= head and route_io.point_saving[j] + links.link_saving[m] > best:
                            best = route_io.point_saving[j] + links.link_saving[m]
                            source = j + 1
                if i >= first_end:
                    if route_io.point_from[i] > 0 and route_io.point_saving[i] > best:
                        best = route_io.point_saving[i]
                        source = route_io.point_from[i]
                    if route_io.point_from[i] != 0 or source > 0:
                        route_io.point_from[i] = source
                        route_io.point_saving[i] = best
                if i < stop_begin:
                    for m in range(links.point_link[i], links.point_link[i] + links.point_links[i]):
                        j = links.link_to[m]
                        gain = best + links.link_saving[m]
                        known = route_io.point_from[j] > 0 and gain <= route_io.point_saving[j]
                        if (i >= head or j < head) and not known:
                            route_io.point_saving[j] = gain
                            route_io.point_from[j] = i + 1
        return best

    @wp.func(module=name)
    def walk_path(
        work: Work,
        marks: Marks,
        k: int,
        course: Course,
        begin: int,
        stop: int,
        cursor: int,
        point_from: wp.array[int],
        cuts_io: Cuts,
    ) -> int:
        """Walk the shortest path back up the points begin .. stop - 1 and note the shortcuts on it where they begin.

        Returns the point that the walk has come to, which lies outside where a shortcut leads there.
        """
        at = int(wp.min(cursor, stop - 1))
        pieces = chosen.piece_count(work, marks, begin, stop)
        for n in range(0, pieces):
            piece = chosen.piece_range(work, marks, begin, stop, pieces - 1 - n)
            if at >= piece[0] and at < stop:
                j = wp.min(at, piece[1] - 1)
                while j >= piece[0] and j < stop:
                    if point_from[j] > 0:
                        i = point_from[j] - 1
                        points = j - i + 1
                        if i > j:
                            points += course.stop - course.first
                        chosen.note_cut(work, k, i, j, points, cuts_io)
                        at = i
                        j = i
                    else:
                        j -= 1
        return at

    @wp.func(module=name)
    def find_route(work: Work, marks: Marks, k: int, links: Links, course: Course, route_io: Route, cuts_io: Cuts):
        """Find the shortest route along a course and note it: in one sweep, on a ring in two, up to its head and on."""
        sweeps = 1 + course.closed
        saved = wp.float64(0.0)
        for n in range(sweeps):
            begin = wp.where(n == 0, course.head, course.first)
            stop = wp.where(n == 0, course.stop, course.head)
            saved = sweep_links(work, marks, links, course, begin, stop, saved, route_io)
        cursor = course.head - 1
        for n in range(sweeps):
            begin = int(course.first)
            stop = int(course.head)
            if n == course.closed:
                begin = course.head + 1 - course.closed
                stop = course.stop
                if cursor < course.head:
                    cursor = stop - 1
            cursor = walk_path(work, marks, k, course, begin, stop, cursor, route_io.point_from, cuts_io)

    @wp.func(module=name)
    def cluster_end(links: Links, link: int, total: int) -> int:
        """Last point of the cluster of shortcuts that begins with one: none of them reaches beyond it."""
        reach = links.link_to[link]
        m = int(link + 1)
        while m < total and links.link_from[m] < reach:
            reach = wp.max(reach, links.link_to[m])
            m += 1
        return reach

    @wp.kernel(module=name, enable_backward=False)
    def find_path(
        # network
        channels: Channels,
        # params
        work: Work,
        # in
        marks: Marks,
        links: Links,
        # out
        route_io: Route,
        cuts_io: Cuts,
    ):
        """Shortest path from the head of a channel to its foot, or round a ring, over its segments and shortcuts.

        Edges run downstream only, so that one sweep is enough. With A the arc length from the head, the distance to
        point i is A_i - S_i; S_j = max(S_(j-1), max over shortcuts (i, j) of S_i + saving), which changes only where
        a shortcut ends: chunks that hold no end of one are passed over. Where routes are equally short, the channel
        goes before a shortcut, and of shortcuts the one that begins farthest upstream is kept.

        A slab takes its channels one by one. A chunk takes the rings and the clusters of shortcuts that begin in it: a
        point that no shortcut passes over is on the route of a line, whatever lies above and below.

        A ring is swept from its head on, round to it. A shortcut is noted where it begins; the end lies before that
        where it passes over the ring's first point.
        """
        k = work.first + wp.tid()
        total = links.share_links_sum[links.share_links_sum.shape[0] - 1][0]
        if total > links.link_to.shape[0]:
            return
        # In slabs there are no clusters: stop is 0.
        link = int(0)
        stop = int(0)
        reach = int(0)
        if work.chunk > 0:
            stop = links.share_links_sum[k][0]
            if k > 0:
                link = links.share_links_sum[k - 1][0]
                reach = links.share_links_sum[k - 1][1]
        run = line.begin_runs(channels, work, k)
        while run.stop < run.end:
            run = line.next_run(channels, run)
            whole = run.closed != 0 and run.begin == run.first
            if work.chunk == 0:
                whole = links.channel_links[run.channel] > 0
            # One place that finds routes, so that its code is there once.
            while whole or (link < stop and links.link_from[link] <= run.last):
                course = Course(run.first, run.last + 1, run.first, run.closed)
                found = bool(whole)
                if whole:
                    if run.closed != 0:
                        course.head = route_io.channel_head[run.channel]
                else:
                    if run.closed == 0 and links.link_from[link] >= reach:
                        found = True
                        course.first = links.link_from[link]
                        course.head = course.first
                        course.stop = cluster_end(links, link, total) + 1
                    reach = wp.max(reach, links.link_to[link])
                    link += 1
                if found:
                    find_route(work, marks, k, links, course, route_io, cuts_io)
                whole = False

    return SimpleNamespace(vec2=vec2, open_rings=open_rings, find_path=find_path)
