"""``warpriver info``: this machine, or what a file holds."""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver import __version__
from warpriver.cli.files import kind_of
from warpriver.cli.output import say
from warpriver.cli.shared import OK, add_heights, add_lines, command, quiet_warp, read_run, stored_run
from warpriver.errors import WarpriverError

if TYPE_CHECKING:
    from warpriver.network import RiverNetwork

__all__ = ["add", "describe_device", "describe_gpus"]

EXTRAS = {
    "viz": ("matplotlib", "pyvista"),
    "movie": ("imageio_ffmpeg",),
    "gis": ("pyogrio", "geopandas", "shapely", "pyproj", "rasterio", "xarray"),
    "bench": ("meanderpy", "h5py", "numba"),
}
# The oldest driver that runs what is built with a version of CUDA. Wheels of warp-lang from 1.18 on are built with 13.
DRIVERS = {12: "driver R525", 13: "driver R580"}
# The oldest GPU that the compiler of CUDA 13 and later serves: Turing.
OLDEST_ARCH = 75
# Where Warp's builds for other versions of CUDA are.
BUILDS = "https://github.com/NVIDIA/warp/releases"


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "info",
        _info,
        help="what this installation can do, or what a file holds",
        description="Without FILE: versions, devices, optional parts, and whether 3-D previews can be drawn.\n"
        "With FILE: what the run, the lines, the terrain or raster, the valley file or the scene holds. A file in\n"
        "degrees is shown in its UTM zone, one without widths without them.",
        epilog="examples:\n"
        "  warpriver info\n"
        "  warpriver info rivers.gpkg\n"
        "  warpriver info dem.tif\n"
        "  warpriver info out/river/run",
    )
    parser.add_argument(
        "file", nargs="?", metavar="FILE", help="a run, river lines, a terrain or raster, a valley file, a scene"
    )
    parser.add_argument(
        "--allow",
        action="append",
        metavar="FOLDER",
        help="of a scene: it may also name files of this folder, beside those of its own; may be given again",
    )
    add_lines(parser)
    add_heights(parser.add_argument_group("terrain or raster"))


def _info(options: argparse.Namespace) -> int:
    quiet_warp()
    if options.file is not None:
        return _info_file(options)
    import numpy
    import scipy
    import warp as wp

    wp.init()
    say(f"warpriver {__version__}, Warp {wp.__version__}, NumPy {numpy.__version__}, SciPy {scipy.__version__}")
    devices, driver, toolkit = wp.get_devices(), wp.get_cuda_driver_version(), wp.get_cuda_toolkit_version()
    for device in devices:
        say(f"device {device.alias}: {describe_device(device)}")
    say(f"CUDA: driver {_version(driver)}, toolkit of Warp {_version(toolkit)}")
    for line in describe_gpus(devices, driver, toolkit):
        say(f"GPU: {line}")
    for extra, modules in EXTRAS.items():
        missing = [m for m in modules if importlib.util.find_spec(m) is None]
        state = "installed" if not missing else f'not installed (pip install "warpriver[{extra}]")'
        say(f"extra {extra}: {state}")
    if importlib.util.find_spec("pyvista") is not None:
        from warpriver import viz

        probe = viz.gl.probe()
        say(f"3-D previews: {'yes' if probe.ok else probe.message}")
    return OK


def describe_device(device: Any) -> str:
    """Name of a Warp device; of a GPU also its architecture, its memory, and whether that is given out from a pool."""
    if not device.is_cuda:
        return str(device.name)
    total, free = device.total_memory / 2**30, device.free_memory / 2**30
    pool = "memory pool" if device.is_mempool_supported else "no memory pool"
    return f"{device.name}, sm_{device.arch}, {total:.0f} GiB, {free:.0f} free, {pool}"


