"""What several commands share: exit codes, flags, what files hold, and checks of what is to be written."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.output import say
from warpriver.cli.parser import BAD_INPUT, number, whole_number
from warpriver.cli.words import naming
from warpriver.errors import (
    InputError,
    MissingExtraError,
    MissingFileError,
    OutputExistsError,
    PathDeniedError,
    WrongPathError,
)

if TYPE_CHECKING:
    from warpriver.history import History
    from warpriver.network import RiverNetwork
    from warpriver.terrain import Terrain

__all__ = [
    "BAD_INPUT",
    "INTERRUPTED",
    "MOVIES",
    "OK",
    "PICTURES",
    "STOPPED_EARLY",
    "add_heights",
    "add_line_options",
    "add_lines",
    "add_systems",
    "add_terrain",
    "can_draw",
    "check_out",
    "check_picture",
    "command",
    "ending_of",
    "fresh_folder",
    "given_flags",
    "ground_under",
    "quiet_warp",
    "read_ground",
    "read_lines",
    "read_run",
    "results_in",
    "stored_run",
]

OK, STOPPED_EARLY, INTERRUPTED = 0, 1, 130
PICTURES, MOVIES = (".png", ".jpg", ".pdf", ".svg"), (".gif", ".mp4")
# Flags that only say how lines are read, and those that only say how a terrain is read.
LINE_FLAGS = (
    "width", "depth", "missing_width", "layer", "short", "repeated", "closed", "topology", "reverse", "crs",
)  # fmt: skip
HEIGHT_FLAGS = ("terrain_crs", "z_factor", "nodata", "band", "cell_size", "range", "shape", "origin")


def command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], **texts: str
) -> argparse.ArgumentParser:
    """Add a command's parser; ``run`` takes its flags and returns the exit code."""
    parser: argparse.ArgumentParser = commands.add_parser(name, **texts)
    parser.set_defaults(command=run, name=name, parser=parser)
    return parser


def given_flags(options: argparse.Namespace, names: Iterable[str]) -> list[str]:
    """Return which of the flags of these names were typed, of those whose default is None or False."""
    values = vars(options)
    return [f"--{n.replace('_', '-')}" for n in names if values.get(n) is not None and values[n] is not False]


# ---- what is written


def can_draw() -> bool:
    """Tell whether pictures can be drawn on this machine; that they cannot is said, and is no failure."""
    if importlib.util.find_spec("matplotlib") is not None:
        return True
    say('  no pictures: matplotlib is missing; pip install "warpriver[viz]"')
    return False


