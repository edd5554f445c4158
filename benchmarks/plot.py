"""Draws the results: cost against points and channels, shares of phases, the roofline, a long run's steps."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogFormatter

RESULTS = Path(__file__).parent / "results"
NAMES = {
    "migration": "migration and resampling alone",
    "cutoffs": "+ cutoffs",
    "full": "+ cutoffs and collisions",
}
COLORS = {"migration": "#7fb3d5", "cutoffs": "#2471a3", "full": "#1b2631"}
PEER, LINE, ROOF = "#c0392b", "#999999", "#b9770e"
PHASES = {
    "migrate": "#2471a3", "cut off": "#5dade2", "resample": "#a9cce3", "collide": "#b9770e", "join": "#e59866",
    "rest of host": "#bfc9ca",
}  # fmt: skip
LENGTHS = ("#7fb3d5", "#2471a3", "#1b2631", "#b9770e")


def rows_of(result: dict, case: str, **wanted: Any) -> list[dict]:
    """Rows of one case with those values, in the order of the file."""
    return [r for r in result["rows"] if r["case"] == case and all(r.get(k) == v for k, v in wanted.items())]


def title(result: dict, text: str) -> str:
    """What is shown and on what."""
    about = result["machine"]
    device = about["processor"] if about["device"] == "CPU" else about["device"]
    return f"{text}\n{device}, {result.get('dtype', 'float64')}, warpriver {about['commit'] or about['warpriver']}"


def column(rows: list[dict], name: str) -> np.ndarray:
    return np.array([r[name] for r in rows], float)


def axes(result: dict, text: str, size: tuple[float, float] = (8.0, 5.0), panels: int = 1, **options: Any) -> Any:
    """A figure with the title, and its panels."""
    figure, found = plt.subplots(1, panels, figsize=size, layout="constrained", squeeze=False, **options)
    figure.suptitle(title(result, text), fontsize=11)
    for panel in found[0]:
        panel.grid(True, which="major", color="#e5e5e5", linewidth=0.8)
        panel.set_axisbelow(True)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    return figure, found[0]


def save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(path)


def draw_points(result: dict, path: Path) -> None:
    """Milliseconds a step against points, with the line of linear growth and meanderpy."""
    figure, (panel,) = axes(result, "Cost of a step, one thread, 1,000 points a channel")
    for variant, name in NAMES.items():
        rows = rows_of(result, "1000 a channel", variant=variant)
        panel.loglog(column(rows, "points"), column(rows, "ms_per_step"), "o-", ms=4, color=COLORS[variant], label=name)
    rows = rows_of(result, "one channel")
    style = {"marker": "D", "ls": "none", "mfc": "white", "color": COLORS["cutoffs"]}
    panel.loglog(column(rows, "points"), column(rows, "ms_per_step"), label="one channel, with cutoffs", **style)
    peer = rows_of(result, "meanderpy")
    if peer:
        x, y = column(peer, "asked_points"), column(peer, "meanderpy_ms")
        panel.loglog(x, y, "s-", ms=4, color=PEER, label="meanderpy, one channel, same line and step")
        for r in peer:
            place = {"xytext": (0, 7), "textcoords": "offset points", "ha": "right", "fontsize": 8, "color": PEER}
            panel.annotate(f"{r['ratio']:,.0f}x ", (r["asked_points"], r["meanderpy_ms"]), **place)
    base = rows_of(result, "1000 a channel", variant="cutoffs")
    middle = min(base, key=lambda r: abs(np.log(r["points"] / 1e4)))
    x = np.array([column(base, "points").min() / 3, column(base, "points").max()])
    label = f"linear: {middle['ns_per_point']:.0f} ns a point"
    panel.loglog(x, 1e-6 * middle["ns_per_point"] * x, "--", color=LINE, lw=1.2, label=label, zorder=1)
    panel.set(xlabel="points", ylabel="ms a step")
    panel.legend(frameon=False, fontsize=8.5)
    save(figure, path)


def draw_phases(step: dict, network: dict | None, path: Path) -> None:
    """Share of each phase in a step, one bar a scene."""
    scenes = {}
    for size in dict.fromkeys(r["asked_points"] for r in rows_of(step, "phase")):
        rows = rows_of(step, "phase", asked_points=size)
        scenes[f"{size:,} points,\n1,000 a channel"] = {r["phase"]: r["ns_per_point"] for r in rows}
    if network is not None:
        found = rows_of(network, "extracted")[0]
        label = f"{found['channels']:,} channels,\n{found['points']:,} points,\nrivers of a terrain"
        scenes[label] = {r["phase"]: r["ms_per_step"] for r in rows_of(network, "extracted, phase")}
    figure, (panel,) = axes(step, "Where the time of a step goes, one thread", size=(9.0, 1.3 + 0.85 * len(scenes)))
    for k, costs in enumerate(scenes.values()):
        left, total = 0.0, sum(costs.values())
        for phase, cost in costs.items():
            share = 100.0 * cost / total
            panel.barh(k, share, left=left, color=PHASES[phase], edgecolor="white", label=phase if k == 0 else None)
            if share >= 4.0:
                dark = phase == "migrate"
                panel.text(
                    left + share / 2, k, f"{share:.0f}", ha="center", va="center", fontsize=9,
                    color="white" if dark else "#1b2631",
                )  # fmt: skip
            left += share
    panel.set(xlabel="% of a step, phases replayed one by one", xlim=(0, 100), yticks=range(len(scenes)))
    panel.set_yticklabels(list(scenes), fontsize=8.5)
    panel.invert_yaxis()
    panel.legend(frameon=False, fontsize=8.5, ncols=1, loc="center left", bbox_to_anchor=(1.0, 0.5))
    save(figure, path)


def draw_roofline(result: dict, path: Path) -> None:
    """Bytes a second that a step has to move at least, against points and by phase, under what a copy moves."""
    figure, (left, right) = axes(
        result, "What a step has to move at least, a second, one thread or one GPU", (9.5, 4.6), 2, width_ratios=(3, 2)
    )
    roof = 1e-9 * result["baseline"]["copy_bytes_per_second"]
    for variant, name in NAMES.items():
        rows = rows_of(result, "1000 a channel", variant=variant)
        speed = column(rows, "roofline_bytes_per_point") / column(rows, "ns_per_point")
        left.loglog(column(rows, "points"), speed, "o-", ms=4, color=COLORS[variant], label=name)
    left.axhline(roof, color=ROOF, label=f"a plain copy: {roof:.3g} GB/s")
    left.set(xlabel="points", ylabel="GB/s")
    left.set_ylim(10 ** np.floor(np.log10(min(np.min(line.get_ydata()) for line in left.lines))), roof * 2)
    left.yaxis.set_major_formatter("{x:g}")
    left.legend(frameon=False, fontsize=8.5, loc="center right", bbox_to_anchor=(1.0, 0.62))
    size = max(r["asked_points"] for r in rows_of(result, "phase"))
    rows = [r for r in rows_of(result, "phase", asked_points=size) if "ratio_to_roofline" in r]
    ratio = column(rows, "ratio_to_roofline")
    right.barh([r["phase"] for r in rows], ratio, color=[PHASES[r["phase"]] for r in rows])
    for k, r in enumerate(rows):
        text = f" {r['ratio_to_roofline']:.1f}  ({r['ns_per_point']:.1f} ns, {r['roofline_bytes_per_point']:.0f} B)"
        right.text(r["ratio_to_roofline"], k, text, va="center", fontsize=8.5)
    right.axvline(1.0, color=ROOF)
    right.set(xlabel=f"times the floor, {size:,} points", xlim=(0, 1.75 * ratio.max()))
    right.invert_yaxis()
    save(figure, path)


def draw_channels(result: dict, path: Path) -> None:
    """Milliseconds a step against channels, by their mean length, and what a line in points and channels says."""
    figure, (panel,) = axes(result, "Cost of a full step, one thread, lengths of channels as those of real links")
    fit = result["fit"]
    for color, mean in zip(
        LENGTHS, dict.fromkeys(r["mean_points"] for r in rows_of(result, "drawn lengths")), strict=False
    ):
        rows = rows_of(result, "drawn lengths", mean_points=mean)
        x, points = column(rows, "channels"), column(rows, "points")
        panel.loglog(x, column(rows, "ms_per_step"), "o", ms=5, color=color, label=f"about {mean} points a channel")
        line = 1e-3 * fit["us_per_step"] + 1e-6 * (fit["ns_per_point"] * points + fit["ns_per_channel"] * x)
        panel.loglog(x, line, "-", lw=1.0, color=color)
        panel.loglog(x, column(rows, "migration_ms"), ":", lw=1.2, color=color)
    panel.plot([], [], "-", color=LINE, label=(
        f"fit: {fit['us_per_step']:.0f} us + {fit['ns_per_point']:.0f} ns a point + "
        f"{fit['ns_per_channel']:.0f} ns a channel"
    ))  # fmt: skip
    panel.plot([], [], ":", color=LINE, label="migration and resampling alone")
    for case, marker in (("extracted", "*"), ("extracted x 4", "P")):
        for r in rows_of(result, case):
            many = "rivers of a terrain, on it" if case == "extracted" else "four times those rivers, on a plain"
            parts = f", {r['substeps']} sub-steps" if r["substeps"] > 1 else ""
            label = f"{many}: {r['points']:,} points{parts}"
            panel.loglog(r["channels"], r["ms_per_step"], marker, ms=10, color=PEER, label=label)
    panel.set(xlabel="channels", ylabel="ms a step")
    panel.legend(frameon=False, fontsize=8.5)
    save(figure, path)


def draw_run(result: dict, path: Path) -> None:
    """How many steps of the long run cost how much, with and without joins."""
    (run,) = rows_of(result, "long run")
    text = f"{run['steps']:,} steps of {run['channels_before']:,} channels, {run['threads']} threads"
    figure, (panel,) = axes(result, text, (8.0, 4.2))
    edges, found = np.array(run["histogram_ms"]), run["histogram"]
    without, joined = (np.array(found[k]) for k in ("without", "with"))
    bars = {"x": edges[:-1], "width": np.diff(edges), "align": "edge", "edgecolor": "white"}
    panel.bar(height=without, color=PHASES["migrate"], label="nothing joined", **bars)
    panel.bar(height=joined, bottom=without, color=PHASES["collide"], label="channels joined in the step", **bars)
    panel.set(xscale="log", xlabel="ms a step", ylabel="steps")
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.5)))
    panel.legend(frameon=False, fontsize=8.5)
    save(figure, path)


def read(folder: Path, name: str) -> dict | None:
    """A result with rows and a baseline, or None where there is none."""
    path = folder / f"{name}.json"
    if not path.exists():
        return None
    result = json.loads(path.read_text())
    if "rows" not in result or "baseline" not in result:
        print(f"{path}: made by an older version, not drawn", file=sys.stderr)
        return None
    return result


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "folder", nargs="?", type=Path, default=RESULTS, help="where the JSON files lie (default results)"
    )
    parser.add_argument("-o", "--out", type=Path, help="folder for the pictures (default: the same)")
    options = parser.parse_args(arguments)
    out = options.out or options.folder
    out.mkdir(parents=True, exist_ok=True)
    drawn = 0
    for device in ("cpu", "cuda"):
        step, network = read(options.folder, f"step-{device}"), read(options.folder, f"network-{device}")
        if step is not None:
            draw_points(step, out / f"points-{device}.png")
            draw_phases(step, network, out / f"phases-{device}.png")
            draw_roofline(step, out / f"roofline-{device}.png")
        if network is not None:
            draw_channels(network, out / f"channels-{device}.png")
            draw_run(network, out / f"run-{device}.png")
        drawn += (step is not None) + (network is not None)
    if not drawn:
        print(f"{options.folder} holds no results of step.py or network.py: run make bench first", file=sys.stderr)
    return 0 if drawn else 1


if __name__ == "__main__":
    sys.exit(main())
