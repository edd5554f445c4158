"""Warp's CPU device with C++ of a test's own in every kernel module, in a process and a kernel cache of their own.

The C++ is an ordinary build option of Warp (``ModuleBuildOptions``), which is set on every module as it is loaded. It
holds one exported variable, through which the test steers the compiled kernels while they run: so one build serves all
that a test compares.
"""

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path

import warp as wp
from warp._src import context

LONGEST = 600  # s; a kernel that never ends should not hold all tests up


def run(script, *arguments):
    """Run a script of this folder in a process of its own and return the JSON that it prints last.

    Its kernels are cached in a folder below Warp's own, so that neither build is ever mistaken for the other.
    """
    wp.init()
    cache = Path(wp.config.kernel_cache_dir) / Path(script).stem
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name(script), *arguments],
        env=os.environ | {"WARP_CACHE_PATH": str(cache)},
        capture_output=True,
        text=True,
        timeout=LONGEST,
    )
    if done.returncode != 0:
        raise AssertionError(f"{script} {' '.join(arguments)} ended with {done.returncode}:\n{done.stderr[-4000:]}")
    return json.loads(done.stdout.splitlines()[-1])


class Preamble:
    """C++ that is put in front of the kernels of every module, and the one exported uint64 that it reads.

    Args:
        source: The C++; it sees all of Warp's headers, and the generated code comes after it.
        variable: Name of the exported variable in it.
    """

    def __init__(self, source, variable):
        if not hasattr(wp, "ModuleBuildOptions"):
            raise RuntimeError(f"Warp {wp.__version__} puts no C++ of others in front of its kernels; this needs 1.19")
        self._options = wp.ModuleBuildOptions(extra_cpu_preamble=source)
        self._variable = variable
        self._value = 0
        self._places = {}  # by loaded module
        # The code is compiled more often than it runs for long.
        wp.config.optimization_level, wp.config.cpu_compiler_flags = 1, "-march=native"
        wp.config.log_level = wp.LOG_WARNING
        load = context.Module.load
        context.Module.load = lambda module, *args, **kwargs: self._load(load, module, *args, **kwargs)

    def set(self, value):
        """Set the variable, in the modules that are loaded and in those to come."""
        self._value = value
        for place in self._places.values():
            place.value = value

    def _load(self, load, module, *args, **kwargs):
        if module.options["extra_build_options"] is None:
            wp.set_module_options({"extra_build_options": self._options}, module)
        loaded = load(module, *args, **kwargs)
        if loaded not in self._places:
            address = context.runtime.llvm.wp_lookup(loaded.handle.encode(), self._variable.encode())
            if not address:
                raise RuntimeError(f"{self._variable} is not in {module.name}: Warp {wp.__version__} builds otherwise")
            self._places[loaded] = ctypes.c_uint64.from_address(address)
            self._places[loaded].value = self._value
        return loaded


class FillingAllocator(type(wp.get_device_allocator("cpu"))):
    """The CPU's allocator, that fills what it gives out with a byte; None: it is left as it is."""

    byte = None

    def allocate(self, size_in_bytes):
        pointer = super().allocate(size_in_bytes)
        if self.byte is not None:
            ctypes.memset(pointer, self.byte, size_in_bytes)
        return pointer


def fill_fresh_memory():
    """Make the CPU device allocate by a ``FillingAllocator``, and return it."""
    device = wp.get_device("cpu")
    device.default_allocator = allocator = FillingAllocator(device)
    if wp.get_device_allocator("cpu") is not allocator:
        raise RuntimeError(f"Warp {wp.__version__} takes no other allocator for the CPU")
    return allocator
