"""Frames, meshes and patches of riverscapes for other programs; loops."""

import json
import math

import numpy as np
import pytest

import warpriver as wr
from warpriver.riverscape import example, write_frames

BOUNDS = (10.0, 4.0, 16.0, 16.0)


@pytest.fixture(scope="module")
def scenes(device):
    made = {name: example(name) for name in "AC"}
    return {
        name: wr.Riverscape(each.terrain, each.courses, rocks=each.rocks, device=device) for name, each in made.items()
    }


def write(scene, folder, suffix):
    return write_frames(scene, folder, times=[0.0, 0.5, 1.0], cell_size=0.25, bounds=BOUNDS, suffix=suffix)


def test_frames_as_exr_have_all_fields_as_channels(scenes, tmp_path):
    exr = pytest.importorskip("OpenEXR")
    files = write(scenes["C"], tmp_path, ".exr")
    assert [f.name for f in files] == ["bed.exr", "0000.exr", "0001.exr", "0002.exr"]
    *_, frame = scenes["C"].frames(BOUNDS, 0.25, [1.0])
    with exr.File(str(files[-1]), separate_channels=True) as file:
        found = {name: channel.pixels for name, channel in file.channels().items()}
        told = json.loads(file.header()["comments"])
    assert set(found) == {"elevation", "depth", "velocity.x", "velocity.y", "foam"}
    np.testing.assert_array_equal(found["depth"], frame.depth.astype(np.float32))
    dry = frame.depth <= 0.0
    assert np.isnan(found["elevation"][dry]).all() and (found["velocity.x"][dry] == 0.0).all()
    np.testing.assert_array_equal(found["velocity.y"][~dry], frame.water.velocity.numpy()[~dry, 1])
    assert told["meters_per_pixel"] == 0.25 and told["west"] == 10.0
    with exr.File(str(files[0]), separate_channels=True) as file:
        np.testing.assert_array_equal(file.channels()["Y"].pixels, frame.bed.numpy().astype(np.float32))


