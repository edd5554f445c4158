"""Tests of the attribute table: what is written comes back to the bit, and the names of others are understood."""

import inspect
import json
import subprocess
import sys

import numpy as np
import pytest
from plain import plain_params
from river_files import GIS, HAS_OGR, Y, collection, confluence, feature, foreign, needs_ogr, needs_pyproj

from warpriver import RiverNetwork, Simulation, extract_network, generate
from warpriver.cli import main
from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge
from warpriver.hydrology import channel_width, horton_order, shreve_magnitude, strahler_order, width_of_discharge
from warpriver.io import read_network, write_network
from warpriver.io.vector import attributes

CHANNEL = (
    "channel_id",
    "channel_from",
    "channel_to",
    "channel_width",
    "channel_depth",
    "channel_discharge",
    "channel_drainage_area",
    "channel_slope",
)
LOSSLESS = [".geojson", ".geojson.gz", *GIS]


def extracted():
    terrain = generate.fluvial_terrain((120, 120), 50.0, 300.0, seed=2)
    terrain.crs = "EPSG:32632"
    return extract_network(terrain, min_drainage_area=5e5)


def simulated(dtype="float64"):
    """An extracted network after collisions: identities with gaps, nodes made anew, widths apart from their points'."""
    params = plain_params(reference_width=0.0, junctions=None, junction_drift=0.0)
    simulation = Simulation(extracted(), params, dtype=dtype)
    simulation.run(years=30)
    assert len(simulation.history.collisions) > 3
    return simulation.network


def with_short_channel():
    """A network in which a collision left a channel shorter than it is wide."""
    node = np.array([0.1, 0.3])
    spoke = np.linspace(0.0, 1.0, 30)[:, None]
    lines = [
        node + (1.0 - spoke) * [-3000.0, 2000.0],
        node + (1.0 - spoke) * [2500.0, 2100.0],
        node + np.linspace(0.0, 1.0, 3)[:, None] * [3.0, -100.0],
        node + [3.0, -100.0] + spoke * [-700.0, -4000.0],
        node + [3.0, -100.0] + (1.0 - spoke) * [4000.0, -900.0],
    ]
    area = np.array([3.3e6, 1.1e6, 5.5e6, 8.8e6, 2.2e6])
    network = RiverNetwork.from_polylines(
        lines, width=[60.0, 40.0, 125.0, 140.0, 50.0], drainage_area=area, channel_id=[4, 9, 2, 17, 5], allow_short=True
    )
    assert network.channel_lengths()[2] < network.channel_width[2]
    return network


NETWORKS = {"extracted": extracted, "simulated": simulated, "short": with_short_channel}


@pytest.fixture(scope="module", params=NETWORKS)
def network(request):
    return NETWORKS[request.param]()


def assert_same(back, network, means=True):
    for name in CHANNEL:
        if means or name not in ("channel_width", "channel_depth"):
            np.testing.assert_array_equal(getattr(back, name), getattr(network, name), name)
    np.testing.assert_array_equal(back.points(), network.points())
    np.testing.assert_array_equal(back.starts(), network.starts())
    for a, b in zip(back.point_widths(), network.point_widths(), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(back.point_depths(), network.point_depths(), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(back.origin, network.origin)
    assert back.crs == network.crs and (back.point_section is None) == (network.point_section is None)


@pytest.mark.parametrize("suffix", LOSSLESS)
def test_out_and_in_without_loss(tmp_path, network, suffix):
    write_network(network, tmp_path / f"a{suffix}")
    back = read_network(tmp_path / f"a{suffix}")
    assert_same(back, network)
    np.testing.assert_array_equal(back.node_xy, network.node_xy)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".txt"])
def test_out_and_in_as_text(tmp_path, network, suffix):
    write_network(network, tmp_path / f"a{suffix}")
    back = read_network(tmp_path / f"a{suffix}")
    assert_same(back, network, means=network.point_section is None)
    # Nodes lie at the ends of their channels; a rounding of 1e7 m is 2e-9 m.
    np.testing.assert_allclose(back.node_xy, network.node_xy, atol=4e-9, rtol=0)