def describe_gpus(devices: Sequence[Any], driver: tuple[int, int] | None, toolkit: tuple[int, int] | None) -> list[str]:
    """Say what each GPU will and will not do; where none will do anything, in one line why, and what to do.

    Args:
        devices: Warp devices.
        driver: Version of CUDA that the installed driver is made for, None where there is no driver.
        toolkit: Version of CUDA that Warp is built with, None where it is built without.
    """
    gpus = [device for device in devices if device.is_cuda]
    if gpus:
        return [_describe_gpu(device, toolkit) for device in gpus]
    on_cpu = "warpriver runs on the CPU"
    if toolkit is None:
        return [f"{on_cpu}: this build of Warp has no CUDA"]
    if driver is None:
        return [f"{on_cpu}: no NVIDIA driver was found"]
    # A driver serves all of its major version.
    if driver[0] < toolkit[0]:
        needed = DRIVERS.get(toolkit[0], f"a driver for CUDA {toolkit[0]}.0")
        return [
            f"{on_cpu}: the driver is for CUDA {_version(driver)}, Warp is built with {_version(toolkit)} and needs "
            f"{needed} or newer; update it, or install a build of Warp for CUDA {driver[0]} ({BUILDS})"
        ]
    return [f"{on_cpu}: there is a driver but no GPU to be seen; is CUDA_VISIBLE_DEVICES set?"]


def _describe_gpu(device: Any, toolkit: tuple[int, int] | None) -> str:
    if toolkit is not None and toolkit >= (13, 0) and device.arch < OLDEST_ARCH:
        return (
            f"{device.alias} is too old (sm_{device.arch}): CUDA {toolkit[0]}, which Warp is built with, is for Turing "
            f'(sm_{OLDEST_ARCH}) and newer; install a build of Warp for CUDA 12 ({BUILDS}), or give device="cpu"'
        )
    if not device.is_mempool_supported:
        return (
            f"{device.alias} has no memory pool, so that steps cannot be recorded: give Simulation(capture=False), "
            "for which each kernel is launched by itself and each sub-step looked at. Is nvidia_uvm loaded?"
        )
    return (
        f"{device.alias} runs steps of rivers, erosion in batches, valleys and terrain; "
        "routing and extraction, and the joining of channels, run on the CPU"
    )


def _version(version: tuple[int, int] | None) -> str:
    return "none" if version is None else f"{version[0]}.{version[1]}"


