"""Every writer on a full disk: the file in place is the old one or the new one, and a failure is told."""

import contextlib
import functools
import importlib.util
import os
import signal

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr
from warpriver.errors import PathError, WarpriverError
from warpriver.files import STAGING, beside

resource = pytest.importorskip("resource")

HEIGHTS = np.random.default_rng(0).normal(100.0, 30.0, (2, 90, 70))
CRS = "EPSG:32619" if importlib.util.find_spec("pyproj") else None


@functools.cache
def terrain(k):
    return wr.Terrain(HEIGHTS[k], 10.0, (5e5, 5e6), crs=CRS)


@functools.cache
def network(k):
    """Two long lines and many short ones, so that either the lines or the table of a shapefile is the larger."""
    lines = [wr.generate.noisy_line(9000.0, 20.0, 50.0, seed=k + j) + [5e5, 5e6 + 4000.0 * j] for j in range(2)]
    lines += [np.array([[5e5 + 500.0 * j, 4.99e6], [5e5 + 500.0 * j, 4.9902e6], [5e5, 4.991e6]]) for j in range(k, 60)]
    return wr.RiverNetwork.from_polylines(lines, width=30.0, crs=CRS)


@functools.cache
def grid(k):
    return wr.synthetic_valley("S3", length=200.0 * (1 + k)).grid(1.0)


@functools.cache
def history(k):
    line = wr.generate.noisy_line(4000.0, 40.0, 50.0, seed=k)
    return wr.Simulation(wr.RiverNetwork.from_polylines([line], width=50.0), plain_params()).run(
        steps=4, record_every=2
    )


WRITERS = {
    **{
        f"terrain{suffix}": lambda path, k: wr.write_terrain(terrain(k), path)
        for suffix in (".tif", ".asc", ".npz", ".npy", ".png", ".r16", ".raw")
    },
    **{
        f"network{suffix}": lambda path, k: wr.write_network(network(k), path)
        for suffix in (".csv", ".csv.gz", ".geojson", ".gpkg", ".shp", ".fgb", ".parquet")
    },
    **{f"mesh{suffix}": lambda path, k: wr.write_mesh(grid(k), path) for suffix in (".obj", ".ply", ".stl", ".vtp")},
    **{f"points{suffix}": lambda path, k: wr.io.valleys.write_points(grid(k), path) for suffix in (".xyz", ".npz")},
    "breaklines.geojson": lambda path, k: wr.io.valleys.write_breaklines({"a": grid(k).points()}, path),
    "valley.toml": lambda path, k: wr.io.valleys.write_valley(wr.synthetic_valley(f"S{k + 2}").params, path),
    **{
        f"map{suffix}": lambda path, k: wr.viz.draw_network(network(k), path, size=(300, 200), dpi=60)
        for suffix in (".png", ".jpg", ".pdf", ".svg")
    },
    **{
        f"movie{suffix}": lambda path, k: wr.viz.movie(history(k), path, size=(248, 422), fps=4.0, hold=0.5)
        for suffix in (".gif", ".mp4")
    },
    "run.npz": lambda path, k: history(k).save(path),
}
NEEDS = {".tif": "rasterio", ".shp": "pyogrio", ".fgb": "pyogrio", ".gpkg": "pyogrio", ".parquet": "geopandas"}
NEEDS |= {".mp4": "imageio_ffmpeg", ".vtp": "pyvista", ".gif": "matplotlib", ".jpg": "matplotlib", ".pdf": "matplotlib"}
NEEDS |= {".png": "matplotlib", ".svg": "matplotlib"}


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@contextlib.contextmanager
def room_for(count):
    """Let no file grow beyond that many bytes: a disk that is full, for this process."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (count, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_old_file_and_is_told(name, tmp_path):
    needed = NEEDS.get(os.path.splitext(name)[1])
    if needed and importlib.util.find_spec(needed) is None:
        pytest.skip(f"{needed} is missing")
    write, path, new = WRITERS[name], tmp_path / "in_place" / name, tmp_path / "new" / name
    for folder in (path.parent, new.parent):
        folder.mkdir()
    write(path, 0)
    write(new, 1)
    old, largest = contents(path.parent), max(map(len, contents(new.parent).values()))
    for fraction in (0.0, 0.6, 1.0):
        room = int(fraction * (largest - 1))
        with pytest.raises(WarpriverError, match=r"cannot") as told, room_for(room):
            write(path, 1)
        assert name in str(told.value), "the file is named"
        assert contents(path.parent) == old, f"room for {room} of {largest} bytes"


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_is_on_the_disk_before_it_takes_its_place(name, tmp_path, monkeypatch):
    needed = NEEDS.get(os.path.splitext(name)[1])
    if needed and importlib.util.find_spec(needed) is None:
        pytest.skip(f"{needed} is missing")
    synced, moved = set(), {}
    fsync, replace = os.fsync, os.replace

    def noted_fsync(descriptor):
        synced.add(os.fstat(descriptor).st_ino)
        fsync(descriptor)

    def noted_replace(source, target):
        moved[os.stat(source).st_ino] = os.stat(source).st_ino in synced
        replace(source, target)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(os, "replace", noted_replace)
    WRITERS[name](tmp_path / name, 0)
    made = {path.stat().st_ino for path in tmp_path.iterdir()}
    assert made <= set(moved) and all(moved.values()), "no file is written in place, and each is synced first"


def test_what_a_check_finds_is_told_and_the_old_file_stays(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def check(written):
        raise KeyError(written.read_text())

    with pytest.raises(PathError, match=r"cannot write .*a\.txt: what was written is not whole .*'new'"):
        with beside(path, check=check) as temporary:
            temporary.write_text("new")
    assert contents(tmp_path) == {"a.txt": b"old"}


def test_an_empty_file_is_no_file(tmp_path):
    with pytest.raises(PathError, match="nothing was written"):
        with beside(tmp_path / "a.txt") as temporary:
            temporary.touch()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("error", "kind"),
    [(FileNotFoundError, FileNotFoundError), (PermissionError, PermissionError), (BlockingIOError, OSError)],
)
def test_an_error_of_the_system_keeps_its_kind_and_number(error, kind, tmp_path):
    with pytest.raises(kind) as told, beside(tmp_path / "a.txt"):
        raise error(11, "No luck")
    assert isinstance(told.value, WarpriverError)
    assert told.value.errno == 11 and str(told.value) == f"cannot write {tmp_path / 'a.txt'}: No luck"
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(STAGING)]
