"""Two result files of benchmarks side by side."""

import copy
import json
import math

import pytest
from compare import compare, main


def result(speed=10e9, **changes):
    """A small result; ``changes`` go into its first row."""
    first = {
        "case": "a", "asked_points": 1000, "points": 1010, "ms_per_step": 2.0, "bytes_per_point": 150.0,
        "triad_ns_per_point": 0.5, "collisions": True,
    }  # fmt: skip
    return {
        "benchmark": "step",
        "machine": {"commit": "abc", "cores": 2},
        "baseline": {"copy_bytes_per_second": speed},
        "exponents": {"full": 1.0},
        "rows": [first | changes, {"case": "b", "asked_points": 1000, "ratio": 100.0, "seconds": {"fill": 1.0}}],
    }


def by_name(changes):
    return {(c.row, c.figure): c for c in changes}


A, B = "rows / a / 1000", "rows / b / 1000"


def test_a_result_is_as_good_as_itself():
    changes = compare(result(), result())
    assert {(c.row, c.figure) for c in changes} == {
        (A, "ms_per_step"), (A, "bytes_per_point"), (B, "ratio"), (B, "seconds.fill")
    }  # fmt: skip
    assert all(c.worse == 1.0 for c in changes)


def test_times_count_by_what_the_memory_does_and_bytes_do_not():
    """Twice as fast a machine that takes as long does twice as badly."""
    changes = by_name(compare(result(10e9), result(20e9, points=1100)))
    assert changes[A, "ms_per_step"].worse == pytest.approx(2.0)
    assert changes[B, "seconds.fill"].worse == pytest.approx(2.0)
    assert changes[A, "bytes_per_point"].worse == changes[B, "ratio"].worse == 1.0
    changes = by_name(compare(result(10e9), result(20e9), normalise=False))
    assert changes[A, "ms_per_step"].worse == 1.0
    bare = result()
    del bare["baseline"]
    assert by_name(compare(bare, result(20e9)))[A, "ms_per_step"].worse == 1.0


def test_of_a_ratio_to_a_peer_more_is_better():
    faster = copy.deepcopy(result())
    faster["rows"][1]["ratio"] = 200.0
    assert by_name(compare(result(), faster))[B, "ratio"].worse == pytest.approx(0.5)


def test_events_a_second_fall_behind_a_faster_memory():
    old = {"benchmark": "erosion", "baseline": {"copy_bytes_per_second": 1e10}, "rows": [{"events_per_second": 50.0}]}
    new = {"benchmark": "erosion", "baseline": {"copy_bytes_per_second": 2e10}, "rows": [{"events_per_second": 50.0}]}
    (change,) = compare(old, new)
    assert change.worse == pytest.approx(2.0)
    (change,) = compare(old, new | {"rows": [{"events_per_second": 200.0}]})
    assert change.worse == pytest.approx(0.5)


def test_rows_that_are_gone_or_new():
    short = result()
    del short["rows"][1]
    gone = by_name(compare(result(), short))
    assert gone[B, "ratio"].worse == math.inf and gone[B, "ratio"].new is None
    new = by_name(compare(short, result()))
    assert new[B, "ratio"].worse is None
    spills = [{"benchmark": "x", "kernels": [{"name": "k", "spills": n}]} for n in (0, 3)]
    assert compare(spills[0], spills[1])[0].worse == math.inf
    assert compare(spills[0], spills[0])[0].worse == 1.0


def test_what_cannot_be_compared():
    with pytest.raises(ValueError, match="different benchmarks"):
        compare(result(), result() | {"benchmark": "network"})
    twice = result()
    twice["rows"].append(twice["rows"][0])
    with pytest.raises(ValueError, match="two rows are called"):
        compare(result(), twice)


@pytest.fixture
def files(tmp_path):
    for name, ms in (("old", 2.0), ("new", 2.6)):
        (tmp_path / f"{name}.json").write_text(json.dumps(result(ms_per_step=ms)))
    return str(tmp_path / "old.json"), str(tmp_path / "new.json")


def test_exit_codes_and_what_is_shown(files, capsys):
    old, new = files
    assert main([old, new]) == 0
    said = capsys.readouterr().out
    assert "1.3 worse" in said and "bytes_per_point" not in said and "10 GB/s" in said
    assert main([old, new, "--fail-above", "1.25"]) == 1
    assert main([old, new, "--fail-above", "1.4"]) == 0
    assert main([new, old, "--fail-above", "1.25"]) == 0  # better is no failure
    capsys.readouterr()
    assert main([old, old, "--all"]) == 0
    assert "bytes_per_point" in capsys.readouterr().out
    for bad in ([old, str(old) + ".none"], [old, new, "--fail-above", "0.9"]):
        with pytest.raises(SystemExit) as stop:
            main(bad)
        assert stop.value.code == 2
