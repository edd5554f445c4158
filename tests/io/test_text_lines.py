"""Tests of lines as columns of numbers."""

import gzip

import numpy as np
import pytest
from river_files import (
    confluence,
    write,
)

from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge
from warpriver.io import read_network, write_network

POINTS = [(0.0, 0.0), (100.0, 10.0), (200.0, -10.0), (300.5, 0.25)]


@pytest.mark.parametrize(
    "text",
    [
        "0,0\n100,10\n200,-10\n300.5,0.25\n",
        "0 0\n100 10\n200 -10\n300.5 0.25",
        "0\t0\r\n100\t10\r\n200\t-10\r\n300.5\t0.25\r\n",
        "0;0\n100;10\n200;-10\n300,5;0,25\n",
        "0,0;0\n100,0;10\n200,0;-10\n300,5;0,25\n",
        "  0   0\n  100   10\n\n\n# the end\n",
        "\ufeffx,y\n0,0\n100,10\n200,-10\n300.5,0.25\n",
        "# a comment\n\nx y\n# another\n0 0 # here\n100 10\n200 -10\n300.5 0.25\n",
        "RMTEXT\t350\t2\n0 0\n100 10\n200 -10\n300.5 0.25\n",
        "Easting,Northing\n0,0\n100,10\n200,-10\n300.5,0.25\n",
        'name,Y,left_x,X\nA,0,1,0\n"B, b",10,1,100\nC,-10,1,200\nD,0.25,1,300.5\n',
        "# y,x\n0,0\n10,100\n-10,200\n0.25,300.5\n",
        "0 0 7\n100 10 7\n200 -10 nan\n300.5 0.25 7\n",
        "id,x,y\n1,0,0\n2,100,10\n3,200,-10\n4,300.5,0.25\n",
        "# order=upstream\n300.5 0.25\n200 -10\n100 10\n0 0\n",
        "0, 0\n1e2, 1.0E1\n200., -10.\n+300.5, .25\n",
    ],
)
def test_text_layouts(tmp_path, text):
    path = tmp_path / "a.txt"
    path.write_bytes(text.encode())
    network = read_network(path, width=20.0)
    assert network.channel_count == 1
    expected = POINTS if "300" in text else [(0.0, 0.0), (50.0, 5.0), (100.0, 10.0)]
    np.testing.assert_array_equal(network.polylines()[0], expected)
    assert network.crs is None


def test_width_and_depth_of_each_point(tmp_path):
    path = write(
        tmp_path / "a.csv",
        """\
        # river=Jurua date=1987 crs=EPSG:32619 units=m order=downstream source=somewhere (Apache-2.0)
        x,y,width_m,depth_m,discharge
        0,0,20,2,5
        100,10,21,2.5,6
        200,-10,22,3,7
        """,
    )
    network = read_network(path)
    assert network.crs == "EPSG:32619"
    np.testing.assert_array_equal(network.point_widths()[0], [20.0, 21.0, 22.0])
    np.testing.assert_array_equal(network.point_section.numpy()[:, 1], [2.0, 2.5, 3.0])
    assert network.channel_discharge[0] == 6.0
    network = read_network(path, width=30.0, discharge=9.0)
    np.testing.assert_array_equal(network.point_widths()[0], 30.0)
    assert network.channel_discharge[0] == 9.0
    np.testing.assert_array_equal(read_network(path, width=[[7.0, 8.0, 9.0]]).point_widths()[0], [7.0, 8.0, 9.0])


def test_laws_fill_what_is_missing(tmp_path):
    network = read_network(write(tmp_path / "a.csv", "x,y,width\n0,0,30\n900,0,30\n1800,9,30\n"))
    np.testing.assert_allclose(network.channel_depth, bankfull_depth(30.0))
    np.testing.assert_allclose(network.channel_discharge, bankfull_discharge(30.0))


@pytest.mark.parametrize(("one", "two"), [("1", "2"), ("north", "south"), ("2.5", "-1"), ('"a, b"', '"c"')])
@pytest.mark.parametrize("name", ["channel", "Channel_ID", "seg_id", "id"])
def test_channels_by_column(tmp_path, name, one, two):
    rows = f"{one},0,0\n{one},100,0\n{one},200,5\n{two},0,900\n{two},100,900\n{two},150,905\n{two},200,900\n"
    network = read_network(write(tmp_path / "a.csv", f"{name},x,y\n{rows}"), width=9.0)
    assert [len(xy) for xy in network.polylines()] == [3, 4]


