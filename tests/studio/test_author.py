"""Edits that are undone and redone at any time: the run is to the bit as if they had or had not been done."""

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr
from warpriver import edits
from warpriver.history import Cutoff
from warpriver.meander import SetControls
from warpriver.studio.author import Author, Checkpoint, brushed

STEPS = 30


def simulation():
    line = wr.generate.noisy_line(length=6000, spacing=50, amplitude=60, seed=0)
    terrain = wr.generate.tilted_plain((60, 90), 100.0, slope=0.001)
    low = line.min(axis=0)
    network = wr.RiverNetwork.from_polylines([line - low + [800.0, 1500.0]], width=60.0)
    return wr.Simulation(network, plain_params(), terrain=wr.Terrain(terrain.to_numpy(), 100.0, origin=(0.0, 6000.0)))


def bits(sim):
    return sim.network.points().tobytes(), sim.terrain.to_numpy().tobytes(), len(sim.controls)


def some_edits(sim):
    channel, xy = int(sim.network.channel_id[0]), sim.network.polylines()[0]
    place = tuple(xy[40])
    return [
        edits.MovePoint(channel, place, (place[0] + 90.0, place[1] + 120.0), 700.0),
        edits.EditTerrain("raise", center=place, radius=500.0, amount=8.0),
        edits.LockPoint(channel, tuple(xy[70])),
    ]


def test_undo_after_steps_leaves_the_run_without_the_edit_and_redo_brings_it_back():
    author, plain = Author(simulation()), simulation()
    author.step(STEPS)
    for edit in some_edits(author.simulation):
        author.apply(edit)
    author.paint(author.simulation.network.polylines()[0][30], 800.0, 50.0)
    author.step(STEPS)
    edited, count = bits(author.simulation), len(author.edits)
    while author.undoable:
        author.undo()
    plain.step(2 * STEPS)
    assert bits(author.simulation) == bits(plain)
    assert author.simulation.step_count == 2 * STEPS and author.redoable == count
    while author.redoable:
        author.redo()
    assert bits(author.simulation) == edited
    with pytest.raises(wr.WarpriverError, match="no edit to redo"):
        author.redo()


def test_a_new_edit_forgets_what_was_undone():
    author = Author(simulation())
    first, second, _ = some_edits(author.simulation)
    author.apply(first)
    author.undo()
    author.apply(second)
    assert author.redoable == 0 and [edit for _, edit in author.edits] == [second]


def test_the_touches_of_a_stroke_are_one():
    author = Author(simulation())
    before = bits(author.simulation)
    place = author.simulation.network.polylines()[0][30]
    for k in range(4):
        author.apply(edits.EditTerrain("raise", center=tuple(place + 50.0 * k), radius=400.0, amount=2.0), "a stroke")
    after = bits(author.simulation)
    assert len(author.undo()) == 4 and bits(author.simulation) == before
    author.redo()
    assert bits(author.simulation) == after
    author.step(5)
    author.undo()
    assert not author.edits and author.simulation.step_count == 5


def test_a_session_that_is_taken_up_again_has_the_same_bits(tmp_path):
    author = Author(simulation())
    author.step(20)
    for edit in some_edits(author.simulation):
        author.apply(edit)
        author.step(7)
    author.paint(author.simulation.network.polylines()[0][50], 900.0, -80.0)
    author.step(60)
    author.write_session(tmp_path / "edits.json")
    again = Author(simulation())
    again.take_up(author.entries, 0, author.simulation.step_count)
    assert bits(again.simulation) == bits(author.simulation)
    other = wr.Simulation.replay(simulation(), tmp_path / "edits.json")
    assert bits(other) == bits(author.simulation)


