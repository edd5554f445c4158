"""Movies of a growing channel belt: GIF by Pillow, MP4 by imageio-ffmpeg."""

from __future__ import annotations

import itertools
import os
import pathlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from warpriver.errors import InputError, MissingExtraError
from warpriver.files import in_memory
from warpriver.history import History
from warpriver.landscape.maps import Landscape
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.validate import one_of
from warpriver.viz.belt import BeltSheet, belt_ramps, checked_record, history_bounds
from warpriver.viz.landscape import LandscapeSheet
from warpriver.viz.sheet import check_drawing, color_ramp, replacing

__all__ = ["movie"]


@public
def movie(
    history: History,
    path: str | os.PathLike[str],
    *,
    terrain: Terrain | None = None,
    fps: float = 12.0,
    size: tuple[int, int] = (1280, 720),
    window: Sequence[float] | None = None,
    every: int = 1,
    title: str | None = None,
    dpi: float = 100.0,
    hold: float = 2.0,
    look: str = "belt",
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a movie of the channel belt as :func:`warpriver.viz.draw_belt` draws it, one frame a record.

    Window, colours and scale of age are those of the whole history and stay fixed. Each frame adds its record
    to the picture of the one before, so that the time taken grows with the number of frames and no faster.

    Args:
        history: The run.
        path: File to write: .gif, or .mp4, which needs ``warpriver[movie]``.
        terrain: Terrain whose shaded relief is drawn as the ground; by default the ground is plain.
        fps: Frames a second, above 0 and at most 60.
        size: Width and height in pixels; both even for .mp4.
        window: (west, south, east, north) to show, in m; by default everything. It grows to fill the frame.
        every: Show every n-th record; the last one is always shown.
        title: Title at the upper left; None writes "Channel belt", "" leaves the line out.
        dpi: Pixels per inch: sets the size of letters.
        hold: Time in s for which the last frame stays.
        look: "belt", or "landscape": sand, plants and lakes as :func:`warpriver.viz.draw_landscape` draws them.
        progress: Called after each frame with the number of frames done and their total.

    Raises:
        ImportError: matplotlib is missing, or, for .mp4, imageio-ffmpeg.
        ValueError: No record, a rate, size, step or window out of range, or an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing()
    last = checked_record(history, None)
    suffix = pathlib.Path(path).suffix.lower()
    if not 0.0 < fps <= 60.0:
        raise InputError(f"fps is {fps:g}; give more than 0 and at most 60 frames a second")
    if every < 1:
        raise InputError(f"every is {every}; give 1 or more")
    if suffix == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise InputError(f"size is {tuple(size)} pixels; .mp4 needs even numbers")
    records = [*range(0, last, every), last]
    layout = {
        "window": window,
        "size": size,
        "dpi": dpi,
        "title": title,
        "terrain": terrain,
        "bounds": history_bounds(history, last),
    }
    if one_of(look, "look", ("belt", "landscape")) == "landscape":
        write_frames(path, _landscape_frames(history, records, layout, progress), fps=fps, hold=hold)
        return
    write_frames(path, _frames(history, records, layout, progress), fps=fps, hold=hold, ramps=belt_ramps(history))


def write_frames(
    path: str | os.PathLike[str],
    frames: Iterator[np.ndarray],
    *,
    fps: float,
    hold: float,
    ramps: Sequence[Any] = (),
) -> None:
    """Write pictures of one size as a movie that appears whole, or not at all.

    Args:
        path: File to write: .gif, or .mp4, which needs ``warpriver[movie]``.
        frames: Pictures (rows, columns, 3) uint8; both even for .mp4. The last one holds the colours of all: a .gif
            has one palette, so that nothing flickers.
        fps: Frames a second.
        hold: Time in s for which the last frame stays.
        ramps: Ramps of colours that must not band in a .gif.
    """
    is_mp4 = pathlib.Path(path).suffix.lower() == ".mp4"
    sent = 0

    def check(written: pathlib.Path) -> None:
        if (found := _count_mp4_frames(written)) != sent:
            raise InputError(f"{found} of {sent} frames")

    with replacing(path, (".gif", ".mp4"), check=check if is_mp4 else None) as temporary:
        if is_mp4:
            first = next(frames)
            rows, columns = first.shape[:2]
            sent = _mp4_writer()(temporary, itertools.chain([first], frames), fps, (columns, rows), hold)
        else:
            _write_gif(temporary, frames, fps, hold, ramps)


def _frames(
    history: History,
    records: Sequence[int],
    layout: dict[str, Any],
    progress: Callable[[int, int], None] | None,
) -> Iterator[np.ndarray]:
    """Yield the picture of each record in turn, (rows, columns, 3) uint8."""
    page = BeltSheet(history, **layout)
    for done, record in enumerate(records, start=1):
        page.turn_to(record)
        yield page.pixels()
        if progress is not None:
            progress(done, len(records))


def _landscape_frames(
    history: History,
    records: Sequence[int],
    layout: dict[str, Any],
    progress: Callable[[int, int], None] | None,
) -> Iterator[np.ndarray]:
    """Yield the landscape at each record in turn, (rows, columns, 3) uint8."""
    options = {name: layout[name] for name in ("window", "size", "dpi", "title")}
    terrain = layout["terrain"]
    page = LandscapeSheet(
        history, "natural", terrain, None, records[-1], legend=True, frame=True, ax=None, **options
    )  # fmt: skip
    page.add_legend()
    landscape = Landscape(history, terrain, page.cell_size, bounds=page.sheet.window)
    for done, record in enumerate(records, start=1):
        landscape.lead_to(record)
        page.show(landscape.maps())
        page.sheet.canvas.draw()
        yield np.ascontiguousarray(np.asarray(page.sheet.canvas.buffer_rgba())[..., :3])
        if progress is not None:
            progress(done, len(records))


def _write_gif(path: str, frames: Iterator[np.ndarray], fps: float, hold: float, ramps: Sequence[Any]) -> None:
    """Write a looping GIF with the palette of its last frame."""
    from PIL import Image

    # On disk until the last one is there.
    with tempfile.TemporaryFile() as kept:
        count = 0
        for sample in frames:
            kept.write(sample.tobytes())
            count += 1
        kept.seek(0)
        # The legend's colours are few but must not band: a patch of them gives them weight in the palette.
        ramp = np.linspace(0.0, 1.0, sample.shape[1])
        patch = np.array([color_ramp(stops, ramp) for stops in ramps]).reshape(-1, *sample.shape[1:])
        patch = np.repeat(np.round(255.0 * patch).astype(np.uint8), max(1, sample.shape[0] // 6), axis=0)
        palette = Image.fromarray(np.concatenate([sample, patch])).quantize(256, method=Image.Quantize.MEDIANCUT)
        pictures = [
            Image.frombytes("RGB", sample.shape[1::-1], kept.read(sample.size)).quantize(
                palette=palette, dither=Image.Dither.NONE
            )
            for _ in range(count)
        ]
    # GIF counts in hundredths of a second, and viewers slow down what is faster than two of them.
    tick = 10 * max(2, round(100.0 / fps))
    duration = [tick] * (len(pictures) - 1) + [max(tick, round(1000.0 * hold))]
    options = {"save_all": True, "append_images": pictures[1:], "duration": duration, "loop": 0, "optimize": False}
    with in_memory(path) as buffer:
        pictures[0].save(buffer, "GIF", **options)


def _mp4_writer() -> Callable[[str, Iterator[np.ndarray], float, tuple[int, int], float], int]:
    """Return the function that writes .mp4 files and counts frames, or raise ``ImportError`` with what to install."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise MissingExtraError(
            'an .mp4 movie needs imageio-ffmpeg: pip install "warpriver[movie]"; a .gif does without it'
        ) from error

    def write(path: str, frames: Iterator[np.ndarray], fps: float, size: tuple[int, int], hold: float) -> int:
        sent = 0
        stream = imageio_ffmpeg.write_frames(
            path, size, fps=fps, codec="libx264", quality=8, macro_block_size=2, ffmpeg_log_level="error"
        )
        stream.send(None)
        try:
            for frame in frames:
                stream.send(frame)
                sent += 1
            for _ in range(round(hold * fps)):
                stream.send(frame)
                sent += 1
        finally:
            stream.close()
        return sent

    return write


def _count_mp4_frames(path: pathlib.Path) -> int:
    """Count the frames that a whole .mp4 file lists, 0 where it is cut: ffmpeg's exit code is not handed on to us."""
    data = path.read_bytes()
    first, last = 0, len(data)
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsz"):
        boxes = {}
        while first + 8 <= last:
            size, kind = int.from_bytes(data[first : first + 4], "big"), data[first + 4 : first + 8]
            head = 8
            if size == 1:
                head, size = 16, int.from_bytes(data[first + 8 : first + 16], "big")
            boxes[kind] = (first + head, first + size)
            if size < head or first + size > last:
                return 0
            first += size
        if first != last or name not in boxes:
            return 0
        first, last = boxes[name]
    return int.from_bytes(data[first + 8 : first + 12], "big")
