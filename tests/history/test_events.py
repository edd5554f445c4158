"""Events: a kind is its dataclass and nothing else; one log holds them all in order."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from plain import plain_params

from warpriver import RiverNetwork, Simulation, generate
from warpriver.history import Collision, Cutoff, Event, EventLog, History, Split, events
from warpriver.history.segments import decode_events, encode


@dataclasses.dataclass(frozen=True)
class GravelFlood(Event):
    """A kind that no part of the program knows of."""

    channel: int
    peak: float
    name: str
    levee_broken: bool
    line: np.ndarray
    depth: np.ndarray
    grains: np.ndarray | None
    note: str | None = None
    crest: float | None = None


def flood(k, **changes):
    rng = np.random.default_rng(k)
    values = {
        "time": 0.5 * k, "channel": k, "peak": float(rng.random()), "name": f"flood {k}", "levee_broken": k % 2 == 0,
        "line": rng.random((k % 4, 2)), "depth": rng.random(k % 4), "grains": np.arange(k) if k % 3 else None,
        "note": None if k % 2 else "high", "crest": None if k % 5 else float(k),
    }  # fmt: skip
    return GravelFlood(**{**values, **changes})


def cutoff(at):
    return Cutoff(at, 3, 50.0, np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]))


def split(at):
    return Split(at, 1, 2, 50.0, np.ones((4, 2)))


def collision(at):
    return Collision(at, "upstream", 1, 2, 50.0, np.arange(10.0).reshape(5, 2), np.array([0, 2, 5]))


def test_a_kind_is_known_by_the_name_of_its_class():
    assert (Cutoff.kind, Split.kind, GravelFlood.kind) == ("cutoff", "split", "gravel_flood")
    assert flood(1).kind == "gravel_flood" and events.event_class("gravel_flood") is GravelFlood
    assert events.event_class("tsunami") is None


def test_equal_events_hold_equal_values():
    assert flood(7) == flood(7) and flood(7) != flood(7, peak=0.0) and flood(7) != flood(7, depth=np.zeros(3))
    assert flood(3) == flood(3, grains=None) != flood(3, grains=np.arange(3))
    assert cutoff(1.0) == copy.deepcopy(cutoff(1.0)) == pickle.loads(pickle.dumps(cutoff(1.0))) != split(1.0)


def test_a_log_is_one_list_and_one_a_kind():
    mixed = [cutoff(0.1), split(0.2), cutoff(0.3), collision(0.3), flood(2), cutoff(0.5)]
    log = EventLog(mixed)
    cutoffs, floods = log.of(Cutoff), log.of(GravelFlood)
    assert list(log) == mixed and len(log) == 6 and log[-1] is mixed[-1] and log[1:3] == mixed[1:3]
    assert [c.time for c in cutoffs] == [0.1, 0.3, 0.5] and cutoffs[-1] is mixed[5] and cutoffs[:2] == mixed[:3:2]
    assert cutoffs == [mixed[0], mixed[2], mixed[5]] and floods == [mixed[4]] and log.of(Split) != []
    assert cutoffs.index(mixed[2]) == 1 and mixed[2] in cutoffs and bool(floods)
    log.append(flood(3))
    assert len(floods) == 2, "a view grows with the log"
    log.truncate(3)
    assert list(log) == mixed[:3] and [c.time for c in cutoffs] == [0.1, 0.3] and floods == [] and not floods
    assert repr(log) == "EventLog(2 cutoff, 1 split)" and repr(EventLog()) == "EventLog(empty)"
    assert log.counts() == {"cutoff": 2, "split": 1}


@pytest.mark.parametrize("first", [0, 7])
def test_any_events_come_back_from_arrays(first):
    mixed = [flood(0), cutoff(0.1), flood(1), split(0.2), *map(flood, range(2, 16)), collision(0.3), cutoff(0.4)]
    for some in (mixed, mixed[:1], mixed[1:2], []):
        place, back = decode_events(encode([], some, first))
        assert place == first and back == some
    for one, two in zip(back, mixed, strict=False):
        for field in dataclasses.fields(one):
            assert type(getattr(one, field.name)) is type(getattr(two, field.name))


def small(**options):
    line = generate.noisy_line(6000.0, 50.0, 50.0, 5)
    return Simulation(RiverNetwork.from_polylines([line], width=50.0), plain_params(friction=0.012), **options)


def test_a_new_kind_is_recorded_stored_read_and_resumed(tmp_path, device):
    """Of a class that stands in this file alone."""

    def rain(sim):
        sim.history.events.append(flood(sim.step_count, time=sim.time))

    whole = small(device=device)
    whole.run(steps=300, record_every=40, callbacks=[rain])
    half = small(device=device)
    half.run(steps=170, record_every=40, callbacks=[rain], store=tmp_path / "run")
    half.history.events.append(flood(999))  # lost with the killed run
    half.history.flush()
    rest = Simulation.resume(tmp_path / "run", device=device)
    assert len(rest.history.events.of(GravelFlood)) == 170
    rest.run(steps=130, record_every=40, callbacks=[rain])
    rest.history.save(tmp_path / "run.npz")
    rest.history.save(tmp_path / "saved")
    assert len(whole.history.cutoffs) > 0
    for found in (rest.history, *(History.load(tmp_path / name) for name in ("run", "run.npz", "saved"))):
        assert list(found.events) == list(whole.history.events)
        assert found.events.of(GravelFlood) == [flood(k, time=k * whole.params.time_step) for k in range(1, 301)]
        assert "300 gravel floods" in repr(found) and found.record(-1).events_before == len(found.events)
    assert copy.deepcopy(rest).history.events.of(GravelFlood) == whole.history.events.of(GravelFlood)


def test_a_kind_without_a_class_is_told_by_name(tmp_path, monkeypatch):
    sim = small()
    sim.history.events.append(flood(1))
    sim.history.save(tmp_path / "run.npz")
    sim.history.save(tmp_path / "run")
    monkeypatch.delitem(events._CLASSES, "gravel_flood")
    with pytest.raises(
        ValueError, match=r"run\.npz holds events of the kind 'gravel_flood', .* import test_events first"
    ):
        History.load(tmp_path / "run.npz")
    opened = History.load(tmp_path / "run")
    assert opened.network(-1).point_count > 0
    with pytest.raises(ValueError, match="import test_events first"):
        len(opened.events)


def test_two_kinds_of_one_name_are_refused():
    with pytest.raises(TypeError, match="both events of the kind 'gravel_flood'; rename one"):
        type("GravelFlood", (Event,), {"__module__": "elsewhere"})


def test_a_class_may_be_made_again():
    """As a notebook does whose cell runs twice."""
    for _ in range(2):

        @dataclasses.dataclass(frozen=True)
        class Drought(Event):
            depth: float

        assert EventLog([Drought(1.0, 2.0)]).of(Drought)[0].depth == 2.0


@pytest.mark.parametrize(
    ("event", "words"),
    [
        ("flood", "is no event; make a frozen dataclass that derives from Event"),
        (Event(1.0), "is no event"),
        (flood(1, channel=2.5), "channel of the event GravelFlood is 2.5, not int"),
        (flood(1, peak=None), "peak of the event GravelFlood is None, not float"),
        (flood(1, name=5), "name of the event GravelFlood is 5, not str"),
        (flood(1, line=None), "line of the event GravelFlood is None, not ndarray"),
        (flood(1, depth=np.array(1.0)), r"depth of the event GravelFlood is float64 \(\); give an array"),
        (flood(1, depth=np.array([{}])), r"depth of the event GravelFlood is object \(1,\); give an array"),
        (
            flood(1, line=np.zeros((2, 3))),
            r"line .* is float64 \(2, 3\), in events before float64 \('n', 2\); all must be of one form",
        ),
        (flood(1, line=np.zeros((2, 2), int)), "in events before float64"),
    ],
)
def test_what_cannot_be_stored_is_refused_when_it_happens(event, words):
    log = EventLog([flood(3)])
    with pytest.raises(TypeError, match=words) as caught:
        log.append(event)
    assert "\n" not in str(caught.value) and len(log) == 1


def test_a_kind_that_cannot_be_stored_is_refused():
    @dataclasses.dataclass(frozen=True)
    class Listed(Event):
        values: list

    class Bare(Event):
        pass

    with pytest.raises(TypeError, match=r"field values of .*Listed is <class 'list'>; an event holds float, int, bool"):
        EventLog([Listed(1.0, [])])
    with pytest.raises(TypeError, match="Bare is no dataclass; decorate it"):
        EventLog([Bare(1.0)])
