"""Landscapes in files: each is read back by the programs, or the libraries of the programs, that it is for."""

import csv
import json

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr
from warpriver.history.events import Cutoff
from warpriver.landscape import (
    carve,
    channel_ribbons,
    channel_splines,
    export_landscape,
    landscape_surfaces,
    plain_under,
    write_surfaces,
)
from warpriver.landscape.engines import ENGINES, engine_size, resampled, whole_weights

CRS, WEST, NORTH, CELL = "EPSG:32633", 500_000.0, 4_200_000.0, 10.0
ROWS, COLUMNS = 90, 130


@pytest.fixture(scope="module")
def land():
    """A carved terrain in UTM coordinates with one junction, its run and a map."""
    x, y = (np.arange(COLUMNS) + 0.5) * CELL, -(np.arange(ROWS) + 0.5) * CELL
    height = 120.0 - 0.02 * x[None] + 0.03 * np.abs(y[:, None] + 450.0)
    height[:4, :4] = np.nan
    terrain = wr.Terrain(height, CELL, (WEST, NORTH), CRS)
    s = np.linspace(0.0, 1.0, 30)[:, None]

    def line(a, b):
        return np.array(a) * (1.0 - s) + np.array(b) * s + [WEST, NORTH]

    lines = [
        line((30.0, -200.0), (600.0, -450.0)),
        line((40.0, -800.0), (600.0, -450.0)),
        line((600.0, -450.0), (1280.0, -430.0)),
    ]
    width = [np.linspace(20.0, 26.0, 30), 18.0 + 0.0 * s[:, 0], np.linspace(34.0, 44.0, 30)]
    network = wr.RiverNetwork.from_polylines(lines, width, crs=CRS)
    history = wr.Simulation(network, plain_params(), threads=1).run(steps=4, record_every=2)
    a = np.linspace(0.0, np.pi, 40)
    loop = np.column_stack([900.0 + 110.0 * np.cos(a[::-1]), -360.0 + 90.0 * np.sin(a)]) + [WEST, NORTH]
    history.events.append(Cutoff(float(history.times[-1]), 2, 20.0, loop))
    carved = carve(terrain, network, history=history)
    moisture = terrain.raster.like(np.tile(np.linspace(0.0, 3.0, COLUMNS), (ROWS, 1)), unit="m", name="moisture")
    return carved, history, {"moisture": moisture}


@pytest.fixture(scope="module")
def folder(land, tmp_path_factory):
    """All of it, exported."""
    pytest.importorskip("rasterio")
    pytest.importorskip("pyogrio")
    carved, history, maps = land
    place = tmp_path_factory.mktemp("land")
    targets = ["gis", "mesh", "paraview", *ENGINES]
    files = export_landscape(carved, place, targets=targets, history=history, maps=maps)
    assert all(file.is_file() and file.stat().st_size for file in files)
    assert len(files) == len(set(files))
    return place


# ---- rasters and lines


def test_geotiffs_have_crs_and_transform_and_the_values(land, folder):
    rasterio = pytest.importorskip("rasterio")
    carved = land[0]
    wanted = {"terrain": carved.terrain.to_numpy(), "water_level": carved.water.numpy(), "water_depth": carved.depth}
    wanted |= {f"material_{name}": raster.numpy() for name, raster in carved.materials.items()}
    wanted["moisture"] = land[2]["moisture"].numpy()
    assert {file.stem for file in (folder / "gis").glob("*.tif")} == set(wanted)
    for name, values in wanted.items():
        with rasterio.open(folder / "gis" / f"{name}.tif") as file:
            assert file.crs.to_epsg() == 32633
            assert tuple(file.transform)[:6] == (CELL, 0.0, WEST, 0.0, -CELL, NORTH)
            assert file.tags(ns="IMAGE_STRUCTURE").get("LAYOUT") == "COG"
            np.testing.assert_allclose(file.read(1), np.asarray(values), atol=1e-12)