def test_channels_by_blank_line(tmp_path):
    blocks = "# first\n0 0\n100 0\n200 5\n \n\n# second\n0 900\n100 900\n# not a new one\n150 905\n200 900\n\n"
    network = read_network(write(tmp_path / "b.xy", blocks), width=[9.0, 8.0])
    assert [len(xy) for xy in network.polylines()] == [3, 4]
    np.testing.assert_array_equal(network.channel_width, [9.0, 8.0])
    path = write(tmp_path / "c.csv", "channel,x,y\n1,0,0\n1,9,0\n1,20,0\n2,0,5\n2,9,5\n2,20,5\n1,40,0\n1,50,0\n")
    with pytest.raises(ValueError, match="rows of channel 1 do not stand together"):
        read_network(path, width=1.0)


def test_many_rows(tmp_path):
    xy = np.cumsum(np.random.default_rng(0).random((200_000, 2)) + 0.01, axis=0)
    rows = "\n".join(f"{x:.2f},{y:.2f}" for x, y in xy.tolist())
    (tmp_path / "a.csv").write_text(rows)
    network = read_network(tmp_path / "a.csv", width=1.0)
    assert network.point_count == 200_000
    np.testing.assert_allclose(network.points(), xy, atol=0.0051)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: the file is empty"),
        (" \n\n", "a.csv: the file is empty"),
        ("# only\n# comments\n", "no row of numbers"),
        ("once upon a time\nthere was a river\n", "no row of numbers"),
        ("x,y\n", "no row of numbers"),
        ("x,y\n0,0\n\n1,one\n", r"a\.csv, line 4: 'one' is not a number \(column 2, y\)"),
        ("0,0\n1\n", r"a\.csv, line 2: 1 columns; y should be in column 2"),
        ("7\n0 0\n1 1\n", r"a\.csv, line 1: 1 columns"),
        ("x,y,width\n0,0,1\n1,1,wide\n", r"line 3: 'wide' is not a number \(column 3, width\)"),
        ("x,y,channel\n0,0\n1,1\n", r"a\.csv, line 2: 2 columns; channel should be in column 3"),
        ("x,y,channel\n0,0,north\n1,1\n", r"a\.csv: its channels cannot be read"),
        ("0,0\n# c\n1,nan\n2,2\n", r"a\.csv, line 3: y is nan"),
        ("0,0\n-inf,3\n2,2\n", r"a\.csv, line 2: x is -inf"),
        ("a,b\n0,0\n1,1\n2,2\n", "its columns are a, b; name two of them x and y"),
        ("# units=ft\n0,0\n1,1\n2,2\n", "units=ft; only metres"),
        ("# order=sideways\n0,0\n1,1\n2,2\n", "order=sideways"),
        ("x,y\n0,0\n100,0\n200,0\n", r"gives no width; pass width= \(bankfull width in m\)"),
        ("x,y,width\n5,5,1\n5,5,1\n", "only one distinct point"),
        ("x,y,width\n0,0,-1\n50,5,-1\n99,9,-1\n", "the file gives no width"),
        ("\x89PNG\x00\x00", "zero bytes"),
    ],
)
def test_bad_text_is_told_in_one_line(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match=message) as caught:
        read_network(path)
    assert "a.csv" in str(caught.value) and "\n" not in str(caught.value)


def test_a_cut_gzip_is_told_at_every_length(tmp_path):
    write_network(confluence(), tmp_path / "a.csv.gz")
    whole = (tmp_path / "a.csv.gz").read_bytes()
    for length in (1, 2, 9, 10, 15, len(whole) // 2, len(whole) - 9, len(whole) - 1):
        (tmp_path / "b.csv.gz").write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"b\.csv\.gz: not a whole gzip file"):
            read_network(tmp_path / "b.csv.gz")
    (tmp_path / "b.csv.gz").write_bytes(whole[:50] + bytes(20) + whole[70:])
    with pytest.raises(ValueError, match="not a whole gzip file"):
        read_network(tmp_path / "b.csv.gz")
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(b""))
    with pytest.raises(ValueError, match="is empty"):
        read_network(tmp_path / "b.csv.gz")
