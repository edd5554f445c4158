"""Meshes: the triangles of a terrain or a valley, and the lines of a network, for 3-D programs and QGIS.

Files are written here, byte for byte: libraries write coordinates of 32 bits, in which a UTM northing is .25 m off.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.device import require_memory
from warpriver.errors import InputError, MissingExtraError, MissingFileError
from warpriver.files import beside
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain, surface_of
from warpriver.validate import finite_numbers
from warpriver.valley.stamps import Structure
from warpriver.valley.valley import Valley, ValleyGrid

__all__ = ["MESHES", "read_mesh", "write_mesh"]

OBJ, PLY, STL, VTP = MESHES = (".obj", ".ply", ".stl", ".vtp")
# Formats that hold lines.
LINES = (OBJ, VTP)
# Bytes that a cell of a terrain takes as a mesh, and rows of text that are made at a time.
CELL_BYTES, ROWS = 120, 50_000
# Beyond this, in m, numbers of single precision are more than a millimetre apart.
FAR = 2.0**14


@dataclasses.dataclass(frozen=True)
class Mesh:
    """Triangles or lines in space.

    Attributes:
        points: (n, 3) absolute places in m, z up.
        triangles: (m, 3) points of each triangle, counter-clockwise seen from above; (0, 3) of lines.
        line_start: (L + 1,) offsets that cut the points into lines; [0] of triangles.
        point_data: Numbers of the points by name, each (n,).
        line_data: Numbers of the lines by name, each (L,).
        crs: Coordinate reference system, or None.
    """

    points: FloatArray
    triangles: NDArray[np.integer]
    line_start: NDArray[np.integer]
    point_data: Mapping[str, np.ndarray]
    line_data: Mapping[str, np.ndarray]
    crs: str | None


@public
def write_mesh(
    surface: Terrain | Raster | Valley | ValleyGrid | Structure | RiverNetwork,
    path: str | os.PathLike[str],
    *,
    origin: Sequence[float] | None = None,
) -> None:
    """Write a surface as triangles, or a network as lines; coordinates are m, z up.

    ===== ==========================================================================================================
    .obj  text; triangles (``f``) or lines (``l``)
    .ply  binary, in double precision, with the numbers of the points; QGIS opens it as a mesh layer
    .stl  binary, in single precision
    .vtp  for ParaView, in double precision: the numbers of the points and lines as arrays, the CRS as field data
    ===== ==========================================================================================================

    A terrain has a point at the centre of each cell with data, and its height as a number; the grid of a valley its
    sections, with height, station (along the channel, m) and lateral (from the centreline, positive to the left, m). A
    network has its points with width_m and depth_m, at their elevations (``point_z``) or at 0, and for each channel
    channel_id, discharge_m3s and width_m.

    Args:
        surface: Terrain, Raster of heights, Valley, its grid or one of its structures; or RiverNetwork, for .obj and
            .vtp.
        path: File name.
        origin: (x, y) in m that is subtracted from all points, as programs need it that hold coordinates in single
            precision (Blender, Unreal Engine): at UTM coordinates they round them to .25 m. By default (0, 0); in an
            .stl, whose numbers are such, the south-west corner in whole metres where coordinates exceed 16 km. Where it
            is not (0, 0) the file NAME.stl.json beside it tells it, with the CRS.

    Raises:
        MemoryError: There is no memory for the mesh.
        OSError: The file cannot be written.
        ValueError: Another suffix, lines in a format of triangles, or a terrain of which no three cells meet.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESHES:
        raise InputError(f"cannot write {path}: the name must end in {', '.join(MESHES)}")
    if isinstance(surface, RiverNetwork) and suffix not in LINES:
        raise InputError(f"{path}: {suffix} holds triangles, a network has lines; write {' or '.join(LINES)}")
    mesh = _mesh_of(surface)
    if origin is not None:
        zero = np.array(finite_numbers(origin, 2, "origin"))
    else:
        far = suffix == STL and np.abs(mesh.points[:, :2]).max() > FAR
        zero = np.floor(mesh.points[:, :2].min(axis=0)) if far else np.zeros(2)
    mesh = dataclasses.replace(mesh, points=mesh.points - [*zero, 0.0])
    write = {OBJ: _write_obj, PLY: _write_ply, STL: _write_stl, VTP: _write_vtp}[suffix]
    side = f"{path.suffix}.json"
    with beside(path, (side,)) as temporary:
        with temporary.open("wb") as file:
            write(mesh, file)
        if zero.any():
            told = {"origin": zero.tolist(), "crs": mesh.crs, "unit": "m"}
            temporary.with_suffix(side).write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


