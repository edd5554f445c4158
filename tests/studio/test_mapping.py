"""What the process beside the simulation makes: maps as those of a recorded run, and files."""

import json

import numpy as np
import pytest

import warpriver as wr
from warpriver.history import Cutoff
from warpriver.studio.figures import FIGURES
from warpriver.studio.folder import begin_folder
from warpriver.studio.frames import MAP, decode_state
from warpriver.studio.generators import GENERATORS, generated
from warpriver.studio.mapping import Mapper
from warpriver.studio.news import REQUEST
from warpriver.studio.worker import Worker


@pytest.fixture(scope="module")
def river():
    made = generated({"generator": "plain", "length": 6.0, "cell": 60.0, "width": 40.0, "wandering": 3.0})
    assert made.terrain is not None and made.network.channel_count == 1
    return made


def learned(worker, sent, mapper):
    """Tell a mapper where the run of a worker stands."""
    worker._ask_mapper("map", {})
    mapper.learn(json.loads(sent[-1][1 + REQUEST.size :])["news"])


def test_maps_are_those_of_a_recorded_run(tmp_path, river):
    begin_folder(tmp_path / "s", river)
    sent, told = [], []
    worker = Worker(tmp_path / "s", sent.append)
    mapper = Mapper(tmp_path / "s", told.append)
    for _ in range(40):
        worker.do_step()
    learned(worker, sent, mapper)
    mapper.do_map("age")
    for _ in range(15):  # from there on
        worker.do_step()
    learned(worker, sent, mapper)
    mapper.do_map("moisture")
    history = river.run(steps=55, record_every=1)
    size = mapper._maps().age.cell_size
    direct = wr.landscape_maps(history, river.terrain, size)
    for name in ("age", "moisture", "sediment", "belt"):
        a, b = mapper._maps().rasters[name].numpy(), direct.rasters[name].numpy()
        # States on disk are single: a few mm, at which a cell may be in a channel or beside it.
        differs = np.abs(np.nan_to_num(a, nan=-1.0) - np.nan_to_num(b, nan=-1.0)) > 1e-3 * max(1.0, np.nanmax(b))
        assert differs.mean() < 2e-3, name
    frame = told[-1][1:]
    assert np.frombuffer(frame, "<u4", 3).tolist() == [MAP, *mapper._maps().age.shape]


def note_cutoffs(author, *times):
    author.simulation.history.events.extend(Cutoff(time, 0, 50.0, np.zeros((3, 2))) for time in times)


def test_the_events_of_a_run_are_told_once_and_taken_back(tmp_path):
    """A long run has thousands of them; after an undo only those since are told again."""
    begin_folder(tmp_path / "s", generated({"generator": "plain", "length": 4.0, "cell": 80.0, "wandering": 3.0}))
    sent = []
    worker, mapper = Worker(tmp_path / "s", sent.append), Mapper(tmp_path / "s", lambda message: None)
    worker.do_step(49)
    note_cutoffs(worker.author, 1.0, 2.0)
    worker.do_step()
    learned(worker, sent, mapper)
    worker.do_edit({"edit": "LockPoint", "channel": 0, "at": 2000.0})
    worker.do_step(50)
    note_cutoffs(worker.author, 30.0)
    learned(worker, sent, mapper)
    assert [event.time for event in mapper._run.events] == [1.0, 2.0, 30.0]
    worker.do_undo()  # does the steps from 50 on again, without the one that was put in by hand
    note_cutoffs(worker.author, 31.0)
    learned(worker, sent, mapper)
    told = json.loads(sent[-1][1 + REQUEST.size :])["news"]
    assert [event["time"] for event in told["events"]] == [31.0]
    assert [event.time for event in mapper._run.events] == [1.0, 2.0, 31.0]


def test_the_figures_come_with_the_scene_and_outlive_the_process(tmp_path):
    """So that plots are full on every page, after a reload, and after the process has died."""
    begin_folder(tmp_path / "s", generated({"generator": "plain", "length": 4.0, "cell": 80.0, "wandering": 3.0}))
    sent = []

    def series():
        worker.tell_scene()
        scenes = [message for message in sent if message.startswith(b'J{"type": "scene"')]
        return json.loads(scenes[-1][1:])["series"]

    worker = Worker(tmp_path / "s", sent.append)
    worker.do_step(200)
    told = series()
    step = worker.author.simulation.params.time_step
    assert [time for time, _ in told["sinuosity"]] == pytest.approx([k * 50 * step for k in range(5)])
    # Mean of arc length over chord.
    network = worker.author.simulation.network
    line = network.polylines()[0]
    length = np.hypot(*np.diff(line, axis=0).T).sum()
    assert told["sinuosity"][-1][1] == pytest.approx(length / np.hypot(*(line[-1] - line[0])), rel=1e-9)
    worker.do_save()
    worker = Worker(tmp_path / "s", sent.append)
    assert series() == told
    worker.do_rewind(100)
    assert series()["sinuosity"] == told["sinuosity"][:3]
    (tmp_path / "s" / FIGURES).write_text("[[1, NaN, 2, 3, 4]]")  # of a session that was made up
    assert Worker(tmp_path / "s", sent.append).author.simulation.step_count == 100


