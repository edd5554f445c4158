"""Launches of the CPU device that were recorded, done one after the other without going back to Python."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels that replay; they are the same in both precisions.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.replay_{scalar.__name__}"

    # A launch is three addresses: of the compiled kernel, of its bounds, and of its arguments.
    @wp.func_native(
        """
        typedef void (*Launch)(void*, void*);
        const uint64_t* launch = (const uint64_t*)(table);
        for (int k = 0; k < count; ++k, launch += 3)
            ((Launch)(launch[0]))((void*)(launch[1]), (void*)(launch[2]));
        """
    )
    def run_all(table: wp.uint64, count: int):
        """Run launches in order."""
        ...

    @wp.func_native("memset((void*)(address), 0, size_t(size));")
    def zero_all(address: wp.uint64, size: wp.uint64):
        """Set memory to zero."""
        ...

    @wp.kernel(module=name, enable_backward=False)
    def run_launches(
        # in
        table: wp.uint64,
        count: int,
    ):
        """Run ``count`` launches in the one thread that there is; the table is the address of three uint64 for each."""
        run_all(table, count)

    @wp.kernel(module=name, enable_backward=False)
    def zero_memory(
        # in
        address: wp.uint64,
        size: wp.uint64,
    ):
        """Set ``size`` bytes from an address on to zero."""
        zero_all(address, size)

    return SimpleNamespace(run_launches=run_launches, zero_memory=zero_memory)
