"""Tests of how rows of text become channels: by a column, by blank lines, and never by a jump without a word."""

import warnings

import numpy as np
import pytest

from warpriver.io import read_network
from warpriver.io.vector.breaks import CHANNEL_NAMES

KNOWN = [
    "reach_id", "fid", "OBJECTID", "river", "line_id", "Channel", "seg_id", "COMID", "name", "gid", "part", "LINKNO",
    "river_name", "Stream",
]  # fmt: skip


def rows(channel, count=20, apart=4000.0):
    """Three rivers with what names them in each row."""
    return "".join(
        f"{channel(k)},{500_000 + 50 * i},{4_000_000 + apart * k},30\n" for k in range(3) for i in range(count)
    )


@pytest.fixture(autouse=True)
def no_surprising_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        yield


@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("words", [False, True])
def test_a_column_that_names_channels_parts_them(tmp_path, name, words):
    assert name.lower() in CHANNEL_NAMES
    (tmp_path / "a.csv").write_text(f"{name},x,y,width\n" + rows(lambda k: "abc"[k] if words else 11 + k))
    network = read_network(tmp_path / "a.csv")
    assert network.channel_count == 3
    np.testing.assert_allclose(network.channel_lengths(), 950.0)
    assert network.channel_id.tolist() == ([0, 1, 2] if words else [11, 12, 13])


@pytest.mark.parametrize("name", ["id", "fid", "OBJECTID", "name", "part"])
def test_a_column_that_numbers_points_parts_nothing(tmp_path, name):
    text = "".join(f"{i},{50 * i},0,30\n" for i in range(20))
    (tmp_path / "a.csv").write_text(f"{name},x,y,width\n{text}")
    assert read_network(tmp_path / "a.csv").channel_count == 1


def test_the_surer_column_counts(tmp_path):
    text = "".join(
        f"{n},{11 + k},{50 * i},{4000 * k},30\n" for n, (k, i) in enumerate((k, i) for k in (0, 1) for i in range(9))
    )
    (tmp_path / "a.csv").write_text(f"fid,reach_id,x,y,width\n{text}")
    assert read_network(tmp_path / "a.csv").channel_id.tolist() == [11, 12]
    (tmp_path / "b.csv").write_text(f"fid,river,x,y,width\n{text}")
    assert read_network(tmp_path / "b.csv").channel_id.tolist() == [11, 12]


def test_a_column_of_something_else_is_passed_over_with_a_word(tmp_path):
    text = "".join(f"{'ab'[i % 2]},{50 * i},0,30\n" for i in range(20))
    (tmp_path / "a.csv").write_text(f"name,x,y,width\n{text}".replace("a,50,", "a,51,"))
    text = "".join(f"{'ab'[i // 3 % 2]},{50 * i},0,30\n" for i in range(20))
    (tmp_path / "a.csv").write_text(f"name,x,y,width\n{text}")
    with pytest.warns(UserWarning, match="the column name does not part the rows into channels.*it is passed over"):
        assert read_network(tmp_path / "a.csv").channel_count == 1


@pytest.mark.parametrize("apart", [4000.0, 1200.0, -2000.0])
def test_a_jump_is_told(tmp_path, apart):
    (tmp_path / "a.csv").write_text("what,x,y,width\n" + rows(lambda k: k, apart=apart))
    with pytest.warns(
        UserWarning, match=r"a\.csv: from line (21|41) to (22|42) it jumps [\d.]+ times its usual spacing"
    ):
        assert read_network(tmp_path / "a.csv").channel_count == 1
    (tmp_path / "b.csv").write_text("river,x,y,width\n" + rows(lambda k: 7, apart=apart))
    with pytest.warns(UserWarning, match=r"2 jumps in all.*part them by blank lines or a column channel"):
        assert read_network(tmp_path / "b.csv").channel_count == 1


def test_uneven_points_are_no_jump(tmp_path):
    x = np.cumsum(np.random.default_rng(0).gamma(2.0, 25.0, 500))
    (tmp_path / "a.csv").write_text("".join(f"{v},{np.sin(v / 200)}\n" for v in x))
    assert read_network(tmp_path / "a.csv", width=30.0).channel_count == 1


ROWS = ["x,y,width"] + [f"{500_000 + 50 * i},4000000,30" for i in range(60)]


@pytest.mark.parametrize("gap", ["\r\r\n", "\n\n", "\r\n\r\n", "\n \n", "\n\n\n", "\r\r"])
@pytest.mark.parametrize("head", [True, False])
def test_line_ends_that_were_doubled_part_nothing(tmp_path, gap, head):
    (tmp_path / "a.csv").write_bytes(gap.join(ROWS[0 if head else 1 :]).encode() + gap.encode())
    network = read_network(tmp_path / "a.csv", width=None if head else 30.0)
    assert network.channel_count == 1 and network.point_count == 60


@pytest.mark.parametrize(("gap", "parting"), [("\r\r\n", "\r\r\n\r\r\n"), ("\n\n", "\n\n\n"), ("\n", "\n\n")])
def test_more_blank_lines_than_usual_part_channels(tmp_path, gap, parting):
    text = parting.join(gap.join(ROWS[1 + 20 * k : 21 + 20 * k]) for k in range(3))
    (tmp_path / "a.csv").write_bytes(text.encode())
    network = read_network(tmp_path / "a.csv", width=30.0)
    assert network.channel_count == 3 and network.point_count == 60
