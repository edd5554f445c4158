"""What a run withstands: being killed, a full disk, a deleted folder, a second process, damaged bytes."""

import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

import warpriver as wr
from warpriver.cli import main
from warpriver.errors import MissingRecordError, RunLockedError, WarpriverError
from warpriver.history import Every, History, StopReason
from warpriver.history.journal import Journal
from warpriver.history.segments import sealed

LINE = wr.generate.noisy_line(4000.0, 50.0, 50.0, 5)
PARAMS = wr.MeanderParams(friction=0.012)


def river():
    return wr.Simulation(wr.RiverNetwork.from_polylines([LINE], width=50.0), PARAMS, threads=1)


@pytest.fixture
def many_segments(monkeypatch):
    """A segment a record."""
    monkeypatch.setattr("warpriver.history.SEGMENT_SECONDS", 0.0)


def files(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def assert_same(a, b):
    np.testing.assert_array_equal(a.steps, b.steps)
    for k in (0, len(a) // 2, -1):
        np.testing.assert_array_equal(a.record(k).point_xy, b.record(k).point_xy)
    assert list(a.events) == list(b.events)


def python(code, *arguments, **options):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        **options,
    )


# ---- killed

RUN = """
    import sys, warpriver as wr, warpriver.history
    warpriver.history.SEGMENT_SECONDS = 0.0
    line = wr.generate.noisy_line(4000.0, 50.0, 50.0, 5)
    network = wr.RiverNetwork.from_polylines([line], width=50.0)
    sim = wr.Simulation(network, wr.MeanderParams(friction=0.012), threads=1)
    sim.step(0 + 1)
    sim = wr.Simulation(network, wr.MeanderParams(friction=0.012), threads=1)
    print("begin", flush=True)
    history = sim.run(steps=int(sys.argv[2]), record_every=10, store=sys.argv[1])
    print(history.stop_reason.name, sim.step_count)
"""


def started(folder, steps):
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(RUN), folder, str(steps)], stdout=subprocess.PIPE, text=True
    )
    for line in process.stdout:
        if line.strip() == "begin":
            return process
    raise AssertionError("it did not begin")


def test_runs_killed_at_any_moment_go_on_to_the_same_bits(tmp_path):
    whole = river().run(steps=400, record_every=10)
    random, reached = np.random.default_rng(1), []
    for k in range(4):
        folder = tmp_path / f"run{k}"
        process = started(folder, 100_000)
        while k > 0 and not (folder / f"segment_{3 * k:06d}.npz").exists():
            time.sleep(0.001)
        time.sleep(0.02 * random.random())
        process.kill()
        process.wait()
        try:
            history = History.load(folder)
        except (FileNotFoundError, ValueError) as error:
            assert "no run" in str(error) or "before its first record" in str(error)
            continue
        if len(history) == 0:
            continue
        reached.append(int(history.steps[-1]))
        with pytest.warns(UserWarning, match="ended without closing the run"):
            sim = wr.Simulation.resume(folder, threads=1)
            sim.run(steps=max(0, 400 - sim.step_count), record_every=10)
        again = History.load(folder)
        if reached[-1] <= 400:
            assert_same(again, whole)
        else:
            np.testing.assert_array_equal(again.record(40).point_xy, whole.record(40).point_xy)
        assert {path.suffix for path in folder.iterdir()} == {".npz", ".json", ".jsonl"}, "nothing else is left"
    assert max(reached) > 0


