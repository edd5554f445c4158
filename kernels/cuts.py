"""What is cut off in a sub-step: the necks of channels, the cuts chosen among them, and the chunks that hold any."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.channels import Work
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@wp.struct
class Cuts:
    """The necks of a sub-step, and which of them are cut.

    ``point_neck`` is the later point that the neck of a point reaches, -1 if it has none. Where there is a neck,
    ``point_cut`` is the point where the loop ends that is cut off, -1 if none is; -2 - j stands for what lies outside
    of i .. j on a ring. ``share_cut`` is the number of cuts that begin in each slab or chunk and of their points,
    ``share_cut_sum`` its running sum. In slabs ``channel_necks`` is 0 for channels without necks.
    """

    point_neck: wp.array[int]
    point_cut: wp.array[int]
    channel_necks: wp.array[int]
    share_cut: wp.array[wp.vec2i]
    share_cut_sum: wp.array[wp.vec2i]


@wp.struct
class Marks:
    """The chunks that hold something, such as necks: a list of them, in ascending order.

    ``place``, one longer than there are chunks, has the number of marked chunks before each. ``sum`` is the running sum
    of the marks, with the running maximum of the points that they reach. Where a thread takes a slab, there are no
    chunks, and all arrays are missing.
    """

    place: wp.array[int]
    chunk: wp.array[int]
    sum: wp.array[wp.vec2i]


@once
def build(scalar):
    """Make the functions; they are the same in both precisions, in a module for each.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.cuts_{scalar.__name__}"

    @wp.func(module=name)
    def share_of(work: Work, k: int, i: int) -> int:
        """Chunk that a point belongs to; in slabs the slab k, whose thread asks."""
        if work.chunk == 0:
            return k
        return i // work.chunk

    @wp.func(module=name)
    def note_cut(work: Work, k: int, i: int, j: int, points: int, cuts_io: Cuts):
        """Note at point i that a loop of so many points is cut off, up to j; k: the slab of the thread."""
        cuts_io.point_cut[i] = j
        wp.atomic_add(cuts_io.share_cut, share_of(work, k, i), wp.vec2i(1, points))

    @wp.func(module=name)
    def piece_count(work: Work, marks: Marks, first: int, stop: int) -> int:
        """Number of pieces of the points first .. stop - 1 for ``piece_range``: the marked chunks, or all as one."""
        if work.chunk == 0:
            return 1
        return marks.place[(stop - 1) // work.chunk + 1] - marks.place[first // work.chunk]

    @wp.func(module=name)
    def piece_range(work: Work, marks: Marks, first: int, stop: int, k: int) -> wp.vec2i:
        """Points of the k-th piece: all of them, or those that lie in a marked chunk."""
        if work.chunk == 0:
            return wp.vec2i(first, stop)
        c = marks.chunk[marks.place[first // work.chunk] + k]
        return wp.vec2i(wp.max(first, c * work.chunk), wp.min(stop, (c + 1) * work.chunk))

    return SimpleNamespace(share_of=share_of, note_cut=note_cut, piece_count=piece_count, piece_range=piece_range)
