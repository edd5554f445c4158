"""Tests of the coordinate reference systems of line files."""

import sys
import warnings

import numpy as np
import pytest
from river_files import needs_pyproj, same_lines, write

from warpriver.io import read_network, write_network

LONLAT = "{0},{1}\n-67.0,-6.5\n-67.01,-6.51\n-67.03,-6.51\n-67.05,-6.5\n"


def test_geographic_coordinates_are_refused(tmp_path):
    named = write(tmp_path / "a.csv", LONLAT.format("lon", "lat"))
    stated = write(tmp_path / "b.csv", "# crs=EPSG:4326\n" + LONLAT.format("x", "y"))
    degrees = write(tmp_path / "c.csv", "# units=degrees\n" + LONLAT.format("x", "y"))
    for path in (named, stated, degrees):
        with pytest.raises(ValueError, match=r"longitude and latitude, not metres; pass to_crs=\"utm\""):
            read_network(path, width=50.0)
    # Nothing is stated: a line in degrees is always shorter than it is wide, whatever `short` is.
    bare = write(tmp_path / "d.csv", LONLAT.format("x", "y"))
    for short in ("error", "narrow", "drop"):
        with pytest.raises(ValueError, match=r'look like longitude and latitude.*crs="EPSG:4326" and to_crs="utm"'):
            read_network(bare, width=50.0, short=short)
    with pytest.raises(ValueError, match=r"longitude and latitude by format or name.*EPSG:32619"):
        read_network(named, width=50.0, crs="EPSG:32619")
    with pytest.raises(ValueError, match="file is in EPSG:4326 but crs= says EPSG:32619"):
        read_network(stated, width=50.0, crs="EPSG:32619")


def test_small_local_metres_pass(tmp_path):
    # A laboratory flume fits into 180 by 90, and is longer than wide.
    path = write(tmp_path / "a.csv", "0,0\n1,0.2\n2,-0.2\n4,0\n")
    assert read_network(path, width=0.3).channel_count == 1
    write_network(read_network(path, width=0.3), tmp_path / "a.geojson")
    assert read_network(tmp_path / "a.geojson").crs is None


@needs_pyproj
def test_reprojection(tmp_path):
    import pyproj

    path = write(tmp_path / "a.csv", LONLAT.format("lon", "lat"))
    network = read_network(path, width=50.0, to_crs="utm")
    assert network.crs == "EPSG:32719"  # 67 W, southern hemisphere
    change = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32719", always_xy=True)
    expected = np.stack(change.transform([-67.0, -67.01, -67.03, -67.05], [-6.5, -6.51, -6.51, -6.5]), axis=1)
    np.testing.assert_allclose(network.polylines()[0], expected, rtol=1e-12)
    geod = pyproj.Geod(ellps="WGS84").line_length([-67.0, -67.01, -67.03, -67.05], [-6.5, -6.51, -6.51, -6.5])
    np.testing.assert_allclose(network.channel_lengths()[0], geod, rtol=1e-3)
    assert read_network(path, width=50.0, to_crs="EPSG:31979").crs == "EPSG:31979"
    swapped = write(tmp_path / "b.csv", "latitude;longitude\n-6,5;-67\n-6,51;-67,01\n-6,51;-67,03\n-6,5;-67,05\n")
    same_lines(read_network(swapped, width=50.0, to_crs="utm").polylines(), network.polylines())
    # NAD83 may be stated for columns named lon and lat.
    assert read_network(path, width=50.0, crs="EPSG:4269", to_crs="utm").crs == "EPSG:32719"
    plain = write(tmp_path / "c.csv", "0,0\n1000,0\n2000,0\n")
    with pytest.raises(ValueError, match="states no CRS to reproject from; pass it as crs="):
        read_network(plain, width=50.0, to_crs="utm")
    with pytest.raises(ValueError, match="pyproj does not know the CRS 'EPSG:1'"):
        read_network(plain, width=50.0, crs="EPSG:1")
    with pytest.raises(ValueError, match="to_crs=: pyproj does not know"):
        read_network(path, width=50.0, to_crs="mars")
    with pytest.raises(ValueError, match="to_crs"):
        read_network(path, width=50.0, to_crs="EPSG:4269")


