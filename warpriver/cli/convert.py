"""``warpriver convert``: lines, terrains, rasters and runs from one format into another."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.files import kind_of, written_terrains
from warpriver.cli.output import say
from warpriver.cli.parser import number
from warpriver.cli.shared import (
    LINE_FLAGS,
    OK,
    add_heights,
    add_lines,
    check_out,
    command,
    given_flags,
    quiet_warp,
    read_ground,
    read_lines,
    read_run,
    stored_run,
)
from warpriver.errors import InputError, OutputExistsError

if TYPE_CHECKING:
    from warpriver.network import RiverNetwork

__all__ = ["add"]

# Flags that only a terrain has a use for; the others of terrains serve rasters as well.
TERRAIN_FLAGS = ("z_factor", "range", "shape")
RASTER_FLAGS = (*TERRAIN_FLAGS, "nodata", "band", "cell_size", "origin")


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "convert",
        _convert,
        help="write lines, a terrain, a raster or a run in another format or system",
        description="Read INPUT and write it in the format that the ending of OUT names, in the system of --to-crs:\n"
        "lines as lines (.gpkg .geojson .csv ...), a terrain as a terrain (.tif .asc .npz .png ...), heights in\n"
        "metres; with --raster any raster, its values as they are. Of a run the lines at one time, or, with OUT as\n"
        "a folder or .npz, the run itself.",
        epilog="examples:\n"
        "  warpriver convert rivers.shp --to-crs utm -o rivers.gpkg\n"
        "  warpriver convert dem.tif --z-factor 0.3048 --cell-size 30 -o dem.npz\n"
        "  warpriver convert dem.tif -o heightmap.png\n"
        "  warpriver convert out/river/run --until 120 -o at120.geojson\n"
        "  warpriver convert out/river/run -o river.npz",
    )
    parser.add_argument("input", metavar="INPUT", help="river lines, a terrain or raster, or a run")
    parser.add_argument("-o", "--out", required=True, metavar="OUT", help="file to write; an existing one is replaced")
    parser.add_argument(
        "--until",
        type=number(unit="years"),
        metavar="YEARS",
        help="of a run: its lines at this time (default: the last)",
    )
    parser.add_argument(
        "--raster", action="store_true", help="any raster, not a terrain: whole numbers and units stay as they are"
    )
    parser.add_argument(
        "--salvage", action="store_true", help="of a damaged run: what can be read of it, into another folder or file"
    )
    parser.add_argument(
        "--shape-junctions",
        action="store_true",
        help="of lines, and those of a run: bend the last reaches of tributaries so that they arrive at the angles "
        "that fit their flows",
    )
    add_lines(parser)
    add_heights(parser.add_argument_group("terrain or raster"))


def _convert(options: argparse.Namespace) -> int:
    source, out = Path(options.input), Path(options.out)
    kind = kind_of(source)
    if kind == "valley":
        raise InputError(f"{source} is a valley file; warpriver valley {source} -o {out} makes what it describes")
    if kind == "scene":
        raise InputError(f"{source} is a scene; warpriver simulate {source} -o FOLDER runs it")
    useless = []
    if kind != "run":
        useless += given_flags(options, ["until", "salvage"])
    if kind != "lines":
        useless += given_flags(options, [name for name in LINE_FLAGS if name != "crs"])
    if kind in ("terrain", "raster"):
        useless += given_flags(options, ["shape_junctions"])
    if kind not in ("terrain", "raster"):
        useless += given_flags(options, ["raster", *RASTER_FLAGS])
    elif options.raster:
        useless += given_flags(options, TERRAIN_FLAGS)
    if useless:
        raise InputError(f"{useless[0]} means nothing to {source}, which holds {_named(kind)}; leave it out")
    quiet_warp()
    write = {"run": _convert_run, "lines": _convert_lines, "terrain": _convert_cells, "raster": _convert_cells}[kind]
    say(write(source, out, options))
    return OK


def _named(kind: str) -> str:
    return {"lines": "lines", "run": "a run"}.get(kind, f"a {kind}")


def _convert_lines(source: Path, out: Path, options: argparse.Namespace) -> str:
    from warpriver.io.vector.networks import line_formats, write_network

    check_out(out, "-o", line_formats())
    # What is only converted may be short.
    options.short = options.short or "keep"
    network = _shaped(read_lines(source, options), options)
    write_network(network, out)
    return f"{network}\n{out}"


def _shaped(network: RiverNetwork, options: argparse.Namespace) -> RiverNetwork:
    if not options.shape_junctions:
        return network
    from warpriver.meander.junctions import shape_junctions

    return shape_junctions(network)


def _convert_cells(source: Path, out: Path, options: argparse.Namespace) -> str:
    from warpriver.io.raster.terrains import read_raster, write_raster, write_terrain

    check_out(out, "-o", written_terrains())
    if not options.raster:
        terrain = read_ground(source, options)
        write_terrain(terrain, out)
        return f"{terrain}\n{out}"
    raster = read_raster(
        source,
        cell_size=options.cell_size,
        origin=options.origin,
        crs=options.crs,
        to_crs=options.to_crs,
        nodata=options.nodata,
        band=options.band or 1,
    )
    write_raster(raster, out)
    return f"{raster}\n{out}"


def _convert_run(source: Path, out: Path, options: argparse.Namespace) -> str:
    from warpriver.io.vector.networks import line_formats, write_network

    if useless := given_flags(options, ["crs", "to_crs"]):
        raise InputError(
            f"{useless[0]} means nothing to a run, which has a system of its own; convert its lines after it"
        )
    run = stored_run(source)
    assert run is not None
    if out.suffix.lower() == ".npz" or not out.suffix:
        if options.until is not None:
            raise InputError(f"--until is for lines of a run, and {out} will be the whole of it; leave it out")
        if options.shape_junctions:
            raise InputError(f"--shape-junctions is for lines of a run, and {out} will be all of it; leave it out")
        if out.exists() and out.suffix.lower() != ".npz":
            raise OutputExistsError(f"{out} exists; name another folder")
        history = read_run(run, salvage=options.salvage)
        history.save(out)
        return f"{history}\n{out}"
    check_out(out, "-o", {**line_formats(), ".npz": True})
    history = read_run(run, salvage=options.salvage)
    index = len(history) - 1
    if options.until is not None:
        index = int((history.times <= options.until).sum()) - 1
        if index < 0:
            raise InputError(f"--until {options.until:g}: the run begins at {history.times[0]:g} yr")
    network = _shaped(history.networks[index], options)
    write_network(network, out)
    return f"{network} at {history.times[index]:.4g} yr\n{out}"