@public
def read_mesh(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray]:
    """Read a mesh of triangles, for :class:`~warpriver.valley.MeshStamp`.

    Args:
        path: .obj, .ply, .stl or .vtp; polygons of more corners are divided.

    Returns:
        (n, 3) vertices, float64, and (m, 3) indices of them.

    Raises:
        ImportError: pyvista is missing.
        ValueError: Another suffix, or a file without triangles.
        OSError: The file cannot be read.
    """
    source = Path(path)
    if source.suffix.lower() not in MESHES:
        raise InputError(f"cannot read {source}: the name must end in {', '.join(MESHES)}")
    if not source.is_file():
        raise MissingFileError(f"{source}: there is no such file")
    try:
        import pyvista
    except ImportError as error:
        raise MissingExtraError(f'reading {source.suffix} needs pyvista: pip install "warpriver[viz]"') from error
    mesh = pyvista.read(source).extract_surface().triangulate()
    if not mesh.n_cells:
        raise InputError(f"{source}: holds no triangles")
    return np.asarray(mesh.points, np.float64), mesh.faces.reshape(-1, 4)[:, 1:].astype(np.int32)


# ---- what becomes a mesh


def _mesh_of(surface: Terrain | Raster | Valley | ValleyGrid | Structure | RiverNetwork) -> Mesh:
    if isinstance(surface, RiverNetwork):
        return _network_mesh(surface)
    if isinstance(surface, Structure):
        points = surface.points()
        return Mesh(points, surface.triangles(), np.zeros(1, np.int64), {"height": points[:, 2]}, {}, surface.crs)
    if isinstance(surface, Valley):
        surface = surface.grid()
    if not isinstance(surface, ValleyGrid):
        return _terrain_mesh(surface_of(surface))
    points = surface.points()
    columns = surface.xyz.shape[1]
    numbers = {
        "height": points[:, 2],
        "station": np.repeat(surface.station, columns),
        "lateral": surface.lateral.ravel(),
    }
    return Mesh(points, surface.triangles(), np.zeros(1, np.int64), numbers, {}, surface.crs)


def _terrain_mesh(terrain: Terrain) -> Mesh:
    """Return a point for each cell with data, and the triangles between those that meet."""
    require_memory(terrain.shape, CELL_BYTES, what="a mesh")
    height, size, (west, north) = terrain.to_numpy(), terrain.cell_size, terrain.origin
    known = np.isfinite(height)
    row, column = np.nonzero(known)
    points = np.column_stack([west + (column + 0.5) * size, north - (row + 0.5) * size, height[known]])
    triangles = cell_triangles(known)
    if not len(triangles):
        raise InputError("the terrain has no three cells with data that meet: there are no triangles to write")
    return Mesh(points, triangles, np.zeros(1, np.int64), {"height": height[known]}, {}, terrain.crs)


def cell_triangles(known: FlagArray) -> IndexArray:
    """Return the triangles between cells with a value that meet, (T, 3) numbers of these cells, row by row.

    Args:
        known: (rows, columns) which cells have one.
    """
    rows, columns = known.shape
    number = np.cumsum(known.ravel(), dtype=np.int64).reshape(known.shape) - 1
    # Corners of the squares between four cells: north-west, north-east, south-west, south-east.
    corners = [(slice(a, a + rows - 1), slice(b, b + columns - 1)) for a in (0, 1) for b in (0, 1)]
    nw, ne, sw, se = (number[c].ravel() for c in corners)
    has = [known[c].ravel() for c in corners]
    total = np.sum(has, axis=0)
    pieces = []
    # Where all four are known or the one that a triangle lacks is the only one missing.
    for missing, triangle in ((1, (nw, sw, se)), (2, (nw, se, ne)), (0, (ne, sw, se)), (3, (nw, sw, ne))):
        there = (total == 3) & ~has[missing]
        if missing in (1, 2):
            there |= total == 4
        pieces.append(np.stack([corner[there] for corner in triangle], axis=1))
    return np.concatenate(pieces)


def _network_mesh(network: RiverNetwork) -> Mesh:
    """Return the channels as lines; rings end at their first point."""
    lines, elevation = network.polylines(close=True), network.point_elevations(close=True)
    xy = np.concatenate(lines)
    z = np.zeros(len(xy)) if elevation is None else np.concatenate(elevation)
    numbers = {
        "width_m": np.concatenate(network.point_widths(close=True)),
        "depth_m": np.concatenate(network.point_depths(close=True)),
    }
    channels = {
        "channel_id": network.channel_id,
        "discharge_m3s": network.channel_discharge,
        "width_m": network.channel_width,
    }
    start = np.concatenate([[0], np.cumsum([len(line) for line in lines])])
    return Mesh(np.column_stack([xy, z]), np.empty((0, 3), np.int64), start, numbers, channels, network.crs)


# ---- formats