@needs_pyproj
def test_utm_zone_at_the_date_line_and_the_pole(tmp_path):
    rows = "lon,lat\n179.9,-16.5\n-179.9,-16.51\n-179.8,-16.5\n"
    assert read_network(write(tmp_path / "a.csv", rows), width=9.0, to_crs="UTM").crs == "EPSG:32701"
    rows = "lon,lat\n10,86\n10.1,86\n10.2,86\n"
    with pytest.raises(ValueError, match="UTM has no zone at 86 degrees"):
        read_network(write(tmp_path / "b.csv", rows), width=9.0, to_crs="utm")
    rows = "lon,lat\n10,95\n10.1,95\n10.2,95\n"
    with pytest.raises(ValueError, match="3 points cannot be brought from"):
        read_network(write(tmp_path / "c.csv", rows), width=9.0, to_crs="EPSG:32632")


@needs_pyproj
def test_files_of_two_zones_meet_in_one(tmp_path):
    a = write(tmp_path / "a.csv", "# crs=EPSG:32619\n780000,0\n790000,0\n800000,0\n")
    b = write(tmp_path / "b.csv", "# crs=EPSG:32620\n180000,0\n190000,0\n200000,0\n")
    network = read_network([a, b], width=50.0, to_crs="EPSG:32619")
    assert network.crs == "EPSG:32619"
    np.testing.assert_array_equal(network.polylines()[0][0], [780000.0, 0.0])
    assert 8.4e5 < network.polylines()[1][0, 0] < 8.6e5
    assert read_network([a, b], width=50.0, to_crs="utm").crs in ("EPSG:32619", "EPSG:32620")


@needs_pyproj
def test_feet_are_refused_or_reprojected(tmp_path):
    path = write(tmp_path / "a.csv", "# crs=EPSG:2263\n980000,200000\n990000,200000\n1000000,201000\n")
    with pytest.raises(ValueError, match=r"EPSG:2263 is in US survey foot, not metres; pass to_crs="):
        read_network(path, width=50.0)
    network = read_network(path, width=50.0, to_crs="utm")
    assert network.crs == "EPSG:32618"
    np.testing.assert_allclose(network.channel_lengths()[0], 20050.0 * 1200.0 / 3937.0, rtol=1e-3)


def mercator_rows(latitude):
    y = 6378137.0 * np.arcsinh(np.tan(np.radians(latitude)))
    return "# crs=EPSG:3857\n" + "".join(f"{x},{y}\n" for x in (-8e6, -7.99e6, -7.98e6))


@pytest.mark.parametrize("bare", [False, True])
def test_web_mercator_depends_on_the_latitude(tmp_path, monkeypatch, bare):
    if bare:
        monkeypatch.setitem(sys.modules, "pyproj", None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_network(write(tmp_path / "a.csv", mercator_rows(3)), width=50.0).crs == "EPSG:3857"
    with pytest.warns(UserWarning, match=r"1\.0[34]\d* times those on the ground"):
        read_network(write(tmp_path / "a.csv", mercator_rows(15)), width=50.0)
    with pytest.raises(ValueError, match=r"EPSG:3857 are 2 times those on the ground there; pass to_crs="):
        read_network(write(tmp_path / "a.csv", mercator_rows(60)), width=50.0)


def test_without_pyproj(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyproj", None)
    path = write(tmp_path / "a.csv", "# crs=EPSG:32619\n0,0\n100,0\n200,0\n")
    assert read_network(path, width=5.0).crs == "EPSG:32619"
    assert read_network(path, width=5.0, crs="urn:ogc:def:crs:EPSG::32619").crs == "EPSG:32619"
    with pytest.raises(ImportError, match=r'to_crs needs pyproj: pip install "warpriver\[gis\]"'):
        read_network(path, width=5.0, to_crs="utm")
    with pytest.raises(ValueError, match="not metres"):
        read_network(write(tmp_path / "b.csv", LONLAT.format("lon", "lat")), width=5.0)
