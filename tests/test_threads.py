"""Threads of one process that work at the same time come to the bits that they come to one after the other.

In processes of their own, which a fault would kill: nothing in them has been started, built or loaded before.
"""

import ast
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import warp as wp

import warpriver
from warpriver import MeanderParams, RiverNetwork, Simulation, generate
from warpriver.kernels.variants import once

HELPERS = Path(__file__).parent / "helpers"
LONGEST = 400  # s


def side_by_side(rounds, *names, **environment):
    """Run jobs of ``side_by_side.py`` in threads of a fresh process; return what each comes to alone."""
    done = subprocess.run(
        [sys.executable, str(HELPERS / "side_by_side.py"), str(rounds), *names],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=LONGEST,
    )
    assert done.returncode == 0, f"the process ended with {done.returncode}: {done.stderr[-3000:]}"
    told = json.loads(done.stdout.splitlines()[-1])
    assert not told["wrong"], "\n".join(told["wrong"])
    return told["alone"]


def test_simulations_beside_each_other():
    """Those of one kind, whose arrays and recordings are alike, start, record, grow and end in turn."""
    side_by_side(3, "plain", "plain", "tree", "tree")


def test_everything_beside_everything():
    """Simulations of all kinds, hydrology, terrain, rain, valleys, rates, stored runs, and work that is refused."""
    alone = side_by_side(
        2, "tree", "on hills", "paths", "single precision", "rings in two", "stored", "hydrology", "hydrology",
        "ground", "rain", "valley", "rates", "files", "pictures", "refused",
    )  # fmt: skip
    assert len(alone["refused"]) == 2, alone["refused"]


def test_kernels_that_are_compiled_by_several_threads_at_once(tmp_path):
    """Nothing has been compiled yet, and all need it."""
    side_by_side(1, "ground", "ground", "ground", WARP_CACHE_PATH=str(tmp_path))
    assert any(tmp_path.rglob("*terrain*"))


def test_kernels_of_a_file_are_made_once_by_any_number_of_threads():
    made, gate = [], threading.Barrier(8)

    @once
    def build(scalar):
        made.append(scalar)
        time.sleep(0.05)
        return SimpleNamespace(scalar=scalar)

    found = []

    def ask(scalar):
        gate.wait()
        found.append(build(scalar))

    threads = [threading.Thread(target=ask, args=((wp.float32, wp.float64)[k % 2],)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8 and len(set(map(id, found))) == 2 and len(made) == 2


def test_kernels_are_loaded_by_one_thread_at_a_time():
    """Whatever launches does so by ``device.launch_kernel`` or ``engine.stages.launch``, which see to that."""
    root = Path(warpriver.__file__).parent
    homes = [root / "device.py", *(root / "engine" / name for name in ("stages.py", "replay.py"))]
    for path in sorted(root.rglob("*.py")):
        loads, launches = (path.read_text().count(word) for word in ("load_kernel(", "wp.launch("))
        assert launches == 0 or path in homes, f"{path}: launch_kernel(...) in place of wp.launch(...)"
        assert loads >= launches


def test_scipy_is_imported_by_one_thread_at_a_time():
    """Its parts import each other: see ``warpriver.extras.IMPORTING``."""
    loose = []
    for path in sorted(Path(warpriver.__file__).parent.rglob("*.py")):
        tree = ast.parse(path.read_text())
        imports = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and (n.module or "").startswith("scipy")]
        guards = [n for n in ast.walk(tree) if isinstance(n, ast.With) and ast.unparse(n.items[0]) == "IMPORTING"]
        guarded = [inner for guard in guards for inner in guard.body]
        loose += [f"{path.name}:{n.lineno}" for n in imports if n not in guarded]
    assert not loose, f"write `with IMPORTING:` around {', '.join(loose)}"


def test_another_thread_may_use_warp_while_a_step_is_recorded():
    """What it launches and copies is done at once, and is in no recording."""
    value, stop, rounds = wp.zeros(64, dtype=float, device="cpu"), threading.Event(), []

    def work():
        while not stop.is_set():
            value.fill_(1.0)
            rounds.append(float(wp.clone(value).numpy().sum()))

    line = generate.noisy_line(4000, 50, 50, 1)
    thread = threading.Thread(target=work)
    thread.start()
    try:
        for _ in range(10):
            Simulation(RiverNetwork.from_polylines([line], width=60.0), MeanderParams()).step(3)
    finally:
        stop.set()
        thread.join()
    assert rounds and set(rounds) == {64.0}
