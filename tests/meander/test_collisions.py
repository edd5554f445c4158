import numpy as np
import pytest
from insides import phase_of
from plain import plain_params
from scipy.spatial import cKDTree
from trees import assert_forest, random_tree

from warpriver import RiverNetwork, Simulation
from warpriver.graph.edits import NetworkEdit
from warpriver.history import History, StopReason
from warpriver.kernels.collisions import COARSEST_SPACING, SLACK_SPACINGS
from warpriver.meander.collisions import Collide, collision_constants, join_channels

WIDTH = 20.0
# Nothing moves: only what touches is joined.
STILL = plain_params(spacing=10.0, migration_rate=0.0)


def line(*corners, spacing=10.0):
    """Evenly spaced points along straight pieces."""
    corners = np.array(corners, np.float64)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    at = np.linspace(0.0, s[-1], max(3, round(s[-1] / spacing) + 1))
    return np.stack([np.interp(at, s, corners[:, 0]), np.interp(at, s, corners[:, 1])], axis=1)


def joined(lines, areas, params=STILL, width=WIDTH, *, device):
    """Take one step of a network that stands still, and return the simulation."""
    network = RiverNetwork.from_polylines(lines, width=width, drainage_area=np.array(areas) * 1e6)
    sim = Simulation(network, params, device=device)
    sim.step()
    assert_forest(sim.network)
    return sim


def graph(network):
    """Channels by identity as (drainage area in km2, identities that flow into it)."""
    table = {}
    for c in range(network.channel_count):
        into = network.channel_id[network.channel_to == network.channel_from[c]]
        table[int(network.channel_id[c])] = (network.channel_drainage_area[c] / 1e6, sorted(into.tolist()))
    return table


def fork(tip=(0.0, 1000.0), other=(-800.0, 1000.0), node=(0.0, 0.0), end=(0.0, -1500.0)):
    """Two tributaries and the channel they flow into, of 4, 2 and 7 km2."""
    return [line(tip, node), line(other, node), line(node, end)], [4.0, 2.0, 7.0]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("dip", [0.0, 300.0])