def test_a_killed_run_has_all_of_its_records(tmp_path):
    """Killed as the 8th record has been made, or in the middle of writing it; no segment is written in between."""
    whole = river().run(steps=100, record_every=10)
    for name, cut in (("whole", 0), ("torn", 100)):
        folder = tmp_path / name
        script = RUN.replace("SEGMENT_SECONDS = 0.0", "SEGMENT_SECONDS = 1e9").replace(
            "history = sim.run",
            """import os, signal
    append = wr.History.append
    def killed(self, record):
        append(self, record)
        if len(self) == 8:
            os.kill(os.getpid(), signal.SIGKILL)
    wr.History.append = killed
    history = sim.run""",
        )
        subprocess.run([sys.executable, "-c", textwrap.dedent(script), folder, "100"], stdout=subprocess.DEVNULL)
        journal = folder / "journal.bin"
        os.truncate(journal, journal.stat().st_size - cut)
        history = History.load(folder)
        assert len(history) == 8 - (cut > 0)
        if cut:
            assert len(History.load(folder, salvage=True)) == 7
        with pytest.warns(UserWarning, match="ended without closing the run"):
            sim = wr.Simulation.resume(folder, threads=1)
            sim.run(steps=100 - sim.step_count, record_every=10)
        assert_same(History.load(folder), whole)
        assert not journal.exists()


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_run_at_a_step_with_its_state_stored(tmp_path, kind):
    process = started(tmp_path / "run", 10_000_000)
    time.sleep(0.3)
    process.send_signal(kind)
    out, _ = process.communicate(timeout=60)
    reason, steps = out.split()
    assert process.returncode == 0 and reason == "INTERRUPTED"
    history = History.load(tmp_path / "run")
    assert history.steps[-1] == int(steps) > 0 and history.stop_reason is StopReason.INTERRUPTED
    whole = river().run(steps=int(steps), record_every=int(steps))
    np.testing.assert_array_equal(history.record(-1).point_xy, whole.record(-1).point_xy)


def test_handlers_of_signals_are_given_back():
    before = {kind: signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)}
    seen = []

    def look(sim):
        seen.append([signal.getsignal(kind) for kind in before])
        if sim.step_count == 2:
            os.kill(os.getpid(), signal.SIGTERM)

    history = river().run(steps=9, callbacks=[look])
    assert history.stop_reason is StopReason.INTERRUPTED and history.steps[-1] == 2
    assert seen[0] != list(before.values())
    assert {kind: signal.getsignal(kind) for kind in before} == before


def test_a_callback_that_fails_loses_no_record(tmp_path):
    def fail(sim):
        if sim.step_count == 7:
            raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        river().run(steps=20, record_every=2, store=tmp_path / "run", callbacks=[fail])
    assert History.load(tmp_path / "run").steps.tolist() == [0, 2, 4, 6]


@pytest.mark.parametrize("left", ["nothing", "run.json", "segments.jsonl", "all"])
def test_a_run_stopped_before_its_first_record_is_told(tmp_path, left, capsys):
    folder = tmp_path / "run"
    river().run(steps=1, store=folder)
    index = (folder / "segments.jsonl").read_bytes()
    for path in folder.iterdir():
        if path.suffix == ".npz" or left not in ("all", path.name):
            path.unlink()
    for path in folder.glob("segments.jsonl"):
        path.write_bytes(b"")
    assert index
    if left in ("run.json", "all"):
        history = History.load(folder)
        assert len(history) == 0
        for call in (lambda: history.record(-1), lambda: history.networks[0], lambda: wr.viz.draw_belt(history)):
            with pytest.raises(ValueError, match=r"no record"):
                call()
        with pytest.raises(ValueError, match=r"run holds no record: .* before the first one; run it again"):
            wr.Simulation.resume(folder)
    else:
        with pytest.raises(ValueError, match=r"is not a run: it has no run\.json"):
            History.load(folder)
    for command in (["info", folder], ["render", folder, "-o", tmp_path / "a.png", "--until", "5"]):
        assert main([str(word) for word in command]) == 2
        said = capsys.readouterr().err
        assert "Traceback" not in said and ("no record" in said or "run" in said)


