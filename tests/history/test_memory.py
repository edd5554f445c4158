"""Memory of a run and of a history that is read: an index, however long the run and whatever it left behind."""

import gc
import tracemalloc

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr
from warpriver.history import AppliedEdit, Collision, Cutoff, EventLog, History, Split
from warpriver.history import folder as folders

# A course of 1000 points: 16 kB. What a record or an event may leave in memory: its line in the index.
COURSE_BYTES, INDEX_BYTES = 16_000, 600


def river():
    line = wr.generate.noisy_line(2000.0, 50.0, 50.0, 5)
    return wr.Simulation(wr.RiverNetwork.from_polylines([line], width=50.0), plain_params(), threads=1)


def loop(at):
    return Cutoff(at, 3, 50.0, np.full((COURSE_BYTES // 16, 2), at))


def leave_loop(sim):
    sim.history.events.append(loop(sim.time))


def live_loops():
    gc.collect()
    return sum(isinstance(found, Cutoff) for found in gc.get_objects())


@pytest.mark.parametrize("every", [4, 10**9])
def test_memory_of_a_run_does_not_grow_with_its_length(tmp_path, monkeypatch, every):
    """Also where no record follows the events for long."""
    monkeypatch.setattr("warpriver.history.SEGMENT_BYTES", 5 * COURSE_BYTES)
    sim, before = river(), live_loops()
    options = {"record_every": every, "store": tmp_path / "run", "callbacks": [leave_loop]}
    sim.run(steps=40, **options)
    tracemalloc.start()
    sim.run(steps=20, **options)
    gc.collect()
    one, before_peak = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    sim.run(steps=100, **options)
    gc.collect()
    two, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # 1.6 MB of courses happened, of which a segment is in memory at a time.
    assert two - one < 125 * INDEX_BYTES < 0.05 * 100 * COURSE_BYTES
    assert peak - before_peak < 10 * COURSE_BYTES
    assert live_loops() == before and len(sim.history.cutoffs) >= 160
    assert sim.history.cutoffs[20] == loop(sim.history.events.times[20])


@pytest.fixture
def stored(tmp_path, monkeypatch):
    """A run whose events lie in many segments, and the events."""
    monkeypatch.setattr("warpriver.history.SEGMENT_BYTES", 5 * COURSE_BYTES)
    history, happened = river().run(steps=1), []
    history.store_in(tmp_path / "run")
    for k in range(100):
        at = 1.0 + k
        happened.append(loop(at) if k % 3 else Split(at, 1, 2, 50.0, np.full((9, 2), at)))
        if k % 10 == 5:
            happened.append(Collision(at, "upstream", 1, 2, 50.0, np.full((5, 2), at), np.array([0, 2, 5])))
        history.events.extend(happened[len(history.events) :])
        history.relieve()
    history.flush()
    return tmp_path / "run", happened


def test_events_of_a_stored_run_are_read_when_asked_for(stored, monkeypatch):
    path, happened = stored
    history = History.load(path)
    assert len(history._folder.segments) > 10
    read = []
    decode = folders.decode_events_of

    def noted(archive, kind):
        read.append(kind)
        return decode(archive, kind)

    monkeypatch.setattr(folders, "decode_events_of", noted)
    assert len(history.cutoffs) == 66 and history.events.counts() == {"split": 34, "cutoff": 66, "collision": 10}
    assert history.events.times.tolist() == [event.time for event in happened]
    assert history.events.kinds == [event.kind for event in happened]
    assert history.edits == [] and history.last_params == history.params and "66 cutoffs" in repr(history)
    assert not read
    assert list(history.splits) == [event for event in happened if isinstance(event, Split)]
    assert set(read) == {"split"}


def test_reading_a_long_history_takes_the_memory_of_a_segment(stored):
    path, happened = stored
    history = History.load(path)
    len(history.events)
    tracemalloc.start()
    length = sum(len(cutoff.xy) for cutoff in history.cutoffs)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert length == 66 * COURSE_BYTES // 16 and peak < 35 * COURSE_BYTES
    kept = history.cutoffs[3]
    assert kept.xy.base is None, "one that is kept does not hold the others"
    assert kept == [event for event in happened if isinstance(event, Cutoff)][3]


def test_a_log_on_disk_is_as_one_in_memory(stored, tmp_path):
    path, happened = stored
    log, known = History.load(path).events, EventLog(happened)
    assert list(log) == happened and log[-1] == happened[-1] and log[7:70:3] == happened[7:70:3]
    for one in (slice(None), slice(20, 60), slice(33, 34), slice(50, 40), slice(80, 10, -7)):
        for classes in ((Cutoff,), (Split, Collision), (AppliedEdit,)):
            expected = [event for event in happened[one] if isinstance(event, classes)]
            for view in (log[one].of(*classes), known[one].of(*classes)):
                assert len(view) == len(expected) and view == expected
                assert view.times.tolist() == [event.time for event in expected]
    assert log[20:60][5:9].of(Cutoff)[-1] == known[20:60][5:9].of(Cutoff)[-1]
    # Cut in the middle of a segment, and continued.
    log.truncate(41)
    log.append(loop(1e3))
    assert list(log) == [*happened[:41], loop(1e3)] and log.of(Cutoff)[-1].time == 1e3
    with pytest.raises(TypeError, match="all must be of one form"):
        log.append(Split(5.0, 1, 2, 50.0, np.zeros((9, 3))))
    with pytest.raises(IndexError):
        log[42]


def test_a_history_that_moves_to_another_folder_takes_its_events_along(stored, tmp_path):
    path, happened = stored
    history = History.load(path)
    history.store_in(tmp_path / "other")
    assert history.path == tmp_path / "other" and list(history.events) == happened
    history.events.append(loop(2e3))
    history.flush()
    assert list(History.load(tmp_path / "other").events) == [*happened, loop(2e3)]
    assert list(History.load(path).events) == happened
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("")
    with pytest.raises(FileExistsError):
        history.store_in(tmp_path / "full")
    assert history.path == tmp_path / "other" and len(history.events) == len(happened) + 1
