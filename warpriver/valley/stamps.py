"""What is set into a synthetic valley: patches of rough ground, and meshes [Brown2014], section 6.5."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpriver.arrays import DeviceArray, FloatArray
from warpriver.device import launch_kernel
from warpriver.errors import InputError
from warpriver.kernels import stamps as kernels
from warpriver.parameter import Params, parameter

__all__ = ["Ground", "MeshStamp", "RoughnessPatch", "Structure", "set_into"]


MODES = {"raise": kernels.RAISE, "lower": kernels.LOWER, "replace": kernels.REPLACE}
# Corners of a patch at most: each place within its bounds looks at all of them.
MAX_CORNERS = 1000


@dataclasses.dataclass(frozen=True, eq=False)
class RoughnessPatch(Params):
    """Rough ground in a polygon: octaves of seeded gradient noise that are added to the surface [Perlin2002].

    Attributes:
        polygon: (n, 2) corners in m, in the valley's frame: x along the axis from the upstream end, y to the left; it
            closes by itself.
    """

    polygon: ArrayLike
    deviation: float = parameter(
        0.1, "m", low=0.0, low_open=True, source="Brown2014", doc="standard deviation of the heights that are added"
    )
    wavelength: float = parameter(
        5.0, "m", low=0.0, low_open=True, source="Perlin2002", doc="wavelength of the first octave"
    )
    octaves: int = parameter(4, "-", low=1, high=16, source="Musgrave1989", doc="number of octaves")
    roughness: float = parameter(
        0.5, "-", low=0.0, high=1.0, source="Musgrave1989", doc="amplitude of an octave over that of the one before"
    )
    blend: float = parameter(1.0, "m", low=0.0, source="warpriver", doc="distance over which it fades at its edge")
    seed: int = parameter(0, "-", low=0, high=2**31 - 17, source="warpriver", doc="seed of the noise")

    def __post_init__(self) -> None:
        super().__post_init__()
        corners = _rows(self.polygon, "RoughnessPatch.polygon", 2)
        if not 3 <= len(corners) <= MAX_CORNERS:
            raise InputError(f"RoughnessPatch.polygon has {len(corners)} corners; give 3 to {MAX_CORNERS}")
        object.__setattr__(self, "polygon", corners)

    def __eq__(self, other: object) -> bool:
        return _same(self, other)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest x and y in the valley's frame, m."""
        corners = np.asarray(self.polygon)
        return corners.min(axis=0), corners.max(axis=0)


@dataclasses.dataclass(frozen=True, eq=False)
class MeshStamp(Params):
    """A mesh of triangles that is set into the ground or stands on it.

    Attributes:
        vertices: (n, 3) in the mesh's own units, z up.
        triangles: (m, 3) indices of vertices.
        place: Where the mesh's origin lies in the valley's frame, m: x along the axis, y to the left.
        name: What it is, for files.
    """

    vertices: ArrayLike
    triangles: ArrayLike
    place: tuple[float, float] = (0.0, 0.0)
    name: str = "mesh"
    base: str = parameter(
        "ground",
        "-",
        choices=("ground", "datum"),
        source="warpriver",
        doc="what the mesh's z = 0 lies on: the ground at its place, or height 0",
    )
    angle: float = parameter(0.0, "deg", source="warpriver", doc="turn to the left against the valley axis")
    scale: float = parameter(1.0, "m", low=0.0, low_open=True, source="warpriver", doc="metres a unit of the mesh")
    mode: str = parameter(
        "raise",
        "-",
        choices=(*MODES, "keep"),
        source="Brown2014",
        doc="the higher of mesh and ground, the lower one, the mesh where there is one; or a mesh of its own",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        vertices = _rows(self.vertices, "MeshStamp.vertices", 3)
        try:
            given = np.asarray(self.triangles)
            triangles = given.astype(np.int32)
            whole = given.ndim == 2 and given.shape[1] == 3 and np.array_equal(triangles, given)
        except (TypeError, ValueError, OverflowError):
            whole = False
        if not whole or not len(triangles) or triangles.min() < 0 or triangles.max() >= len(vertices):
            raise InputError(
                "MeshStamp.triangles must be (m, 3) indices of the vertices, whole numbers from 0 to "
                f"{len(vertices) - 1}"
            )
        place = _rows([self.place], "MeshStamp.place", 2)[0]
        triangles.flags.writeable = False
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "place", (float(place[0]), float(place[1])))

    def __eq__(self, other: object) -> bool:
        return _same(self, other)

    def placed(self, base: float) -> FloatArray:
        """Return the vertices in the valley's frame, (n, 3) in m.

        Args:
            base: Height of the mesh's z = 0, m.
        """
        xyz = self.scale * np.asarray(self.vertices)
        c, s = math.cos(math.radians(self.angle)), math.sin(math.radians(self.angle))
        x, y = self.place
        return np.column_stack([x + c * xyz[:, 0] - s * xyz[:, 1], y + s * xyz[:, 0] + c * xyz[:, 1], base + xyz[:, 2]])

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest x and y in the valley's frame, m."""
        xy = self.placed(0.0)[:, :2]
        return xy.min(axis=0), xy.max(axis=0)


@dataclasses.dataclass(frozen=True)
class Structure:
    """A mesh that stands on a valley's ground without being part of it, as :func:`warpriver.write_mesh` takes it.

    Attributes:
        name: What it is.
        xyz: (n, 3) absolute places and heights in m.
        faces: (m, 3) indices of the places, counter-clockwise seen from outside where the mesh given was.
        crs: Coordinate reference system, or None.
    """

    name: str
    xyz: FloatArray
    faces: NDArray[np.int32]
    crs: str | None = None

    def points(self) -> FloatArray:
        """Return the places, (n, 3)."""
        return self.xyz

    def triangles(self) -> NDArray[np.int32]:
        """Return the triangles, (m, 3)."""
        return self.faces


