import copy
import dataclasses
import json
import pickle
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from plain import plain_params

from warpriver import RiverNetwork, Simulation, generate
from warpriver.history import History, Record, StopReason
from warpriver.history.segments import SegmentIndex


def network():
    line = generate.noisy_line(12_000.0, 50.0, 50.0, 5)
    return RiverNetwork.from_polylines([line + [5e5, -1.6e6]], width=50.0, crs="EPSG:32620")


def run(steps=500, *, device, **options):
    sim = Simulation(network(), plain_params(friction=0.012), seed=9, device=device)
    return sim.run(steps=steps, record_every=25, **options)


@pytest.fixture(scope="module")
def history(device):
    return run(device=device)


def assert_same(a, b):
    assert (a.params, a.seed, a.crs, a.dtype, a.stop_reason) == (b.params, b.seed, b.crs, b.dtype, b.stop_reason)
    assert_same_records(a, b)


def assert_same_records(a, b):
    np.testing.assert_array_equal(a.times, b.times)
    np.testing.assert_array_equal(a.steps, b.steps)
    for one, two in zip(a.networks, b.networks, strict=True):
        np.testing.assert_array_equal(one.polylines()[0], two.polylines()[0])
        np.testing.assert_array_equal(one.channel_depth, two.channel_depth)
    assert len(a.cutoffs) == len(b.cutoffs) > 0
    for one, two in zip(a.cutoffs, b.cutoffs, strict=True):
        assert (one.time, one.channel, one.width) == (two.time, two.channel, two.width)
        np.testing.assert_array_equal(one.xy, two.xy)


def test_records_are_in_order_of_time(history):
    assert history.times[0] == 0.0 and (np.diff(history.times) > 0).all()
    assert history.steps.tolist() == list(range(0, 501, 25))
    assert len(history) == len(history.networks) == 21
    assert history.networks[-1].crs == "EPSG:32620"
    assert [n.point_count for n in history.networks[2:5]] == [history.network(k).point_count for k in (2, 3, 4)]
    assert [history.record(k).events_before for k in (0, -1)] == [0, len(history.events)]


def test_a_file_gives_everything_back(history, tmp_path):
    history.save(tmp_path / "run.npz")
    assert_same(History.load(tmp_path / "run.npz"), history)


def test_a_folder_gives_everything_back(history, tmp_path):
    history.save(tmp_path / "saved")
    assert_same(History.load(tmp_path / "saved"), history)


def test_a_streamed_run_is_the_run_in_memory(history, tmp_path, monkeypatch, device):
    monkeypatch.setattr("warpriver.history.SEGMENT_BYTES", 20_000)
    streamed = run(store=tmp_path / "run", device=device)
    assert len(list((tmp_path / "run").glob("segment_*.npz"))) > 3
    assert not any(isinstance(r, tuple) is False for r in streamed._records), "records on disk are not kept in memory"
    assert_same(streamed, history)
    assert_same(History.load(tmp_path / "run"), history)
    assert not list((tmp_path / "run").glob("*.tmp"))


@pytest.mark.parametrize("moment", ["in the segment", "before the index", "in the index"])
def test_a_killed_run_is_readable_up_to_its_last_segment(history, tmp_path, monkeypatch, moment, device):
    monkeypatch.setattr("warpriver.history.SEGMENT_BYTES", 20_000)
    folder = tmp_path / "run"
    run(store=folder, device=device)
    last, index = sorted(folder.glob("segment_*.npz"))[-1], folder / "segments.jsonl"
    lines = index.read_text().splitlines(keepends=True)
    if moment == "in the segment":  # a part of it is there under another name
        last.rename(last.with_name(last.name + ".tmp"))
    cut = lines[-1][:40] if moment == "in the index" else ""
    index.write_text("".join(lines[:-1]) + cut)
    part = History.load(folder)
    assert 0 < len(part) < len(history)
    np.testing.assert_array_equal(part.times, history.times[: len(part)])
    # Going on from there comes to the same as the run that was not killed.
    rest = Simulation.resume(folder, device=device).run(steps=500 - int(part.steps[-1]), record_every=25)
    assert_same(rest, history)
    assert_same(History.load(folder), history)


