"""Tests of names that look like addresses, and of files that are something else, or far more, than they say."""

import gzip
import io
import os
import struct
import subprocess
import sys
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest
from river_files import needs_ogr
from test_sentinels import valley, write_tif

import warpriver.io.files as files
from warpriver import RiverNetwork, Terrain
from warpriver.io import read_network, read_raster, read_terrain, write_network, write_terrain

ODD = [
    "a!b", "!GIS", "a;b", "a#b", "a?b", "a?b=c", "a%20b", "a b", " a", "a\tb", "zip:a", "http:a", "file:a", "GPKG:a",
    "~a", "a*b",
    "a'b", "a&b", "a,b", "a|b", "[a]", "{a}", "\u00e9\u6cb3", "a.zip", "a.b.c", "$HOME", "-a", "@a", "a\\b",
]  # fmt: skip


def line():
    return RiverNetwork.from_polylines([[(0.0, 0.0), (400.0, 5.0), (900.0, 0.0)]], width=30.0, crs="EPSG:32633")


@needs_ogr
@pytest.mark.parametrize("suffix", [".gpkg", ".shp", ".fgb", ".parquet", ".geojson", ".csv"])
@pytest.mark.parametrize("where", ["file", "folder"])
def test_a_name_is_the_name_of_a_file(tmp_path, monkeypatch, suffix, where):
    """GDAL and the libraries above it take some for addresses, for archives, or for files elsewhere."""
    write_network(line(), tmp_path / f"plain{suffix}")
    beside = [f for f in tmp_path.iterdir() if f.stem == "plain"]
    (tmp_path / f"b{suffix}").write_bytes(b"of somebody else")
    monkeypatch.chdir(tmp_path)
    points = line().points().tolist()
    for odd in ODD:
        folder = tmp_path / (odd if where == "folder" else "in")
        folder.mkdir(exist_ok=True)
        stem = odd if where == "file" else "river"
        for file in beside:
            (folder / f"{stem}{file.suffix}").write_bytes(file.read_bytes())
        network = read_network(
            os.path.join(folder.name, stem + suffix) if where == "folder" else folder / (stem + suffix)
        )
        assert network.crs == "EPSG:32633" and network.points().tolist() == points, odd
    assert (tmp_path / f"b{suffix}").read_bytes() == b"of somebody else"


@pytest.mark.parametrize("suffix", [".tif", ".asc", ".npz", ".png"])
def test_a_name_is_the_name_of_a_raster(tmp_path, monkeypatch, suffix):
    pytest.importorskip("rasterio")
    monkeypatch.chdir(tmp_path)
    terrain = Terrain(valley(), 30.0, (5e5, 5e6), "EPSG:32633")
    write_terrain(terrain, tmp_path / f"plain{suffix}")
    beside = [f for f in tmp_path.iterdir() if f.name.startswith("plain.")]
    for odd in ODD:
        for file in beside:
            (tmp_path / file.name.replace("plain", odd, 1)).write_bytes(file.read_bytes())
        for path in (odd + suffix, tmp_path / f"{odd}{suffix}"):
            read = read_terrain(path)
            np.testing.assert_allclose(read.to_numpy(), terrain.to_numpy(), atol=1e-3)
            assert read.crs == "EPSG:32633", odd


def test_gdal_opens_no_virtual_file_system(tmp_path):
    for name in (
        "/vsicurl/http://localhost:9/a.tif",
        "/vsimem/a.gpkg",
        "http://localhost:9/a.gpkg",
        "zip://a.zip!b.shp",
    ):
        with pytest.raises((FileNotFoundError, ValueError), match=r"there is no such file|names no format"):
            (read_terrain if name.endswith("tif") else read_network)(name)


# ---- something else than the name says


VRT = """<VRTDataset rasterXSize="40" rasterYSize="30"><GeoTransform>0,30,0,900,0,-30</GeoTransform>
<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename relativeToVRT="0">{0}</SourceFilename>
<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"""
OGR_VRT = """<OGRVRTDataSource><OGRVRTLayer name="private"><SrcDataSource>{0}</SrcDataSource>
</OGRVRTLayer></OGRVRTDataSource>"""


@pytest.mark.parametrize("suffix", [".tif", ".tiff", ".dem", ".img", ".bil", ".flt", ".sdat", ".hgt"])
def test_a_virtual_raster_by_another_name_reads_nothing(tmp_path, suffix):
    private = write_tif(tmp_path / "private.tif", valley())
    (tmp_path / f"a{suffix}").write_text(VRT.format(private))
    for read in (read_terrain, read_raster):
        with pytest.raises(ValueError, match=rf"a\{suffix}: not an? .* that rasterio can open") as caught:
            read(tmp_path / f"a{suffix}")
        assert "private" not in str(caught.value).replace(str(tmp_path), "")


