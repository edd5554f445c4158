"""What is set into the surface of a synthetic valley: patches of rough ground, and meshes."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import noise, polygons
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# How the top of a mesh meets the ground: the higher of both, the lower of both, or the mesh wherever there is one.
RAISE, LOWER, REPLACE = range(3)


@once
def build(scalar):
    """Make the kernels of patches and stamped meshes for one precision; heights are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.stamps_{scalar.__name__}"
    field, shapes = noise.build(scalar), polygons.build(scalar)
    vec2 = wp.types.vector(2, scalar)
    ZERO, TWO, THREE = (scalar(v) for v in (0.0, 2.0, 3.0))
    # A ray starts so far above the highest place of a mesh, in its own units, and is followed so far.
    ABOVE, BEYOND = wp.float32(1.0), wp.float32(1.0e30)
    DOWN = wp.vec3(0.0, 0.0, -1.0)

    @wp.struct
    class Patch:
        """Rough ground: a polygon, the deviation of its heights over that of one octave of noise (m), and its noise.

        ``wavelength``: of the first octave, m. ``roughness``: amplitude of an octave over that of the one before.
        ``blend``: distance inside the edge over which it fades, m.
        """

        corner: wp.array[vec2]
        amplitude: scalar
        wavelength: scalar
        roughness: scalar
        blend: scalar
        octaves: int
        seed: int

    @wp.struct
    class Stamp:
        """A mesh on the ground: its place in the valley's frame, its turn, its scale, and the height of its zero, m.

        ``top``: the highest place of the mesh, in its own units.
        """

        mesh: wp.uint64
        place: vec2
        cosine: scalar
        sine: scalar
        scale: scalar
        base: wp.float64
        top: scalar
        mode: int

    @wp.struct
    class Window:
        """Cells of a raster: centre of its cell 0, 0 in the valley's frame, its turn, and a launch's first cell."""

        corner: vec2
        cell_size: scalar
        cosine: scalar
        sine: scalar
        row: int
        column: int

    @wp.func(module=name)
    def rough_height(patch: Patch, xy: vec2) -> scalar:
        """Height that a patch adds at a place, m: octaves of gradient noise [Perlin2002], faded towards its edge."""
        inside = shapes.distance_inside(patch.corner, xy)
        if inside <= ZERO:
            return ZERO
        weight = scalar(1.0)
        if inside < patch.blend:
            weight = inside / patch.blend
            weight = weight * weight * (THREE - TWO * weight)
        total = scalar(0.0)
        size = patch.amplitude
        wavelength = patch.wavelength
        for octave in range(patch.octaves):
            value = field.gradient_noise(patch.seed + octave, xy / wavelength)
            total += size * value[0]
            size = size * patch.roughness
            wavelength = wavelength / TWO
        return weight * total

    @wp.func(module=name)
    def stamped(stamp: Stamp, xy: vec2, height: wp.float64) -> wp.float64:
        """Height at a place after a mesh has been set there: that of its highest face, where there is one."""
        off = (xy - stamp.place) / stamp.scale
        x, y = stamp.cosine * off[0] + stamp.sine * off[1], stamp.cosine * off[1] - stamp.sine * off[0]
        start = wp.float32(stamp.top) + ABOVE
        ray = wp.mesh_query_ray(stamp.mesh, wp.vec3(wp.float32(x), wp.float32(y), start), DOWN, BEYOND)
        if not ray.result:
            return height
        top = stamp.base + wp.float64(stamp.scale) * wp.float64(start - ray.t)
        if stamp.mode == RAISE:
            return wp.max(height, top)
        if stamp.mode == LOWER:
            return wp.min(height, top)
        return top

    @wp.func(module=name)
    def cell_place(window: Window, row: int, column: int) -> vec2:
        """Centre of a cell in the valley's frame."""
        x, y = window.cell_size * scalar(column), -window.cell_size * scalar(row)
        return window.corner + vec2(window.cosine * x - window.sine * y, window.sine * x + window.cosine * y)

    @wp.kernel(module=name, enable_backward=False)
    def roughen_cells(
        # params
        patch: Patch,
        window: Window,
        # out
        cell_height_io: wp.array2d[wp.float64],
    ):
        """Add a patch to the cells of a window."""
        i, j = wp.tid()
        row, column = window.row + i, window.column + j
        added = rough_height(patch, cell_place(window, row, column))
        cell_height_io[row, column] = cell_height_io[row, column] + wp.float64(added)

    @wp.kernel(module=name, enable_backward=False)
    def roughen_points(
        # params
        patch: Patch,
        # in
        point_xy: wp.array[vec2],
        # out
        point_height_io: wp.array[wp.float64],
    ):
        """Add a patch to heights at any places."""
        i = wp.tid()
        point_height_io[i] = point_height_io[i] + wp.float64(rough_height(patch, point_xy[i]))

    @wp.kernel(module=name, enable_backward=False)
    def stamp_cells(
        # params
        stamp: Stamp,
        window: Window,
        # out
        cell_height_io: wp.array2d[wp.float64],
    ):
        """Set a mesh into the cells of a window; cells without ground stay without."""
        i, j = wp.tid()
        row, column = window.row + i, window.column + j
        height = cell_height_io[row, column]
        if not wp.isnan(height):
            cell_height_io[row, column] = stamped(stamp, cell_place(window, row, column), height)

    @wp.kernel(module=name, enable_backward=False)
    def stamp_points(
        # params
        stamp: Stamp,
        # in
        point_xy: wp.array[vec2],
        # out
        point_height_io: wp.array[wp.float64],
    ):
        """Set a mesh into heights at any places; where there is no ground there is none afterwards."""
        i = wp.tid()
        if not wp.isnan(point_height_io[i]):
            point_height_io[i] = stamped(stamp, point_xy[i], point_height_io[i])

    return SimpleNamespace(
        vec2=vec2,
        Patch=Patch,
        Stamp=Stamp,
        Window=Window,
        roughen_cells=roughen_cells,
        roughen_points=roughen_points,
        stamp_cells=stamp_cells,
        stamp_points=stamp_points,
    )