def test_a_checkpoint_goes_on_to_the_same_bits_and_one_of_another_session_is_passed_over(tmp_path):
    author = Author(simulation())
    author.step(20)
    for edit in some_edits(author.simulation):
        author.apply(edit)
    author.paint(author.simulation.network.polylines()[0][50], 900.0, -80.0)
    author.step(15)
    told = author.save_checkpoint(tmp_path / "checkpoint")
    checkpoint = Checkpoint(tmp_path / "checkpoint", told["edits"], told["steps"], told["digest"])
    author.step(10)
    author.apply(edits.LockPoint(int(author.simulation.network.channel_id[0]), 900.0))
    author.step(9)
    again = Author(simulation())
    again.take_up(author.entries, 0, author.simulation.step_count, checkpoint)
    assert bits(again.simulation) == bits(author.simulation) and again.edits == author.edits
    assert [mark.step for mark in again._marks][:2] == [0, 35], "it was taken up at the checkpoint"
    while again.undoable:  # also what lies before it
        again.undo()
    plain = simulation()
    plain.step(54)
    assert bits(again.simulation) == bits(plain)
    for entries, steps in ((author.entries[1:], 54), (author.entries, 34)):
        assert not checkpoint.fits(entries, steps)


def test_marks_share_events_and_unchanged_ground():
    author = Author(simulation())
    author.step(100)
    author.apply(some_edits(author.simulation)[1])
    author.step(50)
    first, second, third, fourth = author._marks
    assert first.ground is second.ground is third.ground and fourth.ground is not third.ground
    assert author.simulation.history.events[0] is fourth.state["history"].events[0]


def test_old_events_are_forgotten_and_counted(monkeypatch):
    monkeypatch.setattr("warpriver.studio.author.EVENTS_KEPT", 5)
    author = Author(simulation())
    author.apply(SetControls((wr.Attractor((1000.0, 1000.0), 500.0),)))
    first = len(author.simulation.history.events)
    author.simulation.history.events.extend(Cutoff(0.1 * k, 0, 50.0, np.zeros((3, 2))) for k in range(30))
    author.step(1)
    held = author.simulation.history.events
    assert len(held) == first + 5 and len(held.of(Cutoff)) == 5
    assert author.count(Cutoff) == 30 and author.events == first + 30
    assert [event.time for event in author.events_after(first + 28)] == pytest.approx([2.8, 2.9])
    author.step(60)  # beyond a mark, which is gone back to
    author.rewind(55)
    assert author.count(Cutoff) >= 30
    assert len(author.simulation.controls) == 1, "what changed the controls is kept"


def test_rewinding_forgets_later_edits():
    author = Author(simulation())
    first, second, _ = some_edits(author.simulation)
    author.apply(first)
    author.step(80)
    half = bits(author.simulation)
    author.step(40)
    author.apply(second)
    author.step(10)
    assert author.rewind(80) == 1
    assert bits(author.simulation) == half and [edit for _, edit in author.edits] == [first]
    with pytest.raises(wr.WarpriverError, match="the run has done 80"):
        author.rewind(81)


def test_an_edit_that_cannot_be_done_changes_nothing():
    author = Author(simulation())
    before = bits(author.simulation)
    with pytest.raises(wr.WarpriverError):
        author.apply(edits.LockPoint(77, 100.0))
    with pytest.raises(wr.WarpriverError, match="misses the field"):
        author.paint((1e7, 1e7), 100.0, 1.0)
    assert bits(author.simulation) == before and not author.edits


def test_marks_do_not_pile_up():
    author = Author(simulation())
    author.step(1000)
    assert len(author._marks) <= 17 and author._marks[0].step == 0 and author._marks[-1].step == 1000


def test_a_stroke_is_round_and_falls_to_nothing():
    """The brush is amount (1 - p^2)^3, a closed form."""
    raster = wr.meander.ControlField.blank((0.0, 0.0, 1000.0, 800.0), 50.0).raster
    window = raster.window(200.0, 200.0, 600.0, 600.0)
    values = brushed(raster, window, (400.0, 400.0), 200.0, 7.0)
    row, column, rows, columns = window
    x = 50.0 * (column + 0.5 + np.arange(columns)) - 400.0
    y = 800.0 - 50.0 * (row + 0.5 + np.arange(rows)) - 400.0
    p = np.hypot(x[None, :], y[:, None]) / 200.0
    np.testing.assert_allclose(values, np.where(p < 1.0, 7.0 * (1.0 - np.minimum(p, 1.0) ** 2) ** 3, 0.0), atol=1e-12)
