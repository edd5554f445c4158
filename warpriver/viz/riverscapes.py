"""Pictures and movies of riverscapes, shaded on the device without a graphics library."""

from __future__ import annotations

import dataclasses
import math
import os
import pathlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpriver.arrays import ByteArray, DeviceArray, FlagArray, FloatArray
from warpriver.device import launch_kernel
from warpriver.errors import InputError, MissingExtraError
from warpriver.kernels import shading as kernels
from warpriver.public import public
from warpriver.riverscape.courses import Log
from warpriver.riverscape.drift import Foam, LeafFrame
from warpriver.riverscape.scene import Frame, Riverscape
from warpriver.riverscape.seeding import BEND, BENDING, THREADED
from warpriver.riverscape.water import WaterGrid
from warpriver.validate import finite_numbers, not_negative, positive, whole
from warpriver.viz.sheet import check_picture, replacing

__all__ = ["Camera", "draw_riverscape", "riverscape_movie", "top_view"]


# What imageio calls kinds of files.
FORMATS = {".png": "PNG-PIL", ".jpg": "JPEG-PIL", ".gif": "GIF-PIL", ".mp4": "FFMPEG"}
# Rays a pixel, in both directions.
RAYS = 2
# Seconds that foam has had to gather before the first frame.
FOAM_BEFORE = 4.0
# Of the grid that foam is carried on, about, m.
FOAM_CELL = 0.03
# Colours of leaves, and their length in m.
LEAF_COLORS = np.array([[0.75, 0.42, 0.07], [0.62, 0.2, 0.05], [0.8, 0.66, 0.16], [0.36, 0.42, 0.1]])
LEAF_LENGTH = 0.09
# How much of its height a bare bank counts as: between threads, and on the inside of bends.
BARE_BARS, BARE_POINTS = 0.12, 0.2


@dataclasses.dataclass(frozen=True)
class Camera:
    """Where a picture is taken from.

    Attributes:
        target: (x, y) of the middle of the picture, m.
        heading: Direction of view, degrees from east to north; 90 looks north.
        tilt: Angle below the horizon, degrees: 90 looks straight down.
        distance: From the target, m.
        field: Angle of view across the picture, degrees; 0: parallel rays, as on a map.
        width: Of what is seen, m, where rays are parallel.
    """

    target: tuple[float, float]
    heading: float = 60.0
    tilt: float = 35.0
    distance: float = 20.0
    field: float = 40.0
    width: float = 20.0


@public
def draw_riverscape(
    scene: Riverscape,
    path: str | os.PathLike[str],
    *,
    time: float = 0.0,
    camera: Camera | None = None,
    size: tuple[int, int] = (960, 540),
    cell_size: float | None = None,
    leaves: int = 0,
) -> None:
    """Write a picture of a riverscape: bed seen through the water, sky and sun in it, foam, and leaves.

    Args:
        scene: The riverscape.
        path: File to write, ``.png`` or ``.jpg``.
        time: s.
        camera: Where it is taken from; by default from aside and above, such that all water is seen.
        size: Width and height in pixels.
        cell_size: Of the grid that bed and water are drawn from, m; by default one and a half pixels.
        leaves: How many drift on the water.

    Raises:
        ImportError: imageio or Pillow is missing.
        ValueError: A size or a cell size out of range.
        OSError: The file cannot be written.
    """
    imageio = _need_imageio()
    check_picture(path, (".png", ".jpg"))
    picture = _Picture(scene, camera, size, cell_size)
    begin = time - FOAM_BEFORE
    moments = np.linspace(begin, time, 13)
    (*_, last) = picture.shots(moments, leaves, None)
    with replacing(path, (".png", ".jpg")) as target:
        imageio.imwrite(target, last, format=FORMATS[pathlib.Path(path).suffix.lower()])


