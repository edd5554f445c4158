"""Shortcuts between near strands of channels, and routes over them, as kernels take them."""

import warp as wp


@wp.struct
class Links:
    """Shortcuts (i, j), in ascending order.

    ``link_saving`` is the arc that each bypasses less its own length, m; below 0 it is never taken. At each point
    ``point_links`` of them begin, of which ``point_link`` is the first. ``share_links`` is the number of those that
    begin in each slab or chunk, with the last point that one of them reaches, and ``share_links_sum`` their running sum
    and maximum. In slabs ``channel_links`` is 0 for channels without any.
    """

    link_from: wp.array[int]
    link_to: wp.array[int]
    link_saving: wp.array[wp.float64]
    point_links: wp.array[int]
    point_link: wp.array[int]
    share_links: wp.array[wp.vec2i]
    share_links_sum: wp.array[wp.vec2i]
    channel_links: wp.array[int]


@wp.struct
class Route:
    """The best route to each point.

    ``point_from`` is the point + 1 where the best shortcut to a point begins, 0 where none is better than the channel
    itself, and ``point_saving`` what that route saves against the channel, m. The route of a ring begins and ends at
    ``channel_head``, which is missing without rings.
    """

    point_from: wp.array[int]
    point_saving: wp.array[wp.float64]
    channel_head: wp.array[int]