@needs_ogr
@pytest.mark.parametrize("suffix", [".gpkg", ".shp", ".fgb"])
def test_virtual_lines_by_another_name_read_nothing(tmp_path, suffix):
    write_network(line(), tmp_path / "private.geojson")
    for text in (OGR_VRT.format(tmp_path / "private.geojson"), (tmp_path / "private.geojson").read_text()):
        (tmp_path / f"a{suffix}").write_text(text)
        with pytest.raises(ValueError, match=rf"a\{suffix}: cannot be read as .*, it does not begin like one"):
            read_network(tmp_path / f"a{suffix}")


def test_a_picture_by_another_name_is_no_height_map(tmp_path):
    image = pytest.importorskip("PIL.Image")
    image.new("L", (9, 9)).save(tmp_path / "a.gif")
    (tmp_path / "a.gif").rename(tmp_path / "a.png")
    with pytest.raises(ValueError, match="not a PNG file"):
        read_terrain(tmp_path / "a.png", range=(0.0, 1.0), cell_size=1.0)


def test_labels_with_a_document_type_are_refused(tmp_path):
    write_terrain(Terrain(valley(), 30.0), tmp_path / "a.asc")
    bomb = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><PAMDataset>&b;</PAMDataset>'
    (tmp_path / "a.asc.aux.xml").write_text(bomb)
    with pytest.raises(ValueError, match="holds a document type"):
        read_terrain(tmp_path / "a.asc")


# ---- far more than the name says