def test_records_are_numbered_as_in_a_list():
    history = river().run(steps=4, record_every=2)
    assert [history.record(k).step for k in (0, np.int64(1), -1)] == [0, 2, 4]
    assert len(list(history.networks)) == 3
    for index in (3, -4):
        with pytest.raises(MissingRecordError, match=f"there is no record {index}; the history has 3, from 0 to 2"):
            history.record(index)
        with pytest.raises(IndexError):
            history.networks[index]
    for index in (0.5, "0", None, np.nan, True):
        with pytest.raises(ValueError, match="index of a record is"):
            history.record(index)


# ---- one process at a time


def test_a_run_is_written_by_one_simulation_at_a_time(tmp_path):
    folder = tmp_path / "run"
    river().run(steps=20, record_every=10, store=folder)
    first, second = (wr.Simulation.resume(folder, threads=1) for _ in range(2))

    def resume_too(sim):
        if sim.step_count == 30:
            before = files(folder)
            with pytest.raises(RunLockedError, match=rf"is being written by process {os.getpid()} on .*; wait until"):
                second.run(steps=10)
            second.step(1)
            with pytest.raises(RunLockedError):
                second.history.flush() if second.history.events[:0] else second.run(steps=1)
            assert files(folder) == before and second.history.stop_reason is not StopReason.STORE_FAILED

    first.run(steps=20, record_every=10, callbacks=[resume_too])
    assert not (folder / "run.lock").exists()
    before = files(folder)
    with pytest.raises(ValueError, match="continued elsewhere since it was opened here; resume it again"):
        second.run(steps=10)
    assert files(folder) == before
    assert History.load(folder).steps.tolist() == [0, 10, 20, 30, 40]
    # In another folder the second may go its own way.
    second.run(steps=9, store=tmp_path / "other")
    assert History.load(tmp_path / "other").steps.tolist() == [0, 10, 20, 30]


def resumed(folder, queue):
    try:
        queue.put(wr.Simulation.resume(folder, threads=1).run(steps=5).stop_reason.name)
    except Exception as error:
        queue.put(f"{type(error).__name__}: {error}")


def test_a_run_is_written_by_one_process_at_a_time(tmp_path):
    context = multiprocessing.get_context("spawn")
    queue, folder = context.Queue(), tmp_path / "run"
    said = []

    def other(sim):
        if sim.step_count == 5:
            process = context.Process(target=resumed, args=(folder, queue))
            process.start()
            said.append(queue.get(timeout=60))
            process.join()

    river().run(steps=10, record_every=1, store=folder, callbacks=[other])
    assert said[0].startswith("RunLockedError: ") and f"process {os.getpid()}" in said[0]
    assert History.load(folder).steps.tolist() == list(range(11))


def test_the_lock_of_a_dead_process_is_taken_over_with_a_word(tmp_path, recwarn):
    folder = tmp_path / "run"
    river().run(steps=2, store=folder)
    (folder / "run.lock").write_text(json.dumps({"process": 4711, "host": "elsewhere"}))
    (folder / ".writing-abc").mkdir()
    (folder / ".writing-abc" / "segment_000007.npz").write_bytes(b"half")
    wr.Simulation.resume(folder, threads=1).run(steps=1)
    assert any("process 4711 on elsewhere ended without closing the run" in str(w.message) for w in recwarn)
    assert sorted(p.name for p in folder.iterdir() if p.suffix != ".npz") == ["run.json", "segments.jsonl"]
    recwarn.clear()
    wr.Simulation.resume(folder, threads=1).run(steps=1)
    assert not [w for w in recwarn if "closing" in str(w.message)]


def test_two_runs_do_not_begin_in_one_folder(tmp_path):
    first, second = river(), river()
    refused = []

    def begin(sim):
        with pytest.raises(OSError) as told:
            second.run(steps=1, store=tmp_path / "run")
        refused.append(str(told.value))

    first.run(steps=2, store=tmp_path / "run", callbacks=[begin])
    assert all("is being written by" in text for text in refused) and len(refused) == 2
    assert second.history.path is None and second.run(steps=1).steps.tolist() == [0, 1]


