import json
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from warpriver import History, MeanderParams, RiverNetwork, Simulation, StopReason, generate


def run(steps=500, *, device, **options):
    line = generate.noisy_line(12_000.0, 50.0, 50.0, 5)
    network = RiverNetwork.from_polylines([line + [5e5, -1.6e6]], width=50.0, crs="EPSG:32620")
    sim = Simulation(network, MeanderParams(friction=0.012), seed=9, device=device)
    return sim.run(steps=steps, record_every=25, **options)


@pytest.fixture(scope="module")
def history(device):
    return run(device=device)


def assert_same(a, b):
    assert (a.params, a.seed, a.crs, a.dtype, a.stop_reason) == (b.params, b.seed, b.crs, b.dtype, b.stop_reason)
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
    assert [history.record(k).cutoffs_before for k in (0, -1)] == [0, len(history.cutoffs)]


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


def test_a_killed_run_is_readable_up_to_its_last_segment(history, tmp_path, monkeypatch, device):
    monkeypatch.setattr("warpriver.history.SEGMENT_BYTES", 20_000)
    run(store=tmp_path / "run", device=device)
    last = sorted((tmp_path / "run").glob("segment_*.npz"))[-1]
    # A kill in the middle of a write leaves a part under another name.
    last.rename(last.with_name(last.name + ".tmp"))
    part = History.load(tmp_path / "run")
    assert 0 < len(part) < len(history)
    np.testing.assert_array_equal(part.times, history.times[: len(part)])


def test_a_full_disk_stops_the_run_with_a_reason_and_loses_nothing(tmp_path):
    # A limit on file sizes makes the system refuse to write on, as a full disk does.
    script = textwrap.dedent(f"""
        import resource, signal
        import numpy as np
        import warpriver.history
        from warpriver import History, RiverNetwork, Simulation, StopReason, generate
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
    history.save(tmp_path / "saved")
    header = json.loads((tmp_path / "saved" / "run.json").read_text())
    (tmp_path / "saved" / "run.json").write_text(json.dumps({**header, "format": "warpriver-run-99"}))
    with pytest.raises(ValueError, match="this version reads"):
        History.load(tmp_path / "saved")


def test_an_empty_history_cannot_be_resumed():
    with pytest.raises(ValueError, match="no record"):
        Simulation.resume(History(MeanderParams()))


def test_repr_and_reasons(history):
    assert repr(History(MeanderParams())) == "History(empty)"
    assert "21 records" in repr(history) and "completed" in repr(history)
    assert all(reason.advice for reason in StopReason)
