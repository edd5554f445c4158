"""Devices: a quiet start of Warp, launches that threads share, the device that a name means, precisions, memory."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import math
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.errors import InputError, OutOfMemoryError, PathError, warn

__all__ = [
    "PRECISIONS",
    "available_memory",
    "launch_kernel",
    "load_kernel",
    "present_device",
    "put_on_device",
    "require_memory",
    "resolve_device",
    "start_warp",
]

log = logging.getLogger("warpriver")

# Warp's types of a real number and a point, and NumPy's type, by the name of the precision.
PRECISIONS = {"float64": (wp.float64, wp.vec2d, np.float64), "float32": (wp.float32, wp.vec2f, np.float32)}


def _settle_cache() -> None:
    """Let Warp keep compiled kernels where files can be written, if they cannot be where it would keep them."""
    if wp.config.kernel_cache_dir is not None or "WARP_CACHE_PATH" in os.environ:
        return
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # nobody's home
        home = Path("/nonexistent")
    there = next(path for path in (home / "warp", home, *home.parents) if path.exists())
    if os.name != "posix" or (there.is_dir() and os.access(there, os.W_OK | os.X_OK)):
        return
    cache = Path(tempfile.gettempdir()) / f"warpriver-{os.getuid()}"
    try:
        cache.mkdir(mode=0o700, exist_ok=True)
        # What is compiled is run: nobody else may have made that folder.
        if cache.is_symlink() or cache.stat().st_uid != os.getuid():
            cache = Path(tempfile.mkdtemp(prefix="warpriver-"))
    except OSError:
        return
    wp.config.kernel_cache_dir = str(cache)
    log.warning("%s cannot be written: kernels are kept in %s; set WARP_CACHE_PATH for another folder", home, cache)


_settle_cache()


# Warp's own start is not safe where two threads come to it at once.
_starting = threading.Lock()
_started = False


def start_warp() -> None:
    """Start Warp, once in a process, without its greeting.

    From then on Warp tells of warnings and errors only, unless ``wp.config.log_level`` had been set before or is set
    again afterwards. On a machine without a CUDA driver its native line about that is left out as well.

    Raises:
        OSError: Warp cannot keep its kernels; it says how to let it.
    """
    global _started
    if _started:
        return
    with _starting:
        if not _started:
            if wp.config.log_level == wp.LOG_INFO:  # as Warp comes
                wp.config.log_level = wp.LOG_WARNING
            with contextlib.nullcontext() if _has_driver() else _without_driver_lines():
                try:
                    wp.init()
                except OSError as error:
                    raise PathError.of(
                        error, "Warp cannot keep its kernels; set WARP_CACHE_PATH to a folder that can be written"
                    ) from error
            _started = True


def _has_driver() -> bool:
    try:
        ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return False
    return True


@contextlib.contextmanager
def _without_driver_lines() -> Iterator[None]:
    """Hold back what native code says to standard error, and let through what is not about the missing driver."""
    try:
        sys.stderr.flush()
        kept = os.dup(2)
    except (AttributeError, OSError):  # there is no standard error
        yield
        return
    # In memory: there may be no room for a file.
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    os.dup2(writing, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(writing)
        with os.fdopen(reading, errors="replace") as said:
            for line in said:
                if "CUDA driver" not in line:
                    print(line, end="", file=sys.stderr)


# Modules of kernels that are loaded, each with the device and the threads of a block that it is loaded for.
_loaded: set[tuple[Any, str, int]] = set()
_loading = threading.Lock()
# Threads of a block where nothing else is said, as Warp has them on a GPU.
BLOCK_DIM = 256


def load_kernel(kernel: Any, device: Any, block_dim: int) -> None:
    """Load the module of a kernel, and compile it if need be, by one thread at a time.

    Warp lets two threads load a module at the same time; the one that comes second then unloads what the first is
    running.
    """
    key = (kernel.module, device.alias, block_dim)
    if key not in _loaded:
        with _loading:
            kernel.module.load(device, block_dim)
            _loaded.add(key)


def launch_kernel(
    kernel: Any, dim: int | Sequence[int], inputs: Sequence[Any], outputs: Sequence[Any] = (), *, device: Any
) -> None:
    """Launch a kernel, from any thread; in place of ``wp.launch``."""
    device = resolve_device(device)
    block_dim = 1 if device.is_cpu else BLOCK_DIM
    load_kernel(kernel, device, block_dim)
    wp.launch(kernel, dim, inputs, outputs, device=device, block_dim=block_dim)


def put_on_device(values: Any, dtype: Any, device: Any) -> DeviceArray:
    """Return values that are only read from now on as an array on a device; on the CPU they are shared, not copied.

    A copy takes five times as long as the rest, which counts where hundreds of short arrays are made.
    """
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device, copy=not device.is_cpu)


def resolve_device(device: Any) -> Any:
    """Return the Warp device of that name, or raise ``ValueError`` that lists the devices of this machine."""
    start_warp()
    try:
        return wp.get_device(device)
    except Exception as error:
        known = ", ".join(d.alias for d in wp.get_devices())
        raise InputError(f"device {device!r} is not on this machine; it has: {known}") from error


def present_device(alias: str, what: str) -> Any:
    """Return the device that something lay on when it was pickled, or the CPU with a ``UserWarning``."""
    start_warp()
    if alias in [device.alias for device in wp.get_devices()]:
        return wp.get_device(alias)
    text = f"{what} was pickled on {alias!r}, which this machine does not have; it lies on the CPU now"
    warn(text)
    return wp.get_device("cpu")


def available_memory(device: Any = "cpu") -> int | None:
    """Return the memory in bytes that can be had on a device now, or None where the system does not tell."""
    device = resolve_device(device)
    if device.is_cuda:
        # What has been freed stays in the pool, and counts as taken, until the device has been waited for.
        wp.synchronize_device(device)
        return int(device.free_memory)
    known = []
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        known += [1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
        group = Path("/sys/fs/cgroup")
        limit, used = (group / "memory.max").read_text(), (group / "memory.current").read_text()
        known += [int(limit) - int(used)] if limit.strip() != "max" else []
    except (OSError, ValueError):
        pass
    return min(known, default=None)


def require_memory(shape: Sequence[int], bytes_per_cell: int, device: Any = "cpu", what: str = "a terrain") -> None:
    """Raise ``MemoryError`` if a raster of that shape cannot fit; call it before anything is allocated.

    Args:
        shape: Rows and columns.
        bytes_per_cell: All that will be alive at a time, divided by the cells.
        device: Where it is to lie.
        what: The thing, for the message.
    """
    need, free = math.prod(int(n) for n in shape) * bytes_per_cell, available_memory(device)
    if free is not None and need > free:
        raise OutOfMemoryError(
            f"{what} of {shape[0]} x {shape[1]} cells needs {need / 1e9:.3g} GB and {free / 1e9:.3g} GB are free on "
            f"{resolve_device(device).alias}; use a coarser cell size or a part of it"
        )