@needs_ogr
def test_out_and_in_as_shapefile(tmp_path):
    network = with_short_channel()
    assert network.point_section is None
    write_network(network, tmp_path / "a.shp")
    import pyogrio

    fields = set(pyogrio.read_info(tmp_path / "a.shp")["fields"])
    # Lists are not written, and there are no slopes to lose.
    assert fields == set(attributes.SHORT_NAMES.values()) - {"joint"}
    back = read_network(tmp_path / "a.shp", short="keep")
    for name in ("channel_id", "channel_from", "channel_to"):
        np.testing.assert_array_equal(getattr(back, name), getattr(network, name))
    # The zero of the device coordinates is not kept: one rounding more, of 1e4 m.
    np.testing.assert_allclose(back.points(), network.points(), atol=2e-12, rtol=0)
    for name in ("channel_width", "channel_depth", "channel_discharge", "channel_drainage_area"):
        np.testing.assert_allclose(getattr(back, name), getattr(network, name), rtol=1e-14)
    assert np.isnan(back.channel_slope).all()


@pytest.mark.parametrize("suffix", LOSSLESS)
def test_single_precision_comes_back_to_the_bit(tmp_path, suffix):
    network = simulated("float32")
    write_network(network, tmp_path / f"a{suffix}")
    back = read_network(tmp_path / f"a{suffix}", dtype="float32")
    assert_same(back, network)
    count = network.point_count
    np.testing.assert_array_equal(back.point_xy.numpy()[:count], network.point_xy.numpy()[:count])


