"""Functions that find the bucket of a grid cell in a table, shared by the searches for points that are near."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import channels
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the bucket functions for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.buckets_{scalar.__name__}"
    Run = channels.build(scalar).Run
    HALF = scalar(0.5)
    # The golden section: rows of cells that far apart, as a fraction of the table, are spread evenly.
    GOLDEN = wp.float32(0.5 * (5.0**0.5 - 1.0))

    @wp.struct
    class PointTable:
        """The points of each channel in a grid of its own, and what of them counts as near.

        Near points are less than ``distance`` apart, in greatest widths of the channel, and more than ``min_arc``
        widths along it. A cell is two distances wide. ``bucket_head`` is the first point of each cell's list + 1 (with
        chunks followed by the highest one + 1), ``point_next`` the next point + 1; 0 ends a list.
        """

        distance: scalar
        min_arc: scalar
        point_next: wp.array[int]
        bucket_head: wp.array[int]

    @wp.struct
    class Reach:
        """What counts as near in one channel: radius in m, cells a metre, and points along it for a metre of width.

        ``first`` is the first of its buckets, ``mask`` their number less one.
        """

        radius: scalar
        per_cell: scalar
        min_arc: scalar
        first: int
        mask: int

    @wp.func(module=name)
    def floor_int(x: scalar) -> int:
        """Greatest integer at or below x (cheaper than a call of floor where the CPU code is generic)."""
        whole = int(x)
        if scalar(whole) > x:
            return whole - 1
        return whole

    @wp.func(module=name)
    def bucket_mask(points: int) -> int:
        """Number of buckets of a channel less one: a power of two, two to four buckets a point."""
        size = int(1)
        while size <= 2 * points:
            size = 2 * size
        return size - 1

    @wp.func(module=name)
    def bucket_of(x: int, y: int, mask: int) -> int:
        """Bucket of a grid cell: x + K y, K odd and near the table's golden section.

        Cells that share a bucket form a lattice whose shortest vectors, in any direction, are about the root of the
        table's size long: unlike those of a scattering hash, they are never near each other.
        """
        rows = int(GOLDEN * wp.float32(mask)) | 1
        return int((wp.uint32(x) + wp.uint32(y) * wp.uint32(rows)) & wp.uint32(mask))

    @wp.func(module=name)
    def reach_in(table: PointTable, run: Run) -> Reach:
        """What counts as near in the channel of a run."""
        reach = Reach()
        reach.radius = table.distance * run.form.widest
        reach.per_cell = HALF / reach.radius
        reach.min_arc = table.min_arc / run.spacing
        reach.first = 4 * run.first
        reach.mask = bucket_mask(run.last + 1 - run.first)
        return reach

    return SimpleNamespace(
        PointTable=PointTable,
        Reach=Reach,
        floor_int=floor_int,
        bucket_mask=bucket_mask,
        bucket_of=bucket_of,
        reach_in=reach_in,
    )
