"""What ``benchmarks/gpu.py`` does around its sections; the sections themselves run in CI, small, by ``--dry``."""

import ast
import json
import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from types import SimpleNamespace

import gpu
import gpu_proof
import gpu_report
import gpu_speed
import gpu_table
import numpy as np
import pytest
import warp as wp
from gpu_report import Report

from warpriver.engine import stages
from warpriver.engine import state as buffers

TESTS = Path(__file__).resolve().parents[1]


def sections(**seconds):
    return [gpu.Section(name, "nowhere", share) for name, share in seconds.items()]


def script(code, *arguments):
    """A process that runs Python code, which finds its arguments in ``sys.argv``."""
    return [sys.executable, "-c", "import json, os, subprocess, sys, time\n" + textwrap.dedent(code), *arguments]


def run(tmp_path, budget=60.0, **codes):
    """Run sections of that code, each told the path of its own JSON file; return their records by name."""

    def command(section, seconds):
        return script(codes[section.name], str(tmp_path / f"{section.name}.json"))

    chosen = sections(**dict.fromkeys(codes, 1.0))
    return {r["section"]: r for r in gpu.run_sections(chosen, command, tmp_path, budget)}


GOOD = """
    record = {"state": "done", "error": None, "failures": [], "facts": {"answer": 42}}
    open(sys.argv[1], "w").write(json.dumps(record))
"""


# ---- budget


def test_shares_make_up_the_budget_with_time_left_for_the_table():
    assert sum(section.seconds for section in gpu.SECTIONS) + gpu.LAST_SECONDS == gpu.BUDGET == 360.0
    assert gpu.deadlines(gpu.SECTIONS, gpu.BUDGET) == [20.0, 100.0, 170.0, 190.0, 220.0, 310.0, 345.0]


def test_a_few_sections_share_the_whole_budget():
    some = sections(a=10.0, b=35.0)
    assert gpu.deadlines(some, 60.0) == [10.0, 45.0]
    assert gpu.deadlines(some, 120.0) == [20.0, 90.0]


def test_what_a_section_saves_the_next_may_use(tmp_path):
    offered = []

    def command(section, seconds):
        offered.append(seconds)
        return script("pass")

    gpu.run_sections(sections(a=10.0, b=35.0), command, tmp_path, 60.0)
    assert offered[0] == pytest.approx(10.0, abs=0.1)
    assert 35.0 < offered[1] < 45.0


# ---- what is written