def test_splines_of_the_geopackage_fall_downstream(land, folder):
    geopandas = pytest.importorskip("geopandas")
    network = land[0].network
    points = geopandas.read_file(folder / "gis" / "rivers.gpkg", layer="splines")
    assert points.crs.to_epsg() == 32633 and len(points) == network.point_count
    np.testing.assert_allclose(points["width_m"], np.concatenate(network.point_widths()))
    np.testing.assert_allclose(points["depth_m"], np.concatenate(network.point_depths()))
    assert (points["tangent_z"] <= 0.0).all()
    for _, group in points.groupby("channel_id"):
        assert (np.diff(group.geometry.z) <= 0.0).all() and (np.diff(group["distance_m"]) > 0.0).all()
    channels = geopandas.read_file(folder / "gis" / "rivers.gpkg", layer="channels")
    assert channels.geometry.has_z.all() and len(channels) == 3
    assert len(geopandas.read_file(folder / "gis" / "rivers.gpkg", layer="oxbows")) == 1
    styles = geopandas.read_file(folder / "gis" / "rivers.gpkg", layer="layer_styles")
    assert {"channels", "splines", "courses", "oxbows"} <= set(styles["f_table_name"])
    # And it is a network again.
    again = wr.read_network(folder / "gis" / "rivers.gpkg", layer="channels")
    np.testing.assert_allclose(again.points(), network.points(), atol=1e-9)


def test_tangents_are_those_of_cubics_that_do_not_rise(land):
    splines = channel_splines(land[0].network)
    t = np.linspace(0.0, 1.0, 21)[:, None]
    for a, b in zip(splines.start[:-1], splines.start[1:], strict=True):
        for k in range(a, b - 1):
            p, q, u, v = splines.xyz[k], splines.xyz[k + 1], splines.tangent[k], splines.tangent[k + 1]
            curve = (2 * t**3 - 3 * t**2 + 1) * p + (t**3 - 2 * t**2 + t) * u
            curve = curve + (3 * t**2 - 2 * t**3) * q + (t**3 - t**2) * v
            assert np.diff(curve[:, 2]).max() <= 1e-12


def test_events_are_a_table(folder):
    with (folder / "gis" / "events.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows] == ["cutoff"]
    assert float(rows[0]["width_m"]) == 20.0 and float(rows[0]["length_m"]) > 200.0


def test_paraview_finds_every_record(land, folder):
    pyvista = pytest.importorskip("pyvista")
    reader = pyvista.get_reader(folder / "paraview" / "run.pvd")
    assert reader.time_values == pytest.approx(land[1].times.tolist())
    reader.set_active_time_point(2)
    lines = reader.read()[0]
    assert lines.n_lines == 3 and "width_m" in lines.point_data
    ground = pyvista.read(folder / "paraview" / "terrain.vtp")
    np.testing.assert_allclose(ground.bounds[4], np.nanmin(land[0].terrain.to_numpy()))


# ---- meshes


def bounds_of(surfaces):
    """Bounds relative to the corner that files have as their zero."""
    low = np.min([s.bounds[0] for s in surfaces], axis=0)
    high = np.max([s.bounds[1] for s in surfaces], axis=0)
    zero = [*np.floor(low[:2]), 0.0]
    return low - zero, high - zero


def test_surfaces_are_those_of_the_rasters(land):
    ground, water, channels = surfaces = landscape_surfaces(land[0])
    assert [s.name for s in surfaces] == ["terrain", "water", "channels"]
    assert len(ground.points) == np.isfinite(land[0].terrain.to_numpy()).sum()
    for surface in surfaces:
        corner = surface.points[surface.triangles]
        face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (face[:, 2] > 0.0).all(), "seen from above, all go round to the left"
        np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-12)
        assert (surface.normals[:, 2] > 0.0).all()
    assert ground.uv.min() > 0.0 and ground.uv.max() < 1.0
    # Every wet cell, and the cells around them.
    assert len(water.points) > np.isfinite(land[0].water.numpy()).sum()
    # Across 0 to 1; along in widths: 622 m that widen from 20 to 26 m.
    assert set(channels.uv[:, 0]) == {0.0, 1.0}
    along = channels.uv[::2, 1]
    first = along[np.flatnonzero(np.diff(along) < 0.0)[0]]
    assert first == pytest.approx(622.4 * np.log(26.0 / 20.0) / 6.0, rel=0.03)


