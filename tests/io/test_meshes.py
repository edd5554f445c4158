"""Tests of meshes: triangles of terrains and valleys, lines of networks, the digits of their coordinates."""

import json
import struct

import numpy as np
import pytest

import warpriver as wr

UTM = (376313.25, 3807917.5)


def hilly(gaps=True):
    y, x = np.mgrid[:12, :9]
    height = 100.0 + 5.0 * np.sin(0.7 * x + 0.1) * np.cos(0.5 * y)
    if gaps:
        height[2, 3] = height[7:9, 2:5] = height[0, 0] = np.nan
    return wr.Terrain(height, 30.0, UTM, "EPSG:32611")


def triangles_by_hand(height):
    """The cells of each triangle, (m, 3, 2), square by square."""
    found = []
    for i in range(height.shape[0] - 1):
        for j in range(height.shape[1] - 1):
            corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]  # north-west, and on against the clock
            known = [c for c in corners if np.isfinite(height[c])]
            if len(known) == 4:
                found += [[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]
            elif len(known) == 3:
                found.append(known)
    return found


def read_ply(path):
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    names = [line.split()[2] for line in lines if line.startswith("property double")]
    count, faces = (int(line.split()[-1]) for line in lines if line.startswith("element"))
    table = np.frombuffer(body, "<f8", count * len(names)).reshape(count, -1)
    rows = np.frombuffer(body, [("n", "u1"), ("p", "<i4", 3)], faces, table.nbytes)
    assert (rows["n"] == 3).all() and len(body) == table.nbytes + rows.nbytes
    return lines, dict(zip(names, table.T, strict=True)), rows["p"]


def read_stl(path):
    data = path.read_bytes()
    assert not data.startswith(b"solid")
    form = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("flags", "<u2")])
    return np.frombuffer(data, form, struct.unpack("<I", data[80:84])[0], 84)


@pytest.mark.parametrize("gaps", [False, True])
def test_a_terrain_is_triangles_between_cells_that_have_data(tmp_path, gaps):
    terrain = hilly(gaps)
    wr.write_mesh(terrain, tmp_path / "a.ply")
    lines, numbers, faces = read_ply(tmp_path / "a.ply")
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", "comment crs EPSG:32611"]
    height = terrain.to_numpy()
    row, column = np.nonzero(np.isfinite(height))
    np.testing.assert_array_equal(numbers["x"], UTM[0] + 30.0 * (column + 0.5))
    np.testing.assert_array_equal(numbers["y"], UTM[1] - 30.0 * (row + 0.5))
    np.testing.assert_array_equal(numbers["z"], height[row, column])
    cells = [[(row[k], column[k]) for k in face] for face in faces.tolist()]
    assert sorted(map(sorted, cells)) == sorted(map(sorted, triangles_by_hand(height)))
    xy = np.stack([numbers["x"], numbers["y"]], axis=1)[faces]
    (ax, ay), (bx, by) = (xy[:, 1] - xy[:, 0]).T, (xy[:, 2] - xy[:, 0]).T
    assert (ax * by - ay * bx > 0.0).all()  # against the clock, seen from above


def test_a_mesh_in_single_precision_lies_near_its_zero(tmp_path):
    terrain = hilly()
    wr.write_mesh(terrain, tmp_path / "a.stl")
    side = json.loads((tmp_path / "a.stl.json").read_text())
    zero = np.array(side["origin"])
    assert (side["crs"], side["unit"]) == ("EPSG:32611", "m") and (zero == np.floor(zero)).all()
    rows = read_stl(tmp_path / "a.stl")
    wr.write_mesh(terrain, tmp_path / "a.ply")
    _, numbers, faces = read_ply(tmp_path / "a.ply")
    exact = np.stack([numbers["x"] - zero[0], numbers["y"] - zero[1], numbers["z"]], axis=1)[faces]
    np.testing.assert_allclose(rows["corner"], exact, atol=1e-4)
    assert (rows["normal"][:, 2] > 0.5).all()
    np.testing.assert_allclose(np.linalg.norm(rows["normal"], axis=1), 1.0, rtol=1e-6)
    # A given zero holds for all formats; without one nothing stays beside the file.
    for suffix in ("obj", "ply", "stl", "vtp"):
        wr.write_mesh(terrain, tmp_path / f"b.{suffix}", origin=(376000.0, 3807000.0))
        assert json.loads((tmp_path / f"b.{suffix}.json").read_text())["origin"] == [376000.0, 3807000.0]
        wr.write_mesh(wr.Terrain(np.eye(4), 10.0), tmp_path / f"b.{suffix}")
        assert not (tmp_path / f"b.{suffix}.json").exists()
    x = [float(row.split()[1]) for row in (tmp_path / "b.obj").read_text().splitlines() if row.startswith("v ")]
    assert x[:4] == [5.0, 15.0, 25.0, 35.0]