def test_a_file_is_whole_at_any_time(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    gpu_report.write_json(path, {"a": 1})
    with pytest.raises(TypeError):
        gpu_report.write_json(path, {"a": object()})
    assert gpu_report.read_json(path) == {"a": 1}
    seen = []
    move = os.replace
    monkeypatch.setattr(os, "replace", lambda a, b: (seen.append((Path(a).read_text(), path.read_text())), move(a, b)))
    gpu_report.write_beside(path, "new")
    assert seen == [("new", '{\n  "a": 1\n}\n')], "written beside, and moved when it is whole"
    assert path.read_text() == "new" and os.listdir(tmp_path) == ["a.json"]
    assert gpu_report.read_json(tmp_path / "missing.json") == {}


def test_a_report_can_be_read_after_each_addition(tmp_path):
    path = tmp_path / "a.json"

    def section(report):
        for k in range(2):
            report.add("rows", {"k": k})
            assert gpu_report.read_json(path)["facts"]["rows"] == [{"k": j} for j in range(k + 1)]
        report.tell(speed=3.0)
        assert gpu_report.read_json(path)["facts"]["speed"] == 3.0
        assert gpu_report.read_json(path)["state"] == "begun"

    assert Report(path).run(section) == "done"
    assert gpu_report.read_json(path)["state"] == "done"


def crash(report):
    report.tell(before=1)
    raise RuntimeError("two\nlines")


def part_of_it_crashes(report):
    report.attempt("first", lambda: crash(report))
    report.tell(after=2)


def skip(report):
    raise gpu_report.SkippedError("no tool")


@pytest.mark.parametrize(
    ("section", "state", "error", "failures", "facts"),
    [
        (crash, "failed", "RuntimeError: two lines", [], {"before": 1}),
        (part_of_it_crashes, "failed", None, ["first: RuntimeError: two lines"], {"before": 1, "after": 2}),
        (lambda report: report.fail("wrong"), "failed", None, ["wrong"], {}),
        (skip, "skipped", "no tool", [], {}),
    ],
)
def test_how_a_section_ends_is_told(tmp_path, section, state, error, failures, facts):
    assert Report(tmp_path / "a.json").run(section) == state
    record = gpu_report.read_json(tmp_path / "a.json")
    assert (record["state"], record["error"], record["failures"], record["facts"]) == (state, error, failures, facts)


# ---- sections as processes


def test_a_section_that_fails_is_recorded_and_the_rest_goes_on(tmp_path):
    fails = """
        record = {"state": "failed", "error": None, "failures": ["7 is not 8"], "facts": {}}
        open(sys.argv[1], "w").write(json.dumps(record))
        sys.exit(1)
    """
    raises = "raise KeyError('early')"
    dies = """
        open(sys.argv[1], "w").write(json.dumps({"state": "begun", "facts": {"rows": [1]}}))
        print("so far", flush=True)
        os.abort()
    """
    # Its record is good, and then the driver takes the process down.
    dies_late = GOOD + "    os.abort()"
    found = run(tmp_path, first=GOOD, fails=fails, raises=raises, dies=dies, late=dies_late, last=GOOD)
    assert {name: r["state"] for name, r in found.items()} == {
        "first": "done", "fails": "failed", "raises": "failed", "dies": "failed", "late": "failed", "last": "done",
    }  # fmt: skip
    assert found["fails"]["failures"] == ["7 is not 8"] and found["last"]["facts"] == {"answer": 42}
    assert "exit code 1" in found["raises"]["error"] and "KeyError" in (tmp_path / "raises.log").read_text()
    assert "exit code -6" in found["dies"]["error"] and found["dies"]["facts"] == {"rows": [1]}
    assert (tmp_path / "dies.log").read_text() == "so far\n"
    for name, record in found.items():
        assert json.loads((tmp_path / f"{name}.json").read_text()) == record
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert not summary["ok"] and [s["section"] for s in summary["sections"]] == list(found)
    assert [s["failures"] for s in summary["sections"]] == [0, 1, 0, 0, 0, 0]
    assert len((tmp_path / "table.txt").read_text().splitlines()) == len(found)


def is_alive(pid):
    """A process that has ended and waits for its parent to notice is not."""
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at /proc")
def test_a_section_that_overruns_is_ended_with_all_it_has_started(tmp_path):
    hangs = """
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(300)"])
        open(sys.argv[1], "w").write(json.dumps({"state": "begun", "facts": {"pid": child.pid}}))
        time.sleep(300)
    """
    begin = time.monotonic()
    found = run(tmp_path, budget=30.0, hangs=hangs, last=GOOD)  # 17 s are left for the table
    assert time.monotonic() - begin < 20.0
    assert found["hangs"]["state"] == "overran" and "not done after 2 s" in found["hangs"]["error"]
    assert found["last"]["state"] == "done"
    deadline = time.monotonic() + 5.0
    while is_alive(found["hangs"]["facts"]["pid"]) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_alive(found["hangs"]["facts"]["pid"])


def test_a_record_of_an_earlier_run_is_not_taken_for_this_one(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"state": "done", "facts": {"old": 1}}))
    found = run(tmp_path, a="sys.exit(0)")
    assert found["a"]["state"] == "failed" and found["a"]["facts"] == {}


@pytest.mark.parametrize(("code", "expected"), [(GOOD, 0), ("sys.exit(1)", 1)])
def test_the_exit_code_is_0_only_if_no_section_failed(tmp_path, monkeypatch, capsys, code, expected):
    """And only the sections asked for are run."""

    def children(options):
        return lambda section, seconds: script(
            code if section.name == "models" else GOOD, str(options.out / f"{section.name}.json")
        )

    monkeypatch.setattr(gpu, "children", children)
    monkeypatch.setattr(gpu.signal, "signal", lambda *_: None)
    arguments = ["--dry", "--out", str(tmp_path / "new" / "out"), "--sections", "models", "machine"]
    assert gpu.main(arguments) == expected
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert names == ["machine", "models"] * 2, "in their own order, as they go and in the table"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--device", "cuda:17"], "no device cuda:17 here"), (["--dry", "--budget", "0"], "more than 0")],
)
def test_bad_input_is_told_before_anything_is_done(tmp_path, capsys, arguments, words):
    with pytest.raises(SystemExit) as stopped:
        gpu.main([*arguments, "--out", str(tmp_path / "out")])
    assert stopped.value.code == 2 and words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_section_is_called_with_the_time_it_has(tmp_path):
    options = SimpleNamespace(out=tmp_path, device="cuda", dry=True)
    command = gpu.children(options)(gpu.SECTIONS[2], 12.3)
    assert command[:2] == [sys.executable, gpu.__file__]
    assert command[2:] == f"--out {tmp_path} --device cuda --section models --budget 12.3 --dry".split()


