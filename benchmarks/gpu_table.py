"""The short table at the end of gpu.py: how each section ended, and its figures in at most 30 lines."""

from __future__ import annotations

from typing import Any

MAX_LINES = 30
# Kernels and layouts that the table names for each precision; the files have all.
MAX_KERNELS, MAX_LAYOUTS = 5, 3
# Failures that it names of each section.
MAX_FAILURES = 2
WIDTH = 130


def outcome(record: dict[str, Any]) -> str:
    """How a section ended, in a line."""
    reason = record["error"] or ""
    count = len(record["failures"])
    if count:
        reason = "; ".join(record["failures"][:MAX_FAILURES]) + (f"; {count} in all" if count > MAX_FAILURES else "")
    return f"{record['state']} in {record['seconds']:.0f} s" + (f": {reason}" if reason else "")


def table(records: list[dict[str, Any]]) -> str:
    """The whole table."""
    lines = [f"{r['section']:<10} {outcome(r)}" for r in records]
    for record in records:
        lines += FIGURES[record["section"]](record["facts"]) if record["section"] in FIGURES else []
    lines = [line if len(line) <= WIDTH else line[: WIDTH - 4] + " ..." for line in lines]
    if len(lines) > MAX_LINES:
        lines = [*lines[: MAX_LINES - 1], f"... and {len(lines) - MAX_LINES + 1} more lines in the files"]
    return "\n".join(lines) + "\n"


def _machine(facts: dict[str, Any]) -> list[str]:
    if "copy_bytes_per_second" not in facts:
        return []
    line = f"{facts['device']}; copy {1e-9 * facts['copy_bytes_per_second']:.4g} GB/s"
    costs = [f"{name} {facts[f'{name}_us']:.3g} us" for name in ("launch", "replay", "look") if f"{name}_us" in facts]
    return [", ".join([line, *costs])]


def _kernels(facts: dict[str, Any]) -> list[str]:
    rows = facts.get("files", [])
    counts = [f"{sum(row[name] for row in rows)} {name}" for name in ("passed", "failed", "skipped")]
    return [f"kernel tests: {', '.join(counts)} in {len(rows)} files"] if rows else []


def _models(facts: dict[str, Any]) -> list[str]:
    rows = facts.get("models", [])
    if not rows:
        return []
    ways = [way for way in ("recorded", "rows", "tight") if way in rows[0]]
    same = ", ".join(f"{way} {sum(row[way] == 'same' for row in rows)}" for way in ways)
    apart = [row["apart_m"] for row in rows if row["apart_m"] is not None]
    farthest = f"; at most {max(apart):.2g} m from the CPU after 3 steps" if apart else ""
    return [f"models with the bits of the plain run, of {len(rows)}: {same}{farthest}"]


def _repeat(facts: dict[str, Any]) -> list[str]:
    said = [f"{r['channels']} channels {r['dtype']} {'same' if r['same'] else 'OTHER'}" for r in facts.get("runs", [])]
    return [f"two runs of {facts['runs'][0]['steps']} steps: {', '.join(said)}"] if said else []


def _sanitizer(facts: dict[str, Any]) -> list[str]:
    return [f"{row['tool']}: {row['summary']}" for row in facts.get("tools", [])]


def _speed(facts: dict[str, Any]) -> list[str]:
    lines = []
    by_scene: dict[str, list[dict[str, Any]]] = {}
    for row in facts.get("steps", []):
        by_scene.setdefault(row["scene"], []).append(row)
    for scene, rows in by_scene.items():
        cells = [f"{r['dtype']} {r['ms_per_step']:.4g} ms, {r['ratio_to_roofline']:.3g} x the floor" for r in rows]
        lines.append(f"{scene}, {rows[0]['points']} points: {'; '.join(cells)}")
    for dtype in dict.fromkeys(row["dtype"] for row in facts.get("kernels", [])):
        rows = [row for row in facts["kernels"] if row["dtype"] == dtype]
        named = [f"{row['kernel']} {row['us']:.3g}" for row in rows[:MAX_KERNELS]]
        total = sum(row["us"] for row in rows)
        lines.append(f"kernels {dtype}, us a step: all {total:.4g}, {', '.join(named)}")
    for dtype in dict.fromkeys(row["dtype"] for row in facts.get("layouts", [])):
        rows = sorted((r for r in facts["layouts"] if r["dtype"] == dtype), key=lambda r: r["ns_per_point"])
        named = [f"{r['chunk']} x {r['block_dim']} {r['ns_per_point']:.3g}" for r in rows[:MAX_LAYOUTS]]
        lines.append(f"chunk x block {dtype}, ns/point, best of {len(rows)}: {', '.join(named)}")
    return lines


def _others(facts: dict[str, Any]) -> list[str]:
    return [
        f"{r['what']}: {r['seconds']:.3g} s, CPU {r['cpu_seconds']:.3g} s, apart by {r['apart']:.2g} at most"
        for r in facts.get("others", [])
    ]


FIGURES = {
    "machine": _machine,
    "kernels": _kernels,
    "models": _models,
    "repeat": _repeat,
    "sanitizer": _sanitizer,
    "speed": _speed,
    "others": _others,
}
