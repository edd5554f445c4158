"""Edits of the graph by its author: lines, flow, sections and free columns of what they make."""

import numpy as np
import pytest
from trees import assert_forest, random_tree

from warpriver import RiverNetwork
from warpriver.channel_table import JOINT_LOCK, JOINT_NONE, JOINT_THROUGH
from warpriver.errors import InputError
from warpriver.graph.authoring import Reworking, nearest_point, river_of, smooth_line

# Sums of some ten flows in another order.
FLOW = 1e-12


def made(network, edited):
    """The network after an edit, its points put together on the host from the runs."""
    xy, section = network.point_xy[: network.point_count].numpy(), None
    if network.point_section is not None:
        section = network.point_section[: network.point_count].numpy()
    if edited.drawn_xy is not None:
        xy = np.concatenate([xy, edited.drawn_xy - network.origin])
        if section is not None:
            section = np.concatenate([section, edited.drawn_section])
    lengths = np.diff(edited.run_start)
    index = np.concatenate([b + np.arange(n) for b, n in zip(edited.run_begin, lengths, strict=True)])
    if section is not None:
        section = section[index] * np.repeat(edited.run_scale, lengths, axis=0)
    return RiverNetwork(
        xy[index], edited.channel_start, edited.channels, node_xy=edited.node_xy, origin=network.origin,
        point_section=section,
    )  # fmt: skip


def rework(network):
    length = network.channel_lengths() / (np.diff(network.starts()) - 1)
    return Reworking(network, length, 0)


def marked(varied=False, seed=3):
    """A tree with a free column, and widths that vary along the channels or do not."""
    tree = random_tree(seed, sources=8, size=8000.0, width=25.0)
    rng = np.random.default_rng(seed)
    width = list(tree.channel_width)
    if varied:
        width = [w * rng.uniform(0.8, 1.2, len(xy)) for w, xy in zip(width, tree.polylines(), strict=True)]
    return RiverNetwork.from_polylines(
        tree.polylines(), width, discharge=tree.channel_discharge, extra={"mark": np.arange(tree.channel_count)}
    )


def sources(network):
    return np.flatnonzero(~np.isin(network.channel_from, network.channel_to))


def way_down(network, c):
    """Channels downstream of one."""
    way = []
    while len(below := np.flatnonzero(network.channel_from == network.channel_to[c])):
        c = int(below[0])
        way.append(c)
    return way


@pytest.mark.parametrize("varied", [False, True])
def test_a_split_changes_no_point_and_no_number(varied):
    network = marked(varied)
    work = rework(network)
    c = 4
    point = int(network.starts()[c]) + 9
    upper = work.split(c, point, JOINT_THROUGH)
    edited = work.build()
    after = made(network, edited)
    assert upper == network.channel_count and not edited.channel_changed.any()
    assert after.channel_id.tolist() == [*network.channel_id, network.channel_id.max() + 1]
    line = np.concatenate([after.polylines()[upper], after.polylines()[c][1:]])
    np.testing.assert_array_equal(line, network.polylines()[c])
    for name in ("width", "depth", "discharge", "mark"):
        np.testing.assert_array_equal(after.channels[name][:-1], network.channels[name])
        assert after.channels[name][upper] == network.channels[name][c]
    if varied:
        np.testing.assert_array_equal(after.point_widths()[upper], network.point_widths()[c][:10])
    assert after.channel_joint[upper] == JOINT_THROUGH and after.channel_joint[:-1].sum() == 0
    assert_forest(after, binary=False)
    back = rework(after)
    back.join(upper, c)
    again = made(after, back.build())
    np.testing.assert_array_equal(again.points(), network.points())
    assert again.channels == network.channels
    np.testing.assert_array_equal(again.node_xy, network.node_xy)


