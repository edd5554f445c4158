"""Proves warpriver on a GPU within minutes: kernels, whole runs, the same bits again, and speed, section by section.

Every section runs in a process of its own, so that a crash or a hang in one leaves the others alone, and has a share of
the time; what it finds is written as it comes. Needs NumPy, SciPy, Warp and pytest, and warpriver on the path; no make.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gpu_table
from gpu_report import DONE, FAILED, OVERRAN, SKIPPED, Report, read_json, write_beside, write_json

ROOT = Path(__file__).resolve().parents[1]
BUDGET = 360.0
# Of the budget, what is left for the table and for processes that end.
LAST_SECONDS = 15.0
GOOD = (DONE, SKIPPED)


@dataclass(frozen=True)
class Section:
    """A part of the proof.

    Attributes:
        name: Name of its files; the function is ``name_section``.
        module: File of the function.
        seconds: Its share of the budget.
    """

    name: str
    module: str
    seconds: float


SECTIONS = (
    Section("machine", "gpu_proof", 20.0),
    Section("kernels", "gpu_proof", 80.0),
    Section("models", "gpu_proof", 70.0),
    Section("repeat", "gpu_proof", 20.0),
    Section("sanitizer", "gpu_proof", 30.0),
    Section("speed", "gpu_speed", 90.0),
    Section("others", "gpu_speed", 35.0),
)


def deadlines(sections: Iterable[Section], budget: float) -> list[float]:
    """Seconds from the start at which each section has to end: what an earlier one saves, later ones may use.

    Args:
        sections: Those that run, in order.
        budget: Seconds for all of them and the table.
    """
    shares = [section.seconds for section in sections]
    scale = budget / (sum(shares) + LAST_SECONDS)
    return [scale * end for end in itertools.accumulate(shares)]


def run_section(name: str, command: list[str], out: Path, seconds: float) -> dict[str, Any]:
    """Run a section as a process, and return its record: state, error, seconds, failures and facts.

    Args:
        name: Name of its files: the process writes ``name.json``, and what it prints goes to ``name.log``.
        command: The process; 0 or 1 is its exit code where it ended its record itself.
        out: Folder of the files.
        seconds: After so many it is killed, with all that it has started.
    """
    record = {"state": FAILED, "error": None, "failures": [], "facts": {}}
    target, begin = out / f"{name}.json", time.monotonic()
    target.unlink(missing_ok=True)
    with open(out / f"{name}.log", "w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            code = process.wait(seconds)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            _end(process)
    record |= read_json(target)
    if code is None:
        record |= {"state": OVERRAN, "error": f"not done after {seconds:.0f} s"}
    elif record["state"] not in (DONE, SKIPPED, FAILED) or (code != 0 and record["state"] in GOOD):
        record |= {"state": FAILED, "error": f"the process ended with exit code {code}"}
    elif code != 0 and record["error"] is None and not record["failures"]:
        record["error"] = f"exit code {code}, and no record"
    record |= {"section": name, "exit_code": code, "seconds": time.monotonic() - begin}
    write_json(target, record)
    return record


def _end(process: subprocess.Popen) -> None:
    """Kill a process and all that it has started, which share its session."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass
    process.wait()


def run_sections(
    sections: Iterable[Section], command: Callable[[Section, float], list[str]], out: Path, budget: float
) -> list[dict[str, Any]]:
    """Run sections one after the other; results and table are on the disk after each.

    Args:
        sections: What is run.
        command: Makes the process of a section, which may take so many seconds.
        out: Folder of the results.
        budget: Seconds for all.

    Returns:
        Their records.
    """
    sections, begin, records = list(sections), time.monotonic(), []
    for section, deadline in zip(sections, deadlines(sections, budget), strict=True):
        seconds = max(0.0, begin + deadline - time.monotonic())
        print(f"{section.name} (at most {seconds:.0f} s) ...", end=" ", flush=True)
        records.append(run_section(section.name, command(section, seconds), out, seconds))
        print(gpu_table.outcome(records[-1]), flush=True)
        write_beside(out / "table.txt", gpu_table.table(records))
        summary = [
            {name: r[name] for name in ("section", "state", "seconds", "error")} | {"failures": len(r["failures"])}
            for r in records
        ]
        write_json(out / "summary.json", {"ok": all(r["state"] in GOOD for r in records), "sections": summary})
    return records


# ---- command line


def children(options: argparse.Namespace) -> Callable[[Section, float], list[str]]:
    """How a section's process is called."""

    def command(section: Section, seconds: float) -> list[str]:
        flags = ["--out", str(options.out), "--device", options.device, "--section", section.name]
        return [sys.executable, __file__, *flags, "--budget", f"{seconds:.1f}", *["--dry"] * options.dry]

    return command


def do_section(options: argparse.Namespace) -> int:
    """Do one section in this process."""
    (section,) = [s for s in SECTIONS if s.name == options.section]
    function = getattr(importlib.import_module(section.module), f"{section.name}_section")
    import warp as wp

    wp.config.log_level = wp.LOG_INFO  # which kernels were compiled, and how long that took, into the log
    report = Report(
        options.out / f"{section.name}.json", device=options.device, small=options.dry, seconds=options.budget
    )
    return 0 if report.run(function) in GOOD else 1


def check_device(device: str) -> str | None:
    """Return why a device cannot be used, None where it can."""
    try:
        import warp as wp

        from warpriver.cli.info import describe_gpus
        from warpriver.kernels import polyline  # noqa: F401
    except ImportError as error:
        return f"{error}; put the folder that holds warpriver, with warpriver/kernels, on PYTHONPATH"
    wp.config.log_level = wp.LOG_WARNING
    devices = wp.get_devices()
    if device in [d.alias for d in devices] or (device == "cuda" and any(d.is_cuda for d in devices)):
        return None
    gpus = describe_gpus(devices, wp.get_cuda_driver_version(), wp.get_cuda_toolkit_version())
    return f"there is no device {device} here; {' '.join(gpus)}; --dry runs everything, small, on the CPU"


def main(arguments: list[str] | None = None) -> int:
    """Run the sections asked for; 0 if none failed."""
    names = [section.name for section in SECTIONS]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "gpu", help="folder of the results (out/gpu)")
    parser.add_argument("--device", help="Warp device (default cuda; with --dry cpu)")
    parser.add_argument("--dry", action="store_true", help="small sizes: whether it works, not how fast it is")
    parser.add_argument("--sections", choices=names, nargs="+", default=names, help="some of them (default all)")
    parser.add_argument(
        "--budget", type=float, default=BUDGET, metavar="S", help=f"seconds in all (default {BUDGET:.0f})"
    )
    parser.add_argument("--section", choices=names, help=argparse.SUPPRESS)  # do it here: for the processes
    options = parser.parse_args(arguments)
    options.device = options.device or ("cpu" if options.dry else "cuda")
    options.out = options.out.resolve()
    if options.section:
        return do_section(options)
    if not options.budget > 0.0:
        parser.error(f"--budget is {options.budget}; give seconds, more than 0")
    problem = check_device(options.device)
    if problem:
        parser.error(problem)
    options.out.mkdir(parents=True, exist_ok=True)
    # Who ends this process ends the section's too: through the same door as Ctrl-C.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    chosen = [section for section in SECTIONS if section.name in options.sections]
    records = run_sections(chosen, children(options), options.out, options.budget)
    print((options.out / "table.txt").read_text(), end="")
    return 0 if all(record["state"] in GOOD for record in records) else 1


if __name__ == "__main__":
    sys.exit(main())