def test_ribbons_are_as_wide_as_their_channels(land):
    ribbon = channel_ribbons(land[0].network)
    width = np.hypot(*(ribbon.points[::2] - ribbon.points[1::2])[:, :2].T)
    assert width.min() == pytest.approx(18.0, rel=1e-6) and width.max() == pytest.approx(44.0, rel=1e-6)


@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_trimesh_opens_meshes(land, folder, suffix):
    trimesh = pytest.importorskip("trimesh")
    surfaces = landscape_surfaces(land[0])
    low, high = bounds_of(surfaces)
    if suffix == "glb":  # y up, north is -z
        low, high = np.array([low[0], low[2], -high[1]]), np.array([high[0], high[2], -low[1]])
    scene = trimesh.load_scene(folder / "mesh" / f"landscape.{suffix}")
    np.testing.assert_allclose(scene.bounds, [low, high], atol=2e-4)
    faces = sum(len(mesh.faces) for mesh in scene.geometry.values())
    assert faces == sum(len(s.triangles) for s in surfaces)
    if suffix == "glb":
        assert set(scene.geometry) == {"terrain", "water", "channels"}
        ground = scene.geometry["terrain"]
        np.testing.assert_allclose(ground.vertex_normals[:, 1], surfaces[0].normals[:, 2], atol=1e-6)
        np.testing.assert_allclose(ground.visual.uv, surfaces[0].uv, atol=1e-6)
        head = (folder / "mesh" / "landscape.glb").read_bytes()
        told = json.loads(head[20 : 20 + int.from_bytes(head[12:16], "little")])["asset"]["extras"]
        assert told["crs"] == CRS and told["origin"] == [WEST + 5.0, NORTH - 895.0]


