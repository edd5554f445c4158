"""Export of a landscape: layers for a GIS, what engines and 3-D programs take, and runs over time for ParaView."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from warpriver.errors import InputError
from warpriver.files import beside
from warpriver.history.history import History
from warpriver.history.tables import event_columns
from warpriver.io.meshes import write_mesh
from warpriver.io.raster.terrains import write_raster, write_terrain
from warpriver.io.vector.histories import history_layers, records_between
from warpriver.io.vector.layers import write_geopackage
from warpriver.io.vector.network_layers import POINTS, network_layers
from warpriver.landscape.carving import Carved
from warpriver.landscape.engines import ENGINES, engine_size, write_engine
from warpriver.landscape.scene_files import write_surfaces
from warpriver.landscape.splines import channel_splines, spline_layer, splines_as_json
from warpriver.landscape.surfaces import landscape_surfaces
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.validate import one_of, whole

__all__ = ["TARGETS", "export_landscape"]

TARGETS = ("gis", "mesh", "paraview", *ENGINES)
# Layers of the GeoPackage.
CHANNELS, SPLINES = "channels", "splines"


@public
def export_landscape(
    carved: Carved,
    folder: str | os.PathLike[str],
    *,
    targets: Sequence[str] = ("gis",),
    history: History | None = None,
    maps: Mapping[str, Raster] | None = None,
    size: int | None = None,
    every: int | None = None,
) -> list[Path]:
    """Write a landscape for other programs, each into a folder of its own.

    ======== ==========================================================================================================
    gis      terrain.tif, water_level.tif, water_depth.tif, material_NAME.tif and the maps, as cloud-optimized GeoTIFF;
             rivers.gpkg with styles for QGIS (channels with elevations, nodes, splines with width, depth and tangents;
             of a run courses, oxbow lakes and abandoned courses over time); splines.json; events.csv of a run
    mesh     landscape.glb, landscape.obj and landscape.usda: ground, water and ribbons of the channels
    paraview terrain.vtp, rivers.vtp; of a run a file a record and run.pvd, which shows them over time
    unreal   heightmap.png of 505 to 8129 vertices, a mask a material, splines in cm, water.glb
    unity    heightmap.r16 of 33 to 4097 vertices, control_N.png with four materials each, splines, water.obj
    godot    heightmap.png and .r16, masks, splines, water.glb
    blender  heightmap.png, masks, splines, landscape.glb
    houdini  heightmap.png and .r16, masks, splines, landscape.usda
    ======== ==========================================================================================================

    Height maps have 16 bits from the lowest to the highest ground; landscape.json beside them has scales, place, CRS
    and what to type into the importer. Elevations of splines never rise downstream.

    Args:
        carved: The landscape.
        folder: Where the folders are made.
        targets: What to write for: the names above.
        history: The run that it comes from.
        maps: Further rasters on the terrain's cells, by name: moisture, vegetation ...
        size: Vertices along the longer side of the height maps of engines; by default as many as there are cells, or
            the next larger number that an engine takes.
        every: For ParaView take every so many records; by default all, or as many as make about two million points.

    Returns:
        The files that were written.

    Raises:
        ImportError: A format needs a module that is not installed (``warpriver[gis]``).
        OSError: A file cannot be written.
        ValueError: Another target, a size that an engine does not take, or a map on other cells.
    """
    wanted = [one_of(name, "targets", TARGETS) for name in ([targets] if isinstance(targets, str) else targets)]
    further = dict(maps or {})
    for name, raster in further.items():
        if not isinstance(raster, Raster) or not carved.water.matches(raster):
            raise InputError(f"maps[{name!r}] is no Raster on the cells of the terrain")
    side = None if size is None else whole(size, "size", 2, "vertices")
    step = None if every is None else whole(every, "every", 1, "records")
    for target in ENGINES.keys() & set(wanted):
        engine_size(ENGINES[target], carved.terrain.shape, side)
    made: list[Path] = []
    for target in dict.fromkeys(wanted):
        place = Path(folder) / target
        place.mkdir(parents=True, exist_ok=True)
        if target in ENGINES:
            made += write_engine(carved, place, target, side, further)
        elif target == "gis":
            made += _write_gis(carved, place, history, further)
        elif target == "mesh":
            made += _write_meshes(carved, place)
        else:
            made += _write_paraview(carved, place, history, step)
    return made


def _write_gis(carved: Carved, folder: Path, history: History | None, maps: Mapping[str, Raster]) -> list[Path]:
    """Write rasters, lines and events."""
    files = [folder / "terrain.tif"]
    write_terrain(carved.terrain, files[0])
    layers = {"water_level": carved.water, "water_depth": carved.depth}
    layers |= {f"material_{name}": raster for name, raster in carved.materials.items()} | dict(maps)
    for name, raster in layers.items():
        files.append(folder / f"{name}.tif")
        write_raster(raster, files[-1])
    splines = channel_splines(carved.network)
    lines = [*network_layers(carved.network, CHANNELS), spline_layer(splines, SPLINES)]
    lines += history_layers(history) if history is not None else []
    files.append(folder / "rivers.gpkg")
    write_geopackage(files[-1], lines, carved.terrain.crs, [CHANNELS + POINTS])
    files.append(folder / "splines.json")
    channels = splines_as_json(splines, lambda v: v, lambda v: v, 1.0)
    content = {"axes": "x east, y north, z up", "crs": carved.terrain.crs, "channels": channels}
    with beside(files[-1]) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if history is not None:
        files.append(folder / "events.csv")
        _write_events(history, files[-1])
    return files


def _write_events(history: History, path: Path) -> None:
    """Write a row an event; what is not known is empty."""
    columns = event_columns(history)

    def cell(value: object) -> object:
        return "" if isinstance(value, float) and np.isnan(value) else value

    with beside(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(columns)
        for row in zip(*(values.tolist() for values in columns.values()), strict=True):
            table.writerow([cell(value) for value in row])


def _write_meshes(carved: Carved, folder: Path) -> list[Path]:
    surfaces = landscape_surfaces(carved)
    files = [folder / f"landscape{suffix}" for suffix in (".glb", ".obj", ".usda")]
    for file in files:
        write_surfaces(surfaces, file)
    return files


def _write_paraview(carved: Carved, folder: Path, history: History | None, every: int | None) -> list[Path]:
    """Write the ground and the channels, and those of a run over time."""
    files = [folder / "terrain.vtp", folder / "rivers.vtp"]
    write_mesh(carved.terrain, files[0])
    write_mesh(carved.network, files[1])
    if history is None or not len(history.times):
        return files
    count = len(history.times)
    records = sorted({*range(0, count, every or records_between(history)), count - 1})
    frames = folder / "run"
    frames.mkdir(exist_ok=True)
    rows = []
    for record in records:
        file = frames / f"record_{record:06d}.vtp"
        write_mesh(history.network(record), file)
        files.append(file)
        time = f'timestep="{float(history.times[record])!r}"'
        rows.append(f'<DataSet {time} group="" part="0" file={quoteattr(f"run/{file.name}")}/>')
    files.append(folder / "run.pvd")
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n<Collection>\n'
    with beside(files[-1]) as temporary:
        temporary.write_text(head + "\n".join(rows) + "\n</Collection>\n</VTKFile>\n", encoding="utf-8")
    return files
