"""Tests of the line files of real rivers."""

import os
from pathlib import Path

import numpy as np
import pytest
from data_folder import DEFAULT, data_folder
from river_files import needs_ogr, needs_pyproj, same_lines

from warpriver.graph.forest import check_forest
from warpriver.hydrology import strahler_order
from warpriver.io import read_network, write_network
from warpriver.io.vector.attributes import next_downstream


def data_files(pattern):
    root = Path(os.environ.get("WARPRIVER_DATA", DEFAULT))
    missing = pytest.mark.skip(reason=f"no {pattern} in {root}; set WARPRIVER_DATA")
    files = [pytest.param(f, id=f.name) for f in sorted(root.glob(pattern))]
    return files or [pytest.param(None, id=pattern, marks=missing)]


@pytest.mark.parametrize("path", data_files("centerlines/*.csv.gz"))
def test_amazon_centrelines(path):
    network = read_network(path)
    raw = np.loadtxt(path, delimiter=",", skiprows=2)
    np.testing.assert_allclose(network.polylines()[0], raw[:, :2], rtol=1e-15)
    np.testing.assert_array_equal(network.point_widths()[0], raw[:, -1])
    assert network.crs in ("EPSG:32619", "EPSG:32620")


@pytest.mark.parametrize("path", data_files("mamore_series/*.csv.gz"))
def test_mamore_series(path):
    network = read_network(path, width=250.0)
    assert (network.channel_count, network.crs) == (1, "EPSG:32620")
    assert 3.1e5 < network.channel_lengths()[0] < 4.1e5
    with pytest.raises(ValueError, match="gives no width"):
        read_network(path)


@pytest.mark.parametrize("path", data_files("centerlines_local/*.txt"))
def test_local_centrelines(path):
    network = read_network(path, width=40.0)
    raw = np.loadtxt(path, skiprows=1 if "mackinaw" in path.name else 0)
    assert network.point_count == len(raw)
    np.testing.assert_allclose(network.polylines()[0], raw, atol=1e-9)
    assert network.crs is None


@needs_pyproj
def test_jurua_in_web_mercator():
    path = data_folder("centerlines_local") / "jurua.txt"
    with pytest.warns(UserWarning, match=r"1\.02 times those on the ground"):
        local = read_network(path, width=200.0, crs="EPSG:3857")
    utm = read_network(path, width=200.0, crs="EPSG:3857", to_crs="utm")
    assert utm.crs == "EPSG:32718"
    np.testing.assert_allclose(local.channel_lengths() / utm.channel_lengths(), 1.012, atol=1e-3)


@needs_ogr
def test_amazon_geopackage():
    path = data_folder("centerlines") / "amazon_centerlines.gpkg"
    with pytest.raises(ValueError, match=r"several layers hold lines: centerlines_utm19n, centerlines_utm20n"):
        read_network(path)
    network = read_network(path, layer="centerlines_utm19n")
    assert (network.channel_count, network.crs) == (2, "EPSG:32619")
    np.testing.assert_allclose(network.channel_width, [273.194674, 245.021835])
    assert read_network(path, layer="centerlines_utm20n").crs == "EPSG:32620"
    text = read_network(data_folder("centerlines") / "purus_19870701.csv.gz")
    np.testing.assert_allclose(network.polylines()[0], text.polylines()[0], atol=1e-9)


@needs_ogr
def test_shellmound_flowlines(tmp_path):
    path = data_folder("networks") / "shellmound_nhdplus.gpkg"
    with pytest.raises(ValueError, match=r"32 of 432 lines are like that.*short='narrow'"):
        read_network(path)
    with pytest.warns(UserWarning, match=r"1 ends lie more than a width .*are left free .*5689 m: feature 42"):
        network = read_network(path, layer="flowlines", short="narrow")
    assert (network.channel_count, network.crs) == (432, "EPSG:5070")
    write_network(network, tmp_path / "a.csv")
    same_lines(read_network(tmp_path / "a.csv").polylines(), network.polylines())


@needs_ogr
def test_shellmound_is_the_forest_that_its_file_routes():
    """The graph read is the one of ToCOMID; the file's sums of stream lengths upstream follow from it."""
    import pyogrio.raw

    path = data_folder("networks") / "shellmound_nhdplus.gpkg"
    columns = ["COMID", "tocomid", "LENGTHKM", "asum_calc"]
    meta, _, _, data = pyogrio.raw.read(path, layer="flowlines", columns=columns)
    table = dict(zip(meta["fields"], data, strict=True))
    with pytest.warns(UserWarning, match="1 ends lie more than a width"):
        network = read_network(path, layer="flowlines", short="narrow")
    np.testing.assert_array_equal(network.channel_id, table["COMID"])
    check_forest(network)
    down = next_downstream(network)
    named = np.where(down < 0, -1, network.channel_id[down])
    # Clipped at the edge of the model: channels downstream that are not in the file; one flows to no end that is near.
    there = np.isin(table["tocomid"], table["COMID"])
    assert (there.sum(), (~there).sum()) == (426, 6)
    wrong = np.flatnonzero(np.where(there, table["tocomid"], -1) != named)
    assert wrong.tolist() == [42]
    order = strahler_order(network.channel_from, network.channel_to)

    def strahler(c):
        above = sorted(strahler(d) for d in np.flatnonzero(named == table["COMID"][c]))
        return above[-1] + (len(above) > 1 and above[-2] == above[-1]) if above else 1

    assert order.tolist() == [strahler(c) for c in range(432)] and order.max() == 3
    # The arbolate sum, km of streams above a channel's end, counts streams that the file leaves out as well: along
    # every link it grows by the length of the channel downstream at least. 1 m is the rounding of the file.
    arbolate, length = table["asum_calc"], table["LENGTHKM"]
    link = np.flatnonzero(down >= 0)
    grown = arbolate[down[link]] - arbolate[link] - length[down[link]]
    assert np.isfinite(grown).sum() == 419 and (grown[np.isfinite(grown)] > -0.0015).all()
    assert np.nanmedian(np.abs(network.channel_lengths() / 1e3 / length - 1.0)) < 1e-3
