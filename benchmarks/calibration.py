"""What calibration is worth on dated rivers, and what it costs: six reaches in turn, forecasts of the Mamore, time.

The data lie in ``shared/data`` beside the checkout, or where WARPRIVER_DATA says. With ``--rivabar`` the forecasts have
rivabar's beside them, from the same surveys, offsets and scored points (pip install rivabar).
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from datetime import date
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from machine import machine, write_result

import warpriver as wr
from warpriver.calibration.fits import measured_law
from warpriver.calibration.hindcasts import nearest_distances
from warpriver.calibration.observed import observe, survey

DATA = Path(os.environ.get("WARPRIVER_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
REACHES = {
    "jurua": ("19871012", "20170710"),
    "jutai": ("19890805", "20170802"),
    "mamore": ("19861105", "19890708"),
    "purus": ("19870701", "20170804"),
    "tarauaca": ("20070729", "20170724"),
    "tarauaca_jurua": ("20070729", "20170724"),
}
# Dated thirty or ten years apart: long enough to be simulated.
LONG = ("jurua", "jutai", "purus", "tarauaca")
MAMORE, MAMORE_WIDTH = [year for year in range(1986, 2007) if year != 2002], 390.0
LAW = measured_law()
# Known constants, and how far off the points of the lines are, m.
TRUE = {"migration_rate": 20.0, "memory_length": 2.5, "curvature_saturation": 0.2}
NOISES = (0.0, 5.0)


def surveys_of(reach: str, device: str) -> tuple[wr.RiverNetwork, wr.RiverNetwork, float]:
    """Two surveys and the years between them."""
    days = [date(int(day[:4]), int(day[4:6]), int(day[6:])) for day in REACHES[reach]]
    networks = [
        wr.read_network(DATA / "centerlines" / f"{reach}_{day}.csv.gz", device=device) for day in REACHES[reach]
    ]
    return networks[0], networks[1], (days[1] - days[0]).days / 365.25


def rate_correlation(fit: wr.calibration.Fit, params: wr.MeanderParams) -> float:
    """Pearson's r of the rates of the first survey by other constants and the displacements of a fit."""
    network = wr.RiverNetwork.from_polylines([fit.xy], width=[fit.width])
    rate = -wr.meander.migration_rate(network, params)[0]
    return float(np.corrcoef(rate[fit.scored], fit.observed[fit.scored])[0, 1])


def measure_reaches(device: str) -> list[dict]:
    """Each reach by its own constants, and by the memory and saturation of the five others."""
    fits, rows = {}, []
    for reach in REACHES:
        before, after, years = surveys_of(reach, device)
        wr.calibrate(before, after, years, fit=["migration_rate"])  # kernels are loaded
        begin = time.perf_counter()
        fits[reach] = wr.calibrate(before, after, years)
        spent = time.perf_counter() - begin
        length = float(wr.metrics.arc_length(fits[reach].xy)[-1]) / 1e3
        rows.append({"reach": reach, "years": years, "km": length, "points": len(fits[reach].xy), "seconds": spent})
    for row in rows:
        fit = fits[row["reach"]]
        others = [f.constants for name, f in fits.items() if name != row["reach"]]
        setting = {
            name: float(np.exp(np.mean([np.log(constants[name]) for constants in others])))
            for name in ("memory_length", "curvature_saturation")
        }
        before, after, years = surveys_of(row["reach"], device)
        # The rate alone is the reach's own: r of a simulation depends a little on it.
        left_out = wr.calibrate(before, after, years, params=LAW.replace(**setting), fit=["migration_rate"])
        row |= fit.constants
        row |= {
            "r": fit.correlation,
            "skill": fit.skill,
            "scored": float(fit.scored.mean()),
            "offset": float(np.hypot(*fit.offset)),
            "r_left_out": left_out.correlation,
            "r_left_out_rates": rate_correlation(left_out, left_out.params),
        }
        halves = wr.hindcast([before, after], [0.0, years], split="reach").forecasts
        row["r_other_half"] = float(np.mean([f.correlation for f in halves]))
        row["coverage_other_half"] = float(np.mean([f.coverage for f in halves]))
        print(
            f"{row['reach']:15} r {row['r']:.3f}; by the others {row['r_left_out']:.3f}, by rates alone "
            f"{row['r_left_out_rates']:.3f}; by the other half {row['r_other_half']:.3f}; "
            f"{row['km']:.0f} km in {row['seconds']:.1f} s",
            flush=True,
        )
    for name, kept in (("all six", REACHES), ("long four", LONG)):
        means = {
            key: float(np.mean([row[key] for row in rows if row["reach"] in kept]))
            for key in ("r", "r_left_out", "r_left_out_rates", "r_other_half", "coverage_other_half")
        }
        print(f"{name}: " + ", ".join(f"{key} {value:.3f}" for key, value in means.items()), flush=True)
        rows.append({"reach": name, **means})
    return rows


def measure_forecasts(device: str, peer: bool) -> list[dict]:
    """What the forecasts of the yearly Mamore are worth."""
    begin = time.perf_counter()
    networks, past = hindcast_of_the_mamore(device)
    spent = time.perf_counter() - begin
    print(past, f"\n{spent:.0f} s", flush=True)
    rows = []
    for lead in past.leads:
        score = past.score(lead)
        rows.append({"lead": lead, "forecasts": score.count, "distance": score.distance, "no_change": score.no_change,
                     "linear": score.linear, "coverage": score.coverage, "seconds": spent})  # fmt: skip
        if peer:
            begins = [f for f in past.forecasts if past.nearest_lead(f.lead) == lead]
            found = [forecast_by_rivabar(networks, f.begin, f.end) for f in begins]
            rows[-1]["rivabar"] = float(np.mean(found))
            print(f"{lead:g} yr: rivabar {rows[-1]['rivabar']:.1f} m", flush=True)
    return rows