def _write_obj(mesh: Mesh, file: BinaryIO) -> None:
    told = "" if mesh.crs is None else f", {' '.join(mesh.crs.split())}"
    file.write(f"# warpriver: metres, z up{told}\n".encode())
    for text in _rows("v %.4f %.4f %.4f\n", mesh.points):
        file.write(text)
    for text in _rows("f %d %d %d\n", mesh.triangles + 1):
        file.write(text)
    first = np.setdiff1d(np.arange(mesh.line_start[-1]), mesh.line_start[1:] - 1)
    for text in _rows("l %d %d\n", np.stack([first + 1, first + 2], axis=1)):
        file.write(text)


def _rows(form: str, table: np.ndarray) -> Iterator[bytes]:
    """Yield the rows of a table as text."""
    for first in range(0, len(table), ROWS):
        part = table[first : first + ROWS]
        yield (form * len(part) % tuple(part.ravel().tolist())).encode()


def _write_ply(mesh: Mesh, file: BinaryIO) -> None:
    names = ["x", "y", "z", *(name for name in mesh.point_data if name != "height")]
    head = ["ply", "format binary_little_endian 1.0"]
    if mesh.crs is not None:
        head.append(f"comment crs {' '.join(mesh.crs.split())}")
    head += [f"element vertex {len(mesh.points)}", *(f"property double {name}" for name in names)]
    head += [f"element face {len(mesh.triangles)}", "property list uchar int vertex_indices", "end_header"]
    file.write(("\n".join(head) + "\n").encode())
    table = np.column_stack([mesh.points, *(mesh.point_data[name] for name in names[3:])])
    file.write(table.astype("<f8").tobytes())
    faces = np.empty(len(mesh.triangles), np.dtype([("count", "u1"), ("points", "<i4", 3)]))
    faces["count"], faces["points"] = 3, mesh.triangles
    file.write(faces.tobytes())


def _write_stl(mesh: Mesh, file: BinaryIO) -> None:
    corner = mesh.points[mesh.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    table = np.zeros(len(corner), np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("flags", "<u2")]))
    table["normal"], table["corner"] = normal, corner
    file.write(b"warpriver: metres, z up".ljust(80))
    file.write(len(corner).to_bytes(4, "little"))
    file.write(table.tobytes())


def _write_vtp(mesh: Mesh, file: BinaryIO) -> None:
    """Write VTK's XML, whose arrays lie end to end behind it."""
    arrays: list[np.ndarray] = []
    size = 0

    def element(values: np.ndarray, name: str = "", components: int = 1) -> str:
        nonlocal size
        values = np.ascontiguousarray(values, "<f8" if values.dtype.kind == "f" else "<i8")
        kind = "Float64" if values.dtype.kind == "f" else "Int64"
        arrays.append(values)
        offset, size = size, size + 8 + values.nbytes
        named = f" Name={quoteattr(name)}" if name else ""
        parts = f' NumberOfComponents="{components}"' if components > 1 else ""
        return f'<DataArray type="{kind}"{named}{parts} format="appended" offset="{offset}"/>'

    def block(tag: str, values: Mapping[str, np.ndarray]) -> str:
        told = f' Scalars="{next(iter(values))}"' if values and tag.endswith("Data") else ""
        return f"<{tag}{told}>{''.join(element(v, name) for name, v in values.items())}</{tag}>"

    lines, start = np.arange(mesh.line_start[-1]), mesh.line_start[1:]
    counts = f'NumberOfLines="{len(start)}" NumberOfPolys="{len(mesh.triangles)}"'
    body = [
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64"><PolyData>',
        "" if mesh.crs is None else f"<FieldData>{_text_element('crs', mesh.crs)}</FieldData>",
        f'<Piece NumberOfPoints="{len(mesh.points)}" NumberOfVerts="0" NumberOfStrips="0" {counts}>',
        block("PointData", mesh.point_data),
        block("CellData", mesh.line_data),
        f"<Points>{element(mesh.points, 'points', 3)}</Points>",
        block("Lines", {"connectivity": lines, "offsets": start}),
        block("Polys", {"connectivity": mesh.triangles, "offsets": 3 * np.arange(1, len(mesh.triangles) + 1)}),
        '</Piece></PolyData><AppendedData encoding="raw">_',
    ]
    file.write("\n".join(body).encode())
    for array in arrays:
        file.write(array.nbytes.to_bytes(8, "little"))
        file.write(array.tobytes())
    file.write(b"\n</AppendedData></VTKFile>\n")


def _text_element(name: str, text: str) -> str:
    """Return a text as VTK's XML has it: the codes of its letters, and a zero."""
    codes = " ".join(map(str, [*text.encode(), 0]))
    return f'<DataArray type="String" Name="{name}" NumberOfTuples="1" format="ascii">{codes}</DataArray>'
