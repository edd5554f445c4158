"""Edits between two steps: what they do, what they leave, how they are taken back, recorded and done again."""

import pickle

import models
import numpy as np
import pytest
from edited import SOLVERS, bends, bits, do_random, lines, river, tree
from plain import plain_params
from scipy.spatial import cKDTree

import warpriver as wr
from warpriver import PathMeander, RiverNetwork, Simulation, Terrain, edits
from warpriver.engine import state as engine_state
from warpriver.errors import InputError, InputTypeError
from warpriver.history import AppliedEdit, History, StopReason

# A curve that is sampled anew: its samples are on the cubic through the old ones, spacings.
SAME_CURVE = 1e-3
# Where a point was moved, as far as that curve tells, m.
MOVED = 0.05
# Joined again after 20 steps apart, widths: what the samples at the node differ by, grown by the bends since.
SAME_RIVER = 0.01


def distance_to(curve, points):
    """Distance of points from a polyline of many more, m."""
    nearest = np.clip(cKDTree(curve).query(points)[1], 1, len(curve) - 2)
    away = []
    for k in (nearest - 1, nearest):
        along, to = curve[k + 1] - curve[k], points - curve[k]
        t = np.clip((to * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
        away.append(np.hypot(*(to - t[:, None] * along).T))
    return np.minimum(*away)


def dense(line, times=50):
    """A line with points on the cubic through those given."""
    from scipy.interpolate import CubicSpline

    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    fine = np.linspace(0.0, arc[-1], times * len(line))
    return CubicSpline(arc, line)(fine)


def test_split_and_join_are_the_identity_to_the_bit(device):
    for sim in (river(device=device), tree(device=device), tree(params=SOLVERS["paths"], device=device)):
        sim.run(steps=5)
        before, channel = bits(sim), int(sim.network.channel_id[0])
        length = sim.network.channel_lengths()[0]
        sim.apply(edits.SplitChannel(channel, 0.4 * length))
        assert bits(sim) != before
        new = int(sim.network.channel_id.max())
        sim.apply(edits.JoinChannels(new, channel))
        after = bits(sim)
        # All but the identity that the next new channel will get, and the nodes that are near each other by now.
        names = sorted(sim.stepper.snapshot().saved)
        free = {
            len(after) - len(names) + names.index(name) for name in ("channel_nodes", "next_identity") if name in names
        }
        assert [a for k, a in enumerate(after) if k not in free] == [b for k, b in enumerate(before) if k not in free]


@pytest.mark.parametrize("memory", ["stem", "channel"])
def test_a_river_that_was_split_goes_on_as_if_it_was_not(memory, device):
    network = river().network
    params = plain_params(spacing=50.0, upstream_memory=memory)
    apart, whole = (Simulation(network, params, device=device) for _ in range(2))
    for sim in (apart, whole):
        sim.run(steps=20)
    apart.apply(edits.SplitChannel(0, 5_000.0))
    for sim in (apart, whole):
        sim.run(steps=20)
    assert apart.network.channel_count == 2
    apart.apply(edits.JoinChannels(1, 0))
    away = distance_to(dense(whole.network.polylines()[0]), apart.network.points())
    assert away.max() < SAME_RIVER * 60.0
    assert not apart.history.collisions


def test_a_split_gives_each_part_its_own_section():
    sim = river()
    sim.apply(edits.SplitChannel(0, 5_000.0, width_above=40.0, depth_above=2.0, width_below=80.0))
    assert sim.network.channel_width.tolist() == [80.0, 40.0] and sim.network.channel_depth[1] == 2.0
    assert sim.network.channel_discharge[0] == sim.network.channel_discharge[1]
    length = sim.network.channel_lengths()
    assert abs(length[1] - 5_000.0) <= 25.0
    sim.run(steps=10)
    sim.apply(edits.JoinChannels(1, 0))
    assert sim.network.channel_width.tolist() == [80.0]


def test_a_moved_point_takes_its_surroundings_along_and_nothing_else(device):
    sim = bends(device=device)
    sim.run(steps=5)
    before, channel = lines(sim), 1
    line = before[channel]
    middle, radius = len(line) // 2, 900.0
    to = line[middle] + [40.0, 60.0]
    sim.apply(edits.MovePoint(channel, tuple(line[middle]), tuple(to), radius))
    after = lines(sim)
    assert distance_to(dense(after[channel]), to[None])[0] < MOVED
    for c in before.keys() - {channel}:
        np.testing.assert_array_equal(after[c], before[c])
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    beyond = np.abs(arc - arc[middle]) > radius
    curve, old = dense(after[channel]), dense(line)
    assert distance_to(curve, line[beyond]).max() < SAME_CURVE * 50.0
    kept = after[channel][np.hypot(*(after[channel] - line[middle]).T) > radius]
    assert distance_to(old, kept).max() < SAME_CURVE * 50.0
    # And they stay the same to the bit in the steps that follow, where nothing joins them.
    others, edited = models.plain(device=device), models.plain(device=device)
    edited.apply(edits.MovePoint(4, 1_000.0, tuple(edited.network.polylines()[4][40] + 60.0), 300.0))
    for each in (others, edited):
        each.run(steps=30)
    plain, changed = lines(others), lines(edited)
    for c in plain.keys() - {4}:
        np.testing.assert_array_equal(changed[c], plain[c])
    assert len(changed[4]) != len(plain[4]) or (changed[4] != plain[4]).any()


def test_a_moved_node_takes_all_channels_along_that_meet_there():
    sim = tree()
    network = sim.network
    node = int(network.channel_to[np.flatnonzero(np.isin(network.channel_to, network.channel_from))[0]])
    at, channel = network.node_xy[node], int(network.channel_id[network.channel_from == node][0])
    sim.apply(edits.MovePoint(channel, tuple(at), tuple(at + [50.0, -20.0]), 400.0))
    ends = [line[k] for c, line in enumerate(sim.network.polylines()) for k in (0, -1)
            if (sim.network.channel_from, sim.network.channel_to)[-k][c] == node]  # fmt: skip
    assert len(ends) == 3
    np.testing.assert_allclose(ends, np.tile(at + [50.0, -20.0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(sim.network.node_xy[node], at + [50.0, -20.0])
    sim.run(steps=3)


def test_a_section_takes_the_course_that_is_drawn():
    sim = river()
    line = sim.network.polylines()[0]
    i, j = 60, 110
    bend = 0.5 * (line[i] + line[j]) + [0.0, 800.0]
    sim.apply(edits.RedrawSection(0, [line[i], bend, line[j]]))
    after = dense(sim.network.polylines()[0])
    assert distance_to(after, [bend])[0] < 1.0
    assert distance_to(after, line[: i - 4]).max() < SAME_CURVE * 50.0
    assert distance_to(after, line[j + 5 :]).max() < SAME_CURVE * 50.0
    gaps = np.hypot(*np.diff(sim.network.polylines()[0], axis=0).T)
    assert gaps.max() < 1.05 * gaps.mean()
    sim.run(steps=20)


def winding(**options):
    """A sine-generated river with strong bends, whose wavelength is 1,200 m."""
    line = wr.generate.sine_generated(1_200.0, 1.9, 6, 30.0)
    network = RiverNetwork.from_polylines([line], width=40.0)
    return Simulation(network, plain_params(spacing=30.0), device="cpu", **options)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_bend_is_cut_off_and_its_loop_is_left(solver):
    made = winding()
    sim = Simulation(made.network, SOLVERS[solver](spacing=30.0), device="cpu") if solver == "paths" else made
    line, before, length = sim.network.polylines()[0], bits(sim), sim.network.channel_lengths()[0]
    apex = int(np.argmax(np.where(np.abs(line[:, 0] - 3_000.0) < 700.0, line[:, 1], -np.inf)))
    sim.apply(edits.CutLoop(0, tuple(line[apex])))
    (cutoff,) = sim.history.cutoffs
    open_loop = cutoff.xy[:-1] if solver == "paths" else cutoff.xy
    assert (np.abs(open_loop - line[apex]).sum(axis=1) == 0.0).any(), "the place lies on what was cut off"
    i = int(np.flatnonzero((line == open_loop[0]).all(axis=1))[0])
    np.testing.assert_array_equal(open_loop, line[i : i + len(open_loop)])
    # The way across is straight, and the river is shorter by loop less way.
    along, across = np.hypot(*np.diff(open_loop, axis=0).T).sum(), np.hypot(*(open_loop[-1] - open_loop[0]))
    assert across < 0.35 * along
    assert sim.network.channel_lengths()[0] == pytest.approx(length - along + across, abs=20.0)
    after = bits(sim)
    sim.undo()
    assert bits(sim) == before and not sim.history.cutoffs
    sim.redo()
    assert bits(sim) == after and len(sim.history.cutoffs) == 1
    sim.run(steps=3)


def test_a_chute_goes_between_two_places():
    sim = winding()
    line = sim.network.polylines()[0]
    sim.apply(edits.CutLoop(0, tuple(line[40]), tuple(line[75])))
    np.testing.assert_array_equal(sim.history.cutoffs[0].xy, line[40:76])
    again = Simulation.replay(winding(), sim.history)
    assert bits(again) == bits(sim)


def test_a_channel_is_added_joins_and_is_removed_again():
    sim = river()
    line = sim.network.polylines()[0]
    before = sim.network.channels
    end = line[120]
    sim.apply(edits.AddChannel([end + [-900.0, 1500.0], end + [-300.0, 700.0], end], width=30.0))
    network = sim.network
    assert network.channel_count == 3 and network.node_count == 4
    added = int(np.flatnonzero(network.channel_width == 30.0)[0])
    node = network.channel_to[added]
    np.testing.assert_array_equal(network.node_xy[node], end)
    assert (network.channel_to == node).sum() == 2
    below = int(np.flatnonzero(network.channel_from == node)[0])
    assert network.channel_id[below] == 0, "the identity stays downstream"
    more = before.discharge[0] + network.channel_discharge[added]
    assert network.channel_discharge[below] == pytest.approx(more, rel=1e-12)
    assert network.channel_width[below] == pytest.approx(60.0 * np.sqrt(more / before.discharge[0]), rel=1e-12)
    sim.run(steps=20)
    sim.apply(edits.RemoveChannel(int(network.channel_id[added])))
    assert sim.network.channels.id.tolist() == [0]
    for name in ("width", "depth", "discharge"):
        assert sim.network.channels[name][0] == pytest.approx(before[name][0], rel=1e-12)


def test_a_channel_may_be_a_river_of_its_own():
    sim = river()
    away = sim.network.polylines()[0][[10, 60, 110]] + [0.0, 4_000.0]
    sim.apply(edits.AddChannel(away, width=50.0, ends="outlet"))
    assert sim.network.channel_count == 2 and sim.network.node_count == 4
    sim.run(steps=5)
    sim.apply(edits.RemoveChannel(0))
    assert sim.network.channel_id.tolist() == [1]
    with pytest.raises(InputError, match="no channel would be left"):
        sim.apply(edits.RemoveChannel(1))


def test_what_no_water_is_left_in_falls_dry():
    """A source that was split: without its upper part there is none in the lower one either."""
    sim = tree()
    network = sim.network
    source = int(np.flatnonzero(~np.isin(network.channel_from, network.channel_to))[0])
    channel, count = int(network.channel_id[source]), network.channel_count
    whole = sim.network.channels
    sim.apply(edits.SplitChannel(channel, 300.0))
    sim.apply(edits.RemoveChannel(int(sim.network.channel_id.max())))
    assert channel not in sim.network.channel_id
    # The junction at its end is one no more.
    assert sim.network.channel_count == count - 2
    outlet = int(np.flatnonzero(~np.isin(sim.network.channel_to, sim.network.channel_from))[0])
    same = whole.id == sim.network.channel_id[outlet]
    assert sim.network.channel_discharge[outlet] == pytest.approx(
        (whole.discharge[same] - whole.discharge[whole.id == channel])[0]
    )


def test_a_river_with_less_water_than_its_tributaries_keeps_that_fraction():
    """Else a river that carries less than a brook that is removed would be a trickle, with a point every few cm."""
    sim = tree()
    network = sim.network
    below = int(network.channel_to[np.flatnonzero(np.isin(network.channel_to, network.channel_from))[0]])
    (lower,) = np.flatnonzero(network.channel_from == below)
    first, second = np.flatnonzero(network.channel_to == below)
    identity = network.channel_id
    sim.apply(edits.SetChannel(int(identity[first]), discharge=60.0))
    sim.apply(edits.SetChannel(int(identity[second]), discharge=30.0))
    sim.apply(edits.SetChannel(int(identity[lower]), discharge=45.0))
    assert not np.isin(network.channel_from[first], network.channel_to), "a brook"
    sim.apply(edits.RemoveChannel(int(identity[first])))
    left = sim.network
    # The node is no junction any more: both that are left are one river, with the discharge of the lower one.
    assert 10.0 < left.channel_discharge[left.channel_id == identity[lower]][0] < 20.0


def test_discharge_goes_on_downstream_and_widths_are_set():
    sim = tree()
    before = sim.network.channels
    source = int(np.flatnonzero(~np.isin(sim.network.channel_from, sim.network.channel_to))[0])
    channel = int(before.id[source])
    sim.apply(edits.SetChannel(channel, discharge=3.0 * before.discharge[source], width=33.0))
    after = sim.network.channels
    assert after.width[source] == 33.0 and after.discharge[source] == 3.0 * before.discharge[source]
    way, node = [], sim.network.channel_to[source]
    while len(below := np.flatnonzero(sim.network.channel_from == node)):
        way.append(int(below[0]))
        node = sim.network.channel_to[below[0]]
    assert way
    np.testing.assert_allclose(after.discharge[way] - before.discharge[way], 2.0 * before.discharge[source], rtol=1e-9)
    others = np.setdiff1d(np.arange(len(before)), [source, *way])
    np.testing.assert_array_equal(after.width[others], before.width[others])
    assert (after.width[way] > before.width[way]).all()


def test_a_reach_is_set_between_through_nodes():
    sim = river()
    sim.apply(edits.SetChannel(0, width=30.0, reach=(3_000.0, 6_000.0)))
    network = sim.network
    assert sorted(network.channel_width.tolist()) == [30.0, 60.0, 60.0]
    assert network.channel_lengths()[network.channel_width == 30.0][0] == pytest.approx(3_000.0, abs=50.0)
    assert sorted(network.channel_joint.tolist()) == [0, 1, 1]
    sim.run(steps=5)


@pytest.mark.parametrize("solver", SOLVERS)
def test_two_hundred_edits_are_taken_back_and_done_again(solver, device):
    sim = tree(params=SOLVERS[solver], ground=True, device=device)
    sim.run(steps=5)
    rng = np.random.default_rng(2)
    states, events = [bits(sim)], [len(sim.history.events)]
    for _ in range(200 if solver == "migration" else 40):
        do_random(sim, rng, 1)
        states.append(bits(sim))
        events.append(len(sim.history.events))
    kinds = {type(event.edit) for event in sim.history.edits}
    assert len(kinds) >= 8
    for k in range(len(states) - 2, -1, -1):
        sim.undo()
        assert bits(sim) == states[k] and len(sim.history.events) == events[k]
    for k in range(1, len(states)):
        sim.redo()
        assert bits(sim) == states[k] and len(sim.history.events) == events[k]
    # The next step is that of one who has never looked back.
    once = tree(params=SOLVERS[solver], ground=True, device=device)
    wr.Simulation.replay(once, sim.history)
    for each in (sim, once):
        each.run(steps=3)
    assert bits(sim) == bits(once)


@pytest.mark.parametrize("name", ["on hills", "single precision", "rings", "paths in parts"])
def test_every_model_goes_on_after_any_edits(name, device):
    """With widths that vary along the channels, in single precision, beside rings; and every phase keeps its word."""
    sim = models.MODELS[name][0](check=True, device=device)
    rng = np.random.default_rng(7)
    for _ in range(8):
        do_random(sim, rng, 4)
        before = bits(sim)
        sim.undo()
        sim.redo()
        assert bits(sim) == before
        sim.step(2)
    again = Simulation.replay(models.MODELS[name][0](threads=2, device=device), sim.history, steps=sim.step_count)
    assert bits(again) == bits(sim)


def test_undo_ends_at_the_last_step():
    sim = river()
    with pytest.raises(InputError, match="nothing to do again"):
        sim.redo()
    edit = edits.SplitChannel(0, 5_000.0)
    sim.apply(edit)
    assert sim.undo() == edit and sim.redo() == edit
    sim.step()
    with pytest.raises(InputError, match="none before it can be taken back; replay the session"):
        sim.undo()
    sim.apply(edits.SplitChannel(0, 2_000.0))
    sim.undo()
    sim.apply(edits.SplitChannel(0, 3_000.0))
    with pytest.raises(InputError, match="nothing to do again"):
        sim.redo()


def session(threads=1, seed=4, **options):
    """A run with edits of all kinds between its steps."""
    sim = tree(ground=True, threads=threads, **options)
    rng = np.random.default_rng(seed)
    for _ in range(6):
        sim.run(steps=4)
        do_random(sim, rng, 3)
    sim.run(steps=4)
    return sim


def test_a_session_is_its_seed_and_its_edits(tmp_path, device):
    sim = session(device=device)
    edits.write_edits(tmp_path / "session.json", sim)
    sim.history.save(tmp_path / "run")
    read = edits.read_edits(tmp_path / "session.json")
    assert len(read.edits) == 18 and read.steps == 28
    for threads in (1, 2, 4):
        again = Simulation.replay(tree(ground=True, threads=threads, device=device), read)
        assert bits(again) == bits(sim) and again.step_count == 28
        assert list(again.history.edits) == list(sim.history.edits)
    # From the history alone, with the ground as it was in the beginning.
    stored = wr.read_history(tmp_path / "run")
    assert [event.edit for event in stored.edits] == [edit for _, edit in read.edits]
    again = Simulation.replay(stored, stored, terrain=tree(ground=True).terrain, device=device)
    assert bits(again) == bits(sim)
    with pytest.raises(InputError, match="is not the one that the run has had"):
        Simulation.replay(stored, stored, terrain=sim.terrain)


def test_a_session_is_the_same_in_a_gpu_s_layout(monkeypatch):
    """But for rounding: recurrences begin anew with each chunk, where what they leave out is lost in it."""
    sim = session()
    monkeypatch.setattr(engine_state, "CPU_CHUNK", 32)
    again = Simulation.replay(tree(ground=True), sim.history, steps=sim.step_count)
    assert again.network.channel_id.tolist() == sim.network.channel_id.tolist()
    np.testing.assert_allclose(again.network.points(), sim.network.points(), rtol=0.0, atol=1e-9)


def test_a_replay_refuses_what_is_another_session(monkeypatch):
    sim = river()
    sim.run(steps=5)
    with pytest.raises(InputError, match="the session has the seed 3, the run 0"):
        Simulation.replay(sim, edits.Session((), seed=3))
    with pytest.raises(InputError, match="was done after 2 steps, and 5 are done already"):
        Simulation.replay(sim, [(2, edits.SplitChannel(0, 5_000.0))])
    with pytest.raises(InputError, match=r"give a list of them, a history or a Session"):
        Simulation.replay(sim, [3])
    monkeypatch.setattr(sim.stepper, "step", lambda count: (_ for _ in ()).throw(FloatingPointError("lost")))
    stopped = Simulation.replay(sim, [(7, edits.SplitChannel(0, 5_000.0))])
    assert stopped is sim and sim.step_count == 5 and not sim.history.edits
    assert sim.history.stop_reason is StopReason.NOT_FINITE


def test_a_run_that_is_resumed_has_its_edits(tmp_path, device):
    """Those before the last record in the network, those after it done again; edits of the ground on the ground."""
    path = tmp_path / "ground.npz"
    wr.write_terrain(tree(ground=True).terrain, path)

    def begin():
        sim = tree()
        return Simulation(sim.network, sim.params, terrain=wr.read_terrain(path), device=device)

    sim = begin()
    sim.run(steps=3, store=tmp_path / "run")
    sim.apply(edits.EditTerrain("raise", center=tuple(sim.network.node_xy[0]), radius=800.0, amount=20.0))
    sim.run(steps=3)
    sim.apply(edits.SplitChannel(int(sim.network.channel_id[0]), 60.0))
    sim.apply(edits.EditTerrain("lower", center=tuple(sim.network.node_xy[2]), radius=800.0, amount=20.0))
    sim.history.flush()
    edited = sim.terrain.copy()
    again = Simulation.resume(tmp_path / "run", device=device)
    assert bits(again) == bits(sim) and list(again.history.edits) == list(sim.history.edits)
    given = Simulation.resume(History.load(tmp_path / "run"), terrain=wr.read_terrain(path), device=device)
    assert bits(given) == bits(sim)
    np.testing.assert_array_equal(edited.to_numpy(), given.terrain.to_numpy())
    for each in (sim, again):
        each.step(4)
    assert bits(again) == bits(sim)
    other = wr.read_terrain(path)
    other.brush("raise", sim.network.node_xy[1], 300.0, 1.0)
    with pytest.raises(InputError, match="is not the one that the run has had"):
        Simulation.resume(tmp_path / "run", terrain=other)
    path.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        Simulation.resume(tmp_path / "run")


def test_ground_that_was_brushed_by_other_hands_is_not_made_again(tmp_path, device):
    path = tmp_path / "ground.npz"
    wr.write_terrain(tree(ground=True).terrain, path)
    start = tree()
    sim = Simulation(start.network, start.params, terrain=wr.read_terrain(path), device=device)
    sim.run(steps=2)
    sim.apply(edits.EditTerrain("raise", center=tuple(sim.network.node_xy[0]), radius=800.0, amount=20.0))
    sim.terrain.brush("raise", sim.network.node_xy[0], 500.0, 3.0)
    history = sim.run(steps=2)
    with pytest.raises(InputError, match="edited by other means than edits of the run"):
        Simulation.resume(history)
    assert Simulation.resume(history, terrain=sim.terrain, device=device).terrain is sim.terrain


def test_a_copy_goes_on_with_the_edits():
    sim = river()
    sim.run(steps=3)
    sim.apply(edits.SplitChannel(0, 5_000.0, width_above=50.0))
    copy = pickle.loads(pickle.dumps(sim))
    for each in (sim, copy):
        each.run(steps=5)
    assert bits(copy) == bits(sim)


def test_edits_are_events_of_the_history(tmp_path):
    sim = river()
    sim.run(steps=3)
    edit = edits.RedrawSection(0, [tuple(p) for p in sim.network.polylines()[0][40:80:5] + [0.0, 1.0 / 3.0]])
    sim.apply(edit)
    sim.run(steps=3)
    (event,) = sim.history.edits
    assert event == AppliedEdit.of(3 * sim.params.time_step, 3, edit) and event.edit == edit
    assert "RedrawSection(channel=0" in repr(event)
    sim.history.save(tmp_path / "run.npz")
    assert list(wr.read_history(tmp_path / "run.npz").edits) == [event]


# ---- what is refused


def ridge():
    """Ground that falls to the south, with a ridge from west to east at y = 2,000 m."""
    y = 5_000.0 - 50.0 * (np.arange(200) + 0.5)
    height = 0.01 * y + 30.0 * np.exp(-((y - 2_000.0) ** 2) / 2e5)
    return Terrain(np.repeat(height[:, None], 320, axis=1), 50.0, origin=(-2_000.0, 5_000.0))


def ring():
    angle = 2.0 * np.pi * np.arange(120) / 120
    line = 1_000.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Simulation(RiverNetwork.from_polylines([line], 60.0, closed=True), plain_params(spacing=50.0), device="cpu")


def evenly():
    """Points 50 m apart, however narrow the channels are."""
    line = river().network.polylines()[0]
    params = plain_params(spacing=50.0, spacing_in_widths=0.0)
    return Simulation(RiverNetwork.from_polylines([line], width=60.0), params, device="cpu")


def far_sighted():
    """A solver that looks for shortcuts over 600 m, which no part of a channel can be shorter than."""
    params = PathMeander(spacing=50.0, search_radius=10.0, cutoff_min_arc=11.0)
    return Simulation(RiverNetwork.from_polylines(river().network.polylines(), width=60.0), params, device="cpu")


def two_rivers():
    line = river().network.polylines()[0]
    network = RiverNetwork.from_polylines([line, line + [0.0, 6_000.0]], width=60.0)
    return Simulation(network, plain_params(spacing=50.0), terrain=None, device="cpu")


def straight():
    return Simulation(RiverNetwork.from_polylines([[(0.0, 0.0), (4e3, 0.0), (9e3, 0.0)]], width=60.0), device="cpu")


def locked():
    sim = river()
    sim.lock(0, 5_000.0)
    return sim


def over_ridge():
    return river(terrain=ridge())


def end_of(sim, dx=0.0, dy=0.0):
    return tuple(sim.network.polylines()[0][120] + [dx, dy])


@pytest.mark.parametrize(
    ("make", "edit", "words"),
    [
        (river, lambda s: edits.LockPoint(7, 100.0), "there is no channel 7; the network has 0"),
        (river, lambda s: edits.LockPoint(0, (6_000.0, 900.0)), "outside of channel 0, which is 60 m wide"),
        (river, lambda s: edits.LockPoint(0, 9e4), "at is 90000 m, beyond the end of channel 0"),
        (river, lambda s: edits.LockPoint(0, 300.0), "6 spacings from its head of channel 0; to be locked keep 10"),
        (locked, lambda s: edits.LockPoint(0, 5_300.0), "6 spacings from a locked point of channel 0; to be locked"),
        (locked, lambda s: edits.LockPoint(0, 5_000.0), "is locked there already"),
        (ring, lambda s: edits.LockPoint(0, 300.0), "channel 0 is a ring, which cannot be locked"),
        (ring, lambda s: edits.SplitChannel(0, 300.0), "channel 0 is a ring, which cannot be split"),
        (far_sighted, lambda s: edits.LockPoint(0, 550.0), "search_radius 10 widths .* exceeds the length"),
        (river, lambda s: edits.UnlockPoint(0, 300.0), "channel 0 has no locked point"),
        (river, lambda s: edits.MovePoint(0, 300.0, (0.0, 0.0), 60.0), "radius is 60 m; the points are"),
        (river, lambda s: edits.SplitChannel(0, 20.0), "0 spacings from its head of channel 0; to be split keep 2"),
        (evenly, lambda s: edits.SplitChannel(0, 5e3, width_above=20.0), "is coarser than channel 1 is wide"),
        (two_rivers, lambda s: edits.JoinChannels(0, 1), "channels 0 and 1 do not follow each other"),
        (two_rivers, lambda s: edits.JoinChannels(0, 0), "channels 0 and 0 are one"),
        (tree, lambda s: edits.JoinChannels(*junction(s)), "meet at a junction of 3 channels"),
        (river, lambda s: edits.AddChannel([end_of(s, 0, 900), end_of(s, 0, 200)], 30.0, ends="channel"), "on no chan"),
        (river, lambda s: edits.AddChannel([end_of(s, 0, 900), end_of(s)], 60.0, ends="outlet"), "on channel 0"),
        (river, lambda s: edits.AddChannel([end_of(s, 0, 40), end_of(s)], 60.0), "40 m long, for a width of 60 m"),
        (river, lambda s: edits.AddChannel([end_of(s, 0, 900), end_of(s)], 60.0, max_rise=1.0), "lies on a plain"),
        (over_ridge, lambda s: edits.AddChannel([end_of(s, 0, 4e3), end_of(s)], 60.0, max_rise=1.0), "ground rises"),
        (over_ridge, lambda s: edits.AddChannel([end_of(s, 0, 9e3), end_of(s)], 60.0, max_rise=1.0), "has no data"),
        (evenly, lambda s: edits.AddChannel([end_of(s, 0, 900), end_of(s)], 30.0), "is coarser than channel"),
        (locked, lambda s: edits.AddChannel([lock_of(s, 900.0), lock_of(s)], 60.0), "ends at a locked point"),
        (river, lambda s: edits.RemoveChannel(3), "there is no channel 3"),
        (river, lambda s: edits.RedrawSection(0, [end_of(s), end_of(s, 0, 500)]), "outside of channel 0"),
        (river, lambda s: edits.RedrawSection(0, [end_of(s), (0, 9), end_of(s, -1e3)]), "(runs upstream|outside of)"),
        (locked, lambda s: edits.RedrawSection(0, s.network.points()[[20, 200]]), "(a locked point|runs upstream)"),
        (evenly, lambda s: edits.SetChannel(0, width=20.0), "is coarser than channel 0 is wide"),
        (river, lambda s: edits.CutLoop(0, 5_000.0, 4_000.0), "to lies upstream of at"),
        (river, lambda s: edits.CutLoop(0, 5_000.0, 5_200.0), "a cutoff takes more than 5 widths"),
        (locked, lambda s: edits.CutLoop(0, 4_000.0, 6_000.0), "a locked point of channel 0 lies on the loop"),
        (straight, lambda s: edits.CutLoop(0, 5_000.0), "hardly bends at"),
        (river, lambda s: edits.SetChannel(0, width=90.0, reach=(5_000.0, 4_000.0)), "reach runs upstream"),
        (river, lambda s: edits.SetChannel(0, width=90.0, reach=(5_000.0, 5_050.0)), "spacings long"),
        (locked, lambda s: edits.SetChannel(0, width=90.0, reach=(4_000.0, 6_000.0)), "a locked point of channel 0"),
        (river, lambda s: edits.EditTerrain("raise", (0.0, 0.0), 500.0, 5.0), "lies on a plain, which cannot be"),
        (river, lambda s: "lock", "edit is .lock.; give an Edit .wr.edits has them"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_told_and_nothing_changes(make, edit, words):
    sim = make()
    before, events = bits(sim), list(sim.history.events)
    with pytest.raises((InputError, InputTypeError), match=words) as told:
        sim.apply(edit(sim))
    assert "\n" not in str(told.value)
    assert bits(sim) == before and list(sim.history.events) == events


def junction(sim):
    network = sim.network
    upper = int(np.flatnonzero(np.isin(network.channel_to, network.channel_from))[0])
    lower = int(np.flatnonzero(network.channel_from == network.channel_to[upper])[0])
    return int(network.channel_id[upper]), int(network.channel_id[lower])


def lock_of(sim, dy=0.0):
    network = sim.network
    return tuple(network.node_xy[network.channel_to[network.channel_joint == 2][0]] + [0.0, dy])


# ---- controls


def steered(**options):
    """A tree with an attractor, over ground."""
    sim = tree(ground=True)
    attractor = wr.meander.Attractor((500.0, 400.0), 3_000.0, 0.5)
    return Simulation(sim.network, sim.params, terrain=sim.terrain, controls=attractor, **options)


def test_controls_are_edits_as_any_other(tmp_path, device):
    """Taken back and done again to the bit, however fine the raster is that they are stamped into, and replayed."""
    sim = steered(device=device)
    sim.run(steps=3)
    middle = sim.network.points().mean(axis=0)
    choices = [
        (*sim.controls, wr.meander.Repeller(tuple(middle), 2_000.0, 1.0)),
        (wr.meander.Guide([tuple(middle), tuple(middle + 900.0)], 40.0, 0.7),),
        (),
        (wr.meander.DampingRegion([middle, middle + [900.0, 0.0], middle + [0.0, 900.0]]), *sim.controls),
    ]
    states = [bits(sim)]
    for controls in choices:
        sim.apply(wr.meander.SetControls(controls))
        states.append(bits(sim))
    assert len(sim.history.edits) == 4 and sim.controls == choices[-1]
    for state in states[-2::-1]:
        sim.undo()
        assert bits(sim) == state
    assert len(sim.controls) == 1 and not sim.history.edits
    once = steered(device=device)
    once.run(steps=3)
    for each in (sim, once):
        each.controls = choices[0]
        each.step(4)
    assert bits(sim) == bits(once), "as if nothing had been taken back"
    edits.write_edits(tmp_path / "session.json", sim)
    session = edits.read_edits(tmp_path / "session.json")
    assert session.edits == ((3, wr.meander.SetControls(choices[0])),)
    for again in (
        Simulation.replay(steered(device=device, threads=2), session),
        Simulation.replay(sim.history, session, terrain=steered().terrain, device=device),
    ):
        assert bits(again) == bits(sim) and again.controls == sim.controls


def test_painted_controls_are_edits():
    sim = river()
    field = wr.meander.ControlField.blank((-1_000.0, -3_000.0, 13_000.0, 3_000.0), 200.0)
    sim.controls = field
    sim.run(steps=2)
    field.paint((5_000.0, 500.0), 1_500.0, 300.0)
    sim.run(steps=2)
    assert [event.step for event in sim.history.edits] == [0, 2]
    again = Simulation.replay(river(), sim.history)
    assert bits(again) == bits(sim) and again.controls == (field,)
    with pytest.raises(InputError, match="is no control; it needs a kind"):
        wr.meander.SetControls([{"kind": "Dam"}])
    with pytest.raises(InputError, match="controls holds a str"):
        wr.meander.SetControls("dam")


def test_edits_that_come_and_go_outdate_no_recording():
    """Where there is room, and locks have been looked for, the next step replays what was recorded."""
    sim = tree(ground=True)
    sim.step(3)
    long = int(sim.network.channel_id[sim.network.channel_lengths().argmax()])

    def place(part):
        return tuple(lines(sim)[long][int(part * len(lines(sim)[long]))])

    sim.lock(long, place(0.5))
    sim.step()
    edition = sim.stepper.state.edition
    for _ in range(3):
        sim.apply(edits.MovePoint(long, place(0.3), tuple(np.add(place(0.3), 20.0)), 300.0))
        sim.step()
        sim.unlock(long, place(0.0))
        sim.apply(edits.EditTerrain("raise", center=place(0.2), radius=300.0, amount=2.0))
        sim.step()
        sim.apply(edits.SetChannel(long, width=26.0))
        sim.lock(long, place(0.5))
        sim.undo()
        sim.redo()
        sim.step()
    assert sim.stepper.state.edition == edition
