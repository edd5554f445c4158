"""Binary glTF 2.0, written byte for byte: triangles with normals, texture coordinates and numbers of one's own."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

from warpriver.arrays import FloatArray, IndexArray

__all__ = ["GltfMesh", "point_normals", "write_gltf"]


# Numbers of glTF: types of components, and what a buffer is for.
FLOAT, UNSIGNED, VERTICES, INDICES = 5126, 5125, 34962, 34963
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
# How rough what can be seen through, such as water, is, and what cannot.
ROUGH_WATER, ROUGH_GROUND = 0.15, 0.95


@dataclasses.dataclass(frozen=True, eq=False)
class GltfMesh:
    """An object of the file, in the axes of glTF: x east, y up, z south.

    Attributes:
        name: Its name.
        attributes: (n,) or (n, k) of each point by name: POSITION, NORMAL, TEXCOORD_0; one's own begin with "_".
        triangles: (m, 3) points of each, counter-clockwise from outside.
        color: Red, green, blue and opacity, 0 to 1.
    """

    name: str
    attributes: Mapping[str, FloatArray]
    triangles: IndexArray
    color: tuple[float, float, float, float]


def write_gltf(meshes: Sequence[GltfMesh], file: BinaryIO, told: Mapping[str, Any]) -> None:
    """Write meshes as binary glTF 2.0, each as an object of its own.

    Args:
        meshes: What to write.
        file: Where to.
        told: What stands in the "extras" of the asset.
    """
    pieces: list[bytes] = []
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def held(array: np.ndarray, component: int, target: int, **more: Any) -> int:
        data = np.ascontiguousarray(array).tobytes()
        offset = sum(len(piece) for piece in pieces)
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(data), "target": target})
        pieces.append(data + b"\0" * (-len(data) % 4))
        kind = KINDS[1 if array.ndim == 1 else array.shape[1]]
        told = {"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind}
        accessors.append(told | more)
        return len(accessors) - 1

    listed, materials = [], []
    for k, mesh in enumerate(meshes):
        attributes = {}
        for name, values in mesh.attributes.items():
            array = np.asarray(values).astype("<f4")
            limits = {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
            attributes[name] = held(array, FLOAT, VERTICES, **(limits if name == "POSITION" else {}))
        indices = held(mesh.triangles.ravel().astype("<u4"), UNSIGNED, INDICES)
        primitive = {"attributes": attributes, "indices": indices, "material": k}
        listed.append({"name": mesh.name, "primitives": [primitive]})
        clear = mesh.color[3] < 1.0
        material: dict[str, Any] = {
            "name": mesh.name,
            "pbrMetallicRoughness": {
                "baseColorFactor": list(mesh.color),
                "metallicFactor": 0.0,
                "roughnessFactor": ROUGH_WATER if clear else ROUGH_GROUND,
            },
        }
        materials.append(material | ({"alphaMode": "BLEND"} if clear else {}))
    whole = b"".join(pieces)
    scene = {
        "asset": {"version": "2.0", "generator": "warpriver", "extras": dict(told)},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(listed)))}],
        "nodes": [{"mesh": k, "name": mesh.name} for k, mesh in enumerate(meshes)],
        "meshes": listed,
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(whole)}],
    }
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    file.write(b"glTF" + np.array([2, 28 + len(text) + len(whole), len(text)], "<u4").tobytes() + b"JSON")
    file.write(text + np.array([len(whole)], "<u4").tobytes() + b"BIN\0" + whole)


def point_normals(points: FloatArray, triangles: IndexArray) -> FloatArray:
    """Return the unit normals of points: of the faces around them, by their areas; up where there is none."""
    corner = points[triangles]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(face[:, k], 3), minlength=len(points)) for k in range(3)], axis=1
    )
    size = np.linalg.norm(normal, axis=1)[:, None]
    return np.where(size > 0.0, normal / np.maximum(size, 1e-300), [0.0, 0.0, 1.0])
