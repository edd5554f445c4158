"""Files of surfaces for 3-D programs, written byte for byte: glTF (binary), OBJ and USD.

Coordinates are relative to an origin, as programs need it that hold them in single precision. glTF has y up by its
definition; OBJ and USD have z up, or y up where that is wanted.
"""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.errors import InputError, MissingExtraError
from warpriver.files import beside
from warpriver.io.gltf import GltfMesh, write_gltf
from warpriver.landscape.surfaces import Surface
from warpriver.public import public
from warpriver.validate import finite_numbers

__all__ = ["SCENES", "write_surfaces"]


GLB, OBJ, USDA, USDC = SCENES = (".glb", ".obj", ".usda", ".usdc")
# Rows of text that are made at a time.
ROWS = 50_000


@public
def write_surfaces(
    surfaces: Sequence[Surface],
    path: str | os.PathLike[str],
    *,
    origin: Sequence[float] | None = None,
    y_up: bool = False,
) -> None:
    """Write surfaces with normals and texture coordinates to one file, each as an object of its own.

    ====== ========================================================================================================
    .glb   binary glTF 2.0, single precision, y up; origin and CRS stand in the "extras" of the asset
    .obj   text
    .usda  USD as text
    .usdc  USD, binary (``warpriver[usd]``)
    ====== ========================================================================================================

    Args:
        surfaces: What to write.
        path: File name.
        origin: (x, y) in m that is subtracted from all points; by default the south-west corner in whole metres. It
            stands in the file, with the CRS.
        y_up: Turn OBJ and USD so that y is up and north is -z, as glTF has it.

    Raises:
        ImportError: The format needs a module that is not installed.
        OSError: The file cannot be written.
        ValueError: Another suffix, or no surface.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in SCENES:
        raise InputError(f"cannot write {target}: the name must end in {', '.join(SCENES)}")
    if not len(surfaces) or not all(isinstance(surface, Surface) for surface in surfaces):
        raise InputError("surfaces holds none, or something else; give those of landscape_surfaces(carved)")
    zero = _corner(surfaces) if origin is None else np.array(finite_numbers(origin, 2, "origin"))
    upright = y_up or suffix == GLB
    told = {"origin": zero.tolist(), "crs": surfaces[0].crs, "unit": "m", "up": "y" if upright else "z"}
    with beside(target) as temporary:
        if suffix == USDC:
            _write_usdc(surfaces, temporary, zero, upright, told)
            return
        with temporary.open("wb") as file:
            if suffix == GLB:
                _write_glb(surfaces, file, zero, told)
            else:
                for text in (_obj if suffix == OBJ else _usda)(surfaces, zero, upright, told):
                    file.write(text)


def _corner(surfaces: Iterable[Surface]) -> FloatArray:
    corner: FloatArray = np.floor(np.min([surface.bounds[0][:2] for surface in surfaces], axis=0))
    return corner


def _turned(vectors: FloatArray, y_up: bool) -> FloatArray:
    """Return vectors with y up, where that is wanted: north is -z."""
    return np.column_stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]]) if y_up else vectors


def _placed(surface: Surface, zero: FloatArray, y_up: bool) -> FloatArray:
    return _turned(surface.points - [*zero, 0.0], y_up)


def _rows(form: str, table: np.ndarray) -> Iterator[bytes]:
    """Yield the rows of a table as text."""
    for first in range(0, len(table), ROWS):
        part = table[first : first + ROWS]
        yield (form * len(part) % tuple(part.ravel().tolist())).encode()


# ---- glTF


def _write_glb(surfaces: Sequence[Surface], file: BinaryIO, zero: FloatArray, told: dict[str, Any]) -> None:
    meshes = []
    for surface in surfaces:
        attributes = {
            "POSITION": _placed(surface, zero, True),
            "NORMAL": _turned(surface.normals, True),
            # Images of glTF have their first row on top.
            "TEXCOORD_0": np.column_stack([surface.uv[:, 0], 1.0 - surface.uv[:, 1]]),
        }
        meshes.append(GltfMesh(surface.name, attributes, surface.triangles, surface.color))
    write_gltf(meshes, file, told)


# ---- OBJ


def _obj(surfaces: Sequence[Surface], zero: FloatArray, y_up: bool, told: dict[str, Any]) -> Iterator[bytes]:
    yield f"# warpriver: {json.dumps(told)}\n".encode()
    first = 1
    for surface in surfaces:
        yield f"o {surface.name}\n".encode()
        yield from _rows("v %.4f %.4f %.4f\n", _placed(surface, zero, y_up))
        yield from _rows("vt %.6f %.6f\n", surface.uv)
        yield from _rows("vn %.5f %.5f %.5f\n", _turned(surface.normals, y_up))
        yield from _rows("f %d/%d/%d %d/%d/%d %d/%d/%d\n", np.repeat(surface.triangles + first, 3, axis=1))
        first += len(surface.points)


# ---- USD


def _usda(surfaces: Sequence[Surface], zero: FloatArray, y_up: bool, told: dict[str, Any]) -> Iterator[bytes]:
    up = "Y" if y_up else "Z"
    about = json.dumps(json.dumps(told))
    head = f'    defaultPrim = "Landscape"\n    doc = {about}\n    metersPerUnit = 1\n    upAxis = "{up}"\n'
    yield f'#usda 1.0\n(\n{head})\n\ndef Xform "Landscape"\n{{\n'.encode()
    for surface in surfaces:
        low, high = (_placed(surface, zero, y_up).min(axis=0), _placed(surface, zero, y_up).max(axis=0))
        name = "".join(letter if letter.isalnum() else "_" for letter in surface.name)
        extent = ", ".join(f"({', '.join(f'{v:.6g}' for v in corner)})" for corner in (low, high))
        color = ", ".join(f"{v:g}" for v in surface.color[:3])
        yield f'    def Mesh "{name}"\n    {{\n        float3[] extent = [{extent}]\n'.encode()
        yield b'        uniform token subdivisionScheme = "none"\n        uniform token orientation = "rightHanded"\n'
        yield f"        color3f[] primvars:displayColor = [({color})]\n".encode()
        yield f"        float[] primvars:displayOpacity = [{surface.color[3]:g}]\n".encode()
        yield from _usd_array("int[] faceVertexCounts", "%d", np.full((len(surface.triangles), 1), 3), "")
        yield from _usd_array("int[] faceVertexIndices", "%d", surface.triangles.reshape(-1, 1), "")
        yield from _usd_array("point3f[] points", "(%.4f, %.4f, %.4f)", _placed(surface, zero, y_up), "")
        vertex = 'interpolation = "vertex"'
        yield from _usd_array("normal3f[] normals", "(%.5f, %.5f, %.5f)", _turned(surface.normals, y_up), vertex)
        yield from _usd_array("texCoord2f[] primvars:st", "(%.6f, %.6f)", surface.uv, vertex)
        yield b"    }\n"
    yield b"}\n"


def _usd_array(name: str, form: str, table: np.ndarray, metadata: str) -> Iterator[bytes]:
    yield f"        {name} = [".encode()
    for first in range(0, len(table), ROWS):
        part = table[first : first + ROWS]
        text = ", ".join([form] * len(part)) % tuple(part.ravel().tolist())
        yield ((", " if first else "") + text).encode()
    yield (f"] (\n            {metadata}\n        )\n" if metadata else "]\n").encode()


def _write_usdc(surfaces: Sequence[Surface], path: Path, zero: FloatArray, y_up: bool, told: dict[str, Any]) -> None:
    try:
        usd = importlib.import_module("pxr.Sdf")
    except ImportError as error:
        raise MissingExtraError(f'writing {USDC} needs usd-core: pip install "warpriver[usd]"') from error
    layer = usd.Layer.CreateAnonymous(".usda")
    text = b"".join(_usda(surfaces, zero, y_up, told)).decode()
    if not layer.ImportFromString(text) or not layer.Export(str(path)):
        raise InputError(f"{path}: usd-core cannot write it")
