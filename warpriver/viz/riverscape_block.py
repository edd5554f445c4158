"""3-D previews of riverscapes by pyvista: a block of ground and water with the colours of the shading."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.files import in_memory
from warpriver.public import public
from warpriver.riverscape.scene import Riverscape
from warpriver.validate import not_negative, positive
from warpriver.viz.riverscapes import top_view
from warpriver.viz.scene import add_block, aim, new_plotter
from warpriver.viz.sheet import check_picture, replacing

__all__ = ["render_riverscape"]


# Cells of a block at most.
MOST_CELLS = 4_000_000


class _Block:
    """Ground and water as one surface."""

    ambient, drop = 0.45, 0.0

    def __init__(self, window: tuple[float, float, float, float], cell_size: float, height: FloatArray):
        self.window = window
        west, south, east, north = window
        self.origin = np.array([0.5 * (west + east), 0.5 * (south + north)])
        rows, columns = height.shape
        # From the south, as the plotter has it.
        self._x = np.asarray(west + cell_size * (np.arange(columns) + 0.5), np.float64)
        self._y = np.asarray(south + cell_size * (np.arange(rows) + 0.5), np.float64)
        self._z = height[::-1]
        self.top = float(self._z.max())

    def grid(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Places along both axes, and heights over the lowest one, m."""
        return self._x, self._y, self._z


@public
def render_riverscape(
    scene: Riverscape,
    path: str | os.PathLike[str],
    *,
    bounds: Sequence[float] | FloatArray | None = None,
    cell_size: float | None = None,
    time: float = 0.0,
    size: tuple[int, int] = (1280, 800),
    exaggeration: float = 1.0,
    camera: Sequence[Sequence[float]] | None = None,
) -> None:
    """Write an oblique 3-D view of a block of a riverscape, drawn off-screen by pyvista.

    Its colours are those of :func:`draw_riverscape`, seen from above: bed through the water, sky, foam.

    Args:
        scene: The riverscape.
        path: File to write (.png or .jpg).
        bounds: (west, south, east, north) of the block in m; by default those of the terrain.
        cell_size: m; by default such that the block is 800 cells long.
        time: s.
        size: Width and height in pixels.
        exaggeration: Factor on heights; 0 for flat ground.
        camera: Position, focal point and up direction, three (x, y, z) in m with z = 0 at the lowest height in the
            block, and heights exaggerated; by default a view from the south that holds the whole block.

    Raises:
        RuntimeError: This machine cannot draw off-screen; the message says what to install.
        ImportError: pyvista is missing.
        ValueError: No such grid, or a size, exaggeration or camera that makes no sense.
        OSError: The file cannot be written.
    """
    check_picture(path, (".png", ".jpg"))
    if min(size) < 16:
        raise InputError(f"size is {tuple(size)} pixels; give at least (16, 16)")
    factor = not_negative(exaggeration, "exaggeration")
    if camera is not None and np.shape(camera) != (3, 3):
        raise InputError("camera: give position, focal point and up direction, each (x, y, z) in m")
    west, south, east, north = scene.terrain.raster.bounds if bounds is None else (float(v) for v in bounds)
    cell = max(east - west, north - south) / 800.0 if cell_size is None else positive(cell_size, "cell_size", "m")
    if max(east - west, 0.0) * max(north - south, 0.0) > MOST_CELLS * cell**2:
        raise InputError(
            f"{(north - south) / cell:.0f} x {(east - west) / cell:.0f} cells are too many for a preview, "
            f"{MOST_CELLS} at most; use a coarser cell size or a part of it"
        )
    (frame,) = scene.frames(bounds, cell, [time])
    rows, columns = frame.water.shape
    bed = frame.bed.numpy()
    height = np.fmax(bed, np.where(frame.depth > 0.0, frame.water.elevation.numpy(), np.nan))
    height = np.where(np.isnan(height), np.nanmin(height), height)
    window = (west, north - rows * cell, west + columns * cell, north)
    block = _Block(window, cell, factor * (height - height.min()))
    with replacing(path, (".png", ".jpg")) as temporary:
        plotter = new_plotter(size)
        try:
            add_block(plotter, block, top_view(scene, window, cell, time))
            aim(plotter, block, camera)
            image = np.asarray(plotter.screenshot(None, return_img=True))[..., :3]
        finally:
            plotter.close()
        pixels = image.reshape(size[1], 2, size[0], 2, 3).mean(axis=(1, 3)).round().astype(np.uint8)
        with IMPORTING:
            from PIL import Image

        with in_memory(temporary) as buffer:
            Image.fromarray(pixels).save(buffer, "PNG" if temporary.lower().endswith(".png") else "JPEG")