def test_upstream_collision(side, dip, device):
    """The smaller tributary meets the larger one 600 m above their junction, at a shallow or a right angle."""
    lines, areas = fork()
    lines[1] = line((-800.0, 1000.0), (-15.0, 600.0 + dip), (-15.0, 600.0), (-300.0, 300.0), (0.0, 0.0))
    sim = joined([xy * [side, 1.0] for xy in lines], areas, device=device)
    (event,) = sim.history.collisions
    assert (event.case, event.channel, event.other) == ("upstream", 1, 0)
    network = sim.network
    assert network.channel_count == 3
    # The junction moved up the larger tributary, which now ends there; its lower reach belongs to the trunk.
    assert network.channel_id.tolist() == [0, 1, 2]
    trunk = 2
    (top,) = network.node_xy[[network.channel_from[trunk]]]
    assert top == pytest.approx([0.0, 600.0 + dip], abs=25.0)
    assert network.channel_lengths()[trunk] == pytest.approx(1500.0 + top[1], rel=1e-3)
    # Sources keep the ground about their heads.
    assert graph(network)[0][0] == pytest.approx(4.0) and graph(network)[1][0] == pytest.approx(2.0)
    assert network.channel_drainage_area[trunk] == pytest.approx(7e6, rel=1e-12)
    assert np.hypot(*np.diff(event.xy, axis=0).T).sum() == pytest.approx(700.0 + dip, abs=150.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_downstream_collision(side, device):
    """A tributary runs beside the trunk and meets it 500 m below the junction; its sibling gets the reach between."""
    lines, areas = fork()
    lines[2] = line((0.0, 0.0), (-400.0, -200.0), (-15.0, -500.0), (0.0, -1500.0))
    lines[0] = line((0.0, 1000.0), (200.0, 500.0), (0.0, 0.0))
    # The tributary comes down on the right and touches the trunk's elbow from the west before it turns to the node.
    lines[1] = line((-800.0, 1000.0), (-600.0, -210.0), (-415.0, -210.0), (-300.0, 100.0), (0.0, 0.0))
    sim = joined([xy * [side, 1.0] for xy in lines], areas, width=[16.0, 20.0, 24.0], device=device)
    (event,) = sim.history.collisions
    assert (event.case, event.channel, event.other) == ("downstream", 1, 2)
    network = sim.network
    assert network.channel_id.tolist() == [0, 1, 2]
    junction = network.node_xy[network.channel_from[2]]
    assert junction == pytest.approx([-400.0 * side, -200.0], abs=25.0)
    longest = network.channel_lengths()[0]
    assert longest == pytest.approx(np.hypot(200, 500) * 2 + np.hypot(400, 200), abs=40.0)
    # The sibling carries what it did and the ground along the reach that it got: it is not as wide as the trunk was.
    reach = network.channel_drainage_area[0] / 4e6
    assert 1.0 < reach < 1.1
    np.testing.assert_allclose(network.channel_width, [16.0 * reach**0.5, 20.0, 24.0])
    assert network.channel_discharge[0] == pytest.approx((16.0 / 7.2) ** 2 * reach)


def test_a_river_of_several_channels_cuts_its_loops_off_like_any_other(device):
    """Three channels, one after the other, go round a loop of 1.6 km whose neck is 15 m wide."""
    corners = [(0.0, 1500.0), (0.0, 0.0), (-300.0, -200.0), (-300.0, -600.0), (300.0, -600.0), (300.0, -200.0)]
    corners += [(15.0, 0.0), (15.0, 1000.0)]
    lines = [line(*corners[:4]), line(*corners[3:5]), line(*corners[4:])]
    network = RiverNetwork.from_polylines(lines, width=WIDTH, drainage_area=[1e6, 1e6, 1e6], channel_id=[3, 5, 4])
    sim = Simulation(network, STILL, device=device)
    sim.run(steps=1)
    (event,) = sim.history.collisions
    assert (event.case, event.channel, event.other) == ("neck", 3, 4)
    assert [len(piece) > 2 for piece in event.pieces()] == [True] * 3
    assert_forest(sim.network, binary=False)
    # The middle one lay in the loop. No identity is given again, in this run or in one that goes on from its record.
    assert sim.network.channel_id.tolist() == [3, 4]
    again = Simulation.resume(sim.history, device=device)
    assert sim.stepper.state.next_identity == again.stepper.state.next_identity == 6


def test_disconnected_collision_gives_the_smaller_river_to_the_larger(device):
    """A river of 3 km2 with two tributaries touches one of 10 km2; below, its old course is abandoned."""
    large = line((1000.0, 2000.0), (1000.0, -2000.0))
    left, right = line((-400.0, 2000.0), (0.0, 1000.0)), line((400.0, 2000.0), (0.0, 1000.0))
    small = line((0.0, 1000.0), (985.0, 0.0), (200.0, -1000.0), (0.0, -2000.0))
    sim = joined([large, left, right, small], [10.0, 1.0, 1.5, 3.0], device=device)
    (event,) = sim.history.collisions
    assert (event.case, event.channel, event.other) == ("disconnected", 3, 0)
    table = graph(sim.network)
    # The larger river keeps its identity downstream of the new junction.
    assert set(table) == {0, 1, 2, 3, 4}
    assert table[3] == (
        pytest.approx(2.5 + 0.5 * np.hypot(985, 1000) / (np.hypot(985, 1000) * 2 + 0), rel=0.05),
        [1, 2],
    )
    assert table[0] == (pytest.approx(13.0, rel=1e-9), [3, 4])
    assert event.xy[-1] == pytest.approx([0.0, -2000.0])
    below = sim.network.channel_id == 0
    # w ~ a^0.5 and d ~ w^(1 / 1.41) by the area that the downstream piece gained.
    gain = 1.3
    assert sim.network.channel_width[below] == pytest.approx(WIDTH * gain**0.5)
    assert sim.network.channel_depth[below] == pytest.approx((WIDTH * gain**0.5 / 18.8) ** (1 / 1.41))


def test_a_captured_tributary_leaves_its_sibling_one_channel(device):
    """A tributary is captured by a larger river next door: its old junction dissolves, the trunk there shrinks."""
    lines, _ = fork()
    captured = line((-800.0, 1000.0), (-1485.0, 500.0), (-500.0, 200.0), (0.0, 0.0))
    neighbour = line((-1500.0, 2000.0), (-1500.0, -2000.0))
    sim = joined([lines[0], captured, lines[2], neighbour], [4.0, 2.0, 7.0, 20.0], device=device)
    (event,) = sim.history.collisions
    assert (event.case, event.channel, event.other) == ("disconnected", 1, 3)
    network = sim.network
    assert network.channel_count == 4
    trunk = network.channel_id == 2
    assert network.channel_lengths()[trunk] == pytest.approx(2500.0)
    # The sibling's 4 and the trunk's own 1 km2; the 2 km2 of the captured one now reach the neighbour.
    assert network.channel_drainage_area[trunk] == pytest.approx(5e6)
    assert network.channel_drainage_area.max() == pytest.approx(22e6)
    # 5 km2 are nearer to the sibling's 4 than to the 7 that the trunk had.
    assert network.channel_width[trunk] == pytest.approx(WIDTH * (5 / 4) ** 0.5)


@pytest.mark.parametrize(
    ("turn", "memory", "cases"), [(120.0, "channel", []), (160.0, "channel", ["neck"]), (120.0, "stem", ["neck"])]
)
def test_the_two_nodes_of_a_short_channel_count_as_one(turn, memory, cases, device):
    """Four widths part two junctions. The trunk turns back at ``turn`` and passes the upper one at 18 m.

    Its way there from the lower junction is 178 m, within the reach of ten widths, or 258 m. The short channel and
    the trunk begin at one node then: from the foot of the short one, 80 m more, both would be too far. As links of one
    river they have a neck there at either turn, as one channel has.
    """
    lines = [
        line((-800.0, -400.0), (0.0, 0.0)),
        line((-800.0, -900.0), (0.0, 0.0)),
        line((0.0, 0.0), (80.0, 0.0)),
        line((80.0, -800.0), (80.0, 0.0)),
        line((80.0, 0.0), (turn, 0.0), (turn, 18.0), (0.0, 18.0), (0.0, 1000.0)),
    ]
    params = STILL.replace(cutoff_distance=0.0, upstream_memory=memory)
    sim = joined(lines, [4.0, 2.0, 6.0, 1.0, 7.0], params, device=device)
    assert [(event.case, event.channel, event.other) for event in sim.history.collisions] == [
        (case, 2, 4) for case in cases
    ]


def test_a_channel_consumed_whole_disappears(device):
    """A short source lies within the width of a larger river at its very head."""
    large = line((0.0, 2000.0), (0.0, -2000.0))
    short = line((12.0, 100.0), (400.0, 0.0), (900.0, -300.0))
    sim = joined([large, short], [10.0, 0.5], device=device)
    (event,) = sim.history.collisions
    assert sim.network.channel_count == 1
    assert len(event.xy) > 50 and sim.network.channel_drainage_area[0] == pytest.approx(10.5e6)


def test_three_channels_at_once_and_two_collisions_in_one_step(device):
    lines = [
        line((0.0, 2000.0), (0.0, -2000.0)),
        line((-1000.0, 1500.0), (-15.0, 300.0), (-1000.0, -1500.0)),
        line((1000.0, 1500.0), (15.0, 310.0), (1000.0, -1500.0)),
        line((3000.0, 2000.0), (3000.0, -2000.0)),
        line((2200.0, 1500.0), (2985.0, 0.0), (2200.0, -1500.0)),
    ]
    sim = joined(lines, [10.0, 2.0, 3.0, 9.0, 1.0], device=device)
    assert [e.case for e in sim.history.collisions] == ["disconnected"] * 3
    network = sim.network
    outlets = ~np.isin(network.channel_to, network.channel_from)
    assert sorted(np.round(network.channel_drainage_area[outlets] / 1e6, 6)) == [10.0, 15.0]
    # Two junctions, 20 m or more apart, since a node joins two channels only.
    assert network.channel_count == 8


def test_channels_that_share_a_node_do_not_collide_beside_it(device):
    """Tributaries that meet at 15 degrees touch for 70 m above their junction; that is no collision."""
    angle = np.radians(7.5)
    tip = 2000.0 * np.array([np.sin(angle), np.cos(angle)])
    sim = joined(
        [line(tip, (0.0, 0.0)), line(tip * [-1, 1], (0.0, 0.0)), line((0.0, 0.0), (0.0, -2000.0))],
        [2, 2, 5],
        device=device,
    )
    assert sim.history.collisions == []


def test_the_lower_of_two_related_channels_keeps_its_course(device):
    """A headwater touches the trunk three channels below it, though the network says that it carries more."""
    lines = [
        line((1300.0, 3000.0), (1004.0, 0.0), (700.0, 1900.0), (0.0, 2000.0)),
        line((-500.0, 3000.0), (0.0, 2000.0)),
        line((0.0, 2000.0), (0.0, 1000.0)),
        line((-900.0, 1800.0), (0.0, 1000.0)),
        line((0.0, 1000.0), (1000.0, 0.0), (0.0, -2000.0)),
    ]
    # The headwater claims 9 km2; what it flows into has less.
    network = RiverNetwork.from_polylines(lines, width=WIDTH, drainage_area=[9e6, 1e6, 3e6, 1e6, 5e6])
    # Its hairpin is narrow enough to be cut off, which is not what is looked at here.
    sim = Simulation(network, STILL.replace(cutoff_distance=0.0), device=device)
    sim.step()
    (event,) = sim.history.collisions
    assert (event.case, event.channel, event.other) == ("neck", 0, 4)


def test_a_touched_channel_waits_for_the_next_round():
    lines, areas = fork()
    network = RiverNetwork.from_polylines(lines, width=WIDTH, drainage_area=np.array(areas) * 1e6)
    edit = NetworkEdit(network)
    start = network.starts()
    assert edit.rejoin(0, int(start[0]) + 50, 1, int(start[1]) + 50) is not None
    assert edit.rejoin(1, int(start[1]) + 20, 2, int(start[2]) + 20) is None
    assert join_channels(network, np.zeros((0, 2), np.int32)) is None


def test_width_that_varies_changes_by_the_flow_that_comes_and_goes(device):
    large = line((0.0, 2000.0), (0.0, -2000.0))
    small = line((-900.0, 1500.0), (-12.0, 0.0), (-900.0, -1500.0))
    width = np.linspace(20.0, 30.0, len(large))
    network = RiverNetwork.from_polylines([large, small], width=[width, 15.0], drainage_area=[8e6, 2e6])
    sim = Simulation(network, STILL, device=device)
    sim.step()
    assert_forest(sim.network)
    width = dict(zip(sim.network.channel_id.tolist(), sim.network.point_widths(), strict=True))
    assert width[2][0] == pytest.approx(20.0)
    ratio = width[0][0] / width[2][-1]
    # 10 km2 below the junction where there were 8; above it the source keeps its 8.
    assert ratio == pytest.approx((10 / 8) ** 0.5, rel=0.02)


@pytest.mark.parametrize("unknown", [None, 0, 2])
def test_slopes_go_on_through_a_collision(tmp_path, unknown, device):
    """What stays of a channel keeps its slope; a channel of two parts has the drop of both over their length."""
    lines, areas = fork()
    lines[1] = line((-800.0, 1000.0), (-15.0, 600.0), (-300.0, 300.0), (0.0, 0.0))
    slope = np.array([0.01, 0.02, 0.003])
    if unknown is not None:
        slope[unknown] = np.nan
    network = RiverNetwork.from_polylines(lines, width=WIDTH, drainage_area=np.array(areas) * 1e6, slope=slope)
    sim = Simulation(network, STILL, device=device)
    np.testing.assert_array_equal(sim.network.to(dtype="float32").channel_slope, slope)
    sim.run(steps=1, record_every=1, store=tmp_path / "run")
    after = sim.network
    (trunk,) = np.flatnonzero(after.channel_drainage_area > 6e6)
    found = dict(zip(after.channel_id.tolist(), after.channel_slope.tolist(), strict=True))
    assert found[0] == pytest.approx(slope[0], nan_ok=True) and found[1] == slope[1]
    top = after.node_xy[after.channel_from[trunk], 1]
    mixed = (slope[0] * top + slope[2] * 1500.0) / (top + 1500.0)
    # The spacing is 10 m: where the junction lies is known to a point.
    assert after.channel_slope[trunk] == pytest.approx(mixed, rel=0.01, nan_ok=True)
    history = History.load(tmp_path / "run")
    np.testing.assert_array_equal(history.networks[0].channel_slope, slope)
    np.testing.assert_array_equal(history.networks[-1].channel_slope, after.channel_slope)


def test_a_graph_that_is_no_forest_is_refused(device):
    lines, _ = fork()
    parting = [*lines, line((0.0, 0.0), (900.0, -900.0))]
    with pytest.raises(ValueError, match=r"channels 2 and 3 both begin at \(0, 0\), where water would part"):
        Simulation(RiverNetwork.from_polylines(parting, width=WIDTH), STILL)
    Simulation(
        RiverNetwork.from_polylines(parting, width=WIDTH), STILL.replace(collision_distance=0.0), device=device
    ).step()
    triangle = [line(a, b) for a, b in (((0, 0), (900, 0)), ((900, 0), (500, 800)), ((500, 800), (0, 0)))]
    with pytest.raises(ValueError, match="channel 0 belongs to a circle"):
        Simulation(RiverNetwork.from_polylines(triangle, width=WIDTH), STILL)


def test_collisions_can_be_turned_off(device):
    lines = [line((0.0, 2000.0), (0.0, -2000.0)), line((-900.0, 1500.0), (-12.0, 0.0), (-900.0, -1500.0))]
    network = RiverNetwork.from_polylines(lines, width=WIDTH)
    sim = Simulation(network, STILL.replace(collision_distance=0.0), device=device)
    sim.step()
    assert sim.history.collisions == [] and sim.network.channel_count == 2


def test_search_finds_what_comparing_all_pairs_finds(device):
    rng, ranks = np.random.default_rng(3), set()
    for seed in range(20):
        network = random_tree(seed, sources=4 + seed % 5, size=4000.0, width=30.0, noise=rng.uniform(0.5, 3.0))
        # Nothing but nodes keeps channels from touching: none are links of one river, with necks.
        params = plain_params(spacing=20.0, migration_rate=0.0, cutoff_distance=0.0, upstream_memory="channel")
        sim = Simulation(network, params.replace(collision_distance=1e-9), device=device)
        xy, starts, width = sim.network.points(), sim.network.starts(), sim.network.channel_width
        owner = np.repeat(np.arange(len(width)), np.diff(starts))
        state, collide = sim.stepper.state, phase_of(sim, Collide)
        spacing = state.spacing.numpy()[: sim.network.channel_count]
        up = (np.arange(len(xy)) - starts[owner]) * spacing[owner]
        down = (starts[owner + 1] - 1 - np.arange(len(xy))) * spacing[owner]
        above, below = sim.network.channel_from[owner], sim.network.channel_to[owner]
        # No pair farther apart than the widest channel touches.
        i, j = cKDTree(xy).query_pairs(width.max(), output_type="ndarray").T
        i, j = np.where(owner[i] < owner[j], (i, j), (j, i))
        away, a, b = np.hypot(*(xy[i] - xy[j]).T), owner[i], owner[j]
        reach = params.junction_reach * np.maximum(width[a], width[b])
        shared = np.zeros(len(i), bool)
        for ends_i, arc_i in ((above, up), (below, down)):
            for ends_j, arc_j in ((above, up), (below, down)):
                shared |= (ends_i[i] == ends_j[j]) & (arc_i[i] + arc_j[j] < reach)
        touching = np.stack([i, j], axis=1)[(away < 0.5 * (width[a] + width[b])) & (a < b) & ~shared]
        form = state.form.numpy()[: sim.network.channel_count]
        constants = collision_constants(sim.network, params, form)
        nodes = np.stack([sim.network.channel_from, sim.network.channel_to], axis=1).astype(np.int32)
        state.assign(collide.nodes, nodes)
        state.assign(state.step, np.ones(len(nodes)))
        collide._constants = constants
        state.begin_batch()
        state.run(collide.stages(state))
        contacts = collide.contacts(state)
        # A channel looks for those of its own reach and a higher number, and for all of a longer reach, by octaves.
        widest, longest = form["widest"], COARSEST_SPACING * form["target_spacing"]
        far = 0.5 * (widest + np.maximum(constants.block * widest, longest)) + SLACK_SPACINGS * longest
        rank = np.maximum(np.ceil(np.log2(far / constants.reach)), 0.0) * len(width) + np.arange(len(width))
        pairs = {tuple(sorted(p, key=lambda k: rank[owner[k]])) for p in touching.tolist()}
        assert {tuple(p) for p in contacts.tolist()} <= pairs
        # Every point that touches lies in a block whose contact is listed, at that point or before it.
        assert {owner[i] for i, _ in contacts.tolist()} == {owner[i] for i, _ in pairs}
        ranks |= set((rank // len(width)).tolist())
    assert len(ranks) > 1, "channels of several reaches were looked for"


# Half of the collisions of 300 steps happen in the first 100, while trees are as they were made.
TREES = [
    ("float64", range(20), 300),
    ("float64", range(100, 130), 100),
    ("float32", range(2), 300),
]


@pytest.mark.parametrize(("dtype", "seeds", "steps"), TREES, ids=str)
def test_random_trees_stay_forests(dtype, seeds, steps, device):
    """Invariants after every step of runs with many collisions; area is conserved at the outlets."""
    kinds = set()
    for seed in seeds:
        network = random_tree(seed, sources=3 + seed % 8, size=8000.0, width=25.0)
        assert_forest(network)
        sim = Simulation(network, plain_params(spacing=20.0), dtype=dtype, device=device)
        before, seen = outlet_area(network), set(network.channel_id.tolist())
        for k in range(steps):
            known = set(sim.network.channel_id.tolist())
            sim.step()
            new = set(sim.network.channel_id.tolist()) - known
            assert not new & seen, "an identity is given once"
            seen |= new
            if k % 10 == 0 or (sim.history.collisions and sim.history.collisions[-1].time > sim.time - 0.3):
                assert_forest(sim.network)
        assert outlet_area(sim.network) == pytest.approx(before, rel=1e-9)
        kinds |= {event.case for event in sim.history.collisions}
    # Some take longer to come about.
    expected = {"upstream", "disconnected"} | ({"downstream", "neck"} if steps > 100 else set())
    assert expected <= kinds or dtype == "float32"


def outlet_area(network):
    return network.channel_drainage_area[~np.isin(network.channel_to, network.channel_from)].sum()


def test_each_channel_may_have_its_own_spacing(tmp_path, device):
    network = random_tree(3, sources=6, size=8000.0, width=12.0)
    with pytest.raises(ValueError, match="or spacing_in_widths=1"):
        Simulation(network, plain_params(spacing_in_widths=0.0))
    by_default = Simulation(network, plain_params(), device=device).stepper.state.spacing.numpy()[
        : network.channel_count
    ]
    np.testing.assert_allclose(by_default, np.minimum(50.0, network.channel_width), rtol=0.02)
    params = plain_params(spacing_in_widths=0.8)
    sim = Simulation(network, params, device=device)
    wanted = np.minimum(50.0, 0.8 * sim.network.channel_width)
    np.testing.assert_allclose(sim.stepper.state.spacing.numpy()[: len(wanted)], wanted, rtol=0.02)
    assert np.ptp(wanted) > 5.0
    sim.run(steps=100, store=tmp_path / "run")
    rest, whole = Simulation.resume(tmp_path / "run", device=device), Simulation(network, params, device=device)
    rest.run(steps=100)
    whole.run(steps=200)
    assert len(whole.history.collisions) > 0
    np.testing.assert_array_equal(rest.network.points(), whole.network.points())


def test_a_run_with_collisions_is_reproducible_and_can_be_resumed(tmp_path, device):
    def start():
        return Simulation(random_tree(7, sources=8, size=8000.0, width=25.0), plain_params(spacing=20.0), device=device)

    whole, again = start(), start()
    whole.run(steps=300, record_every=50)
    again.run(steps=150, record_every=50, store=tmp_path / "run")
    rest = Simulation.resume(tmp_path / "run", device=device)
    history = rest.run(steps=150, record_every=50)
    assert history.stop_reason is StopReason.COMPLETED
    assert len(whole.history.collisions) == len(history.collisions) > 4
    np.testing.assert_array_equal(whole.network.points(), rest.network.points())
    np.testing.assert_array_equal(whole.network.channel_id, rest.network.channel_id)
    reopened = History.load(tmp_path / "run")
    assert [e.case for e in reopened.collisions] == [e.case for e in whole.history.collisions]
    for one, two in zip(reopened.collisions, whole.history.collisions, strict=True):
        assert [p.tobytes() for p in one.pieces()] == [p.tobytes() for p in two.pieces()]
    np.testing.assert_array_equal(reopened.networks[-1].channel_drainage_area, whole.network.channel_drainage_area)
    assert_forest(reopened.networks[-1])