@pytest.mark.parametrize("suffix", [".csv", *LOSSLESS])
def test_what_is_not_known_stays_unknown(tmp_path, suffix):
    base = confluence()
    slope = [0.001, np.nan, 1.0 / 3.0]
    network = RiverNetwork.from_polylines(base.polylines(), width=50.0, slope=slope, channel_id=[7, 2**60 + 1, -3])
    if suffix == ".csv":  # numbers of text are doubles
        network = RiverNetwork.from_polylines(base.polylines(), width=50.0, slope=slope, channel_id=[7, 2**53 - 1, -3])
    write_network(network, tmp_path / f"a{suffix}")
    back = read_network(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(back.channel_slope, slope)
    np.testing.assert_array_equal(back.channel_id, network.channel_id)
    assert back.channel_drainage_area is None


def test_written_attributes_are_the_documented_ones(tmp_path):
    network = simulated()
    write_network(network, tmp_path / "a.geojson")
    rows = [f["properties"] for f in json.loads((tmp_path / "a.geojson").read_text())["features"]]
    assert list(rows[0]) == [a.name for a in attributes.WRITTEN if a.name != "joint"]
    table = {name: np.array([row[name] for row in rows]) for name in list(rows[0])[:-2]}
    above, below, area = network.channel_from, network.channel_to, network.channel_drainage_area
    np.testing.assert_array_equal(table["strahler"], strahler_order(above, below))
    np.testing.assert_array_equal(table["shreve"], shreve_magnitude(above, below))
    np.testing.assert_array_equal(table["horton"], horton_order(above, below, area))
    np.testing.assert_array_equal(table["drainage_area_km2"], area / 1e6)
    np.testing.assert_array_equal(table["length_m"], network.channel_lengths())
    chord = [np.hypot(*(xy[-1] - xy[0])) for xy in network.polylines()]
    np.testing.assert_allclose(table["sinuosity"], network.channel_lengths() / chord)
    # Downstream is the channel that begins where one ends; the lowest of a stem flows out or into a larger one.
    place = {number: c for c, number in enumerate(table["channel_id"].tolist())}
    for c, number in enumerate(table["next_down"].tolist()):
        assert below[c] not in above if number == -1 else above[place[number]] == below[c]
    assert set(table["main_stem"]) <= set(table["channel_id"])


def test_the_documentation_has_the_tables():
    assert attributes.written_table() in inspect.getdoc(write_network)
    assert attributes.read_table() in inspect.getdoc(read_network)
    # What is written is read again, or follows from the lines.
    read = {name.name for name in attributes.READ["any file"]}
    lists = {name for role in attributes.LISTS for name in attributes.list_names(role)}
    follow = {"length_m", "sinuosity", "strahler", "shreve", "horton", "main_stem"}
    assert {a.name for a in attributes.WRITTEN} == (read | lists) & {a.name for a in attributes.WRITTEN} | follow
    shorts = [a.short for a in attributes.WRITTEN if a.short]
    assert all(len(short) <= 10 for short in shorts) and len(set(shorts)) == len(shorts)
    assert set(shorts) <= read | follow
    for names in attributes.READ.values():
        assert {name.role for name in names} <= set(attributes.ROLES)


def test_files_of_before_are_read(tmp_path):
    """The attributes that 0.1.0 wrote."""
    rows = [
        {"seg_id": k, "down_id": d, "from_node": a, "to_node": b, "width": 9.0, "depth": 1.0, "discharge": 3.0}
        for k, d, a, b in ((0, 2, 0, 2), (1, 2, 1, 2), (2, -1, 2, 3))
    ]
    rows[2]["point_width"] = [8.0, 9.0, 10.0]
    path = collection(tmp_path / "a.geojson", *(feature("LineString", Y[k], **row) for k, row in enumerate(rows)))
    network = read_network(path, crs=None)
    assert network.channel_to.tolist() == [2, 2, 3] and network.channel_from.tolist() == [0, 1, 2]
    assert network.point_widths()[2].tolist() == [8.0, 9.0, 10.0]
    text = "# units=m order=downstream\nchannel,x,y,width,depth,discharge\n0,0,0,9,1,3\n0,99,0,9,1,3\n0,200,0,9,1,3\n"
    (tmp_path / "a.csv").write_text(text)
    assert read_network(tmp_path / "a.csv").channel_discharge.tolist() == [3.0]


# ---- the names of others


def test_hydrorivers(tmp_path):
    rows = [
        {
            "HYRIV_ID": n,
            "NEXT_DOWN": d,
            "MAIN_RIV": 30,
            "LENGTH_KM": 0.6,
            "UPLAND_SKM": a,
            "DIS_AV_CMS": q,
            "ORD_STRA": o,
        }
        for n, d, a, q, o in ((10, 30, 12.5, 0.2, 1), (20, 30, 20.0, 0.0, 1), (30, 0, 33.0, 0.5, 2))
    ]
    path = foreign(tmp_path / "a.geojson", *rows)
    with pytest.warns(UserWarning, match=r"3 of 3 channels have no width; inferred 3 from the drainage area by w"):
        network = read_network(path)
    assert network.channel_id.tolist() == [10, 20, 30]
    np.testing.assert_array_equal(network.channel_drainage_area, [12.5e6, 20e6, 33e6])
    # The discharge of 0.2 m3/s is a mean one: a river of 12.5 km2 is not 3.2 m wide.
    width = channel_width(network.channel_drainage_area)
    np.testing.assert_allclose(network.channel_width, width, rtol=1e-15)
    # No flow is resolved for the second one: the bankfull one of its width, scaled to means as the others are.
    scale = np.median([0.2 / bankfull_discharge(width[0]), 0.5 / bankfull_discharge(width[2])])
    np.testing.assert_allclose(network.channel_discharge, [0.2, scale * bankfull_discharge(width[1]), 0.5])
    np.testing.assert_allclose(network.channel_depth, bankfull_depth(width))
    assert network.channel_to[0] == network.channel_to[1] == network.channel_from[2]
    order = strahler_order(network.channel_from, network.channel_to)
    assert order.tolist() == [row["ORD_STRA"] for row in rows]
    # The caller knows better: no warning.
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_network(path, width=12.0).channel_width.tolist() == [12.0] * 3


def test_mean_discharges_without_an_area_make_narrow_widths_and_say_so(tmp_path):
    rows = [{"HYRIV_ID": n, "NEXT_DOWN": d, "DIS_AV_CMS": q} for n, d, q in ((1, 3, 0.2), (2, 3, 0.3), (3, 0, 0.5))]
    path = foreign(tmp_path / "a.geojson", *rows)
    with pytest.warns(UserWarning, match=r"inferred 3 from the long-term mean discharge .* too narrow"):
        network = read_network(path)
    np.testing.assert_array_equal(network.channel_width, width_of_discharge([0.2, 0.3, 0.5]))
    # A discharge that the caller gives is bankfull, and makes the width.
    with pytest.warns(UserWarning, match=r"inferred 3 from the bankfull discharge"):
        assert read_network(path, discharge=8.0).channel_width.tolist() == [float(width_of_discharge(8.0))] * 3


@pytest.mark.parametrize("identity", ["COMID", "NHDPlusID"])
def test_nhdplus(tmp_path, identity):
    rows = [
        {
            identity: 55000100000000.0 + n,
            "FromNode": a,
            "ToNode": b,
            "TotDASqKm": s,
            "SLOPE": i,
            "QE_MA": 100.0,
            "width": 9,
        }
        for n, a, b, s, i in ((1, 901, 903, 5.0, 0.01), (2, 902, 903, 6.0, -9998.0), (3, 903, 904, 12.0, 0.002))
    ]
    network = read_network(foreign(tmp_path / "a.geojson", *rows))
    np.testing.assert_array_equal(network.channel_id - 55000100000000, [1, 2, 3])
    np.testing.assert_array_equal(network.channel_slope, [0.01, np.nan, 0.002])  # -9998: no value
    np.testing.assert_allclose(network.channel_discharge, 100.0 * 0.3048**3)  # ft3/s
    np.testing.assert_allclose(network.channel_drainage_area, [5e6, 6e6, 12e6])
    assert network.channel_from.tolist() == [0, 1, 2] and network.channel_to.tolist() == [2, 2, 3]
    np.testing.assert_array_equal(network.node_xy, [Y[0][0], Y[1][0], Y[2][0], Y[2][-1]])


def test_sword(tmp_path):
    rows = [
        {"reach_id": n, "rch_id_dn": d, "n_rch_up": u, "facc": a, "width": w, "slope": s, "reach_length": 600.0}
        for n, d, u, a, w, s in (
            (74100100011, "74100100031", 0, 300.0, 60.0, 0.4),
            (74100100021, "74100100031 74100100041", 0, 500.0, 90.0, -9999.0),
            (74100100031, "", 2, 810.0, 110.0, 0.1),
        )
    ]
    # Its lines run upstream.
    network = read_network(foreign(tmp_path / "a.geojson", *rows, lines=[xy[::-1] for xy in Y]))
    for xy, expected in zip(network.polylines(), Y, strict=True):
        np.testing.assert_array_equal(xy, expected)
    np.testing.assert_allclose(network.channel_slope, [4e-4, np.nan, 1e-4])  # m/km there
    np.testing.assert_array_equal(network.channel_drainage_area, [300e6, 500e6, 810e6])
    assert network.channel_to[0] == network.channel_to[1] == network.channel_from[2]
    # Beside other attributes the same names are in our units.
    for row in rows:
        del row["n_rch_up"], row["facc"]
    assert read_network(foreign(tmp_path / "b.geojson", *rows)).channel_slope[0] == 0.4


def test_where_a_river_parts_the_larger_branch_goes_on(tmp_path):
    rows = [
        {"reach_id": 1, "rch_id_dn": "2 3", "facc": 50.0, "n_rch_up": 0, "width": 9.0},
        {"reach_id": 2, "rch_id_dn": "-9999", "facc": 20.0, "n_rch_up": 1, "width": 9.0},
        {"reach_id": 3, "rch_id_dn": 0, "facc": 30.0, "n_rch_up": 1, "width": 9.0},
    ]
    arms = [Y[2], [[500, 0], [300, -200], [0, -400]], [[500, 0], [700, -200], [1000, -400]]]
    network = read_network(foreign(tmp_path / "a.geojson", *rows, lines=arms))
    assert network.channel_to[0] == network.channel_from[2] != network.channel_from[1]
    assert strahler_order(network.channel_from, network.channel_to).tolist() == [1, 1, 1]


def test_units_are_turned_and_fill_values_passed_over():
    other = attributes.family_of(["Reach_ID", "FACC"])
    assert other.name == "SWORD" and attributes.family_of(["reach_id", "slope"]).name == "any file"
    assert attributes.family_of(["comid"]).name == "NHDPlus" and attributes.family_of(["hyriv_id"]).mean_flow
    for value in (None, "", "  ", float("nan"), -9999, "-9998", -999900.0):
        assert attributes.read_role({"slope": value}, other, "slope", "here") is None
    assert attributes.read_role({"slope": "2"}, other, "slope", "here") == 2e-3
    assert attributes.read_role({"channel_id": 2**60 + 1}, attributes.GENERIC, "channel_id", "here") == 2**60 + 1
    for value in ("A12", 1.5, float("inf"), [], {}):
        assert attributes.read_role({"channel_id": value}, attributes.GENERIC, "channel_id", "here") is None
    with pytest.raises(ValueError, match="here: facc is 'much', not a number"):
        attributes.read_role({"facc": "much"}, other, "drainage_area", "here")


@pytest.mark.parametrize("law", ["area", "discharge"])
def test_widths_are_inferred_with_a_warning(tmp_path, law):
    name, value = ("drainage_area_km2", 100.0) if law == "area" else ("discharge_m3s", 10.0)
    path = foreign(tmp_path / "a.geojson", {name: value}, {name: value, "width": 5.0}, {name: value})
    words = "drainage area by w = c A" if law == "area" else "bankfull discharge by w = 7.2 Q"
    with pytest.warns(UserWarning, match=rf"2 of 3 channels have no width; inferred 2 from the {words}.*Pass width="):
        network = read_network(path)
    width = float(channel_width(100e6) if law == "area" else width_of_discharge(10.0))
    assert network.channel_width.tolist() == [width, 5.0, width]


@needs_pyproj
def test_degrees_with_attributes(tmp_path):
    """HydroRIVERS and SWORD come in longitude and latitude; the graph stays the file's."""
    rows = [{"HYRIV_ID": n, "NEXT_DOWN": d, "UPLAND_SKM": 9.0} for n, d in ((1, 3), (2, 3), (3, 0))]
    lines = [(np.array(xy) / 1e5 + [10.0, 45.0]).tolist() for xy in Y]
    path = foreign(tmp_path / "a.geojson", *rows, lines=lines)
    with pytest.warns(UserWarning, match="3 of 3 channels have no width"):
        network = read_network(path, crs="EPSG:4326", to_crs="utm")
    assert network.crs == "EPSG:32632" and network.channel_to[0] == network.channel_from[2]


@pytest.mark.skipif(not HAS_OGR, reason="pyogrio is not installed (warpriver[gis])")
def test_info_tells_of_the_attributes(tmp_path):
    write_network(extracted(), tmp_path / "a.gpkg")
    arguments = [sys.executable, "-m", "warpriver", "info", str(tmp_path / "a.gpkg")]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    for words in ("outlets", "Strahler order 1 to 2", "drainage area 0.71 to 3.92 km2", "slope 0.0317 to 0.0908 m/m"):
        assert words in done.stdout


def test_info_warns_in_one_line_and_takes_short_lines(tmp_path, capsys):
    rows = [
        {"channel_id": k, "next_down": d, "drainage_area_km2": area}
        for k, d, area in ((1, 3, 1e5), (2, 3, 10.0), (3, -1, 10.0))
    ]
    lines = [Y[0], [*Y[1][:-1], [1500.0, 1500.0]], Y[2]]
    path = str(foreign(tmp_path / "a.geojson", *rows, lines=lines))
    assert main(["info", path, "--short", "error"]) == 2
    assert "--short narrow, 'drop' or 'keep'" in capsys.readouterr().err
    assert main(["info", path]) == 0
    said = capsys.readouterr()
    assert "2 outlets, Strahler order 1 to 1" in said.out and "slope" not in said.out
    warned = [line for line in said.err.splitlines() if line.startswith("warpriver info: warning: ")]
    assert len(warned) == 2 and "inferred 3 from the drainage area" in warned[0] and "left free" in warned[1]