def test_obj_with_y_up_is_turned(land, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    surfaces = landscape_surfaces(land[0])[:1]
    write_surfaces(surfaces, tmp_path / "a.obj", origin=(WEST, NORTH), y_up=True)
    mesh = trimesh.load(tmp_path / "a.obj", process=False)
    low, high = surfaces[0].bounds
    np.testing.assert_allclose(mesh.bounds[0], [low[0] - WEST, low[2], NORTH - high[1]], atol=2e-4)
    assert mesh.face_normals[:, 1].min() > 0.0


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_usd_core_opens_stages(land, tmp_path, suffix):
    usd = pytest.importorskip("pxr.Usd")
    geometry = pytest.importorskip("pxr.UsdGeom")
    surfaces = landscape_surfaces(land[0])
    write_surfaces(surfaces, tmp_path / f"a.{suffix}", y_up=suffix == "usdc")
    stage = usd.Stage.Open(str(tmp_path / f"a.{suffix}"))
    assert geometry.GetStageUpAxis(stage) == ("Y" if suffix == "usdc" else "Z")
    assert geometry.GetStageMetersPerUnit(stage) == 1.0 and CRS in stage.GetRootLayer().documentation
    found = {prim.GetName(): geometry.Mesh(prim) for prim in stage.Traverse() if prim.IsA(geometry.Mesh)}
    zero = [*np.floor(np.min([s.bounds[0][:2] for s in surfaces], axis=0)), 0.0]
    for surface in surfaces:
        mesh = found[surface.name]
        points = np.array(mesh.GetPointsAttr().Get())
        placed, normals = surface.points - zero, surface.normals
        if suffix == "usdc":
            placed, normals = (np.column_stack([v[:, 0], v[:, 2], -v[:, 1]]) for v in (placed, normals))
        np.testing.assert_allclose(points, placed, atol=2e-4)
        np.testing.assert_allclose(np.array(mesh.GetNormalsAttr().Get()), normals, atol=1e-5)
        np.testing.assert_allclose(np.array(mesh.GetExtentAttr().Get())[1], placed.max(axis=0), rtol=1e-5, atol=1e-3)
        assert len(mesh.GetFaceVertexIndicesAttr().Get()) == surface.triangles.size
        uv = geometry.PrimvarsAPI(mesh).GetPrimvar("st")
        assert uv.GetInterpolation() == "vertex" and len(uv.Get()) == len(surface.uv)


# ---- engines


@pytest.mark.parametrize("name", ENGINES)
def test_height_maps_come_back_to_half_a_step(land, folder, name):
    image = pytest.importorskip("PIL.Image")
    told = json.loads((folder / name / "landscape.json").read_text())
    shape, (low, high) = (told["rows"], told["columns"]), (told["height_low"], told["height_high"])
    wanted = land[0].terrain.to_numpy()
    gap = np.isnan(wanted)
    for file in told["heightmap"]:
        path = folder / name / file
        if file.endswith(".png"):
            with image.open(path) as picture:
                step = np.array(picture)
            assert step.dtype == np.uint16
        else:
            step = np.fromfile(path, "<u2").reshape(shape)
            step = step[::-1] if told["first_row"][".r16"] == "south" else step
        same = shape == wanted.shape
        assert step.shape == shape and (not same or (step.min() == 0 and step.max() == 65535))
        height = low + step * ((high - low) / 65535.0)
        # Vertices of other sizes lie between the cells: the corners are those of the terrain.
        corners = (np.array([0, -1, -1]), np.array([-1, 0, -1]))
        found, right = (height[~gap], wanted[~gap]) if same else (height[corners], wanted[corners])
        assert np.abs(found - right).max() <= 0.5001 * (high - low) / 65535.0
    dx, dy = told["metres_per_pixel"]
    assert dx * (shape[1] - 1) == pytest.approx(CELL * (COLUMNS - 1))
    assert dy * (shape[0] - 1) == pytest.approx(CELL * (ROWS - 1))
    assert told["crs"] == CRS


@pytest.mark.parametrize("name", ENGINES)
def test_masks_add_up(land, folder, name):
    image = pytest.importorskip("PIL.Image")
    told = json.loads((folder / name / "landscape.json").read_text())
    total = np.zeros((told["rows"], told["columns"]), int)
    for material in land[0].materials:
        where = told["masks"][material]
        with image.open(folder / name / where["file"]) as picture:
            pixels = np.array(picture).astype(int)
        total += pixels["rgba".index(where["channel"])] if pixels.ndim == 2 and "channel" in where else (
            pixels[..., "rgba".index(where["channel"])] if "channel" in where else pixels
        )  # fmt: skip
    np.testing.assert_array_equal(total, 255)
    assert told["masks"]["moisture"]["high"] == 3.0 and told["masks"]["moisture"]["unit"] == "m"


def test_unreal_gets_its_sizes_scales_and_centimetres(land, folder):
    told = json.loads((folder / "unreal" / "landscape.json").read_text())
    assert (told["rows"] - 1) % 126 == 0 and told["columns"] == 505
    rise = (told["height_high"] - told["height_low"]) / 65535.0
    # A step is scale / 100 / 128 m; step 32,768 lies at the landscape's own height.
    assert told["import"]["scale"][2] / 100.0 / 128.0 == pytest.approx(rise)
    assert told["import"]["location"][2] / 100.0 - 32768 * rise == pytest.approx(told["height_low"])
    channels = json.loads((folder / "unreal" / "splines.json").read_text())["channels"]
    network = land[0].network
    x, y, z = np.array(channels[2]["points"]).T
    xy = network.polylines()[2] - [told["corners"]["west"], told["corners"]["north"]]
    np.testing.assert_allclose(x, 100.0 * xy[:, 0], atol=1e-3)
    np.testing.assert_allclose(y, -100.0 * xy[:, 1], atol=1e-3)
    assert (np.diff(z) <= 0.0).all()
    assert channels[0]["next_down"] == channels[2]["channel_id"] and channels[2]["next_down"] is None
    np.testing.assert_allclose(channels[2]["width"], 100.0 * network.point_widths()[2], atol=1e-3)


def test_sizes_of_engines():
    assert engine_size(ENGINES["unreal"], (643, 1197), None) == (1135, 2017)
    assert engine_size(ENGINES["unreal"], (300, 300), 1009) == (1009, 1009)
    assert engine_size(ENGINES["unity"], (300, 600), None) == (1025, 1025)
    assert engine_size(ENGINES["blender"], (300, 600), None) == (300, 600)
    assert engine_size(ENGINES["houdini"], (300, 600), 1200) == (600, 1200)
    assert engine_size(ENGINES["godot"], (30_000, 10), None) == (4097, 4097)
    with pytest.raises(ValueError, match="size is 1000; Unreal Engine takes 505, 1009"):
        engine_size(ENGINES["unreal"], (300, 300), 1000)


def test_resampling_keeps_planes_and_weights_their_sum():
    plane = np.add.outer(3.0 * np.arange(7.0), -2.0 * np.arange(11.0))
    wanted = np.add.outer(np.linspace(0.0, 18.0, 40), np.linspace(0.0, -20.0, 5))
    np.testing.assert_allclose(resampled(plane, (40, 5)), wanted, atol=1e-12)
    np.testing.assert_array_equal(resampled(plane, (40, 5), slice(7, 9)), resampled(plane, (40, 5))[7:9])
    np.testing.assert_array_equal(resampled(plane, plane.shape), plane)
    np.testing.assert_array_equal(resampled(np.array([[255, 0], [0, 255]], np.uint8), (2, 3))[0], [255.0, 127.5, 0.0])
    weights = whole_weights(np.random.default_rng(0).random((50, 60, 5)))
    np.testing.assert_array_equal(weights.astype(int).sum(axis=-1), 255)


# ---- what is refused, and grounds


def test_what_cannot_be_exported_is_refused(land, tmp_path):
    carved = land[0]
    with pytest.raises(ValueError, match="targets"):
        export_landscape(carved, tmp_path, targets=["maya"])
    other = wr.Terrain(np.zeros((3, 3)), 1.0).raster
    with pytest.raises(ValueError, match="maps\\['m'\\] is no Raster on the cells"):
        export_landscape(carved, tmp_path, maps={"m": other})
    with pytest.raises(ValueError, match=r"must end in .glb, .obj, .usda, .usdc"):
        write_surfaces(landscape_surfaces(carved), tmp_path / "a.fbx")
    with pytest.raises(ValueError, match="surfaces holds none"):
        write_surfaces([], tmp_path / "a.obj")


def test_a_plain_falls_from_sources_to_outlets(land):
    network = land[0].network
    plain = plain_under(network, slope=2e-3, margin=100.0)
    west, south, east, north = network.bounds()
    bounds = plain.bounds
    assert bounds[0] == west - 100.0 and bounds[3] == north + 100.0
    assert bounds[1] <= south - 100.0 and bounds[2] >= east + 100.0
    np.testing.assert_allclose(plain.slope(), 2e-3, rtol=1e-9)
    sources = plain.sample(network.node_xy[np.setdiff1d(network.channel_from, network.channel_to)])
    outlet = plain.sample(network.node_xy[np.setdiff1d(network.channel_to, network.channel_from)])
    assert sources.min() > outlet.max()
