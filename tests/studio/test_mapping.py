"""What the process beside the simulation makes: maps as those of a recorded run, and files."""

import json

import numpy as np
import pytest

import warpriver as wr
from warpriver.studio.folder import begin_folder
from warpriver.studio.frames import MAP, decode_state
from warpriver.studio.generators import GENERATORS, generated
from warpriver.studio.mapping import Mapper
from warpriver.studio.worker import Worker


@pytest.fixture(scope="module")
def river():
    made = generated({"generator": "plain", "length": 6.0, "cell": 60.0, "width": 40.0, "wandering": 3.0})
    assert made.terrain is not None and made.network.channel_count == 1
    return made


def learned(worker, sent, mapper):
    """Tell a mapper where the run of a worker stands."""
    worker._ask_mapper("map", {})
    mapper.learn(json.loads(sent[-1][1:])["news"])


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
    # The state kept at an edit is the one before it; within 10 steps the bend moves on by more than half its width.
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
