"""Devices: the one that a name means, the precisions there are, and whether something fits into its memory."""

from __future__ import annotations

import logging
import math
import os
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpriver.errors import InputError, OutOfMemoryError, PathError

__all__ = ["PRECISIONS", "available_memory", "present_device", "require_memory", "resolve_device", "start_warp"]

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


def start_warp() -> None:
    """Start Warp, or raise ``OSError`` that says how to let it keep its kernels."""
    try:
        wp.init()
    except OSError as error:
        raise PathError.of(
            error, "Warp cannot keep its kernels; set WARP_CACHE_PATH to a folder that can be written"
        ) from error


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
    if alias in [device.alias for device in wp.get_devices()]:
        return wp.get_device(alias)
    text = f"{what} was pickled on {alias!r}, which this machine does not have; it lies on the CPU now"
    warnings.warn(text, UserWarning, stacklevel=3)
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