# ---- parts of the sections


def test_tests_are_counted():
    text = """<testsuites><testsuite>
        <testcase name="a[cuda:0]"/><testcase name="b"/>
        <testcase name="c"><skipped message="no"/></testcase>
        <testcase name="d"><failure message="1 is&#10;not 2">trace</failure></testcase>
        <testcase name="e"><error message="gone"/></testcase>
    </testsuite></testsuites>"""
    row = {"passed": 0, "failed": 0, "skipped": 0}
    assert gpu_proof.count_tests(text, row) == ["d: 1 is not 2", "e: gone"]
    assert row == {"passed": 2, "failed": 2, "skipped": 1}


def test_tests_of_a_process_that_was_not_done_are_counted_from_its_log():
    log = """
        tests/kernels/test_a.py::test_a[cuda:0-float64] PASSED   [ 33%]
        tests/kernels/test_a.py::test_b[cuda:0-float64] FAILED   [ 66%]
        tests/kernels/test_a.py::test_c SKIPPED (no reason)      [ 80%]
        tests/kernels/test_a.py::test_d[cuda:0-float64]

    """
    row = {"passed": 0, "failed": 0, "skipped": 0}
    assert gpu_proof.count_said(log, row) == "tests/kernels/test_a.py::test_d[cuda:0-float64]"
    assert row == {"passed": 1, "failed": 1, "skipped": 1}
    assert gpu_proof.count_said("", row) == "(empty)"


def test_tests_of_a_file_are_run_on_one_device(tmp_path):
    """And import what is on the path, kernels included."""
    test = "import pytest, warpriver.kernels\n\n@pytest.mark.parametrize('device', ['cpu', 'cuda:0'])\n"
    (tmp_path / "test_some.py").write_text(test + "def test_it(device):\n    assert device == 'cuda:0'\n")
    for alias, passed, failed in (("cpu", 0, ["test_some: test_it[cpu]: AssertionError"]), ("cuda:0", 1, [])):
        row, failures = gpu_proof.run_tests(tmp_path / "test_some.py", alias, Report(tmp_path / "kernels.json"))
        assert (row["passed"], row["failed"], row["skipped"]) == (passed, len(failed), 0)
        assert [failure[: len(begin)] for failure, begin in zip(failures, failed, strict=True)] == failed


def test_a_file_that_hangs_is_ended(tmp_path):
    (tmp_path / "test_slow.py").write_text("import time\ntime.sleep(60)\n")
    report = Report(tmp_path / "kernels.json", seconds=gpu_proof.CLOSING + 0.5)
    row, (failure,) = gpu_proof.run_tests(tmp_path / "test_slow.py", "cpu", report)
    assert row["passed"] == 0 and row["seconds"] < 10.0 and failure.startswith("test_slow: not done after ")


def test_a_file_that_cannot_be_imported_has_failed(tmp_path):
    (tmp_path / "test_bad.py").write_text("import nowhere\n")
    row, (failure,) = gpu_proof.run_tests(tmp_path / "test_bad.py", "cpu", Report(tmp_path / "kernels.json"))
    assert row["failed"] == 1 and failure.startswith("test_bad: ") and failure.endswith("collection failure")


def test_no_test_is_begun_without_time(tmp_path):
    report = Report(tmp_path / "kernels.json", seconds=gpu_proof.CLOSING)
    row, failures = gpu_proof.run_tests(tmp_path / "test_a.py", "cpu", report)
    assert failures == ["test_a: not begun, no time was left"] and row["passed"] == 0


TOOL = """#!{python}
import subprocess, sys
at = sys.argv.index({python!r})
print("flags", *sys.argv[1:at], flush=True)
code = subprocess.run(sys.argv[at:]).returncode
print("========= ERROR SUMMARY: {errors} errors")
sys.exit(99 if {errors} else code)
"""