def test_a_full_disk_stops_the_run_with_a_reason_and_loses_nothing(tmp_path):
    # A limit on file sizes makes the system refuse to write on, as a full disk does.
    script = textwrap.dedent(f"""
        import resource, signal
        import numpy as np
        import warpriver.history
        from warpriver import RiverNetwork, Simulation, generate
        from warpriver.history import History, StopReason
        warpriver.history.SEGMENT_BYTES = 20_000
        line = generate.noisy_line(12_000.0, 50.0, 50.0, 5)
        sim = Simulation(RiverNetwork.from_polylines([line], width=50.0))
        sim.run(steps=60, record_every=5, store={str(tmp_path / "run")!r})
        stored = len(History.load({str(tmp_path / "run")!r}))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
        history = sim.run(steps=1000, record_every=5)
        assert history.stop_reason is StopReason.STORE_FAILED, history.stop_reason
        assert "make room" in history.stop_reason.advice
        assert sim.step_count < 1060
        assert len(history) > stored and history.networks[-1].point_count > 0
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        readable = History.load({str(tmp_path / "run")!r})
        assert len(readable) >= stored
        history.save({str(tmp_path / "rescued.npz")!r})
        assert len(History.load({str(tmp_path / "rescued.npz")!r})) == len(history)
        print("fine")
    """)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip().endswith("fine"), done.stderr
    assert not list((tmp_path / "run").glob("*.tmp"))