@public
def riverscape_movie(
    scene: Riverscape,
    path: str | os.PathLike[str],
    *,
    seconds: float = 8.0,
    fps: float = 24.0,
    loop: float | None = None,
    camera: Camera | None = None,
    size: tuple[int, int] = (960, 540),
    cell_size: float | None = None,
    leaves: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a movie of a riverscape's water.

    Args:
        scene: The riverscape.
        path: File to write: .gif, or .mp4, which needs ``warpriver[movie]``.
        seconds: Its length, s.
        fps: Frames a second, above 0 and at most 60.
        loop: Period in s after which water and foam repeat themselves without a seam; give as many ``seconds`` for a
            movie that can be repeated. By default water never repeats itself.
        camera: Where it is taken from; by default from aside and above, such that all water is seen.
        size: Width and height in pixels; both even for .mp4.
        cell_size: Of the grid that bed and water are drawn from, m; by default one and a half pixels.
        leaves: How many drift on the water; they do not repeat themselves.
        progress: Called after each frame with the number of frames done and their total.

    Raises:
        ImportError: imageio is missing, or, for .mp4, imageio-ffmpeg.
        ValueError: A rate, length or size out of range, or an unknown suffix.
        OSError: The file cannot be written.
    """
    imageio = _need_imageio()
    suffix = pathlib.Path(path).suffix.lower()
    rate, length = positive(fps, "fps"), positive(seconds, "seconds", "s")
    if rate > 60.0 or rate * length > 100_000:
        raise InputError(f"fps is {rate:g} and seconds {length:g}; give 60 a second at most, and 100,000 frames in all")
    if suffix not in (".gif", ".mp4"):
        raise InputError(f"{path} ends in {suffix or 'nothing'}; use .gif or .mp4")
    if suffix == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise InputError(f"size is {tuple(size)} pixels; .mp4 needs even numbers")
    picture = _Picture(scene, camera, size, cell_size)
    before = np.arange(-round(FOAM_BEFORE * rate), 0) / rate
    frames = max(1, round(length * rate))
    moments = np.concatenate([before, np.arange(frames) / rate])
    options: dict[str, Any] = {"fps": rate} if suffix == ".mp4" else {"duration": 1000.0 / rate, "loop": 0}
    if suffix == ".mp4":
        options |= {"macro_block_size": 1, "quality": 8}
    with (
        replacing(path, (".gif", ".mp4")) as target,
        imageio.get_writer(target, format=FORMATS[suffix], **options) as writer,
    ):
        for done, shot in enumerate(picture.shots(moments, leaves, loop, skip=len(before)), 1):
            writer.append_data(shot)
            if progress is not None:
                progress(done, frames)


def top_view(scene: Riverscape, window: tuple[float, float, float, float], cell_size: float, time: float) -> ByteArray:
    """Return a window as it is seen from above, (rows, columns, 3), north up, a pixel a cell.

    Args:
        scene: The riverscape.
        window: (west, south, east, north), whole cells, m.
        cell_size: m.
        time: s.
    """
    west, south, east, north = window
    size = (max(16, round((east - west) / cell_size)), max(16, round((north - south) / cell_size)))
    camera = Camera((0.5 * (west + east), 0.5 * (south + north)), 90.0, 90.0, 10.0, 0.0, east - west)
    picture = _Picture(scene, camera, size, cell_size)
    (*_, last) = picture.shots(np.linspace(time - FOAM_BEFORE, time, 13), 0, None)
    return last


def _need_imageio() -> Any:
    try:
        import imageio.v2 as imageio
    except ImportError as error:
        raise MissingExtraError("pictures of riverscapes need imageio: pip install 'warpriver[viz]'") from error
    return imageio


class _Picture:
    """A camera above the grid of a scene: what does not change from frame to frame."""

    def __init__(
        self, scene: Riverscape, camera: Camera | None, size: tuple[int, int], cell_size: float | None
    ) -> None:
        self.width, self.height = (whole(v, "size", 16, maximum=16384) for v in size)
        west, south, east, north = scene.courses.bounds
        if camera is None:
            across = max(east - west, (north - south) * 1.8)
            camera = Camera((0.5 * (west + east), 0.5 * (south + north)), 70.0, 42.0, 1.05 * across, 50.0)
        self.camera, self.scene = camera, scene
        finite_numbers(camera.target, 2, "Camera.target")
        reach = camera.distance * math.tan(math.radians(0.5 * camera.field)) if camera.field else 0.5 * camera.width
        size_of_cell = max(1.5 * 2.0 * reach / self.width, 0.005) if cell_size is None else cell_size
        self.cell = positive(size_of_cell, "cell_size", "m")
        self.bounds = self._window(scene.terrain.raster.bounds, reach)
        self.device = scene.courses.device
        self.kernels = kernels.build(wp.float32)

    def _window(self, ground: tuple[float, float, float, float], reach: float) -> tuple[float, float, float, float]:
        """The part of the ground that the camera may see."""
        camera = self.camera
        x, y = camera.target
        far = 2.2 * reach + (camera.distance if camera.tilt < 60.0 else 0.0)
        near = 1.6 * reach
        c, s = math.cos(math.radians(camera.heading)), math.sin(math.radians(camera.heading))
        corners = np.array([[-near, -far], [-near, far], [far, -far], [far, far]]) @ np.array([[c, s], [-s, c]])
        low, high = corners.min(axis=0) + (x, y), corners.max(axis=0) + (x, y)
        west, south = max(ground[0], low[0]), max(ground[1], low[1])
        east, north = min(ground[2], high[0]), min(ground[3], high[1])
        if not (west < east and south < north):
            raise InputError(f"Camera.target {camera.target} shows nothing of the terrain; it lies within {ground}")
        # Whole cells, whose centres all lie on the ground.
        columns, rows = (max(2, math.floor(v / self.cell + 1e-9)) for v in (east - west, north - south))
        return west, north - rows * self.cell, west + columns * self.cell, north

    def shots(
        self, moments: FloatArray, leaves: int, loop: float | None, skip: int | None = None
    ) -> Iterator[ByteArray]:
        """Pictures at moments; the first ``skip`` (all but the last by default) only let the foam gather."""
        not_negative(leaves, "leaves")
        skipped = len(moments) - 1 if skip is None else skip
        # Foam is softer than waves: larger cells do.
        wide = self.cell * max(1.0, round(FOAM_CELL / self.cell))
        drifting: Iterator[LeafFrame | None]
        drifting = iter(self.scene.drift(moments, leaves=leaves)) if leaves else iter([None] * len(moments))
        foam, made, view = None, None, self._view()
        step = float(np.diff(moments[:2])[0]) if len(moments) > 1 else 0.0
        frames = self.scene.frames(self.bounds, self.cell, moments[skipped:], loop=loop)
        for k, (coarse, afloat) in enumerate(zip(self._coarse(wide, moments, loop), drifting, strict=True)):
            foam = Foam(coarse) if foam is None else foam
            cover = foam.step(coarse, step)
            if k >= skipped:
                frame = next(frames)
                made = self._scene(frame) if made is None else made
                yield self._shot(frame, made, view, (coarse, cover), afloat)

    def _coarse(self, cell_size: float, moments: FloatArray, loop: float | None) -> Iterator[WaterGrid]:
        """The water on larger cells, from which foam is made."""
        west, south, east, north = self.bounds
        shape = (math.ceil((north - south) / cell_size), math.ceil((east - west) / cell_size))
        surface = self.scene.water_surface
        for moment in moments:
            where = ((west, north), cell_size, shape, float(moment))
            yield surface.on_grid(*where) if loop is None else surface.loop_grid(*where, loop)

    def _view(self) -> Any:
        camera, view = self.camera, self.kernels.View()
        heading, tilt = math.radians(camera.heading), math.radians(camera.tilt)
        forward = np.array([math.cos(heading) * math.cos(tilt), math.sin(heading) * math.cos(tilt), -math.sin(tilt)])
        right = np.array([math.sin(heading), -math.cos(heading), 0.0])
        up = np.cross(right, forward)
        (level,) = self.scene.bed([camera.target])
        corner = np.array([self.bounds[0] + 0.5 * self.cell, self.bounds[3] - 0.5 * self.cell])
        target = np.array([*(np.array(camera.target) - corner), level - self._datum])
        half = 0.5 * camera.width if camera.field == 0.0 else math.tan(math.radians(0.5 * camera.field))
        self._axes = (target - camera.distance * forward, forward, right, up, half)
        view.eye, view.forward = wp.vec3f(*self._axes[0]), wp.vec3f(*forward)
        view.right = wp.vec3f(*(half * right))
        view.up = wp.vec3f(*(half * self.height / self.width * up))
        # The sun stands to the left behind what is seen, where water glitters.
        toward = heading + math.radians(35.0)
        low = math.radians(38.0)
        view.sun = wp.vec3f(math.cos(toward) * math.cos(low), math.sin(toward) * math.cos(low), math.sin(low))
        view.parallel = int(camera.field == 0.0)
        view.width, view.height = RAYS * self.width, RAYS * self.height
        return view

    @property
    def _datum(self) -> float:
        return float(np.floor(np.nanmin(self.scene.terrain.raster.values.numpy())))

    def _scene(self, frame: Frame) -> Any:
        """Fields that do not change: bed, distance to the water, rocks."""
        made = self.kernels.Scene()
        bed = frame.bed.numpy()
        rows, columns = bed.shape
        x = self.bounds[0] + self.cell * (np.arange(columns) + 0.5)
        y = self.bounds[3] - self.cell * (np.arange(rows) + 0.5)
        at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        shore = self._shore(at).reshape(rows, columns)
        rock = np.where((bed - self.scene.bed(at, rocks=False).reshape(rows, columns)) > 0.004, 1.0, 0.0)
        rock[_in_logs(self.scene.courses.logs, at).reshape(rows, columns)] *= -1.0
        # Where there is no ground, nothing can be seen.
        self._float_bed = np.nan_to_num(bed - self._datum, nan=-1e3).astype(np.float32)
        made.bed = wp.array(self._float_bed, device=self.device)
        made.rock = wp.array(rock.astype(np.float32), device=self.device)
        made.shore = wp.array(shore.astype(np.float32), device=self.device)
        made.cell_size = self.cell
        return made

    def _shore(self, at: FloatArray) -> FloatArray:
        """How far places lie below the water, or above it, m; less far up where floods keep the ground bare."""
        courses = self.scene.courses
        found = courses.survey(at)
        point = np.maximum(found.point, 0)
        kinds = np.array([course.channel_type for course in courses.courses])[courses.course_of_point]
        share = np.where(np.isin(kinds, THREADED)[point], BARE_BARS, 1.0)
        # Point bars lie along the inner banks of bends.
        bent = np.where(np.isin(kinds, BENDING), courses.joined("curvature") * courses.joined("width"), 0.0)[point]
        inner = np.where(found.across * bent > 0.0, np.abs(bent), 0.0)
        share *= 1.0 - (1.0 - BARE_POINTS) * _step(0.0, 2.0 * BEND, inner)
        shore = np.where(found.depth < 0.0, share * found.depth, found.depth)
        return np.where(found.point >= 0, shore, -10.0)

    def _shot(
        self, frame: Frame, made: Any, view: Any, foam: tuple[WaterGrid, DeviceArray], leaves: LeafFrame | None
    ) -> ByteArray:
        water = (frame.water.elevation.numpy() - self._datum).astype(np.float32)
        # Below dry ground the water's surface goes on as it does beside it, so that its edge is smooth.
        water = np.where(np.isnan(water), self._float_bed - 0.05, water)
        made.water = wp.array(water.astype(np.float32), device=self.device)
        coarse, cover = foam
        white = np.clip(0.45 * coarse.effervescence.numpy() + 0.75 * cover.numpy(), 0.0, 1.0)
        made.white = wp.array(_step(0.2, 0.85, white).astype(np.float32), device=self.device)
        made.white_scale = self.cell / coarse.cell_size
        made.top = float(max(self._float_bed.max(), water.max())) + 0.01
        shape = (view.height, view.width)
        color = wp.empty(shape, dtype=wp.vec3f, device=self.device)
        far = wp.empty(shape, dtype=wp.float32, device=self.device)
        launch_kernel(self.kernels.shade_pixels, shape, [made, view], [color, far], device=self.device)
        rays = color.numpy().reshape(self.height, RAYS, self.width, RAYS, 3)
        picture = rays.mean(axis=(1, 3)).astype(np.float64)
        if leaves is not None:
            depth = far.numpy().reshape(self.height, RAYS, self.width, RAYS).max(axis=(1, 3))
            self._strew(picture, depth, leaves)
        return _displayed(picture)

    def _strew(self, picture: FloatArray, far: FloatArray, leaves: LeafFrame) -> None:
        """Draw leaves as ellipses that lie on the water, where nothing stands before them."""
        eye, forward, right, up, half = self._axes
        corner = np.array([self.bounds[0] + 0.5 * self.cell, self.bounds[3] - 0.5 * self.cell])
        xyz = np.column_stack([leaves.xy - corner, leaves.elevation - self._datum + 0.004])
        off = xyz - eye
        depth = off @ forward
        parallel = self.camera.field == 0.0
        scale = np.full(len(off), half) if parallel else half * np.maximum(depth, 1e-6)
        pixels = 0.5 * self.width / scale
        column = 0.5 * self.width + pixels * (off @ right)
        row = 0.5 * self.height - pixels * (off @ up)
        reach = int(np.clip(np.ceil(pixels.max(initial=1.0) * LEAF_LENGTH * 0.5), 1, 40))
        u, v = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
        j = np.round(column)[:, None] + u.ravel()
        i = np.round(row)[:, None] + v.ravel()
        # From the pixel back onto the water: foreshortened along the line of sight.
        flat = np.array([forward[0], forward[1]])
        flat = flat / max(float(np.hypot(*flat)), 1e-9) if np.hypot(*flat) > 1e-6 else up[:2]
        sine = max(float(-forward[2]), 0.15)
        aside = (j - column[:, None]) / pixels[:, None]
        along = -(i - row[:, None]) / pixels[:, None] / sine
        x, y = (aside * right[k] + along * flat[k] for k in (0, 1))
        c, s = np.cos(leaves.heading)[:, None], np.sin(leaves.heading)[:, None]
        long, short = c * x + s * y, c * y - s * x
        least = 0.5 / pixels[:, None]
        inside = (long / np.maximum(0.5 * LEAF_LENGTH, least)) ** 2 + (
            short / np.maximum(0.22 * LEAF_LENGTH, least)
        ) ** 2 < 1.0
        inside &= (i >= 0) & (i < self.height) & (j >= 0) & (j < self.width) & (depth[:, None] > 0.0)
        leaf, place = np.nonzero(inside)
        i, j = i[leaf, place].astype(int), j[leaf, place].astype(int)
        ray = depth[leaf] if parallel else np.sqrt((off[leaf] ** 2).sum(axis=1))
        seen = (far[i, j] < 0.0) | (ray < far[i, j] + 0.15)
        picture[i[seen], j[seen]] = LEAF_COLORS[leaf[seen] % len(LEAF_COLORS)]


def _in_logs(logs: Sequence[Log], at: FloatArray) -> FlagArray:
    """Which places lie below the trunk of a log."""
    inside = np.zeros(len(at), bool)
    for log in logs:
        start, toward = np.array(log.start), np.subtract(log.end, log.start)
        part = np.clip((at - start) @ toward / max(float(toward @ toward), 1e-12), 0.0, 1.0)
        inside |= np.hypot(*(at - start - part[:, None] * toward).T) < 0.55 * log.diameter
    return inside


def _step(low: float, high: float, x: NDArray[Any]) -> NDArray[Any]:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _displayed(picture: FloatArray) -> ByteArray:
    """From linear light to the bytes of a screen: bright places are rolled off, then sRGB."""
    light = np.maximum(picture, 0.0) * 1.15
    light = light * (1.0 + light / 9.0) / (1.0 + 0.45 * light)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1.0 / 2.4) - 0.055)
    return (255.0 * np.clip(coded, 0.0, 1.0) + 0.5).astype(np.uint8)