@pytest.mark.parametrize(("errors", "code"), [(0, 0), (3, 0), (0, 5)])
def test_what_compute_sanitizer_finds_is_told(tmp_path, monkeypatch, capsys, errors, code):
    tool = tmp_path / "cuda" / "bin" / "compute-sanitizer"
    tool.parent.mkdir(parents=True)
    tool.write_text(TOOL.format(python=sys.executable, errors=errors))
    tool.chmod(0o755)
    monkeypatch.setenv("CUDA_HOME", str(tmp_path / "cuda"))
    monkeypatch.setenv("PATH", "")
    assert gpu_proof.find_sanitizer() == str(tool)
    report = Report(tmp_path / "sanitizer.json")
    gpu_proof.sanitize(report, str(tool), "memcheck", [sys.executable, "-c", f"raise SystemExit({code})"], 30.0)
    assert "flags --tool memcheck --error-exitcode 99" in capsys.readouterr().out
    (row,) = report.facts["tools"]
    assert row["summary"] == f"{errors} errors" and bool(report.failures) == (errors + code > 0)


def test_compute_sanitizer_that_hangs_is_told(tmp_path):
    report = Report(tmp_path / "sanitizer.json")
    gpu_proof.sanitize(report, sys.executable, "-c", ["import time; time.sleep(60)"], 1.0)
    assert report.failures and report.facts["tools"][0]["summary"] is None


def test_names_of_kernels_are_those_in_their_files():
    assert gpu_speed.plain_name("forward kernel build__locals__move_points_0123abcd") == "move_points"
    assert gpu_speed.plain_name("build__locals__find_necks") == "find_necks"
    assert gpu_speed.plain_name("memset") == "memset"
    assert gpu_speed.plain_name("builtin kernel array_fill<int>") == "builtin kernel array_fill<int>"


def test_kernels_of_a_gpu_are_timed_between_events(monkeypatch):
    began, steps = [], []
    results = [("forward kernel build__locals__find_necks_89abcdef", 0.5), ("memset", 0.125)]
    monkeypatch.setattr(wp, "timing_begin", began.append)
    monkeypatch.setattr(wp, "timing_end", lambda: [SimpleNamespace(name=n, elapsed=ms) for n, ms in 2 * results])
    sim = SimpleNamespace(device=SimpleNamespace(is_cuda=True, is_cpu=False), step=steps.append)
    assert gpu_speed.kernel_times(sim, 2) == {"find_necks": [500.0, 500.0], "memset": [125.0, 125.0]}
    assert steps == [2] and began[0] & wp.TIMING_KERNEL and not began[0] & wp.TIMING_GRAPH


def test_values_are_compared_with_those_that_are_missing():
    here = np.array([1.0, 2.0, np.nan, np.nan])
    cpu = np.array([1.0, 2.5, np.nan, 4.0])
    found = gpu_speed.compared("heights", here, cpu, 0.1)
    assert found == {"what": "heights", "values": 4, "apart": 0.5, "share_beyond": 0.5}
    assert gpu_speed.compared("heights", here, here, 0.0)["share_beyond"] == 0.0


def test_launches_are_dealt_out_in_chunks_and_blocks(monkeypatch):
    given, gpu = [], SimpleNamespace(is_cpu=False)
    monkeypatch.setattr(stages, "load_kernel", lambda *arguments: None)
    monkeypatch.setattr(wp, "launch", lambda *arguments, **options: given.append(options.get("block_dim")))
    chunks, usual = (buffers.CPU_CHUNK, buffers.CUDA_CHUNK), stages.BLOCK_DIM
    with gpu_speed.dealt_out(False, 16, 256):
        assert (buffers.CPU_CHUNK, buffers.CUDA_CHUNK) == (chunks[0], 16)
        stages.launch("kernel", 1, [], [], gpu)
    with gpu_speed.dealt_out(True, 8, 128):
        assert buffers.CPU_CHUNK == 8
        stages.launch("kernel", 1, [], [], gpu)
    stages.launch("kernel", 1, [], [], gpu)
    assert given == [256, 128, usual]
    assert (buffers.CPU_CHUNK, buffers.CUDA_CHUNK) == chunks


