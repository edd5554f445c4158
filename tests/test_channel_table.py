"""The table of channels: its columns, free ones beside them, and that nothing of it can be written into."""

import copy
import pickle

import numpy as np
import pytest
from plain import plain_params
from trees import random_tree

from warpriver import RiverNetwork, Simulation
from warpriver.channel_table import COLUMNS, ChannelTable
from warpriver.graph.edits import NetworkEdit
from warpriver.graph.rings import split_rings
from warpriver.history import History


def table(**changes):
    columns = {
        "width": [10.0, 20.0, 30.0],
        "depth": [1.0, 2.0, 3.0],
        "discharge": [5.0, 6.0, 7.0],
        "extra": {"rock": ["clay", "", "sandstone"], "grain": [0.5, np.nan, 2.0], "dam": [True, False, False]},
    }
    return ChannelTable(**{**columns, **changes})


def test_a_table_gives_its_columns():
    channels = table(closed=[False, True, False])
    assert len(channels) == 3
    assert list(channels) == [
        "width", "depth", "discharge", "slope", "id", "from_node", "to_node", "closed", "joint", "rock", "grain", "dam",
    ]  # fmt: skip
    assert "grain" in channels and "drainage_area" not in channels and channels.drainage_area is None
    assert channels["width"] is channels.width and channels.id.tolist() == [0, 1, 2]
    assert np.isnan(channels.slope).all() and (channels.from_node == -1).all()
    kinds = {
        name: channels[name].dtype.kind + str(channels[name].itemsize) for name in ("id", "to_node", "closed", "dam")
    }
    assert kinds == {"id": "i8", "to_node": "i4", "closed": "b1", "dam": "b1"}
    assert channels.nbytes == sum(channels[name].nbytes for name in channels)
    assert "3 channels: width, depth" in repr(channels)
    with pytest.raises(KeyError, match="drainage_area"):
        channels["drainage_area"]


def test_nothing_can_be_written_into():
    given = np.array([10.0, 20.0, 30.0])
    channels = table(width=given)
    for made in (channels, channels.take([0, 1]), channels.take(slice(1, 3)), channels.replace(depth=given),
                 pickle.loads(pickle.dumps(channels))):  # fmt: skip
        for name in made:
            with pytest.raises(ValueError, match="read-only"):
                made[name][:] = made[name][0]
    with pytest.raises(AttributeError):
        channels.width = given
    with pytest.raises(TypeError):
        channels.extra["rock"] = given
    given[0] = 5.0  # the caller's own array is no part of the table
    assert channels.width[0] == 10.0


def test_take_keeps_every_column():
    channels = table(drainage_area=[1e6, 2e6, 3e6])
    for index, order in (([2, 0, 0], [2, 0, 0]), (channels.width > 10.0, [1, 2]), (slice(None, None, 2), [0, 2])):
        taken = channels.take(index)
        assert len(taken) == len(order) and list(taken) == list(channels)
        for name in channels:
            np.testing.assert_array_equal(taken[name], channels[name][order])


def test_replace_changes_what_it_names_and_shares_the_rest():
    channels = table()
    made = channels.replace(width=[1, 2, 3], grain=[1, 2, 3], extra={"dam": None, "name": ["a", "b", "c"]})
    assert made.width.tolist() == [1.0, 2.0, 3.0] and made["grain"].dtype == np.int64
    assert list(made.extra) == ["rock", "grain", "name"] and list(channels.extra) == ["rock", "grain", "dam"]
    assert made.depth is channels.depth and made["rock"] is channels["rock"]
    area = channels.replace(drainage_area=[1.0, 2.0, 3.0])
    assert area.drainage_area.tolist() == [1.0, 2.0, 3.0] and area.replace(drainage_area=None) == channels


def test_equal_tables_hold_the_same_values():
    assert table() == table() and table() != table(width=[1.0, 2.0, 3.0]) and table() != 5
    assert table() != table(extra={}) and table() != table(extra={**table().extra, "more": [1, 2, 3]})
    assert copy.deepcopy(table()) == pickle.loads(pickle.dumps(table())) == table()
    with pytest.raises(TypeError, match="unhashable"):
        hash(table())


