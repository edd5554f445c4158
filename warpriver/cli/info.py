"""``warpriver info``: this machine, or what a file holds."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver import __version__
from warpriver.cli.shared import OK, add_lines, command, quiet_warp, read_lines, stored_run

if TYPE_CHECKING:
    from warpriver.network import RiverNetwork

__all__ = ["add"]

EXTRAS = {
    "viz": ("matplotlib", "pyvista"),
    "movie": ("imageio_ffmpeg",),
    "gis": ("pyogrio", "geopandas", "shapely", "pyproj", "rasterio", "xarray"),
    "bench": ("meanderpy", "h5py", "numba"),
}


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "info",
        _info,
        help="what this installation can do, or what a file holds",
        description="Without FILE: versions, devices, optional parts, and whether 3-D previews can be drawn.\n"
        "With FILE: what the run or the lines hold.",
    )
    parser.add_argument("file", nargs="?", metavar="FILE", help="a run or river lines")
    add_lines(parser)


def _info(options: argparse.Namespace) -> int:
    quiet_warp()
    if options.file is not None:
        return _info_file(options)
    import numpy
    import scipy
    import warp as wp

    wp.init()
    print(f"warpriver {__version__}, Warp {wp.__version__}, NumPy {numpy.__version__}, SciPy {scipy.__version__}")
    for device in wp.get_devices():
        memory = f", {device.total_memory / 2**30:.0f} GiB" if device.is_cuda else ""
        print(f"device {device.alias}: {device.name}{memory}")
    for extra, modules in EXTRAS.items():
        missing = [m for m in modules if importlib.util.find_spec(m) is None]
        state = "installed" if not missing else f'not installed (pip install "warpriver[{extra}]")'
        print(f"extra {extra}: {state}")
    if importlib.util.find_spec("pyvista") is not None:
        from warpriver import viz

        probe = viz.gl.probe()
        print(f"3-D previews: {'yes' if probe.ok else probe.message}")
    return OK


def _info_file(options: argparse.Namespace) -> int:
    from warpriver import metrics
    from warpriver.history import History

    source = Path(options.file)
    run = stored_run(source)
    if run is not None:
        history = History.load(run)
        print(history)
        network = history.networks[-1]
    else:
        network = read_lines(source, options)
    print(network)
    west, south, east, north = network.bounds()
    print(f"west {west:.1f}, south {south:.1f}, east {east:.1f}, north {north:.1f} m")
    print(_attribute_summary(network))
    lines, lengths = network.polylines(), network.channel_lengths()
    for c in lengths.argsort()[::-1][:10]:
        sinuosity = metrics.sinuosity(lines[c], bool(network.channel_closed[c]))
        print(
            f"channel {c}: {lengths[c] / 1e3:.4g} km, {len(lines[c])} points, width {network.channel_width[c]:.4g} m, "
            f"depth {network.channel_depth[c]:.3g} m, sinuosity {sinuosity:.3g}"
        )
    if network.channel_count > 10:
        print(f"... and {network.channel_count - 10} shorter ones")
    return OK


def _attribute_summary(network: RiverNetwork) -> str:
    """Say from where to where the attributes of the channels go, of those that are known."""
    import numpy as np

    from warpriver import hydrology

    def span(values: np.ndarray, unit: str) -> str:
        low, high = f"{values.min():.3g}", f"{values.max():.3g}"
        return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"

    outlets = int((~np.isin(network.channel_to, network.channel_from)).sum())
    parts = [f"{outlets} outlet{'s' * (outlets != 1)}"]
    try:
        order = hydrology.strahler_order(network.channel_from, network.channel_to)
        parts.append(f"Strahler order 1 to {order.max()}")
    except ValueError as error:
        parts.append(f"no stream orders ({error})")
    parts.append(f"discharge {span(network.channel_discharge, 'm3/s')}")
    if network.channel_drainage_area is not None:
        parts.append(f"drainage area {span(network.channel_drainage_area / 1e6, 'km2')}")
    known = network.channel_slope[np.isfinite(network.channel_slope)]
    if len(known):
        some = "" if len(known) == network.channel_count else f" in {len(known)} channels"
        parts.append(f"slope {span(known, 'm/m')}{some}")
    return ", ".join(parts)
