"""3-D previews by pyvista: a block of floodplain with its river, drawn without a screen."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from warpriver.errors import InputError, InternalError, MissingExtraError
from warpriver.extras import IMPORTING
from warpriver.files import in_memory
from warpriver.history import History
from warpriver.landscape.maps import landscape_maps
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.validate import not_negative, one_of
from warpriver.viz import gl
from warpriver.viz.bands import Window, bank_lines, refine_lines, select_inside, taper_ends
from warpriver.viz.belt import OXBOW_RAMP, BeltPainter, checked_record, history_bounds, vegetation_noise
from warpriver.viz.landscape import DEEP, landscape_picture
from warpriver.viz.maps import RELIEF_RAMP, map_window
from warpriver.viz.sheet import GROUND, WATER, color_ramp, replacing
from warpriver.viz.surface import LIT_STRENGTH, TerrainGround, clip_window

__all__ = ["render_scene"]

SOIL = "#8d7b62"
RELIEF_WATER = RELIEF_RAMP[1][1]
SKY = ("#f4f6f5", "#c9dbe6")

# Longest side of the ground's picture in pixels, and of its height grid in cells.
TEXTURE_PIXELS = 3072
GRID_CELLS = 720
# Fractions of the channel depth: how far the water lies below the floodplain, and how high the levees stand above
# it.
WATER_DROP = 0.5
LEVEE_RISE = 0.3
# The floodplain falls from the levee to its own level over this many widths.
LEVEE_REACH = 2.5


@public
def render_scene(
    network_or_history: RiverNetwork | History,
    path: str | os.PathLike[str],
    *,
    terrain: Terrain | None = None,
    size: tuple[int, int] = (1280, 800),
    exaggeration: float | None = None,
    camera: Sequence[Sequence[float]] | None = None,
    window: Sequence[float] | None = None,
    until: int | None = None,
    look: str = "belt",
) -> None:
    """Write an oblique 3-D view of a river in its floodplain or on its terrain, drawn off-screen.

    Channels and oxbow lakes are ribbons at true width; on a terrain those that would be narrower than two pixels are
    made as wide as that. The ground carries the channel belt of a history as its colour. Without a terrain it is a
    floodplain whose levees and banks are drawn, not simulated: their height is a fixed fraction of the channel depth. A
    terrain is drawn with at most a million cells, level across each channel.

    Args:
        network_or_history: A network, or the run of one.
        path: File to write (.png or .jpg).
        terrain: Terrain under the channels; its gaps are filled with the nearest heights and left plain.
        size: Width and height in pixels.
        exaggeration: Factor on heights; 0 for a flat ground. By default 8, and on a terrain as much as makes its
            relief a twelfth of the block's length, but 1 to 8.
        camera: Position, focal point and up direction, three (x, y, z) in m with z = 0 at the floodplain, or at the
            terrain's lowest height in the block, and heights exaggerated; by default a view from the south that holds
            the whole block.
        window: (west, south, east, north) of the block in m; by default everything, up to the terrain's edge.
        until: Index of the record of a history to show as the present; by default the last.
        look: What lies on the ground of a history: "belt", courses by age, or "landscape", sand, plants and lakes as
            :func:`draw_landscape` has them.

    Raises:
        RuntimeError: This machine cannot draw off-screen; the message says what to install.
        ImportError: pyvista is missing.
        ValueError: A size, exaggeration, camera, record or window that makes no sense, a terrain elsewhere or in
            another CRS, or an unknown suffix.
        OSError: The file cannot be written.
    """
    if min(size) < 16:
        raise InputError(f"size is {tuple(size)} pixels; give at least (16, 16)")
    if exaggeration is not None:
        not_negative(exaggeration, "exaggeration")
    if camera is not None and np.shape(camera) != (3, 3):
        raise InputError("camera: give position, focal point and up direction, each (x, y, z) in m")
    one_of(look, "look", ("belt", "landscape"))
    with replacing(path, (".png", ".jpg")) as temporary:
        pixels = _draw(network_or_history, terrain, size, exaggeration, camera, window, until, look)
        from PIL import Image

        with in_memory(temporary) as buffer:
            Image.fromarray(pixels).save(buffer, "PNG" if temporary.lower().endswith(".png") else "JPEG")


def _draw(
    subject: RiverNetwork | History,
    terrain: Terrain | None,
    size: tuple[int, int],
    exaggeration: float | None,
    camera: Sequence[Sequence[float]] | None,
    window: Sequence[float] | None,
    until: int | None,
    look: str,
) -> np.ndarray:
    """Draw the scene and return its pixels, (rows, columns, 3) uint8."""
    history = None if isinstance(subject, RiverNetwork) else subject
    record = checked_record(history, until) if history is not None else 0
    network = subject if isinstance(subject, RiverNetwork) else subject.networks[record]
    bounds = network.bounds() if history is None else history_bounds(history, record)
    width = float(np.max(network.channel_width))
    view = map_window(window, bounds, 3.0 * width, terrain, subject.crs if terrain is not None else None)
    if terrain is not None:
        view = clip_window(view, terrain.bounds)
    plotter = new_plotter(size)
    try:
        painter, planted = None, history is not None and look == "landscape"
        if history is not None and not planted:
            painter = BeltPainter(history, view, _texture_shape(view), terrain=terrain, strength=LIT_STRENGTH)
            painter.advance(record)
        ground: Any
        if terrain is None:
            ground = _Ground(view, network, 8.0 if exaggeration is None else float(exaggeration))
        else:
            ground = TerrainGround(view, network, terrain, exaggeration)
        if history is not None and planted:
            picture = _planted_picture(history, record, view, terrain)
        elif painter is not None:
            picture = painter.picture(record)
        else:
            picture = _plain_picture(_texture_shape(view)) if terrain is None else ground.picture(_texture_shape(view))
        add_block(plotter, ground, picture)
        if painter is not None and terrain is None:
            # On a terrain the lakes are a part of the picture.
            _add_lakes(plotter, ground, painter, record)
        lines, widths = select_inside(network.polylines(close=True), network.point_widths(close=True), view)
        if lines:
            if terrain is None:
                lines, widths = refine_lines(lines, widths, step=0.2 * width)
            else:
                lines, widths = ground.drape(lines, widths, 2.0 * (view[2] - view[0]) / size[0])
            gap = 0.02 * ground.depth * ground.exaggeration
            water = DEEP if planted else WATER if terrain is None else RELIEF_WATER
            _add_ribbons(plotter, ground, lines, widths, water, gap=gap, water=True)
        aim(plotter, ground, camera)
        image = plotter.screenshot(None, return_img=True)
    finally:
        plotter.close()
    # Drawn at twice the size and averaged: smooth edges on every driver.
    image = np.asarray(image)[..., :3]
    blocks = image.reshape(image.shape[0] // 2, 2, image.shape[1] // 2, 2, 3)
    pixels: np.ndarray = np.round(blocks.mean(axis=(1, 3))).astype(np.uint8)
    return pixels


def _planted_picture(history: History, record: int, window: Window, terrain: Terrain | None) -> np.ndarray:
    """Return the landscape at a record as the picture of the ground, (rows, columns, 3) uint8."""
    rows, columns = _texture_shape(window)
    cell = max((window[2] - window[0]) / columns, (window[3] - window[1]) / rows)
    maps = landscape_maps(history, terrain, cell, bounds=window, until=record)
    return landscape_picture(maps, terrain, strength=LIT_STRENGTH)


def new_plotter(size: tuple[int, int]) -> Any:
    """Return an off-screen plotter with light from the north-west, or say what is missing."""
    try:
        import pyvista
    except ImportError as error:
        raise MissingExtraError('3-D previews are drawn with pyvista: pip install "warpriver[viz]"') from error
    # Importing is safe without an OpenGL library; opening a window is not.
    answer = gl.probe()
    if not answer.ok:
        raise InternalError(answer.message)
    for name, value in gl.window_environment().items():
        os.environ.setdefault(name, value)
    plotter = pyvista.Plotter(off_screen=True, window_size=[2 * size[0], 2 * size[1]], lighting="none")
    plotter.renderer.set_background(SKY[0], top=SKY[1])
    for position, strength in (((-1.0, 0.9, 1.1), 0.75), ((0.6, -1.0, 1.4), 0.3), ((0.0, 0.0, 1.0), 0.15)):
        light = pyvista.Light(position=position, focal_point=(0.0, 0.0, 0.0), intensity=strength)
        light.positional = False
        plotter.add_light(light)
    return plotter


class _Ground:
    """The drawn floodplain: levees beside the channel, and banks that meet the water at the true width."""

    def __init__(self, window: Window, network: RiverNetwork, exaggeration: float):
        with IMPORTING:
            from scipy.spatial import cKDTree

        west, south, east, north = window
        self.window, self.exaggeration = window, exaggeration
        self.top, self.ambient = 0.0, 0.25
        self.origin = np.array([0.5 * (west + east), 0.5 * (south + north)])
        self.cell = max(east - west, north - south) / GRID_CELLS
        lines, widths = select_inside(network.polylines(close=True), network.point_widths(close=True), window)
        narrowest = float(np.min(network.channel_width))
        self.depth = float(np.max(network.channel_depth))
        # Banks are left out where the grid is too coarse to show them: the ribbons then lie on a plane.
        relief = exaggeration * float(np.clip(0.5 * narrowest / self.cell - 0.5, 0.0, 1.0)) if lines else 0.0
        self.drop, self.rise = WATER_DROP * self.depth * relief, LEVEE_RISE * self.depth * relief
        self._tree = None
        if relief > 0.0:
            lines, widths = refine_lines(lines, widths, step=0.5 * self.cell)
            self._half = 0.5 * np.concatenate(widths)
            self._tree = cKDTree(np.concatenate(lines))

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Return the height in m, exaggerated, at (n, 2) absolute positions."""
        if self._tree is None:
            return np.zeros(len(xy))
        reach = 6.0 * LEVEE_REACH * float(self._half.max())
        distance, nearest = self._tree.query(xy, distance_upper_bound=reach)
        far = ~np.isfinite(distance)
        half = self._half[np.where(far, 0, nearest)]
        out = np.where(far, reach, distance - half) / (2.0 * half)
        # Water's edge at 0 widths outside the bank line, levee crest at 0.4.
        bank = np.clip((out + 0.25) / 0.65, 0.0, 1.0)
        bank = bank * bank * (3.0 - 2.0 * bank)
        levee = self.rise * np.exp(-np.maximum(out, 0.0) / LEVEE_REACH)
        edge = _smooth_step(0.25 / 0.65)
        floor = -(self.drop + edge * self.rise) / (1.0 - edge)
        return np.where(far, 0.0, floor + bank * (levee - floor))

    def water_level(self, xy: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Return the height of the water in m at the (2 P, 2) banks of channels with that many points each."""
        return np.full(len(xy), -self.drop)

    def grid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x (nx,), y (ny,) in absolute m and the height (ny, nx) in m."""
        west, south, east, north = self.window
        x = np.linspace(west, east, max(2, round((east - west) / self.cell) + 1))
        y = np.linspace(south, north, max(2, round((north - south) / self.cell) + 1))
        xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return x, y, self.height(xy).reshape(len(y), len(x))


def _smooth_step(t: float) -> float:
    """Return 3 t^2 - 2 t^3."""
    return t * t * (3.0 - 2.0 * t)


def _texture_shape(window: Window) -> tuple[int, int]:
    """Return (rows, columns) of the ground's picture."""
    width, height = window[2] - window[0], window[3] - window[1]
    scale = TEXTURE_PIXELS / max(width, height)
    return max(16, round(height * scale)), max(16, round(width * scale))


def _plain_picture(shape: tuple[int, int]) -> np.ndarray:
    """Return a gently mottled floodplain, (rows, columns, 3) uint8."""
    tone = 1.0 + 0.02 * vegetation_noise(shape)[..., None]
    return np.clip(255.0 * color_ramp(((0.0, GROUND),), 0.0) * tone, 0.0, 255.0).astype(np.uint8)


def add_block(plotter: Any, ground: Any, picture: np.ndarray) -> None:
    """Add the ground with its picture, and the sides of the block below it."""
    import pyvista

    x, y, z = ground.grid()
    gx, gy = np.meshgrid(x - ground.origin[0], y - ground.origin[1])
    surface = pyvista.StructuredGrid(gx, gy, z).extract_surface(algorithm=None)
    west, south, east, north = ground.window
    local = surface.points[:, :2] + ground.origin
    u, v = (local[:, 0] - west) / (east - west), (local[:, 1] - south) / (north - south)
    surface.active_texture_coordinates = np.stack([u, v], axis=1)
    texture = pyvista.Texture(np.ascontiguousarray(picture))
    texture.interpolate = True
    texture.mipmap = True
    plotter.add_mesh(surface, texture=texture, smooth_shading=True, ambient=ground.ambient, diffuse=0.85, specular=0.0)
    points, faces = block_sides(gx, gy, z, 0.04 * np.sqrt((east - west) * (north - south)) + 2.0 * ground.drop)
    sides = pyvista.PolyData(points, faces)
    plotter.add_mesh(sides, color=SOIL, smooth_shading=False, ambient=0.7, diffuse=0.5, specular=0.0)


def block_sides(x: np.ndarray, y: np.ndarray, z: np.ndarray, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) and faces (pyvista's packed quads) of the four sides below a height grid."""
    ring = np.concatenate(
        [
            np.stack([x[0], y[0], z[0]], axis=1)[:-1],
            np.stack([x[:, -1], y[:, -1], z[:, -1]], axis=1)[:-1],
            np.stack([x[-1], y[-1], z[-1]], axis=1)[:0:-1],
            np.stack([x[:, 0], y[:, 0], z[:, 0]], axis=1)[:0:-1],
        ]
    )
    count = len(ring)
    below = ring.copy()
    below[:, 2] = -thickness
    i = np.arange(count)
    j = (i + 1) % count
    faces = np.stack([np.full(count, 4), i, j, j + count, i + count], axis=1)
    return np.concatenate([ring, below]), faces.ravel()


def ribbon_surface(
    lines: Sequence[np.ndarray], widths: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Build the surface of all channels at their width.

    Args:
        lines: (n, 2) points of each channel, m.
        widths: (n,) width at each point, m.

    Returns:
        Points (2 P, 2) in m, all left banks and then all right banks; faces in pyvista's packed form, one
        quad a segment; and the channel of each face.
    """
    left, right, _ = bank_lines(lines, widths)
    counts = np.array([len(xy) for xy in lines])
    total = int(counts.sum())
    segment = np.delete(np.arange(total), np.cumsum(counts) - 1)
    faces = np.stack([np.full(len(segment), 4), segment + total, segment + 1 + total, segment + 1, segment], axis=1)
    owner = np.repeat(np.arange(len(counts)), counts)[segment]
    return np.concatenate([left, right]), faces.ravel(), owner


def runs(mask: np.ndarray) -> list[slice]:
    """Return the slices of a mask's runs of at least two true values."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    pairs = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
    return [slice(int(a), int(b)) for a, b in pairs if b - a >= 2]


def _add_ribbons(
    plotter: Any,
    ground: Any,
    lines: Sequence[np.ndarray],
    widths: Sequence[np.ndarray],
    colors: Any,
    *,
    gap: float,
    water: bool,
) -> None:
    """Add ribbons as one surface, at the water's level or above the ground; one colour, or one a line."""
    import pyvista

    xy, faces, owner = ribbon_surface(lines, widths)
    z = ground.water_level(xy, np.array([len(line) for line in lines])) if water else ground.height(xy)
    # On a plane a small lift keeps the ribbon clear of the ground at any distance.
    lift = max(gap, 2e-4 * (ground.window[2] - ground.window[0]) if ground.drop == 0.0 else 0.0)
    surface = pyvista.PolyData(np.column_stack([xy - ground.origin, z + lift]), faces)
    look = {
        "ambient": 0.35,
        "diffuse": 0.7,
        "specular": 0.25,
        "specular_power": 20.0,
        "smooth_shading": False,
    }
    if not isinstance(colors, str):
        surface.cell_data["rgb"] = np.round(255.0 * np.asarray(colors)[owner]).astype(np.uint8)
    surface = _trim(surface, ground)
    if surface.n_cells == 0:
        return
    if isinstance(colors, str):
        actor = plotter.add_mesh(surface, color=colors, **look)
    else:
        actor = plotter.add_mesh(surface, scalars="rgb", rgb=True, **look)
    if isinstance(ground, TerrainGround):
        # What lies on rough ground wins against it where both are about as far away.
        mapper = actor.GetMapper()
        mapper.SetResolveCoincidentTopologyToPolygonOffset()
        mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(-4.0, -8.0)


def _trim(surface: Any, ground: Any) -> Any:
    """Cut a surface off at the sides of the block."""
    west, south, east, north = ground.window
    half = 0.5 * np.array([east - west, north - south])
    for axis in (0, 1):
        for side in (-1.0, 1.0):
            reach = surface.bounds[2 * axis + (side > 0.0)] * side if surface.n_cells else 0.0
            if reach > half[axis]:
                plane = np.zeros(3)
                plane[axis] = side
                surface = surface.clip(normal=plane, origin=plane * half[axis], invert=True)
    return surface


def _add_lakes(plotter: Any, ground: _Ground, painter: BeltPainter, record: int) -> None:
    """Add what later courses have left of the oxbow lakes, coloured by their age."""
    lines, widths, colors = [], [], []
    for xy, width, age, seen in painter.lakes(record):
        for run in runs(seen):
            lines.append(xy[run])
            widths.append(taper_ends(xy, width)[run])
            colors.append(color_ramp(OXBOW_RAMP, age))
    if lines:
        gap = 0.04 * ground.depth * ground.exaggeration
        _add_ribbons(plotter, ground, lines, widths, np.array(colors), gap=gap, water=False)


def aim(plotter: Any, ground: Any, camera: Sequence[Sequence[float]] | None) -> None:
    """Point the camera: as asked, or from the south so that the block fills the picture."""
    if camera is not None:
        position, focus, up = (np.array(v, np.float64) for v in camera)
        position[:2] -= ground.origin
        focus[:2] -= ground.origin
        plotter.camera_position = [tuple(position), tuple(focus), tuple(up)]
        plotter.reset_camera_clipping_range()
        return
    west, south, east, north = ground.window
    aspect = (east - west) / (north - south)
    # A long block is seen along a diagonal, so that it fills the picture's height as well.
    turn = np.radians(-12.0 - 40.0 * np.clip(np.log2(max(aspect, 1.0)) / 3.0 - 0.4, 0.0, 1.0))
    rise = np.radians(40.0)
    direction = np.array([np.sin(turn) * np.cos(rise), -np.cos(turn) * np.cos(rise), np.sin(rise)])
    half = 0.5 * np.array([east - west, north - south])
    corners = np.array([[sx * half[0], sy * half[1], z] for sx in (-1, 1) for sy in (-1, 1) for z in {0.0, ground.top}])
    plotter.camera.view_angle = 25.0
    width, height = plotter.window_size
    focus, distance = fit_view(corners, direction, np.radians(25.0), width / height)
    plotter.camera_position = [tuple(focus + distance * direction), tuple(focus), (0.0, 0.0, 1.0)]
    plotter.camera.view_angle = 25.0
    plotter.reset_camera_clipping_range()


def fit_view(corners: np.ndarray, direction: np.ndarray, angle: float, aspect: float) -> tuple[np.ndarray, float]:
    """Find the focal point and the distance from which all corners just fill the picture.

    Args:
        corners: (n, 3) points that must be seen, m.
        direction: (3,) unit vector from the focal point to the camera.
        angle: Vertical view angle, rad.
        aspect: Width of the picture over its height.

    Returns:
        Focal point (3,) and distance in m.
    """
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    tangent = np.tan(0.5 * angle) * np.array([aspect, 1.0])
    focus = corners.mean(axis=0)
    distance = 1.0
    for _ in range(20):
        offset = corners - focus
        side = np.stack([offset @ right, offset @ up], axis=1)
        toward = offset @ direction
        distance = float((np.abs(side) / tangent + toward[:, None]).max()) * 1.06
        screen = side / (distance - toward)[:, None]
        middle = 0.5 * (screen.max(axis=0) + screen.min(axis=0)) * distance
        focus = focus + middle[0] * right + middle[1] * up
    return focus, distance
