"""Functions that find the bucket of a grid cell in a table, shared by the searches for points that are near."""

import functools
from types import SimpleNamespace

import warp as wp

wp.set_module_options({"enable_backward": False})


@functools.cache
def build(scalar):
    """Make the bucket functions for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.buckets_{scalar.__name__}"
    # Odd 32-bit constants with well mixed bits, to scatter tiles over the table.
    HASH_X, HASH_Y, HASH_MIX = wp.uint32(0x9E3779B1), wp.uint32(0x85EBCA77), wp.uint32(0x27D4EB2F)

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
        """Bucket of a grid cell: cells of an 8 x 8 tile stay together in memory, tiles are scattered."""
        tile = ((wp.uint32(x >> 3) * HASH_X) ^ (wp.uint32(y >> 3) * HASH_Y)) * HASH_MIX
        inside = wp.uint32(((y & 7) << 3) | (x & 7))
        return int((((tile >> wp.uint32(9)) << wp.uint32(6)) | inside) & wp.uint32(mask))

    return SimpleNamespace(floor_int=floor_int, bucket_mask=bucket_mask, bucket_of=bucket_of)