def ending_of(path: Path, known: Iterable[str]) -> str:
    """Return the ending of a name that says the format: .gpkg, or .csv of rivers.csv.gz."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if suffixes[-1:] == [".gz"] and ".gz" not in known:
        suffixes.pop()
    return suffixes[-1] if suffixes else ""


def check_out(path: str | Path, flag: str, formats: Mapping[str, bool] | Iterable[str]) -> Path:
    """Return the path of a file to write, or raise an error before anything has been computed for it.

    Args:
        path: What was typed.
        flag: The flag that it was typed for.
        formats: Endings of the formats there are, and whether what they need is installed.
    """
    target = Path(path)
    known = formats if isinstance(formats, Mapping) else dict.fromkeys(formats, True)
    ending = ending_of(target, known)
    if ending not in known:
        raise InputError(
            f"{flag} {target}: {ending or 'no ending'} names no format of what is to be written; use {', '.join(known)}"
        )
    if not known[ending]:
        raise MissingExtraError(f'{flag} {target}: {ending} needs the extra "gis": pip install "warpriver[gis]"')
    if target.is_dir():
        raise WrongPathError(f"{flag} {target} is a folder; give the name of a file")
    if not target.absolute().parent.is_dir():
        raise MissingFileError(f"{flag} {target}: there is no folder {target.parent}; make it first")
    if not os.access(target.absolute().parent, os.W_OK | os.X_OK):
        raise PathDeniedError(f"{flag} {target}: the folder {target.parent} is not yours to write in")
    return target


def check_picture(path: str | Path, flag: str, formats: Iterable[str] = PICTURES) -> Path:
    """Return the path of a picture or movie to write, as :func:`check_out` does, if this machine can draw it."""
    target = check_out(path, flag, formats)
    if importlib.util.find_spec("matplotlib") is None:
        raise MissingExtraError(f'{flag} {target}: pictures need matplotlib: pip install "warpriver[viz]"')
    if target.suffix.lower() == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise MissingExtraError(f'{flag} {target}: .mp4 needs imageio-ffmpeg: pip install "warpriver[movie]"')
    return target


def fresh_folder(path: str | Path, *names: str, flag: str = "-o", make: bool = True) -> Path:
    """Return the folder for results, and make it; one that holds such results already is refused.

    Args:
        path: The folder.
        names: Files and folders that will be written into it.
        flag: The flag that names it.
        make: Make it now; else it is only checked.
    """
    folder = Path(path)
    there = next((name for name in names if (folder / name).exists()), None)
    if there is not None:
        again = f", or continue {folder / there}" if there == "run" else ""
        raise OutputExistsError(f"{folder} holds an earlier {there}; remove it, or choose another {flag}{again}")
    above = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    if not above.is_dir():
        raise WrongPathError(f"{flag} {folder}: {above} is a file; give the name of a folder")
    if make:
        folder.mkdir(parents=True, exist_ok=True)
    return folder


# ---- rivers


def add_line_options(parser: Any) -> None:
    """Flags of a command that reads rivers from a file."""
    parser.add_argument("--layer", help="layer to read, of a file with several")
    parser.add_argument(
        "--short",
        choices=("error", "drop", "narrow", "keep"),
        help="what to do about lines that are shorter than they are wide, as linework has at junctions: refuse the "
        "file, drop them, narrow them to their length, or keep them (default error)",
    )
    parser.add_argument(
        "--closed",
        action="store_true",
        help="lines that end at their first point are rings, in which the water goes round (default: those that the "
        "file marks)",
    )
    parser.add_argument(
        "--missing-width",
        type=number(above=0.0, unit="m"),
        metavar="M",
        help="width in m of lines that have neither a width nor anything that it follows from",
    )
    parser.add_argument(
        "--repeated",
        choices=("drop", "error"),
        help="what to do about points that are repeated: drop them, or refuse the file (default drop)",
    )
    parser.add_argument(
        "--topology",
        choices=("file", "ends"),
        help="join channels as the file says, or only where their ends meet (default file)",
    )
    parser.add_argument("--reverse", action="store_true", help="reverse all lines: points of the file run upstream")


def add_systems(parser: Any, what: str) -> None:
    """Flags for coordinate reference systems."""
    parser.add_argument("--crs", help=f"coordinate reference system of {what} that states none, e.g. EPSG:32619")
    parser.add_argument(
        "--to-crs", metavar="CRS", help='reproject, e.g. to EPSG:32619, or "utm" for the UTM zone of the data'
    )


def add_lines(parser: argparse.ArgumentParser) -> None:
    """Flags of a command that only looks at rivers: all that :func:`read_lines` asks for."""
    group = parser.add_argument_group("river lines")
    group.add_argument(
        "--width", type=number(above=0.0, unit="m"), metavar="M", help="bankfull width in m (default: the file's)"
    )
    add_line_options(group)
    add_systems(group, "a file")


def read_lines(source: Path, options: argparse.Namespace, **further: Any) -> RiverNetwork:
    """Read rivers as the flags say, and as ``further`` arguments of ``read_network`` do."""
    from warpriver.io.vector.networks import read_network

    return read_network(
        source,
        width=options.width,
        missing_width=options.missing_width,
        layer=options.layer,
        short=options.short or "error",
        repeated=options.repeated or "drop",
        topology=options.topology or "file",
        reverse=options.reverse,
        closed=options.closed or None,
        crs=options.crs,
        to_crs=options.to_crs,
        **further,
    )


# ---- terrains


def add_heights(parser: Any, cell_size: bool = True) -> None:
    """Flags of every command that reads a terrain from a file."""
    parser.add_argument(
        "--z-factor",
        type=number(above=0.0),
        metavar="M",
        help="metres in the file's unit of height, 0.3048 for feet (default: by the unit that it states, else 1)",
    )
    parser.add_argument(
        "--nodata",
        type=float,
        metavar="H",
        help='height that stands for no data, besides what the file says, as it is stored there; "nan" for no other',
    )
    if cell_size:
        parser.add_argument(
            "--cell-size",
            type=number(above=0.0, unit="m"),
            metavar="M",
            help="size of a cell in m: of a file that does not state it; else heights are resampled to it",
        )
    parser.add_argument("--band", type=whole_number(1), metavar="N", help="band of a raster with several (default 1)")
    parser.add_argument(
        "--range",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="heights in m of the lowest and the highest step of a height map (.png, .r16, .raw)",
    )
    parser.add_argument(
        "--shape", type=whole_number(1), nargs=2, metavar=("ROWS", "COLUMNS"), help="size of a raw height map"
    )
    parser.add_argument(
        "--origin",
        type=float,
        nargs=2,
        metavar=("WEST", "NORTH"),
        help="corner in the north-west in m, of a file that does not state it (default 0 0)",
    )


def add_terrain(parser: argparse.ArgumentParser, what: str) -> Any:
    """Flags of a command that takes a terrain beside rivers; return their group."""
    group = parser.add_argument_group("terrain")
    group.add_argument("--terrain", metavar="FILE", help=what)
    group.add_argument(
        "--terrain-crs", metavar="CRS", help="coordinate reference system of a --terrain that states none"
    )
    add_heights(group)
    return group


def read_ground(
    path: str | Path, options: argparse.Namespace, *, to_crs: str | None = None, device: str = "cpu"
) -> Terrain:
    """Read a terrain as the flags say; ``to_crs`` in place of theirs is that of the rivers on it."""
    from warpriver.io.raster.terrains import read_terrain

    beside_rivers = hasattr(options, "terrain_crs")
    with naming(**({"crs": "--terrain-crs"} if beside_rivers else {})):
        return read_terrain(
            path,
            cell_size=options.cell_size,
            origin=options.origin,
            crs=options.terrain_crs if beside_rivers else options.crs,
            to_crs=to_crs or options.to_crs,
            range=None if options.range is None else tuple(options.range),
            z_factor=options.z_factor,
            nodata=options.nodata,
            shape=None if options.shape is None else tuple(options.shape),
            band=options.band or 1,
            device=device,
        )


def ground_under(options: argparse.Namespace, crs: str | None) -> Terrain | None:
    """Read the terrain under rivers in that CRS, if there is to be one.

    Where --to-crs is given it is brought into the CRS of the rivers: "utm" means one zone for both.

    Raises:
        ValueError: There is none, but flags that say how it is read.
    """
    if options.terrain is None:
        if useless := given_flags(options, HEIGHT_FLAGS):
            raise InputError(f"{useless[0]} says how a --terrain is read, and none is given; leave it out")
        return None
    return read_ground(options.terrain, options, to_crs=crs if options.to_crs is not None else None)


# ---- runs


def stored_run(source: Path) -> Path | None:
    """The stored run at a path: the file or folder itself, or the one in a folder of results; None without one."""
    if source.suffix.lower() == ".npz" and source.is_file():
        return source if _is_run(source) else None
    marks = ("run.json", "segments.jsonl")
    return next((p for p in (source, source / "run") for mark in marks if (p / mark).is_file()), None)


def read_run(path: Path, *, salvage: bool = False) -> History:
    """Open a stored run that holds a record or more; ``salvage``: what can be read of a damaged one."""
    from warpriver.history import read_history

    history = read_history(path, salvage=salvage)
    history.record(-1)
    return history


def _is_run(path: Path) -> bool:
    """Tell a stored run from a terrain: it has a header."""
    import zipfile

    try:
        with zipfile.ZipFile(path) as archive:
            return "header.npy" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return True  # whoever reads it says what is wrong


@contextlib.contextmanager
def results_in(folder: Path) -> Iterator[Path]:
    """Make a folder for results; if the block fails before there are any, it goes again."""
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
    except BaseException:
        with contextlib.suppress(OSError):  # not empty
            for path in made:
                path.rmdir()
        raise


def quiet_warp() -> None:
    """Start Warp, and let it tell of errors only."""
    import warp as wp

    from warpriver.device import start_warp

    wp.config.log_level = wp.LOG_ERROR
    start_warp()