def test_paraview_finds_numbers_and_crs(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    terrain = hilly()
    wr.write_mesh(terrain, tmp_path / "a.vtp")
    mesh = pyvista.read(tmp_path / "a.vtp")
    assert mesh.points.dtype == np.float64 and list(mesh.field_data["crs"]) == ["EPSG:32611"]
    assert mesh.n_cells == len(triangles_by_hand(terrain.to_numpy()))
    np.testing.assert_array_equal(mesh.point_data["height"], mesh.points[:, 2])
    valley = wr.synthetic_valley("S3", increments=40, origin=(500000.0, 4e6), crs="EPSG:32619")
    wr.write_mesh(valley, tmp_path / "v.vtp")
    mesh, grid = pyvista.read(tmp_path / "v.vtp"), valley.grid()
    np.testing.assert_array_equal(mesh.points, grid.points())
    station = mesh.point_data["station"].reshape(grid.xyz.shape[:2])
    assert station[0, 0] == 0.0 and station[-1, 0] == pytest.approx(valley.stations.length)
    lateral = mesh.point_data["lateral"].reshape(grid.xyz.shape[:2])
    left, right = lateral[:, grid.banks[0]], lateral[:, grid.banks[1]]
    np.testing.assert_allclose(left - right, valley.network.point_widths()[0], rtol=1e-6)
    assert (left > 0.0).all() and (right < 0.0).all()


def test_a_network_is_lines(tmp_path):
    ring = np.stack([np.cos(np.linspace(0, 6, 40)), np.sin(np.linspace(0, 6, 40))], axis=1) * 400.0
    line = np.c_[np.linspace(1000.0, 3000.0, 21), np.zeros(21)]
    network = wr.RiverNetwork.from_polylines(
        [line, ring], width=[np.linspace(10.0, 20.0, 21), np.full(40, 30.0)], closed=[False, True], crs="EPSG:32619"
    )
    wr.write_mesh(network, tmp_path / "a.obj")
    rows = [row.split() for row in (tmp_path / "a.obj").read_text().splitlines()]
    pairs = [(int(row[1]), int(row[2])) for row in rows if row[0] == "l"]
    assert pairs == [(k, k + 1) for k in range(1, 62) if k != 21] and sum(row[0] == "v" for row in rows) == 62
    for suffix in ("ply", "stl"):
        with pytest.raises(ValueError, match=rf"\.{suffix} holds triangles, a network has lines; write \.obj or \.vtp"):
            wr.write_mesh(network, tmp_path / f"a.{suffix}")
    pyvista = pytest.importorskip("pyvista")
    wr.write_mesh(network, tmp_path / "a.vtp")
    mesh = pyvista.read(tmp_path / "a.vtp")
    assert (mesh.n_lines, mesh.n_points) == (2, 62)
    np.testing.assert_array_equal(mesh.point_data["width_m"][:21], np.linspace(10.0, 20.0, 21))
    assert mesh.cell_data["channel_id"].tolist() == [0, 1]


def test_what_is_no_mesh_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"a\.dxf: the name must end in \.obj, \.ply, \.stl, \.vtp"):
        wr.write_mesh(hilly(), tmp_path / "a.dxf")
    lonely = np.full((4, 4), np.nan)
    lonely[0, 0] = lonely[3, 3] = 1.0
    with pytest.raises(ValueError, match=r"no three cells with data that meet"):
        wr.write_mesh(wr.Terrain(lonely, 1.0), tmp_path / "a.ply")
    with pytest.raises(ValueError, match=r"surface is .*; give a Terrain"):
        wr.write_mesh("dem.tif", tmp_path / "a.ply")
    with pytest.raises(ValueError, match=r"origin"):
        wr.write_mesh(hilly(), tmp_path / "a.ply", origin=(1.0, np.nan))
    assert not list(tmp_path.iterdir())