def _attempts(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """How to look at a file: as the flags say, then with what it lacks, so that it can be looked at."""
    systems: list[dict[str, Any]] = [{}]
    if options.to_crs is None:
        systems.append({"to_crs": "utm"})
        if options.crs is None:
            systems.append({"crs": "EPSG:4326", "to_crs": "utm"})
    for width in ({}, {"missing_width": 1.0}) if options.width is None else ({},):
        for system in systems:
            yield {**width, **system}


def _look(read: Callable[[argparse.Namespace], Any], options: argparse.Namespace, names: Sequence[str]) -> Any:
    """Read a file, if need be with what it does not say itself; return it, and what was added.

    Raises:
        WarpriverError: It cannot be read in any way: why not as the flags say.
    """
    first: WarpriverError | None = None
    for added in _attempts(options):
        if not set(added) <= set(names):
            continue
        try:
            return read(argparse.Namespace(**{**vars(options), **added})), added
        except WarpriverError as error:
            first = first or error
    assert first is not None
    raise first


def _told(added: dict[str, Any], crs: str | None) -> list[str]:
    """What was added to look at a file, as notes."""
    notes = []
    if "to_crs" in added:
        stated = "is in longitude and latitude, or another unit than metres"
        notes.append(
            f"note: the file {stated}; what follows is in {crs}: give --to-crs utm, or another system, to use it"
        )
    if "missing_width" in added:
        notes.append(
            "note: the file has lines without a width, or anything that it follows from, here as if 1 m wide: give "
            "--width or --missing-width to use it"
        )
    return notes


def _info_file(options: argparse.Namespace) -> int:
    source = Path(options.file)
    kind = kind_of(source)
    tell = {"run": _tell_run, "lines": _tell_lines, "scene": _tell_scene, "valley": _tell_valley}.get(kind, _tell_cells)
    for line in tell(source, options):
        say(line)
    return OK


def _tell_run(source: Path, options: argparse.Namespace) -> list[str]:
    from warpriver.history import GroundChange, ParameterChange

    run = stored_run(source)
    assert run is not None
    history = read_run(run)
    told = [repr(history)]
    ground = history.last_ground
    if ground is not None:
        told.append(f"terrain: {ground.about}{', ' + ground.path if ground.path else ''}")
    for event in history.events.of(ParameterChange, GroundChange):
        told.append(f"at {event.time:.4g} yr: {event}")
    return told + _tell_network(history.networks[-1])


def _tell_lines(source: Path, options: argparse.Namespace) -> list[str]:
    from warpriver.cli.shared import read_lines

    options.short = options.short or "keep"
    network, added = _look(lambda given: read_lines(source, given), options, ("missing_width", "crs", "to_crs"))
    return _told(added, network.crs) + _tell_network(network, wide="missing_width" not in added)


def _tell_cells(source: Path, options: argparse.Namespace) -> list[str]:
    import numpy as np

    raster, added = _look(lambda given: _read_cells(source, given), options, ("crs", "to_crs"))
    values = raster.numpy()
    known = values[np.isfinite(values)] if values.dtype.kind == "f" else values.ravel()
    west, south, east, north = raster.bounds
    unit = f" {raster.unit}" if raster.unit else ""
    told = [*_told(added, raster.crs), repr(raster)]
    told.append(f"west {west:.1f}, south {south:.1f}, east {east:.1f}, north {north:.1f} m")
    low, middle, high = np.quantile(known, (0.05, 0.5, 0.95)) if known.size else (np.nan,) * 3
    told.append(f"5 % below {low:.6g}{unit}, half below {middle:.6g}{unit}, 95 % below {high:.6g}{unit}")
    return told


def _read_cells(source: Path, options: argparse.Namespace) -> Any:
    """Read a terrain as its raster, or any other raster."""
    from warpriver.cli.shared import read_ground
    from warpriver.io.raster.terrains import read_raster

    if kind_of(source) == "terrain":
        return read_ground(source, options).raster
    return read_raster(source, crs=options.crs, to_crs=options.to_crs, nodata=options.nodata, band=options.band or 1)


def _tell_scene(source: Path, options: argparse.Namespace) -> list[str]:
    from warpriver.scenes import describe_scene, read_scene

    return describe_scene(read_scene(source, folders=options.allow or ())).splitlines()


def _tell_valley(source: Path, options: argparse.Namespace) -> list[str]:
    from warpriver.io.valleys import read_valley
    from warpriver.valley.valley import synthetic_valley

    valley = synthetic_valley(read_valley(source))
    params = valley.params
    return [
        repr(valley),
        f"bankfull width {params.width:.4g} m, bankfull depth {valley.bankfull_depth:.4g} m, sinuosity "
        f"{valley.sinuosity:.4g}, slope {params.slope:.4g} m/m",
        f"width to depth {params.width_to_depth:.4g}, confinement {params.confinement:.4g}",
    ]


def _tell_network(network: RiverNetwork, wide: bool = True) -> list[str]:
    from warpriver import metrics

    west, south, east, north = network.bounds()
    told = [repr(network), f"west {west:.1f}, south {south:.1f}, east {east:.1f}, north {north:.1f} m"]
    told.append(_attribute_summary(network, wide))
    lines, lengths = network.polylines(), network.channel_lengths()
    for c in lengths.argsort()[::-1][:10]:
        sinuosity = metrics.sinuosity(lines[c], bool(network.channel_closed[c]))
        section = f"width {network.channel_width[c]:.4g} m, depth {network.channel_depth[c]:.3g} m, " if wide else ""
        told.append(
            f"channel {c}: {lengths[c] / 1e3:.4g} km, {len(lines[c])} points, {section}sinuosity {sinuosity:.3g}"
        )
    if network.channel_count > 10:
        told.append(f"... and {network.channel_count - 10} shorter ones")
    return told


def _attribute_summary(network: RiverNetwork, wide: bool) -> str:
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
    if wide:
        parts.append(f"bankfull discharge {span(network.channel_discharge, 'm3/s')}")
    area = network.channel_drainage_area
    if area is not None and np.isfinite(area).any():
        parts.append(f"drainage area {span(area[np.isfinite(area)] / 1e6, 'km2')}")
    known = network.channel_slope[np.isfinite(network.channel_slope)]
    if len(known):
        some = "" if len(known) == network.channel_count else f" in {len(known)} channels"
        parts.append(f"slope {span(known, 'm/m')}{some}")
    return ", ".join(parts)