def test_frames_as_a_zarr_store_open_in_xarray(scenes, tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("zarr")
    (store,) = write(scenes["C"], tmp_path, ".zarr")
    data = xarray.open_zarr(store, consolidated=False)
    assert dict(data.sizes) == {"time": 3, "y": 48, "x": 24} and data.time.values.tolist() == [0.0, 0.5, 1.0]
    *_, frame = scenes["C"].frames(BOUNDS, 0.25, [1.0])
    np.testing.assert_array_equal(data.depth[2].values, frame.depth)
    np.testing.assert_array_equal(data.bed.values, frame.bed.numpy())
    assert data.bed.dims == ("y", "x") and data.y.values[0] > data.y.values[-1]
    with pytest.raises(OSError, match="exists"):
        write(scenes["C"], tmp_path, ".zarr")


@pytest.mark.parametrize("suffix", [".png", ".r16"])
def test_frames_as_height_maps_of_16_bits(suffix, scenes, tmp_path):
    if suffix == ".png":
        pytest.importorskip("PIL")
    write(scenes["C"], tmp_path, suffix)
    *_, frame = scenes["C"].frames(BOUNDS, 0.25, [1.0])
    options = {"shape": (48, 24)} if suffix == ".r16" else {}
    for name, values in (("elevation", None), ("depth", frame.depth), ("north", None)):
        back = wr.read_terrain(tmp_path / f"0002_{name}{suffix}", **options).to_numpy()
        if values is not None:
            np.testing.assert_allclose(back, values, atol=0.51 * np.ptp(values) / 65535)
        assert np.isfinite(back).all()


def gltf_arrays(path):
    """Attributes and triangles of each mesh of a GLB, by name, and its extras."""
    data = path.read_bytes()
    size = int(np.frombuffer(data, "<u4", 1, 12)[0])
    head = json.loads(data[20 : 20 + size])
    body = data[28 + size :]

    def read(number):
        accessor = head["accessors"][number]
        wide = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        offset = head["bufferViews"][accessor["bufferView"]]["byteOffset"]
        flat = np.frombuffer(body, kind, accessor["count"] * wide, offset)
        return flat.reshape(-1, wide) if wide > 1 else flat

    found = {}
    for mesh in head["meshes"]:
        (primitive,) = mesh["primitives"]
        found[mesh["name"]] = {name: read(k) for name, k in primitive["attributes"].items()} | {
            "triangles": read(primitive["indices"]).reshape(-1, 3)
        }
    return found, head["asset"]["extras"]


def test_a_glb_opens_elsewhere_with_bounds_and_normals(scenes, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    scene = scenes["A"]
    bounds = (10.0, -6.0, 30.0, 6.0)
    scene.to_glb(tmp_path / "a.glb", bounds=bounds, cell_size=0.2, time=2.0)
    opened = trimesh.load(tmp_path / "a.glb")
    assert set(opened.geometry) == {"terrain", "water", "falls"}
    (frame,) = scene.frames(bounds, 0.2, [2.0])
    bed = frame.bed.numpy()
    low, high = opened.geometry["terrain"].bounds
    # x east, y up, z south, from the south-west corner.
    np.testing.assert_allclose(low, [0.1, bed.min(), -11.9], atol=1e-4)
    np.testing.assert_allclose(high, [19.9, bed.max(), -0.1], atol=1e-4)
    for name, mesh in opened.geometry.items():
        normals = mesh.vertex_normals
        assert np.isfinite(normals).all() and np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
        assert (mesh.face_normals[:, 1] > 0.0).mean() > 0.99, name
        assert (normals[:, 1] > 0.0).all()
    # What was stored is what the faces have.
    arrays, told = gltf_arrays(tmp_path / "a.glb")
    faces = opened.geometry["water"]
    stored = arrays["water"]["NORMAL"]
    assert len(stored) == len(faces.vertices)
    assert (np.einsum("ij,ij->i", stored, faces.vertex_normals) > 0.97).mean() > 0.95
    assert told["origin"] == [10.0, -6.0] and "_FLOW" in told["water"]


def test_water_of_a_glb_has_its_course_and_current(scenes, tmp_path):
    """s and n are those of the course, and grow along and across it; the flow is the water's, in the mesh's axes."""
    scene = scenes["C"]
    scene.to_glb(tmp_path / "c.glb", bounds=BOUNDS, cell_size=0.1)
    arrays, told = gltf_arrays(tmp_path / "c.glb")
    water = arrays["water"]
    x, z = water["POSITION"][:, 0] + told["origin"][0], told["origin"][1] - water["POSITION"][:, 2]
    found = scene.water(np.column_stack([x, z]))
    np.testing.assert_allclose(water["POSITION"][:, 1], found.elevation, atol=1e-4)
    # The places are stored in single precision.
    np.testing.assert_allclose(water["_FLOW"][:, 0], found.velocity[:, 0], atol=1e-3)
    np.testing.assert_allclose(water["_FLOW"][:, 2], -found.velocity[:, 1], atol=1e-3)
    here = scene.courses.survey(np.column_stack([x, z]))
    near = here.point >= 0
    np.testing.assert_allclose(water["TEXCOORD_0"][near, 0], here.along[near], atol=1e-3)
    # No triangle is torn: along its sides s and n change by no more than the sides are long, and bends stretch them.
    uv = water["TEXCOORD_0"][water["triangles"]]
    assert np.abs(np.diff(uv, axis=1)).max() < 1.0


def test_triangles_between_two_courses_belong_to_one(device, tmp_path):
    made = example("D")
    scene = wr.Riverscape(made.terrain, made.courses, rocks=made.rocks, device=device)
    scene.to_glb(tmp_path / "d.glb", bounds=(0.0, -4.0, 10.0, 4.0), cell_size=0.1)
    water = gltf_arrays(tmp_path / "d.glb")[0]["water"]
    uv = water["TEXCOORD_0"][water["triangles"]]
    # Where threads meet, n of one and of the other are up to 2 m apart.
    assert np.abs(np.diff(uv, axis=1)).max() < 1.0
    assert len(water["POSITION"]) > len(np.unique(water["POSITION"], axis=0))


def edge_of(patch, side):
    """Heights, water and currents along an edge of a patch, by place on it."""
    count = math.isqrt(len(patch.points))
    values = np.column_stack([patch.points, patch.water, patch.velocity, patch.effervescence]).reshape(count, count, -1)
    return {"north": values[-1], "south": values[0], "east": values[:, -1], "west": values[:, 0]}[side]


def test_patches_are_fine_where_near_and_have_no_cracks(scenes):
    """Along each edge that two patches share both lie on the same lines, though their steps differ."""
    scene = scenes["C"]
    patches = scene.patches((12.0, 4.0, 3.0), cell_size=0.1, angle=0.06, bounds=(5.0, 0.0, 30.0, 10.0))
    assert len(patches) == 25 * 10 and {patch.step for patch in patches} == {1, 2, 5, 10}
    table = {(patch.row, patch.column): patch for patch in patches}
    far = [np.hypot(*(patch.points[:, :2].mean(axis=0) - (12.0, 4.0))) for patch in patches]
    steps = [patch.step for patch in patches]
    assert np.corrcoef(far, steps)[0, 1] > 0.8
    mixed = 0
    for (row, column), patch in table.items():
        for other, sides, axis in (
            ((row + 1, column), ("north", "south"), 0),
            ((row, column + 1), ("east", "west"), 1),
        ):
            if other not in table:
                continue
            a, b = edge_of(patch, sides[0]), edge_of(table[other], sides[1])
            every = np.union1d(a[:, axis], b[:, axis])
            mixed += patch.step != table[other].step
            for k in range(2, a.shape[1]):
                lines = [np.interp(every, v[:, axis], v[:, k]) for v in (a, b)]
                np.testing.assert_allclose(*lines, rtol=0.0, atol=1e-9)
    assert mixed > 20
    # At full detail the heights are those of the bed.
    fine = next(patch for patch in patches if patch.step == 1)
    inner = fine.points.reshape(11, 11, 3)[1:-1, 1:-1].reshape(-1, 3)
    np.testing.assert_array_equal(inner[:, 2], scene.bed(inner[:, :2]))
    corner = patch.points[patch.triangles]
    assert (np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] > 0.0).all()


def test_patches_out_of_view_are_left_out(scenes):
    scene, bounds = scenes["C"], (5.0, 0.0, 45.0, 20.0)
    every = scene.patches((5.0, 10.0, 3.0), cell_size=0.2, bounds=bounds)
    ahead = scene.patches((5.0, 10.0, 3.0), cell_size=0.2, bounds=bounds, heading=0.0, field=40.0)
    kept = {(patch.row, patch.column) for patch in ahead}
    assert 0.2 * len(every) < len(ahead) < 0.8 * len(every)
    for patch in every:
        off = patch.points[:, :2] - (5.0, 10.0)
        if (np.abs(np.degrees(np.arctan2(off[:, 1], off[:, 0]))) < 20.0).any():
            assert (patch.row, patch.column) in kept


def test_a_loop_ends_where_it_begins_without_a_seam(scenes):
    """Frame N is frame 0, to the bit; the step to it is no larger than others, nor do waves grow or fade on the way."""
    scene, rate = scenes["C"], 12
    times = np.arange(8 * rate + 1) / rate
    heights = []
    for frame in scene.frames(BOUNDS, 0.2, times, loop=8.0):
        heights.append(np.where(frame.depth > 0.0, frame.water.elevation.numpy() - frame.water.still.numpy(), 0.0))
    heights = np.array(heights)
    np.testing.assert_array_equal(heights[0], heights[-1])
    step = np.sqrt((np.diff(heights, axis=0) ** 2).mean(axis=(1, 2)))
    assert step[-1] < 1.25 * np.median(step)
    # A sum of two fields whose correlation is known: over all cells its size varies by what few waves in view leave.
    size = heights.std(axis=(1, 2))
    assert size.min() > 0.8 * size.max()


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda s, t: s.to_glb(t / "a.obj"), "a mesh of a riverscape is a .glb"),
        (lambda s, t: s.to_glb(t / "a.glb", cell_size=0.0), "cell_size is 0"),
        (lambda s, t: s.to_glb(t / "a.glb", bounds=(900.0, 0.0, 910.0, 9.0)), "no three cells"),
        (lambda s, t: s.patches((0.0, 0.0)), "eye"),
        (lambda s, t: s.patches((0.0, 0.0, 1.0), angle=0.0), "angle is 0"),
        (lambda s, t: write_frames(s, t, times=[0.0], cell_size=1.0, suffix=".bmp"), "bmp"),
    ],
)
def test_what_cannot_be_written_is_refused(call, told, scenes, tmp_path):
    with pytest.raises(ValueError, match=told):
        call(scenes["C"], tmp_path)