@pytest.mark.parametrize("varied", [False, True])
def test_a_tributary_adds_its_water_down_to_the_outlet_and_takes_it_away_again(varied):
    network = marked(varied)
    c = int(sources(network)[2])
    first, last = network.starts()[c], network.starts()[c + 1] - 1
    work = rework(network)
    node = work.junction_at(c, int(first + last) // 2)
    end = work.node_place(node)
    line = smooth_line(np.array([end + [-900.0, 800.0], end]), 20.0)
    added = work.add(line, node, {"width": 18.0, "depth": 1.2, "discharge": 7.0}, c)
    after = made(network, work.build())
    assert_forest(after)
    place = {k: n for n, k in enumerate([*range(network.channel_count), "upper", "added"])}
    assert added == place["added"]
    # Of a source all its ground lies above the junction.
    assert after.channel_discharge[place["upper"]] == network.channel_discharge[c]
    way = [c, *way_down(network, c)]
    gain = (network.channel_discharge[way] + 7.0) / network.channel_discharge[way]
    np.testing.assert_allclose(after.channel_discharge[way] / network.channel_discharge[way], gain, rtol=FLOW)
    np.testing.assert_allclose(after.channel_width[way] / network.channel_width[way], np.sqrt(gain), rtol=FLOW)
    others = np.setdiff1d(np.arange(network.channel_count), way)
    for name in ("width", "depth", "discharge"):
        np.testing.assert_array_equal(after.channels[name][others], network.channels[name][others])
    if varied:
        for k, g in zip(way[1:], gain[1:], strict=True):
            np.testing.assert_allclose(after.point_widths()[k], network.point_widths()[k] * np.sqrt(g), rtol=FLOW)
        assert (after.point_widths()[added] == 18.0).all()
    work = rework(after)
    work.remove([added])
    again = made(after, work.build())
    assert again.channel_id.tolist() == network.channel_id.tolist()
    for name in ("width", "depth", "discharge"):
        np.testing.assert_allclose(again.channels[name], network.channels[name], rtol=FLOW)
    np.testing.assert_array_equal(again.points(), network.points())


def test_where_areas_are_known_they_add_up():
    network = marked()
    table = network.channels.replace(drainage_area=1e6 * network.channel_discharge)
    network = network.with_channels(table)
    c = int(sources(network)[0])
    work = rework(network)
    line = smooth_line(np.array([[-9e3, 0.0], network.node_xy[network.channel_to[c]]]), 50.0)
    added = work.add(line, int(network.channel_to[c]), {"width": 18.0, "depth": 1.2, "discharge": 7.0}, c)
    after = made(network, work.build())
    area = after.channel_drainage_area
    assert area[added] == pytest.approx(7e6, rel=FLOW)
    way = way_down(network, c)
    np.testing.assert_allclose(area[way] - network.channel_drainage_area[way], 7e6, rtol=1e-9)
    np.testing.assert_allclose(after.channel_discharge[way] - network.channel_discharge[way], 7.0, rtol=1e-9)


def test_all_that_flows_into_a_channel_that_is_removed_ends_there():
    network = marked()
    inner = int(np.setdiff1d(np.arange(network.channel_count), sources(network))[1])
    work = rework(network)
    work.remove([inner])
    after = made(network, work.build())
    assert network.channel_id[inner] not in after.channel_id
    node = network.node_xy[network.channel_from[inner]]
    ends = [xy[-1] for xy in after.polylines()]
    assert sum(np.hypot(*(end - node)) < 1e-6 for end in ends) == 2
    flow = np.bincount(after.channel_to, weights=after.channel_discharge)
    heads = np.isin(after.channel_from, after.channel_to)
    assert (after.channel_discharge[heads] >= flow[after.channel_from[heads]] * (1.0 - 1e-9)).all()


def test_a_river_is_what_lies_between_its_locks():
    network = marked()
    c = int(sources(network)[0])
    ids = [int(network.channel_id[c])]
    for _ in range(2):
        # The lock is made in the lowest part, below the one before.
        work = rework(network)
        c = int(np.flatnonzero(network.channel_id == ids[0])[0])
        work.split(c, int(network.starts()[c : c + 2].sum()) // 2, JOINT_LOCK)
        network = made(network, work.build())
        ids.append(int(network.channel_id.max()))
    parts = river_of(network, c)
    assert network.channel_id[parts].tolist() == [ids[1], ids[2], ids[0]]
    assert [river_of(network, part) for part in parts] == [parts] * 3
    assert river_of(network, parts[-1] + 1) == [parts[-1] + 1]
    # A part that falls dry with a lock is refused.
    work = rework(network)
    with pytest.raises(InputError, match="would fall dry, and has a locked point"):
        work.remove(parts[:1])
    # Where something joins at its node, a joint is one no more.
    work = rework(network)
    foot = int(network.channel_to[parts[0]])
    work.add(
        np.array([[0.0, 9e3], [10.0, 9e3], network.node_xy[foot]]),
        foot,
        {"width": 9.0, "depth": 1.0, "discharge": 1.0},
        0,
    )
    assert made(network, work.build()).channel_joint[parts[0]] == JOINT_NONE


def test_a_line_through_points_is_smooth_and_passes_them():
    angle = np.linspace(0.0, 1.5, 9)
    circle = 500.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    line = smooth_line(circle, 20.0)
    gaps = np.hypot(*np.diff(line, axis=0).T)
    assert gaps.max() <= 20.0 * 1.01
    assert nearest_point(line, circle[4])[1] == 0.0 and (line[-1] == circle[-1]).all()
    # The error of the tangents at the ends, of first order, is gone after one segment.
    inner = line[(line[:, 1] > circle[2, 1]) & (line[:, 1] < circle[-3, 1])]
    assert np.abs(np.hypot(*inner.T) - 500.0).max() < 0.5
    straight = smooth_line(np.array([[0.0, 0.0], [30.0, 0.0], [100.0, 0.0]]), 7.0)
    assert np.abs(straight[:, 1]).max() == 0.0 and (np.diff(straight[:, 0]) > 0.0).all()