# ---- no room


class Disk:
    """Lets archives grow to so many bytes only, as a disk does that is nearly full."""

    def __init__(self, monkeypatch):
        self.room = 10**9
        savez = np.savez

        def limited(file, **arrays):
            savez(file, **arrays)
            if file.tell() > self.room:
                file.truncate(self.room)
                raise OSError(28, "No space left on device")
            self.room -= file.tell()

        def cleared(journal):
            if journal.path.exists():
                self.room += journal.path.stat().st_size
            clear(journal)

        clear = Journal.clear
        monkeypatch.setattr(np, "savez", limited)
        monkeypatch.setattr(Journal, "clear", cleared)


def test_a_full_disk_loses_only_what_does_not_fit(tmp_path, monkeypatch):
    monkeypatch.setattr("warpriver.history.SEGMENT_SECONDS", 1e9)
    whole = river().run(steps=200, record_every=10)
    disk, sim = Disk(monkeypatch), river()
    sim.run(steps=10, record_every=10, store=tmp_path / "run")
    whole.save(tmp_path / "whole.npz")
    disk.room = int(0.6 * (tmp_path / "whole.npz").stat().st_size)
    with pytest.warns(UserWarning, match=r"cannot write .*segment_.*: No space left on device"):
        history = sim.run(steps=190, record_every=10)
    assert history.stop_reason is StopReason.STORE_FAILED and len(history) == 21
    stored = History.load(tmp_path / "run")
    assert len(stored) == history.stored_count and 8 <= len(stored) < 21
    np.testing.assert_array_equal(stored.steps, whole.steps[: len(stored)])
    assert list(stored.events) == list(whole.events[: stored.record(-1).events_before])
    assert not [path for path in (tmp_path / "run").iterdir() if path.name.startswith(".")]
    # Both ways that the advice names: elsewhere, and on with room made.
    disk.room = 10**9
    history.save(tmp_path / "saved.npz")
    assert_same(History.load(tmp_path / "saved.npz"), whole)
    sim.run(steps=0)
    assert_same(History.load(tmp_path / "run"), whole)
    assert history.stored_count == 21 and history.stop_reason is StopReason.COMPLETED


@pytest.mark.parametrize("room", [0, 3])
def test_a_run_that_cannot_begin_leaves_nothing(tmp_path, monkeypatch, room):
    disk, sim = Disk(monkeypatch), river()
    disk.room = room
    with pytest.raises(OSError, match="No space left"):
        sim.run(steps=3, store=tmp_path / "a" / "b" / "run")
    assert not list(tmp_path.iterdir()) and sim.history.path is None and sim.step_count == 0
    history = river().run(steps=30, record_every=3)
    with pytest.raises(OSError, match="No space left"):
        history.save(tmp_path / "a" / "run")
    with pytest.raises(OSError, match="No space left"):
        history.save(tmp_path / "run.npz")
    assert not list(tmp_path.iterdir())
    disk.room = 10**9
    sim.run(steps=3, store=tmp_path / "run")
    assert len(History.load(tmp_path / "run")) == 2