def test_the_state_of_the_timeline_is_the_one_after_an_edit(tmp_path):
    begin_folder(tmp_path / "s", generated({"generator": "plain", "length": 4.0, "cell": 80.0, "wandering": 3.0}))
    worker = Worker(tmp_path / "s", lambda message: None)

    def is_kept():
        """The kept state of the present step is the present one."""
        state = decode_state(worker._reel.frame(worker.author.simulation.step_count))
        present = (worker.author.simulation.network.points() - worker._origin).astype(np.float32)
        return np.array_equal(state.point_xy, present)

    worker.do_step(3)
    at = worker.author.simulation.network.polylines()[0][30]
    edit = {"edit": "MovePoint", "channel": 0, "at": at.tolist(), "to": (at + [0, 90]).tolist(), "radius": 500.0}
    worker.do_edit(edit)
    assert is_kept()
    worker.do_undo()
    assert is_kept()
    worker.do_redo()
    assert is_kept()
    edited = worker._reel.frame(3)
    worker.do_step(4)
    worker.do_undo()  # now it is done again from the beginning
    worker.do_redo()
    assert decode_state(worker._reel.frame(3)).point_xy.tobytes() == decode_state(edited).point_xy.tobytes()
    worker.do_rewind(3)
    assert is_kept() and worker.author.undoable == 1


def test_of_the_ground_only_what_was_carved_is_sent(tmp_path, river):
    begin_folder(tmp_path / "s", river)
    sent = []
    worker = Worker(tmp_path / "s", sent.append)
    terrain = worker.author.simulation.terrain
    heights = terrain.raster.cells((20, 30, 4, 5)) - 1.0
    terrain.raster.put_cells((20, 30, 4, 5), heights)
    sent.clear()
    worker._send_carved()
    (frame,) = sent
    assert np.frombuffer(frame[1:25], "<u4")[2:].tolist() == [20, 30, 4, 5]
    np.testing.assert_array_equal(np.frombuffer(frame[33:], "<f4").reshape(4, 5), heights.astype(np.float32))
    worker._send_carved()
    assert len(sent) == 1, "nothing has changed since"


def test_states_that_are_given_up_meanwhile_are_passed_over(tmp_path, river):
    begin_folder(tmp_path / "s", generated({"generator": "plain", "length": 6.0, "cell": 60.0, "wandering": 3.0}))
    sent = []
    worker, mapper = Worker(tmp_path / "s", sent.append), Mapper(tmp_path / "s", lambda message: None)
    for _ in range(3):
        worker.do_step(10)
    learned(worker, sent, mapper)
    mapper._maps()
    for _ in range(12):
        worker.do_step()
    learned(worker, sent, mapper)
    network = type(mapper._led).network
    thinned = []

    def meanwhile(index):
        if len(thinned) < 1:
            thinned.append(worker._reel._leave(worker._reel._held[::2]))
        return network(mapper._led, index)

    mapper._led.network = meanwhile
    assert mapper._maps().time == worker._reel.states[-1][1] and thinned


def test_maps_begin_anew_after_an_edit_was_undone(tmp_path, river):
    begin_folder(tmp_path / "s", generated({"generator": "plain", "length": 6.0, "cell": 60.0, "wandering": 3.0}))
    sent = []
    worker, mapper = Worker(tmp_path / "s", sent.append), Mapper(tmp_path / "s", lambda message: None)
    channel, line = 0, worker.author.simulation.network.polylines()[0]
    at = line[len(line) // 2]
    edit = {"edit": "MovePoint", "channel": channel, "at": at.tolist(), "to": (at + [0, 500]).tolist(), "radius": 900.0}
    worker.do_edit(edit)
    for count in (1, 9, *7 * [10]):
        worker.do_step(count)
    learned(worker, sent, mapper)
    led = [tuple(at + [0.0, 500.0])]
    assert mapper._maps().belt.sample(led)[0] == 1.0
    worker.do_undo()
    learned(worker, sent, mapper)
    assert mapper._maps().belt.sample(led)[0] == 0.0, "where the river was led is no part of the belt any more"
    assert worker._reel.last == 80, "the states are those of the run that was done again"
    assert {step for step, _ in worker._reel.states} >= {0, 50, 80}


def test_the_page_is_sent_the_present_state_after_an_undo_between_two_kept_ones(tmp_path, river):
    begin_folder(tmp_path / "s", generated({"generator": "plain", "length": 6.0, "cell": 60.0, "wandering": 3.0}))
    sent = []
    worker = Worker(tmp_path / "s", sent.append)
    worker._reel.every = 50
    worker.do_edit({"edit": "LockPoint", "channel": 0, "at": 3000.0})
    worker.do_step(53)
    for way in (worker.do_undo, worker.do_redo, lambda: worker.do_rewind(52)):
        way()
        sent.clear()
        worker.credits = 1
        worker.turn()
        state = next(decode_state(each[1:]) for each in sent if each[:1] == b"B")
        assert state.step == worker.author.simulation.step_count


def test_every_generator_says_what_it_asks_for():
    for name, each in GENERATORS.items():
        assert each.title and each.doc and set(each.fields), name
        for field in each.fields.values():
            assert field.label and field.doc and (field.choices or field.low < field.high)
            assert field.choices or field.low <= field.value <= field.high


@pytest.mark.parametrize("name", ["fan", "valley", "fractal"])
def test_land_is_generated_with_rivers_that_move(name):
    small = {"fan": {"size": 4.0}, "fractal": {"size": 4.0, "area": 1.0}}.get(name, {})
    made = generated({"generator": name, **small})
    before = made.network.points()
    made.step(2)
    after = made.network.points()
    assert before.shape != after.shape or np.abs(after - before).max() > 0.0
    other = generated({"generator": name, **small})
    assert other.network.points().tobytes() == before.tobytes(), "the same recipe gives the same land"
