"""``warpriver valley``: valleys of prescribed form."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.shared import OK, can_draw, check_map, command, quiet_warp, results_in
from warpriver.errors import InputError
from warpriver.files import check_place

if TYPE_CHECKING:
    from warpriver.valley.valley import Valley

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "valley",
        _valley,
        help="make a river valley of prescribed form, from an example or a TOML file",
        description="Make a synthetic river valley (Brown et al. 2014): S1 to S6, the paper's examples, or a TOML\n"
        "file of your own. Into a folder go its terrain, channel lines, points, mesh, breaklines, parameters and\n"
        "pictures; into a file what its ending says: terrain (.tif .asc .npz .r16 ...), points (.xyz .csv), mesh\n"
        "(.obj .ply .stl .vtp), breaklines (.geojson), channel (.gpkg), parameters (.toml) or picture (.png .pdf).",
        epilog="examples:\n"
        "  warpriver valley S3 -o out/S3\n"
        "  warpriver valley S5 --cell-size 0.5 -o s5.tif\n"
        "  warpriver valley S1 -o mine.toml                      # parameters to start from\n"
        "  warpriver valley mine.toml --set slope=0.004 --set sharp_bends=blend -o out/mine\n"
        "  warpriver valley --schema                             # every key of a valley file",
    )
    parser.add_argument("valley", nargs="?", metavar="S1..S6|FILE.toml", help="an example, or a valley file")
    parser.add_argument("-o", "--out", metavar="PATH", help="folder or file to write (default folder out/NAME)")
    parser.add_argument(
        "--cell-size", type=float, metavar="M", help="cells of the terrain in m (default: bankfull width / 20)"
    )
    parser.add_argument(
        "--spacing",
        type=float,
        metavar="M",
        help="distance of points and mesh across the channel in m (default: bankfull width / 20; the paper's is 0.1)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a constant of the valley, as width=40; may be given again",
    )
    parser.add_argument("--crs", help="coordinate reference system of the outputs, e.g. EPSG:32619 (default: none)")
    parser.add_argument(
        "--origin",
        type=float,
        nargs=2,
        default=(0.0, 0.0),
        metavar=("X", "Y"),
        help="place of the upstream end of the valley axis in m (default 0 0); moves a valley with a line of its own",
    )
    parser.add_argument("--device", default="cpu", help='"cpu", "cuda", "cuda:1" ... (default cpu)')
    parser.add_argument("--schema", action="store_true", help="print the keys of a valley file and stop")


def _valley(options: argparse.Namespace) -> int:
    from warpriver.io.valleys import read_valley, valley_schema
    from warpriver.valley.valley import synthetic_valley

    if options.schema:
        print(valley_schema())
        return OK
    if options.valley is None:
        raise InputError("name an example, S1 to S6, or a TOML file")
    out = Path(options.out) if options.out is not None else None
    if out is not None and out.suffix:
        write = _writer_of(out, options.spacing)
        check_place(out)
    quiet_warp()
    is_file = Path(options.valley).suffix.lower() == ".toml"
    params = read_valley(options.valley) if is_file else options.valley
    valley = synthetic_valley(
        params,
        cell_size=options.cell_size,
        origin=options.origin,
        crs=options.crs,
        device=options.device,
        **_settings(options.set),
    )
    print(valley)
    width, depth = valley.network.point_widths()[0], valley.network.point_depths()[0]
    print(f"width {width.min():.2f} to {width.max():.2f} m, bankfull depth {depth.min():.3f} to {depth.max():.3f} m")
    print(f"width to depth {valley.params.width_to_depth:.2f}, confinement {valley.params.confinement:.2f}")
    found = valley.covariance
    print(f"mean c(z_T, W) {found.mean_thalweg_width:.3f}, mean c(z_T, |C|) {found.mean_thalweg_curvature:.3f}")
    if out is not None and out.suffix:
        write(valley)
        print(out)
        return OK
    with results_in(out or Path("out") / valley.params.name) as folder:
        _write_folder(valley, folder, options.spacing)
    return OK


def _write_folder(valley: Valley, folder: Path, spacing: float | None) -> None:
    """Write all there is of a valley into a folder."""
    terrain = "terrain.tif" if importlib.util.find_spec("rasterio") is not None else "terrain.npz"
    for name in (terrain, "channel.csv", "points.csv", "mesh.obj", "breaklines.geojson", "valley.toml"):
        _writer_of(folder / name, spacing)(valley)
        print(folder / name)
    if not can_draw():
        return
    from warpriver import viz

    viz.draw_valley(valley, folder / "valley.png")
    viz.draw_valley_sections(valley, folder / "sections.png")
    print(folder / "valley.png", folder / "sections.png", sep="\n")


def _writer_of(path: Path, spacing: float | None) -> Callable[[Valley], object]:
    """Return what writes a file of that name: breaklines, channel, parameters, picture, mesh, points, else terrain.

    Raises:
        ValueError: No format has such a name.
    """
    from warpriver.io import meshes, valleys
    from warpriver.io.raster.terrains import terrain_formats, write_terrain
    from warpriver.io.vector.networks import line_formats, write_network

    suffix = path.suffix.lower()
    if suffix == ".toml":
        return lambda valley: valleys.write_valley(valley.params, path)
    if suffix in (".geojson", ".json"):
        return lambda valley: valleys.write_breaklines(valley.breaklines(), path, crs=valley.crs)
    if path.name == "channel.csv":
        return lambda valley: write_network(valley.network, path)
    if suffix in valleys.POINTS and suffix != ".npz":
        return lambda valley: valleys.write_points(valley.grid(spacing), path)
    if suffix in meshes.MESHES:
        return lambda valley: meshes.write_mesh(valley.grid(spacing), path)
    if suffix in (".pdf", ".svg", ".png", ".jpg"):
        check_map(path)
        from warpriver import viz

        return lambda valley: viz.draw_valley(valley, path)
    if suffix in terrain_formats():
        return lambda valley: write_terrain(valley.terrain, path)
    if suffix in line_formats():
        return lambda valley: write_network(valley.network, path)
    raise InputError(f"cannot write {path}: no format of terrains, points, meshes, lines or pictures ends so")


def _settings(texts: Sequence[str]) -> dict[str, Any]:
    """Constants from KEY=VALUE, numbers where they are numbers."""
    found: dict[str, Any] = {}
    for text in texts:
        key, sign, word = text.partition("=")
        if not sign or not key.strip() or not word.strip():
            raise InputError(f"--set {text}: give KEY=VALUE, as --set width=40")
        value: Any = word.strip()
        for kind in (float, int):
            with contextlib.suppress(ValueError):
                value = kind(word)
        found[key.strip()] = value
    return found
