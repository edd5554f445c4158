"""What several commands share: exit codes, flags, files, and a quiet start of Warp."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.words import renamed
from warpriver.errors import InputError

if TYPE_CHECKING:
    from warpriver.history import History
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
    "ground_under",
    "quiet_warp",
    "read_ground",
    "read_lines",
    "read_run",
    "stored_run",
]

OK, STOPPED_EARLY, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], **texts: str
) -> argparse.ArgumentParser:
    """Add a command's parser; ``run`` takes its flags and returns the exit code."""
    parser = commands.add_parser(name, formatter_class=argparse.RawDescriptionHelpFormatter, **texts)
    parser.set_defaults(command=run, name=name, parser=parser)
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
        missing_width=options.missing_width,
        short=options.short,
        repeated=options.repeated,
        topology=options.topology,
        reverse=options.reverse,
        closed=options.closed or None,
        crs=options.crs,
        to_crs=options.to_crs,
        **further,
    )


def add_heights(parser: Any, *, cell_size: bool = True) -> None:
    """Flags of every command that reads heights from a file; ``cell_size``: also that, where it means nothing else."""
    parser.add_argument(
        "--z-factor", type=float, metavar="M", help="metres in the file's unit of height, 0.3048 for feet (default 1)"
    )
    parser.add_argument(
        "--nodata",
        type=float,
        metavar="H",
        help='height that stands for no data, besides what the file says, as it is stored there; "nan" for no other',
    )
    if cell_size:
        parser.add_argument(
            "--cell-size", type=float, metavar="M", help="cell in m of a file that does not tell it; or to resample to"
        )
    parser.add_argument(
        "--origin",
        type=float,
        nargs=2,
        metavar=("W", "N"),
        help="north-west corner in m of a file that does not tell it",
    )
    parser.add_argument(
        "--range", type=float, nargs=2, metavar=("LOW", "HIGH"), help="lowest and highest height of a height map in m"
    )
    parser.add_argument("--shape", type=int, nargs=2, metavar=("ROWS", "COLUMNS"), help="size of a raw height map")
    parser.add_argument("--band", type=int, default=1, metavar="N", help="band of a GeoTIFF (default 1)")


def add_ground(parser: argparse.ArgumentParser) -> None:
    """Flags of a command that takes a terrain beside rivers."""
    parser.add_argument("--terrain-crs", metavar="CRS", help="coordinate reference system of a --terrain without one")
    add_heights(parser)


def read_ground(path: str, options: argparse.Namespace, *, to_crs: str | None = None, device: str = "cpu") -> Terrain:
    """Read a terrain as the flags say; ``to_crs`` in place of theirs is that of the rivers on it."""
    from warpriver.io.raster.terrains import read_terrain

    beside_rivers = hasattr(options, "terrain_crs")
    with renamed(crs="terrain_crs") if beside_rivers else contextlib.nullcontext():
        return read_terrain(
            path,
            cell_size=options.cell_size,
            origin=options.origin,
            crs=options.terrain_crs if beside_rivers else options.crs,
            to_crs=to_crs or options.to_crs,
            range=options.range,
            z_factor=options.z_factor,
            nodata=options.nodata,
            shape=options.shape,
            band=options.band,
            device=device,
        )


def ground_under(options: argparse.Namespace, crs: str | None) -> Terrain | None:
    """Read the terrain under rivers in that CRS, if there is to be one.

    Where --to-crs is given it is brought into the CRS of the rivers: "utm" means one zone for both.
    """
    if options.terrain is None:
        return None
    return read_ground(options.terrain, options, to_crs=crs if options.to_crs is not None else None)


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
        "--missing-width", type=float, metavar="M", help="width in m of lines for which nothing tells one"
    )
    parser.add_argument(
        "--repeated",
        default="drop",
        choices=("drop", "error"),
        help="points that stand twice in a row: drop them, or refuse the file (default drop)",
    )
    parser.add_argument(
        "--topology",
        default="file",
        choices=("file", "ends"),
        help="join lines as the file says, or where their ends meet (default file)",
    )
    parser.add_argument("--reverse", action="store_true", help="turn all lines round: those of the file run upstream")
    parser.add_argument(
        "--closed",
        action="store_true",
        help="lines that end at their first point are rings: the water goes round (default: those that the file marks)",
    )


def add_lines(parser: argparse.ArgumentParser) -> None:
    """Flags of a command that only looks at rivers: all that :func:`read_lines` asks for."""
    parser.add_argument(
        "--width", type=float, metavar="M", help="bankfull width in m of all lines (default: the file's)"
    )
    parser.add_argument("--layer", help="layer to read, of a file with several")
    add_line_options(parser)
    parser.add_argument("--crs", help="coordinate reference system of a file that does not say")
    parser.add_argument("--to-crs", help='reproject lines, e.g. "utm"')


def stored_run(source: Path) -> Path | None:
    """The stored run at a path: the file or folder itself, or the one in a folder of results; None without one."""
    if source.suffix == ".npz":
        return source
    marks = ("run.json", "segments.jsonl")
    return next((p for p in (source, source / "run") for mark in marks if (p / mark).is_file()), None)


def read_run(path: Path) -> History:
    """Open a stored run that holds a record or more."""
    from warpriver.history import History

    history = History.load(path)
    history.record(-1)
    return history


def fresh_folder(path: str) -> Path:
    """Make the folder for results; one that holds an earlier run is not written over."""
    folder = Path(path)
    if (folder / "run").exists():
        raise InputError(f"{folder} holds an earlier run; remove it, choose another -o, or continue {folder / 'run'}")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def quiet_warp() -> None:
    """Start Warp without its greeting, and without its native warning where a machine has no CUDA driver."""
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        said.seek(0)
        for line in said.read().decode(errors="replace").splitlines():
            if "CUDA driver" not in line:
                print(line, file=sys.stderr)
