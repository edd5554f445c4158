"""Pictures and tables of benchmark results, from a small made-up result."""

import json

import matplotlib.image
import plot
import pytest
import table

MACHINE = {"processor": "a processor", "device": "CPU", "commit": "abc", "warpriver": "0"}
HEAD = {"machine": MACHINE, "baseline": {"copy_bytes_per_second": 2e10}}


def step_result():
    rows = []
    for n in (1000, 10_000, 100_000):
        for k, variant in enumerate(plot.NAMES):
            cost = {
                "points": n,
                "channels": n // 1000,
                "ns_per_point": 40.0 + 20 * k,
                "ms_per_step": (40 + 20 * k) * n / 1e6,
            }
            rows.append(
                {"case": "1000 a channel", "asked_points": n, "variant": variant, "roofline_bytes_per_point": 200.0}
                | cost
            )
    rows.append({"case": "one channel", "asked_points": 300, "points": 300, "ms_per_step": 0.02, "ns_per_point": 66.0})
    for phase in plot.PHASES:
        rows.append({"case": "phase", "asked_points": 10_000, "phase": phase, "ns_per_point": 10.0})
        if phase not in ("join", "rest of host"):
            rows[-1] |= {"roofline_bytes_per_point": 60.0, "ratio_to_roofline": 3.3}
    rows.append({"case": "meanderpy", "asked_points": 300, "meanderpy_ms": 2.0, "ours_ms": 0.02, "ratio": 100.0})
    return HEAD | {"benchmark": "step", "rows": rows, "exponents": {"cutoffs": 1.0}}


def network_result():
    rows = []
    for channels in (1, 10, 100):
        cost = {
            "channels": channels,
            "points": 100 * channels,
            "ms_per_step": 0.01 * channels,
            "migration_ms": 0.005 * channels,
        }
        rows.append({"case": "drawn lengths", "asked_channels": channels, "mean_points": 100} | cost)
    for case in ("extracted", "extracted x 4"):
        rows.append(
            {"case": case, "channels": 50, "points": 9000, "ms_per_step": 3.0, "substeps": 2, "ratio_to_migration": 2.6}
        )
    for phase in plot.PHASES:
        rows.append({"case": "extracted, phase", "phase": phase, "ms_per_step": 0.5, "times_migrate": 1.0})
    rows.append({
        "case": "long run", "steps": 6, "years": 2.0, "seconds": 1.0, "threads": 1, "channels_before": 50,
        "histogram_ms": [1.0, 2.0, 4.0], "histogram": {"with": [0, 2], "without": [4, 0]},
    })  # fmt: skip
    fit = {"us_per_step": 5.0, "ns_per_point": 90.0, "ns_per_channel": 1000.0, "largest_relative_error": 0.1}
    return HEAD | {"benchmark": "network", "rows": rows, "fit": fit}


@pytest.fixture
def folder(tmp_path):
    for name, result in (("step", step_result()), ("network", network_result())):
        (tmp_path / f"{name}-cpu.json").write_text(json.dumps(result))
    return tmp_path


def test_every_picture_is_drawn(folder):
    assert plot.main([str(folder), "-o", str(folder / "pictures")]) == 0
    drawn = sorted((folder / "pictures").glob("*.png"))
    assert [p.stem for p in drawn] == [f"{n}-cpu" for n in ("channels", "phases", "points", "roofline", "run")]
    for path in drawn:
        picture = matplotlib.image.imread(path)
        assert picture.shape[1] >= 800 and picture[..., :3].std() > 0.03, path


def test_the_table_has_the_figures_and_tells_which_goals_are_met(folder, capsys):
    assert table.main([str(folder)]) == 0
    said = capsys.readouterr().out
    assert "| points | 1,000 | 10,000 | 100,000 |" in said
    assert "| with cutoffs, ns per point and step | 60 | 60 | 60 |" in said
    assert "1/100 of meanderpy's time at 300 points" in said and "20.0 GB/s" in said
    assert table.main([str(folder), "--goals"]) == 0
    said = capsys.readouterr().out
    assert "| ns a point, 10,000 points, cutoffs on | <= 70 | 60 | yes |" in said
    assert "| rivers of terrains, 50 channels, 9,000 points: the same | <= 2.5 | 2.6 | NO |" in said
    assert "| meanderpy over ours, 300 points | >= 100 | 100 | yes |" in said
    assert "| ns a point, 10,000,000 points, cutoffs on | <= 90 | not measured |  |" in said


def test_a_folder_without_results(tmp_path, capsys):
    assert plot.main([str(tmp_path)]) == 1 and table.main([str(tmp_path)]) == 1
    (tmp_path / "step-cpu.json").write_text('{"benchmark": "step", "sizes": []}')
    assert plot.main([str(tmp_path)]) == 1
    assert "older version" in capsys.readouterr().err