def test_a_folder_that_holds_something_is_not_written_into(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(FileExistsError, match="not empty"):
        run(steps=5, store=tmp_path, device="cpu")
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_folder_that_cannot_be_made_is_an_error_before_the_run(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        run(steps=5, store=tmp_path / "file" / "run", device="cpu")


def test_what_is_not_a_run_is_refused(tmp_path, history):
    with pytest.raises(FileNotFoundError, match="no run at"):
        History.load(tmp_path / "nothing")
    with pytest.raises(ValueError, match=r"has no run\.json"):
        History.load(tmp_path)
    np.savez(tmp_path / "other.npz", a=np.ones(3))
    with pytest.raises(ValueError, match="not a warpriver run"):
        History.load(tmp_path / "other.npz")
    history.save(tmp_path / "cut.npz")
    whole = (tmp_path / "cut.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="damaged"):
        History.load(tmp_path / "cut.npz")
    with pytest.raises(TypeError, match="params is None; give MeanderParams or PathMeander"):
        History(None)


@pytest.mark.parametrize("old", ["warpriver-run-1", "warpriver-run-99"])
def test_a_run_of_another_format_is_refused(tmp_path, history, old):
    history.save(tmp_path / "saved")
    header = json.loads((tmp_path / "saved" / "run.json").read_text())
    assert header["format"] == "warpriver-run-3"
    del header["checksum"]  # the first format had none
    (tmp_path / "saved" / "run.json").write_text(json.dumps({**header, "format": old}))
    with pytest.raises(
        ValueError, match=rf"run\.json is a run of the format '{old}'; this version reads 'warpriver-run-3'"
    ):
        History.load(tmp_path / "saved")


def test_any_changed_bit_of_the_header_is_noticed(tmp_path):
    history = run(steps=1, store=tmp_path / "run", device="cpu")
    path = tmp_path / "run" / "run.json"
    good = path.read_bytes()
    told = (history.params, history.seed, history.origin.tolist(), history.crs, history.dtype, history.stop_reason)
    noticed = 0
    # Each byte of it in one bit or two, and all eight bits in turn.
    for bit in range(0, 8 * len(good), 7):
        changed = bytearray(good)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            found = History.load(tmp_path / "run")
        except ValueError as error:
            assert "run.json" in str(error)
            noticed += 1
        else:  # white space
            assert (found.params, found.seed, found.origin.tolist(), found.crs, found.dtype, found.stop_reason) == told
    assert noticed > len(good) // 4


# ---- segments and their index


@pytest.fixture
def stored(tmp_path, monkeypatch, device):
    """A run of several segments, with the number of records in each."""
    monkeypatch.setattr("warpriver.history.SEGMENT_BYTES", 20_000)
    run(store=tmp_path / "run", device=device)
    lines = (tmp_path / "run" / "segments.jsonl").read_text().splitlines()
    counts = [len(json.loads(line)["steps"]) for line in lines]
    assert len(counts) > 3
    return tmp_path / "run", counts


def test_reopening_a_folder_reads_no_segment(stored, history, monkeypatch):
    folder, counts = stored
    read = []
    load = np.load

    def noted(path, **options):
        read.append(path.name)
        return load(path, **options)

    monkeypatch.setattr(np, "load", noted)
    again = History.load(folder)
    np.testing.assert_array_equal(again.times, history.times)
    assert len(again) == sum(counts) and not read
    assert again.record(-1).step == 500 and read == [f"segment_{len(counts) - 1:06d}.npz"]
    assert again.record(0).step == 0 and read[1:] == ["segment_000000.npz"]
    assert again.cutoffs == history.cutoffs and len(read) <= len(counts) + 2


@pytest.mark.parametrize("number", [0, 1, -1])
def test_a_segment_that_is_missing_is_told_at_once(stored, history, number):
    folder, counts = stored
    number %= len(counts)
    name = f"segment_{number:06d}.npz"
    (folder / name).unlink()
    with pytest.raises(ValueError, match=rf"{name} is missing; put it back from a copy .* salvage=True"):
        History.load(folder)
    with pytest.raises(ValueError, match="is missing"):
        Simulation.resume(folder)
    assert not (folder / name).exists(), "nothing was written"
    with pytest.warns(UserWarning, match=rf"{number} segments were read; then: .*{name}"):
        saved = History.load(folder, salvage=True)
    assert len(saved) == sum(counts[:number]) and saved.path is None
    np.testing.assert_array_equal(saved.times, history.times[: len(saved)])
    assert saved.cutoffs == history.cutoffs[: len(saved.cutoffs)]


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("damage", ["cut", "bit", "other"])
def test_a_damaged_segment_is_told_when_it_is_read(stored, history, damage, last):
    folder, counts = stored
    number = len(counts) - 1 if last else 1
    name, before = f"segment_{number:06d}.npz", sum(counts[:number])
    data = bytearray((folder / name).read_bytes())
    if damage == "cut":
        del data[-100:]
    elif damage == "bit":
        data[len(data) // 2] ^= 4
    else:  # as long as it was, but of something else
        data = (folder / "segment_000000.npz").read_bytes().ljust(len(data), b"\0")[: len(data)]
    (folder / name).write_bytes(data)
    with pytest.raises(ValueError, match=rf"{name} is damaged: it.* put it back from a copy"):
        again = History.load(folder)
        np.testing.assert_array_equal(again.record(0).point_xy, history.record(0).point_xy)
        again.record(before)
    if damage == "cut" or last:  # what a run goes on from
        with pytest.raises(ValueError, match=f"{name} is damaged"):
            Simulation.resume(folder)
    if damage != "other":
        with pytest.warns(UserWarning, match=f"{number} segments were read"):
            assert len(History.load(folder, salvage=True)) == before


def test_a_damaged_index_is_told_at_once(stored, history):
    folder, _ = stored
    index = folder / "segments.jsonl"
    lines = index.read_text().splitlines(keepends=True)
    for changed, words in (
        (
            [lines[0].replace('"steps": [0', '"steps": [1'), *lines[1:]],
            r"segments.jsonl, line 1, is damaged: its checksum",
        ),
        ([lines[0][:50] + "\n", *lines[1:]], "line 1, is damaged: it is cut or changed"),
        ([lines[1], *lines[1:]], "line 1, is damaged: it names segment_000001.npz where segment_000000.npz"),
        (lines[:2], r"segments.jsonl lists 2 segments, but segment_000003.npz is there as well"),
        ([], "lists 0 segments"),
    ):
        index.write_text("".join(changed))
        with pytest.raises(ValueError, match=words):
            History.load(folder)
    index.unlink()
    with pytest.raises(ValueError, match="lists 0 segments"):
        History.load(folder)
    with pytest.warns(UserWarning, match="segments were read"):
        assert_same_records(History.load(folder, salvage=True), history)


def test_an_index_that_cannot_grow_stays_as_it_was(stored):
    folder, counts = stored
    again = History.load(folder)
    before = (folder / "segments.jsonl").read_bytes()
    grown = SegmentIndex.load(folder / "segments.jsonl")
    grown.path = folder / "gone" / "segments.jsonl"
    with pytest.raises(OSError, match="cannot write"):
        grown.append(grown.segments[-1])
    assert (folder / "segments.jsonl").read_bytes() == before and len(grown.segments) == len(counts)
    again.append(again.record(-1))
    again.flush()
    assert len(History.load(folder)) == sum(counts) + 1


def test_events_that_a_resumed_run_has_not_met_yet_do_not_count(tmp_path, device):
    """A run was killed after more events had been stored than its last record knows of."""
    sim = Simulation(network(), plain_params(friction=0.012), device=device)
    sim.run(steps=300, record_every=100, store=tmp_path / "run")
    known = len(sim.history.events)
    while len(sim.history.events) < known + 3:
        sim.step()
    sim.history.flush()
    whole = Simulation(network(), plain_params(friction=0.012), device=device).run(steps=450, record_every=150)
    rest = Simulation.resume(tmp_path / "run", device=device)
    assert len(rest.history.events) == known
    rest.run(steps=10)
    found = History.load(tmp_path / "run")
    assert all(event.time <= found.times[-1] for event in found.events)
    rest.run(steps=140)
    for found in (rest.history, History.load(tmp_path / "run")):
        assert list(found.events) == list(whole.events) and len(whole.events) > known


def test_records_of_one_run_have_one_form(history):
    record, other = history.record(0), History(plain_params())
    other.append(record)
    for changed in (
        {"channels": record.channels.replace(extra={"rock": ["clay"]})},
        {"resume": {}},
        {"point_section": record.point_xy},
        {"point_xy": record.point_xy.astype(np.float32)},
    ):
        with pytest.raises(ValueError, match="all records of a run have one form"):
            other.append(dataclasses.replace(record, **changed))
    assert len(other) == 1


def test_a_record_needs_nothing_to_go_on_with(history, tmp_path):
    """What the stepper stores beside the network is its own affair."""
    bare = History(plain_params(), origin=history.origin)
    for k in range(3):
        bare.append(dataclasses.replace(history.record(k), resume={}))
    bare.save(tmp_path / "run.npz")
    again = History.load(tmp_path / "run.npz")
    assert [again.record(k).resume for k in range(3)] == [{}] * 3
    with pytest.raises(ValueError, match="channel_spacing is missing or damaged; resume from a copy"):
        Simulation.resume(again)


@pytest.mark.parametrize(
    ("name", "change"),
    [("channel_spacing", 0.0), ("channel_fixed", -1.0), ("channel_max_speed", np.nan), ("channel_fixed", None)],
)
def test_a_record_that_makes_no_sense_is_not_gone_on_from(history, name, change):
    record = history.record(-1)
    values = np.ones((1, 5)) if change is None else change * record.resume[name]
    other = History(plain_params(), origin=history.origin)
    other.append(dataclasses.replace(record, resume={**record.resume, name: values}))
    with pytest.raises(ValueError, match=f"record of step 500: {name} is missing or damaged"):
        Simulation.resume(other)


def test_a_record_costs_the_same_however_many_wait(tmp_path, monkeypatch, device):
    """Counting the bytes of all that waits, at every record, made a run of many records quadratic."""
    sized = []
    whole = Record.nbytes.fget
    monkeypatch.setattr(Record, "nbytes", property(lambda self: sized.append(1) or whole(self)))
    monkeypatch.setattr("warpriver.history.SEGMENT_SECONDS", 1e9)
    line = generate.noisy_line(2000.0, 40.0, 10.0, 7)
    sim = Simulation(RiverNetwork.from_polylines([line], width=50.0), plain_params(), device=device)
    history = sim.run(steps=200, record_every=1, store=tmp_path / "run")
    assert len(history) == 201 and len(sized) <= 200
    assert len(History.load(tmp_path / "run")) == 201


# ---- copies


def test_histories_are_pickled_and_copied(history, stored, device):
    for source in (history, History.load(stored[0])):
        for other in (pickle.loads(pickle.dumps(source)), copy.deepcopy(source)):
            assert_same(other, history)
            assert other.path is None and list(other.events) == list(history.events)
            for k in (0, -1):
                assert other.record(k).channels == history.record(k).channels
            other.append(other.record(-1))
            assert len(other) == len(source) + 1
    again = pickle.loads(pickle.dumps(Simulation.resume(stored[0], device=device).history))
    assert Simulation.resume(again, device=device).step_count == 500


def test_an_empty_history_cannot_be_resumed():
    with pytest.raises(ValueError, match="no record"):
        Simulation.resume(History(plain_params()))


def test_repr_and_reasons(history):
    assert repr(History(plain_params())) == "History(empty)"
    assert "21 records" in repr(history) and "completed" in repr(history)
    assert all(reason.advice for reason in StopReason)
