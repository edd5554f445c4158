"""What several commands share: exit codes, flags, files, and a quiet start of Warp."""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.errors import InputError

if TYPE_CHECKING:
    from warpriver.network import RiverNetwork
    from warpriver.terrain import Terrain

__all__ = [
    "BAD_INPUT",
    "INTERRUPTED",
    "OK",
    "STOPPED_EARLY",
    "add_ground",
    "add_heights",
    "add_line_options",
    "add_lines",
    "can_draw",
    "command",
    "fresh_folder",
    "quiet_warp",
    "read_ground",
    "read_lines",
    "stored_run",
]

OK, STOPPED_EARLY, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], **texts: str
) -> argparse.ArgumentParser:
    """Add a command's parser; ``run`` takes its flags and returns the exit code."""
    parser = commands.add_parser(name, formatter_class=argparse.RawDescriptionHelpFormatter, **texts)
    parser.set_defaults(command=run, name=name)
    return parser


def can_draw() -> bool:
    """Tell whether pictures can be drawn on this machine; that they cannot is said, and is no failure."""
    if importlib.util.find_spec("matplotlib") is not None:
        return True
    print('  no pictures: matplotlib is missing; pip install "warpriver[viz]"')
    return False


def read_lines(source: Path, options: argparse.Namespace, **further: Any) -> RiverNetwork:
    """Read rivers as the flags say, and as ``further`` arguments of ``read_network`` do."""
    from warpriver.io.vector.networks import read_network

    return read_network(
        source,
        width=options.width,
        layer=options.layer,
        short=options.short,
        closed=options.closed or None,
        crs=options.crs,
        to_crs=options.to_crs,
        **further,
    )


def add_heights(parser: Any) -> None:
    """Flags of every command that reads heights from a file."""
    parser.add_argument(
        "--z-factor", type=float, metavar="M", help="metres in the file's unit of height, 0.3048 for feet (default 1)"
    )
    parser.add_argument(
        "--nodata", type=float, metavar="H", help="height that stands for no data, besides what the file says"
    )


def add_ground(parser: argparse.ArgumentParser) -> None:
    """Flags of a command that takes a terrain beside rivers."""
    parser.add_argument("--terrain-crs", metavar="CRS", help="coordinate reference system of a --terrain without one")
    add_heights(parser)


def read_ground(path: str, crs: str | None, options: argparse.Namespace, device: str = "cpu") -> Terrain:
    """Read a terrain as the flags say."""
    from warpriver.io.raster.terrains import read_terrain

    return read_terrain(
        path, crs=crs, to_crs=options.to_crs, z_factor=options.z_factor, nodata=options.nodata, device=device
    )


def add_line_options(parser: argparse.ArgumentParser) -> None:
    """Flags of a command that reads rivers from a file."""
    parser.add_argument(
        "--short",
        default="error",
        choices=("error", "drop", "narrow", "keep"),
        help="lines shorter than they are wide, as linework has at junctions: refuse the file, drop them, narrow them "
        "to their length, or keep them (default error)",
    )
    parser.add_argument(
        "--closed",
        action="store_true",
        help="lines that end at their first point are rings: the water goes round (default: those that the file marks)",
    )


def add_lines(parser: argparse.ArgumentParser) -> None:
    """Flags of a command that only looks at rivers: all that :func:`read_lines` asks for."""
    parser.add_argument("--width", type=float, metavar="M", help="bankfull width in m of lines that have none")
    parser.add_argument("--layer", help="layer to read, of a file with several")
    add_line_options(parser)
    parser.add_argument("--crs", help="coordinate reference system of a file that does not say")
    parser.add_argument("--to-crs", help='reproject lines, e.g. "utm"')


def stored_run(source: Path) -> Path | None:
    """The stored run at a path: the file or folder itself, or the one in a folder of results; None without one."""
    if source.suffix == ".npz":
        return source
    return next((p for p in (source, source / "run") if (p / "run.json").is_file()), None)


def fresh_folder(path: str) -> Path:
    """Make the folder for results; one that holds an earlier run is not written over."""
    folder = Path(path)
    if (folder / "run").exists():
        raise InputError(f"{folder} holds an earlier run; remove it, choose another -o, or continue {folder / 'run'}")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def quiet_warp() -> None:
    """Start Warp, and let it tell of errors only."""
    import warp as wp

    from warpriver.device import start_warp

    wp.config.log_level = wp.LOG_ERROR
    start_warp()