def _rows(values: ArrayLike, label: str, columns: int) -> FloatArray:
    """Read-only (n, columns) of finite numbers; raises ValueError."""
    try:
        rows = np.array(values, np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.ndim != 2 or rows.shape[1] != columns or not len(rows) or not np.isfinite(rows).all():
        raise InputError(f"{label} must be (n, {columns}) finite numbers")
    rows.flags.writeable = False
    return rows


def _same(a: Params, b: object) -> bool:
    """Whether two of one kind have equal fields, arrays among them."""
    names = [field.name for field in dataclasses.fields(a)]
    return type(a) is type(b) and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


# ---- set into heights


class Ground:
    """Heights on the device that stamps are set into: the cells of a raster or any places, in the valley's frame.

    Attributes:
        height: (rows, columns) or (n,) float64, m.
        place: (n,) places of points in m; None for a raster.
        window: Grid of a raster, for the kernels; None for points.
    """

    def __init__(self, height: DeviceArray, place: DeviceArray | None = None, window: Any = None):
        """Take what is on the device already."""
        self.height, self.place, self.window = height, place, window

    def launch(self, kernel: str, stamp: object, bounds: tuple[FloatArray, FloatArray]) -> None:
        """Run a kernel over all points, or over the cells of a raster within bounds of the valley's frame."""
        made = kernels.build(wp.float64)
        if self.place is not None:
            launch_kernel(
                getattr(made, f"{kernel}_points"),
                dim=len(self.height),
                inputs=[stamp, self.place],
                outputs=[self.height],
                device=self.height.device,
            )
            return
        rows, columns = self._cells(bounds)
        if not len(rows) or not len(columns):
            return
        self.window.row, self.window.column = rows.start, columns.start
        launch_kernel(
            getattr(made, f"{kernel}_cells"),
            dim=(len(rows), len(columns)),
            inputs=[stamp, self.window],
            outputs=[self.height],
            device=self.height.device,
        )

    def _cells(self, bounds: tuple[FloatArray, FloatArray]) -> tuple[range, range]:
        """Rows and columns of the cells whose centres may lie within the bounds."""
        window, (low, high) = self.window, bounds
        corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
        x, y = (corners - np.array(window.corner)).T
        column = (window.cosine * x + window.sine * y) / window.cell_size
        row = (window.sine * x - window.cosine * y) / window.cell_size
        found = []
        for at, size in zip((row, column), self.height.shape, strict=True):
            found.append(range(max(0, math.floor(at.min())), min(size, math.ceil(at.max()) + 1)))
        return found[0], found[1]


def set_into(
    ground: Ground, patches: Sequence[RoughnessPatch], stamps: Sequence[MeshStamp], bases: Sequence[float]
) -> None:
    """Set patches, then meshes in their order, into heights on the device.

    Args:
        ground: The heights; they are changed.
        patches: Patches of rough ground.
        stamps: Meshes; those with mode "keep" are left out.
        bases: Height of each mesh's z = 0, m.
    """
    device = ground.height.device
    made = kernels.build(wp.float64)
    for patch in patches:
        struct = made.Patch()
        struct.corner = wp.array(np.asarray(patch.polygon), dtype=wp.vec2d, device=device)
        octaves = patch.roughness ** (2.0 * np.arange(patch.octaves))
        struct.amplitude = patch.deviation / (_noise_deviation() * math.sqrt(float(octaves.sum())))
        struct.wavelength, struct.roughness, struct.blend = patch.wavelength, patch.roughness, patch.blend
        struct.octaves, struct.seed = int(patch.octaves), int(patch.seed)
        ground.launch("roughen", struct, patch.bounds)
    for stamp, base in zip(stamps, bases, strict=True):
        if stamp.mode == "keep":
            continue
        mesh = wp.Mesh(
            wp.array(np.asarray(stamp.vertices, np.float32), dtype=wp.vec3, device=device),
            wp.array(np.asarray(stamp.triangles, np.int32).ravel(), dtype=wp.int32, device=device),
        )
        struct = made.Stamp()
        struct.mesh, struct.mode, struct.base = mesh.id, MODES[stamp.mode], base
        struct.place, struct.scale = wp.vec2d(*stamp.place), stamp.scale
        struct.cosine, struct.sine = math.cos(math.radians(stamp.angle)), math.sin(math.radians(stamp.angle))
        struct.top = float(np.asarray(stamp.vertices)[:, 2].max())
        ground.launch("stamp", struct, stamp.bounds)
        # The mesh is freed with its name.
        wp.synchronize_device(device)


@functools.cache
def _noise_deviation() -> float:
    """Standard deviation of one octave of the kernels' gradient noise over all places and gradients.

    At (x, y) of a lattice cell it is the root of the sum of w^2 d^2 over the four corners, of weight w and at the
    distance d: a unit gradient of random direction has the variance 1/2 along d, and the noise is scaled by sqrt 2.
    """
    node, weight = np.polynomial.legendre.leggauss(16)
    at, weight = 0.5 + 0.5 * node, 0.5 * weight
    fade = at**3 * (at * (6.0 * at - 15.0) + 10.0)
    total = 0.0
    for fx, dx in ((1.0 - fade, at), (fade, at - 1.0)):
        for fy, dy in ((1.0 - fade, at), (fade, at - 1.0)):
            square = (fx[:, None] * fy) ** 2 * (dx[:, None] ** 2 + dy**2)
            total += float(weight @ square @ weight)
    return math.sqrt(total)