def forecast_by_rivabar(networks: list[wr.RiverNetwork], begin: float, end: float) -> float:
    """Mean distance of rivabar's forecast with a local rate, fitted to the last five years before it begins."""
    from rivabar.prediction import calibrate_local_kl, predict_forward_local

    at = MAMORE.index(int(begin))
    back = max(k for k, year in enumerate(MAMORE) if year <= begin - 5.0)
    old, now, target = (survey(networks[k], "", 0.5) for k in (back, at, MAMORE.index(int(end))))
    years = begin - MAMORE[back]
    seen = observe(old, now, years)
    xy = old.lines.xy
    fitted = calibrate_local_kl(
        wr.metrics.curvature(xy), np.nan_to_num(seen.displacement) / years, wr.metrics.arc_length(xy), MAMORE_WIDTH,
        mask=seen.scored,
    )  # fmt: skip
    fitted["kl_local_full"], fitted["s_full"] = fitted["kl_local"], fitted["s"]
    x, y = now.lines.xy.T
    half = np.full(len(x), 0.5 * MAMORE_WIDTH)
    edge = {"geometry": SimpleNamespace(xy=(x, y)), "half_widths": {0: half, 1: half}}
    river = SimpleNamespace(main_path=[(0, 1, 0)], _D_primal={0: {1: {0: edge}}})
    made = predict_forward_local(
        river, fitted, delta_s=100.0, smoothing_factor=0.0, pixel_size=1.0, prediction_years=end - begin
    )
    scored = observe(target, now, end - begin).scored
    line = np.column_stack([made["predicted_x"], made["predicted_y"]])
    return float(nearest_distances(target.lines.xy[scored], [line]).mean())


def draw(folder: Path, device: str) -> None:
    """The pictures of the documents: the Purus, and the forecasts of the Mamore."""
    folder.mkdir(parents=True, exist_ok=True)
    fit = wr.calibrate(*surveys_of("purus", device))
    wr.viz.draw_fit(fit, folder / "calibration_fit.png", dpi=90)
    wr.viz.draw_fit_map(fit, folder / "calibration_map.png", dpi=90)
    wr.viz.draw_hindcast(hindcast_of_the_mamore(device)[1], folder / "calibration_forecasts.png", dpi=110)


def hindcast_of_the_mamore(device: str) -> tuple[list[wr.RiverNetwork], wr.calibration.Hindcast]:
    """The yearly lines, and forecasts from every start that has five years before it."""
    folder = DATA / "mamore_series"
    networks = [wr.read_network(folder / f"mamore_{y}.csv.gz", width=MAMORE_WIDTH, device=device) for y in MAMORE]
    return networks, wr.hindcast(networks, MAMORE)


def measure_recovery(device: str) -> list[dict]:
    """A river that is known, and what calibration makes of its lines."""
    law, rows = LAW.replace(**TRUE), []
    for width, length, warm in ((100.0, 40_000.0, 500.0), (200.0, 80_000.0, 900.0)):
        start = wr.RiverNetwork.from_polylines(
            [wr.generate.noisy_line(length, 25.0, 0.5 * width, 3)], width=width, device=device
        )
        first = wr.Simulation(start, law)
        first.run(years=warm, record_every=10**6)
        then = wr.Simulation(first.network, law)
        then.run(years=20.0, record_every=10**6)
        for noise in NOISES:
            rng = np.random.default_rng(1)
            surveys = [
                wr.RiverNetwork.from_polylines([xy + noise * rng.standard_normal(xy.shape)], width=width, device=device)
                for xy in (first.network.polylines()[0], then.network.polylines()[0])
            ]
            fit = wr.calibrate(*surveys, then.time)
            off = {name: fit.constants[name] / value - 1.0 for name, value in TRUE.items()}
            print(f"width {width:g} m, {noise:g} m off: " + ", ".join(f"{n} {100 * v:+.1f} %" for n, v in off.items()))
            rows.append({"width": width, "noise": noise, **off})
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    parser.add_argument("--rivabar", action="store_true", help="forecasts of rivabar beside ours")
    parser.add_argument("--only", choices=("recovery", "reaches", "forecasts"), nargs="+", help="some of them")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="draw the pictures of the documents as well")
    parser.add_argument("-o", "--out", type=Path, help="JSON file for the results (default benchmarks/results)")
    options = parser.parse_args()
    wanted = options.only or ["recovery", "reaches", "forecasts"]
    if not DATA.is_dir() and wanted != ["recovery"]:
        print(f"no data in {DATA}; set WARPRIVER_DATA to the folder that holds centerlines and mamore_series")
        wanted = ["recovery"]
    result = {"machine": machine(options.device, ["rivabar"] if options.rivabar else [])}
    if "recovery" in wanted:
        result["recovery"] = measure_recovery(options.device)
    if "reaches" in wanted:
        result["reaches"] = measure_reaches(options.device)
    if "forecasts" in wanted:
        result["forecasts"] = measure_forecasts(options.device, options.rivabar)
    if options.pictures is not None:
        draw(options.pictures, options.device)
    write_result(result, options.out, f"calibration-{options.device.split(':')[0]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