@pytest.mark.parametrize(
    ("kind", "changes", "words"),
    [
        (TypeError, {"widht": [1.0] * 3}, "no column 'widht'; a free one goes into extra"),
        (TypeError, {"depth": None}, "channel_depth is missing"),
        (ValueError, {"depth": [1.0]}, r"channel_depth has shape \(1,\) for 3 channels"),
        (ValueError, {"width": [1.0, -2.0, 3.0]}, "channel_width of channel 1 is -2; it must be positive"),
        (ValueError, {"discharge": [1.0, 2.0, np.nan]}, "channel_discharge of channel 2 is nan"),
        (ValueError, {"drainage_area": [0.0, 2.0, 3.0]}, "channel_drainage_area of channel 0 is 0"),
        (ValueError, {"slope": [1.0, np.inf, 3.0]}, "channel_slope of channel 1 is infinite"),
        (ValueError, {"width": ["a", "b", "c"]}, "channel_width is .*; give one number a channel"),
        (ValueError, {"id": [0.5, 1.0, 2.0]}, "channel_id is float64; give one whole number"),
        (ValueError, {"from_node": [0, 1]}, r"channel_from has shape \(2,\)"),
        (ValueError, {"closed": []}, r"channel_closed has shape \(0,\)"),
        (ValueError, {"closed": ["yes", "no", "no"]}, "give True or False"),
        (ValueError, {"extra": {"rock": ["a"]}}, r"extra column 'rock' has shape \(1,\) for 3 channels"),
        (ValueError, {"extra": {"rock": [None, 1, "a"]}}, "extra column 'rock' is object"),
        (ValueError, {"extra": {"rock": [2**64 - 1] * 3}}, "does not fit"),
        (ValueError, {"extra": {"id": [1, 2, 3]}}, "'id', which every table has"),
        (ValueError, {"extra": {" ": [1, 2, 3]}}, "letters that can be printed"),
        (ValueError, {"extra": {"a\nb": [1, 2, 3]}}, "letters that can be printed"),
    ],
)
def test_bad_columns_get_one_clear_error(kind, changes, words):
    with pytest.raises(kind, match=words) as caught:
        table(**changes)
    assert "\n" not in str(caught.value)


def test_a_column_that_is_not_there_is_not_replaced():
    with pytest.raises(ValueError, match=r"no column 'widht'; there are width.* added by extra=\{'widht'"):
        table().replace(widht=[1.0, 2.0, 3.0])


# ---- free columns go where channels go


def marked_tree():
    network = random_tree(7, sources=8, size=8000.0, width=25.0)
    count = network.channel_count
    extra = {"mark": network.channel_id, "rock": np.array(["clay", "sand", "gravel"])[np.arange(count) % 3]}
    return network.with_channels(network.channels.replace(extra=extra))


def test_edits_hand_every_column_on():
    network = marked_tree()
    edit = NetworkEdit(network)
    first, stop = network.starts()[:2]
    far = next(c for c in range(1, network.channel_count) if network.channel_to[c] != network.channel_to[0])
    assert edit.rejoin(0, int(first + stop) // 2, far, int(network.starts()[far : far + 2].sum()) // 2) is not None
    edited = edit.build()
    assert set(edited.channels) == set(network.channels)
    for name in ("mark", "rock", "closed"):
        np.testing.assert_array_equal(edited.channels[name], network.channels[name][edited.channel_old])


def test_both_parts_of_a_ring_have_its_columns():
    angle = 2.0 * np.pi * np.arange(40) / 40
    ring = 500.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [ring, ring + [3000.0, 0.0]]
    network = RiverNetwork.from_polylines(rings, 20.0, closed=True, extra={"name": ["west", "east"]})
    edited = split_rings(network, np.array([[1, 0, 12], [1, 12, 9]]), ring)
    assert edited.channels["name"].tolist() == ["west", "east", "east", "east"] and edited.channels.closed.all()
    assert edited.channels.id.tolist() == [0, 1, 2, 3] and edited.channels.to_node.tolist() == [0, 1, 2, 3]


def test_runs_keep_every_column(tmp_path, device):
    sim = Simulation(
        marked_tree(),
        plain_params(spacing=20.0, reference_width=0.0, junctions=None, junction_drift=0.0),
        device=device,
    )
    history = sim.run(steps=150, record_every=50, store=tmp_path / "run")
    assert len({event.case for event in history.collisions}) > 2
    rock = dict(zip(range(1000), ["clay", "sand", "gravel"] * 333, strict=False))
    channels = sim.network.channels
    assert [rock[mark] for mark in channels["mark"].tolist()] == channels["rock"].tolist()
    history.save(tmp_path / "run.npz")
    for found in (history, History.load(tmp_path / "run"), History.load(tmp_path / "run.npz")):
        assert found.record(-1).channels == found.network(-1).channels == channels
        assert set(found.record(0).channels) == {*COLUMNS, "mark", "rock"}
    again = Simulation.resume(tmp_path / "run", device=device)
    assert again.network.channels == channels