def test_a_save_that_fails_half_way_leaves_nothing(tmp_path, monkeypatch, many_segments):
    history, disk = river().run(steps=30, record_every=3), Disk(monkeypatch)
    disk.room = 20_000
    with pytest.raises(OSError, match="No space left"):
        history.save(tmp_path / "run")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_that_is_deleted_during_a_run_costs_what_was_in_it_alone(tmp_path, many_segments, resume):
    whole = river().run(steps=60, record_every=10)
    folder = tmp_path / "run"
    sim = river()
    if resume:
        sim.run(steps=20, record_every=10, store=folder)
        sim = wr.Simulation.resume(folder, threads=1)
    remove = (Every(steps=30), lambda sim: shutil.rmtree(folder) if sim.step_count == 30 else None)
    with pytest.warns(UserWarning, match=r"is gone, and with it 4 of 5 records; the others are in memory"):
        history = sim.run(steps=60 - sim.step_count, record_every=10, store=folder, callbacks=[remove])
    assert history.stop_reason is StopReason.STORE_FAILED and history.path is None
    assert history.steps.tolist() == [40] and not folder.exists()
    np.testing.assert_array_equal(history.record(0).point_xy, whole.record(4).point_xy)
    history.save(tmp_path / "saved")
    assert History.load(tmp_path / "saved").steps.tolist() == [40]
    sim.run(steps=20, record_every=10, store=tmp_path / "again")
    again = History.load(tmp_path / "again")
    assert again.steps.tolist() == [40, 50, 60]
    np.testing.assert_array_equal(again.record(-1).point_xy, whole.record(-1).point_xy)


def test_a_record_is_on_the_disk_before_it_counts(tmp_path, monkeypatch):
    """The order of what the system is told: the segment, its place, and only then the line of the index."""
    told, fsync, replace = [], os.fsync, os.replace

    def noted_fsync(file):
        told.append(("sync", Path(os.readlink(f"/proc/self/fd/{file}")).name))
        fsync(file)

    def noted_replace(source, target):
        told.append(("move", Path(target).name))
        replace(source, target)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(os, "replace", noted_replace)
    river().run(steps=1, record_every=1, store=tmp_path / "run")
    first = told.index(("sync", "segment_000000.npz"))
    assert told[first : first + 4] == [
        ("sync", "segment_000000.npz"),
        ("move", "segment_000000.npz"),
        ("sync", "run"),
        ("sync", "segments.jsonl"),
    ]


# ---- damaged bytes


def told_of(folder):
    history = History.load(folder)
    records = [history.record(k) for k in range(len(history))]
    return (
        repr(history.params), history.seed, history.origin.tolist(), history.crs, history.dtype, history.stop_reason,
        history.steps.tolist(), history.times.tolist(), list(map(repr, history.events)),
        [(r.point_xy.tobytes(), r.channel_start.tobytes(), r.node_xy.tobytes(), r.events_before) for r in records],
        [{name: array.tobytes() for name, array in r.resume.items()} for r in records],
    )  # fmt: skip


@pytest.mark.parametrize("name", ["run.json", "segments.jsonl", "segment_000000.npz", "segment_000002.npz", "run.npz"])
def test_no_flipped_bit_changes_a_run_unnoticed(tmp_path, many_segments, name):
    folder = tmp_path / "run"
    history = wr.Simulation(wr.RiverNetwork.from_polylines([LINE[:12]], width=50.0), PARAMS, threads=1).run(
        steps=2, record_every=1, store=folder
    )
    path = folder / name
    if name == "run.npz":
        history.save(path := tmp_path / name)
        folder = path
    good, data = told_of(folder), path.read_bytes()
    bits = np.arange(8 * len(data))
    if name.endswith(".npz"):  # some of the directory, and some others
        bits = np.concatenate([bits[-8 * 300 :: 11], np.random.default_rng(0).choice(bits, 100, replace=False)])
    else:  # the last character, and each other one in a bit or two
        bits = np.concatenate([bits[:-8:7], bits[-8:]])
    noticed = 0
    for bit in bits.tolist():
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            found = told_of(folder)
        except ValueError as error:
            assert isinstance(error, WarpriverError) and path.name in str(error)
            noticed += 1
        else:
            assert found == good, f"bit {bit} of {name}"
    assert noticed > 0.5 * len(bits)


MUTATED = """
    import signal, sys, warnings
    warnings.simplefilter("ignore")
    import warpriver as wr
    for folder in sys.argv[1:]:
        signal.alarm(20)  # kills
        try:
            history = wr.History.load(folder)
            [len(network.polylines()) for network in history.networks], list(history.events)
            said = wr.Simulation.resume(folder, threads=1).run(steps=2).stop_reason.name
        except (wr.WarpriverError, ValueError) as error:
            said = type(error).__name__ if isinstance(error, wr.WarpriverError) else "OBSCURE " + repr(error)
        print(folder.rpartition("/")[2], said, flush=True)
"""