def test_rows_for_which_no_time_is_left_are_told(tmp_path):
    report = Report(tmp_path / "speed.json", seconds=20.0)
    assert gpu_speed.longest(report, "steps") == 1.0
    for seconds in (4.0, 3.0):
        report.add("steps", {"seconds": seconds})
    assert gpu_speed.longest(report, "steps") == 4.0
    assert gpu_speed.enough_left(report, "small", 8.0) and "left_out" not in report.facts
    assert not gpu_speed.enough_left(report, "large", 24.0)
    (row,) = report.facts["left_out"]
    assert row["what"] == "large"


# ---- table


def record(section, state="done", error=None, failures=(), **facts):
    return {
        "section": section,
        "state": state,
        "error": error,
        "seconds": 3.0,
        "failures": list(failures),
        "facts": facts,
    }


def test_the_table_is_short_and_tells_what_failed():
    step = {"dtype": "float64", "points": 1000, "ms_per_step": 1.0, "ratio_to_roofline": 2.0}
    steps = [step | {"scene": f"scene {k}"} for k in range(40)]
    text = gpu_table.table(
        [
            record("machine", "overran", "not done after 20 s"),
            record("models", "failed", failures=["paths: other", "tree: other", "rings: other"]),
            record("sanitizer", "skipped", "no compute-sanitizer"),
            record("speed", steps=steps),
        ]
    )
    lines = text.splitlines()
    assert len(lines) == gpu_table.MAX_LINES and max(map(len, lines)) <= gpu_table.WIDTH
    assert lines[0] == "machine    overran in 3 s: not done after 20 s"
    assert lines[1] == "models     failed in 3 s: paths: other; tree: other; 3 in all"
    assert lines[2] == "sanitizer  skipped in 3 s: no compute-sanitizer"
    assert lines[4] == "scene 0, 1000 points: float64 1 ms, 2 x the floor"
    assert lines[-1] == "... and 15 more lines in the files"


def test_the_table_has_the_best_layouts_and_the_dearest_kernels():
    layouts = [
        {"dtype": "float32", "chunk": c, "block_dim": b, "ns_per_point": c * b} for c in (16, 32) for b in (256, 64)
    ]
    kernels = [{"dtype": "float32", "kernel": name, "us": us} for name, us in (("slow", 30.0), ("fast", 2.0))]
    speed = gpu_table.table([record("speed", layouts=layouts, kernels=kernels)]).splitlines()
    assert speed[1] == "kernels float32, us a step: all 32, slow 30, fast 2"
    assert (
        speed[2] == "chunk x block float32, ns/point, best of 4: 16 x 64 1.02e+03, 32 x 64 2.05e+03, 16 x 256 4.1e+03"
    )


def test_the_table_stands_without_any_figure():
    names = [section.name for section in gpu.SECTIONS]
    assert len(gpu_table.table([record(name, "failed", "early") for name in names]).splitlines()) == len(names)


def test_every_section_has_a_function_and_its_figures():
    for section in gpu.SECTIONS:
        module = {"gpu_proof": gpu_proof, "gpu_speed": gpu_speed}[section.module]
        assert callable(getattr(module, f"{section.name}_section")) and section.name in gpu_table.FIGURES


def test_nothing_is_imported_that_a_gpu_machine_may_lack():
    """NumPy, SciPy, Warp and pytest alone: neither the tests of kernels nor the sections ask for more."""
    heavy = (
        "pyvista",
        "matplotlib",
        "rasterio",
        "pyogrio",
        "geopandas",
        "shapely",
        "pyproj",
        "xarray",
        "xdist",
        "numba",
    )
    code = f"""
        import importlib, sys
        for name in {heavy}:
            sys.modules[name] = None  # importing it raises
        sys.path[:0] = {[str(gpu.ROOT / folder) for folder in ("benchmarks", "tests/helpers", "tests/kernels")]}
        for name in ("gpu", "gpu_proof", "gpu_speed", "models"):
            importlib.import_module(name)
        import pathlib
        for path in pathlib.Path({str(gpu.ROOT / "tests" / "kernels")!r}).glob("test_kernel_*.py"):
            importlib.import_module(path.stem)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_every_file_of_tests_can_be_run_alone():
    """As here: of other tests it imports none, but for those beside it and those of the folder of them all."""
    lost = []
    for path in sorted(TESTS.rglob("test_*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text())))
        names = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
        names += [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
        lost += [
            f"{path.name} imports {name}"
            for name in names
            if name.startswith("test_") and not any((f / f"{name}.py").exists() for f in (path.parent, TESTS))
        ]
    assert not lost, lost
