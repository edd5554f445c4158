"""What figures were measured on, as every result file says it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import warp as wp

import warpriver as wr


def machine(device: str, peers: Iterable[str] = ()) -> dict:
    """Processor, versions and commit.

    Args:
        device: Warp device name.
        peers: Distributions whose versions matter; None stands for one that is not installed.
    """
    processor = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [row.split(":", 1)[1].strip() for row in info.read_text().splitlines() if row.startswith("model name")]
        processor = names[0] if names else processor
    done = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    versions = {}
    for peer in peers:
        try:
            versions[peer] = importlib.metadata.version(peer)
        except importlib.metadata.PackageNotFoundError:
            versions[peer] = None
    return {
        "processor": processor,
        "cores": os.cpu_count(),
        "device": wp.get_device(device).name,
        "python": platform.python_version(),
        "warpriver": wr.__version__,
        "warp": wp.__version__,
        "numpy": np.__version__,
        "commit": done.stdout.strip() or None,
        "peers": versions,
    }