def mutations(array):
    """Changes of an array by which a run cannot go on, whatever it holds."""
    yield "absent", None
    yield "empty", array[:0]
    yield "cut", array[:-1]
    if array.dtype.kind == "f":
        yield "zero", array * 0.0
        yield "NaN", array * np.nan
        yield "huge", (array + 1.0) * 1e300
        yield "tiny", array * 1e-9
        yield "text", array.astype(str)
    else:
        yield "negative", -array - 1
        yield "huge", (array + 1) * 10**8
        yield "backwards", array[::-1]


def test_no_record_that_makes_no_sense_ends_the_process(tmp_path):
    """Records whose checksums are right: written by a faulty program."""
    lines = [[[0, 0], [500, 20], [1000, 0]], [[0, 800], [500, 400], [1000, 0]], [[1000, 0], [1500, 30], [2500, 0]]]
    widths = [[40.0, 45.0, 50.0], [30.0, 30.0, 30.0], [60.0, 60.0, 70.0]]
    network = wr.RiverNetwork.from_polylines(np.array(lines, float), width=widths)
    wr.Simulation(network, wr.MeanderParams(spacing=25.0)).run(steps=4, record_every=4, store=tmp_path / "run")
    name = max(path.name for path in (tmp_path / "run").glob("segment_*"))
    *before, line = (tmp_path / "run" / "segments.jsonl").read_text().splitlines(keepends=True)
    arrays, listed = dict(np.load(tmp_path / "run" / name)), json.loads(line)
    del listed["checksum"]
    folders = []
    for key in ("point/xy", "point/section", "channel/start", *(k for k in arrays if k.startswith("resume/"))):
        for what, array in mutations(arrays[key]):
            changed = {k: v for k, v in {**arrays, key: array}.items() if v is not None}
            folder = tmp_path / f"{key.replace('/', '+')}={what}"
            shutil.copytree(tmp_path / "run", folder)
            np.savez(folder / name, **changed)
            data = (folder / name).read_bytes()
            last = sealed({**listed, "bytes": len(data), "crc32": zlib.crc32(data)})
            (folder / "segments.jsonl").write_text("".join(before) + last + "\n")
            folders.append(folder)
    done = python(MUTATED, *folders)
    said = dict(line.rsplit(" ", 1) for line in done.stdout.splitlines() if "=" in line)
    assert done.returncode == 0 and len(said) == len(folders), (done.returncode, done.stdout[-300:], done.stderr[-300:])
    fine = {name: words for name, words in said.items() if words not in ("InputError", "SavedError", "DamageError")}
    # Without widths of points those of the channels hold; labels of nodes are not looked up; a max speed may be 0; and
    # one number is the same backwards.
    assert set(fine) <= {"point+section=absent", "resume+channel_nodes=huge", "resume+channel_max_speed=zero",
                         "resume+channel_nodes=backwards", "resume+channel_max_speed=tiny",
                         "resume+next_identity=backwards"} | {
        f"resume+channel_max_speed={what}" for what in ("huge",)}, fine  # fmt: skip
    assert set(fine.values()) <= {"COMPLETED"}


def test_a_lost_end_of_line_loses_no_record(tmp_path, many_segments):
    folder = tmp_path / "run"
    whole = river().run(steps=40, record_every=10, store=folder)
    index = folder / "segments.jsonl"
    index.write_bytes(index.read_bytes()[:-1])
    assert_same(History.load(folder), whole)
    wr.Simulation.resume(folder, threads=1).run(steps=10)
    assert History.load(folder).steps.tolist() == [0, 10, 20, 30, 40, 50]