def npz(path, name, shape, dtype="<f8", body=b"", stated=None):
    """An archive of an array of that shape, whose numbers are ``body`` over and over."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": dtype, "fortran_order": False, "shape": stated or shape})
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open(f"{name}.npy", "w") as file:
        file.write(header.getvalue())
        block = body or bytes(1 << 20)
        for _ in range(size // len(block)):
            file.write(block)
        file.write(block[: size % len(block)])


def peak(call):
    """The most memory that Python and NumPy hold while something is refused, in bytes."""
    tracemalloc.start()
    try:
        with pytest.raises((ValueError, MemoryError)) as caught:
            call()
        return tracemalloc.get_traced_memory()[1], str(caught.value)
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("shape", "name", "words"),
    [
        ((2048, 2048), "height", r"bytes unpack to 0\.0336 GB or more, which no file of measurements does"),
        ((4, 1024, 1024), "height", r"an array of shape \(4, 1024, 1024\)"),
        ((1 << 22,), "crs", "too much for a word or a few numbers"),
    ],
    ids=["cells", "no raster", "crs"],
)
def test_an_archive_is_looked_at_before_it_is_unpacked(tmp_path, monkeypatch, shape, name, words):
    monkeypatch.setattr(files, "ALWAYS_UNPACKED", 1 << 20)
    npz(tmp_path / "a.npz", name, shape)
    if name == "crs":
        with zipfile.ZipFile(tmp_path / "a.npz", "a") as archive, archive.open("height.npy", "w") as file:
            np.lib.format.write_array(file, valley())
    assert (tmp_path / "a.npz").stat().st_size < 2e6
    most, text = peak(lambda: read_terrain(tmp_path / "a.npz"))
    assert most < 5e6
    with pytest.raises(ValueError, match=words):
        raise ValueError(text)


def test_an_archive_that_promises_more_than_it_holds(tmp_path):
    npz(tmp_path / "a.npz", "height", (10, 10), stated=(100_000, 100_000))
    most, text = peak(lambda: read_terrain(tmp_path / "a.npz"))
    assert "cut short" in text and most < 1e7


def test_an_archive_of_objects_runs_nothing(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "ran"),)

    np.savez(tmp_path / "a.npz", height=np.array([[Bomb(), Bomb()], [Bomb(), Bomb()]], object))
    np.save(tmp_path / "b.npy", np.array([[Bomb(), Bomb()], [Bomb(), Bomb()]], object))
    np.savez(tmp_path / "c.npz", height=valley(), cell_size=30.0, crs=np.array(Bomb(), object))
    for name in ("a.npz", "b.npy", "c.npz"):
        with pytest.raises(ValueError, match=name.replace(".", r"\.")):
            read_terrain(tmp_path / name, cell_size=30.0)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("damage", ["npy", "cut", "encrypted", "not zip"])
def test_damaged_archives_are_one_sentence(tmp_path, damage):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, height=valley(), cell_size=30.0)
    data = path.read_bytes()
    if damage == "npy":
        np.save(tmp_path / "b.npy", valley())
        path.write_bytes((tmp_path / "b.npy").read_bytes())
        np.testing.assert_array_equal(read_terrain(path, cell_size=30.0).to_numpy(), valley())
        return
    if damage == "cut":
        data = data[: len(data) // 2]
    elif damage == "encrypted":
        at = data.index(b"PK\x01\x02")
        data = data[: at + 8] + struct.pack("<H", 1) + data[at + 10 :]
    else:
        data = b"PK" + bytes(100)
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"a\.npz: cannot be read as NumPy's \.npz"):
        read_terrain(path)


@pytest.mark.parametrize("suffix", [".csv.gz", ".geojson.gz", ".txt.gz"])
def test_a_packed_text_is_unpacked_within_limits(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(files, "ALWAYS_UNPACKED", 1 << 20)
    path = tmp_path / f"a{suffix}"
    with gzip.open(path, "wb") as file:
        for _ in range(32):
            file.write(b"0 " * (1 << 19))  # 32 MB
    most, text = peak(lambda: read_network(path))
    assert "unpack to" in text and most < 1.5e7


def test_a_packed_text_of_measurements_is_read(tmp_path):
    xy = np.cumsum(np.random.default_rng(0).normal(20.0, 3.0, (20_000, 2)), axis=0)
    with gzip.open(tmp_path / "a.csv.gz", "wt") as file:
        file.writelines(f"{x},{y}\n" for x, y in xy.tolist())
    assert read_network(tmp_path / "a.csv.gz", width=9.0).point_count == 20_000


def test_text_that_does_not_fit_into_memory_is_told_before_it_is_read(tmp_path, monkeypatch):
    (tmp_path / "a.csv").write_text("0,0\n1,1\n2,2\n" * 1000)
    monkeypatch.setattr(files, "available_memory", lambda: 50_000)
    with pytest.raises(MemoryError, match=r"a\.csv: .* GB of text or more, and there is memory to read"):
        read_network(tmp_path / "a.csv", width=1.0)
    with gzip.open(tmp_path / "a.csv.gz", "wb") as file:
        file.write((tmp_path / "a.csv").read_bytes())
    with pytest.raises(MemoryError, match=r"a\.csv\.gz: "):
        read_network(tmp_path / "a.csv.gz", width=1.0)


def test_parquet_that_unpacks_to_far_more_is_refused(tmp_path, monkeypatch):
    geopandas = pytest.importorskip("geopandas")
    pytest.importorskip("pyarrow")
    from shapely.geometry import LineString

    shapes = [LineString([(0, k), (9, k + 1), (20, k)]) for k in range(0, 5000, 50)]
    geopandas.GeoDataFrame({"width": np.arange(1.0, 101.0)}, geometry=shapes).to_parquet(tmp_path / "a.parquet")
    assert read_network(tmp_path / "a.parquet", short="keep").channel_count == 100
    monkeypatch.setattr(files, "ALWAYS_UNPACKED", 1000)
    monkeypatch.setattr(files, "MAX_UNPACKED", 0)
    with pytest.raises(ValueError, match=r"a\.parquet: \d+ bytes unpack to"):
        read_network(tmp_path / "a.parquet")


def test_json_that_is_nested_too_deeply_is_one_sentence(tmp_path):
    (tmp_path / "a.geojson").write_text('{"type": "LineString", "coordinates": ' + "[" * 100_000)
    with pytest.raises(ValueError, match=r"a\.geojson: not whole JSON"):
        read_network(tmp_path / "a.geojson")


def test_a_png_of_many_pixels_is_told_from_its_header(tmp_path):
    pytest.importorskip("PIL")
    head = struct.pack(">IIBBBBB", 2_000_000, 2_000_000, 16, 0, 0, 0, 0)
    chunk = b"IHDR" + head
    data = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(MemoryError, match="2000000 x 2000000 cells"):
        read_terrain(tmp_path / "a.png", range=(0.0, 1.0), cell_size=1.0)


# ---- a GeoPackage that somebody has open


HOLDER = """
import os, sqlite3, sys
holder = sqlite3.connect(sys.argv[1], isolation_level=None)
holder.execute("PRAGMA journal_mode=WAL").fetchone()
holder.execute("PRAGMA wal_autocheckpoint=0")
for (name,) in holder.execute("SELECT name FROM sqlite_master WHERE type='trigger'").fetchall():
    holder.execute(f'DROP TRIGGER "{name}"')
holder.execute("UPDATE channels SET width_m = 44.0")
print("ready", flush=True)
if sys.stdin.readline().strip() == "crash":
    os._exit(0)
print(holder.execute("SELECT width_m FROM channels").fetchone()[0], flush=True)
"""


@needs_ogr
@pytest.mark.parametrize("end", ["close", "crash"])
@pytest.mark.parametrize("name", ["a", "a!b"])
def test_a_geopackage_that_another_program_has_open_is_read_as_it_stands(tmp_path, end, name):
    write_network(line(), tmp_path / "plain.gpkg")
    path = (tmp_path / "plain.gpkg").rename(tmp_path / f"{name}.gpkg")
    command = [sys.executable, "-c", HOLDER, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "ready\n"
        if end == "crash":
            holder.communicate("crash\n")
        assert read_network(path).channel_width.tolist() == [44.0]
        if end == "close":
            assert path.with_name(f"{path.name}-wal").stat().st_size > 0, "what is not yet in the file stays"
            assert holder.communicate("close\n")[0] == "44.0\n"
    assert read_network(path).channel_width.tolist() == [44.0]
