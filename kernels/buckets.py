"""Functions that find the bucket of a grid cell in a table, shared by the searches for points that are near."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the bucket functions for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.buckets_{scalar.__name__}"
    # The golden ratio's smaller brother: rows of cells that far apart in a table, in parts of it, are spread evenly.
    GOLDEN = wp.float32(0.5 * (5.0**0.5 - 1.0))

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

    return SimpleNamespace(floor_int=floor_int, bucket_mask=bucket_mask, bucket_of=bucket_of)
