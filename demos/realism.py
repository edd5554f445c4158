"""What makes a river believable: each option off, as by default and strong, one row an option, the rest left alone.

``python demos/realism.py FOLDER chutes widths`` draws these options only.
"""

import sys
from pathlib import Path

import matplotlib.image
import numpy as np

import warpriver as wr

WIDTH, YEARS = 100.0, 800.0
WINDOW = (-1_000.0, -5_000.0, 19_000.0, 5_000.0)  # m
# The law and the banks: constants that are neutral and strong, or short and long, on both sides of the default.
OPTIONS = {
    "curvature_saturation": (0.0, 0.1),
    "memory_length": (1.2, 4.0),
    "inlet_curvature": (0.0, 0.3),
    "inlet_wavelength": (6.0, 60.0),
    "bank_spread": (0.0, 1.0),
    "bank_correlation": (1.0, 12.0),
    "sinuosity_scaling": ("none", "upstream"),
    "cutoff_distance": (1.0, 3.0),
}
# Events and what they leave, seen from nearer and for fewer years: each alone, beside what is as by default.
NEAR, SHORT, FEWER_YEARS = (3_000.0, -2_250.0, 12_000.0, 2_250.0), 14_000.0, 400.0  # m, m, yr
ALONE = wr.FloodplainParams(plug_factor=1.0, bar_factor=1.0, unrest=0.0)
EVENTS = {
    "inlet": [(rule, rule) for rule in ("none", "edge", "periodic")],
    "clay plugs": [(f"factor {v:g}", ALONE.replace(plug_factor=v)) for v in (1.0, 0.3, 0.05)],
    "young bars": [(f"factor {v:g}", ALONE.replace(bar_factor=v)) for v in (1.0, 1.5, 4.0)],
    "unrest near cutoffs": [(f"{v:g}", ALONE.replace(unrest=v)) for v in (0.0, 1.0, 4.0)],
    "chutes": [(f"{v:g} a year", wr.ChuteParams(rate=v)) for v in (0.0, 0.002, 0.01)],
    "widths": [(f"lag {v:g}", wr.WidthParams(lag=v)) for v in (0.0, 0.3, 0.6)],
}
FIELDS = {str: "inlet", wr.FloodplainParams: "floodplain", wr.ChuteParams: "chutes", wr.WidthParams: "widths"}


def simulate(params: wr.MeanderParams, length: float = 25_000.0, years: float = YEARS) -> wr.History:
    line = wr.generate.noisy_line(length, spacing=50.0, amplitude=20.0, seed=3)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=WIDTH), params.replace(spacing=WIDTH), seed=2)
    return sim.run(years=years, record_every=wr.Every(years=20))


def draw(history: wr.History, folder: Path, title: str, window: tuple[float, ...] = WINDOW) -> np.ndarray:
    picture = folder / "option.png"
    wr.viz.draw_belt(history, picture, window=window, title=title, size=(640, 360), dpi=80.0, legend=False)
    image = matplotlib.image.imread(picture)
    picture.unlink()
    return image


def save(path: Path, rows: list[np.ndarray]) -> None:
    """Rows of pictures, one below the other."""
    image = np.concatenate(rows)[..., :3]
    matplotlib.image.imsave(path, image, pil_kwargs={"quality": 55, "optimize": True})


def draw_law(folder: Path, options: set[str]) -> None:
    rows, told = [], {}
    usual = simulate(wr.MeanderParams())
    middle = draw(usual, folder, "all as by default")
    for option, (least, most) in OPTIONS.items():
        if option not in options:
            continue
        row, default = [], getattr(wr.MeanderParams(), option)
        for value in (least, default, most):
            is_default = value == default
            history = usual if is_default else simulate(wr.MeanderParams(**{option: value}))
            found = told[option, value] = wr.metrics.statistics(history)
            print(
                f"{option} {value}: {found.bends:.0f} bends of {found.bend_length:.1f} w, R {found.radius:.1f} w, "
                f"straight below the head {found.straight_below_head:.0f} w, {found.oxbows:.0f} oxbows"
            )
            row.append(middle if is_default else draw(history, folder, f"{option.replace('_', ' ')} {value}"))
        rows.append(np.concatenate(row, axis=1))
    save(folder / "realism.jpg", rows)

    usual = wr.metrics.statistics(usual)
    assert 8.0 < usual.bend_length < 16.0 and 2.0 < usual.radius < 4.0 and usual.straight_below_head < 30.0
    if "inlet_curvature" in options:
        straight = told["inlet_curvature", 0.0].straight_below_head
        assert straight > 30.0, "nothing grows below a head that nothing disturbs"
    if "bank_spread" in options:
        assert told["bank_spread", 0.0].radius > usual.radius, "bends are tight where banks differ"
    for option in {"memory_length", "bank_correlation"} & options:
        short, long = (told[option, value].bend_length for value in OPTIONS[option])
        assert short < long, f"a longer {option} makes longer bends"


def draw_events(folder: Path, options: set[str]) -> None:
    rows, told = [], {}
    usual = simulate(wr.MeanderParams(), SHORT, FEWER_YEARS)
    for option, values in EVENTS.items():
        if option not in options:
            continue
        row = []
        for label, value in values:
            # The first of each are neutral, and bring the same river.
            is_usual = value == ("edge" if option == "inlet" else values[0][1])
            params = wr.MeanderParams(**{FIELDS[type(value)]: value})
            history = usual if is_usual else simulate(params, SHORT, FEWER_YEARS)
            width = history.networks[-1].point_widths()[0]
            found = wr.metrics.statistics(history)
            told[option, label] = found, width
            print(
                f"{option}, {label}: {found.oxbows:.0f} oxbows of {found.oxbow_length:.0f} w, "
                f"{sum(cutoff.chute for cutoff in history.cutoffs)} by chutes; sinuosity {found.sinuosity:.2f}, "
                f"widths {width.min():.0f} to {width.max():.0f} m"
            )
            row.append(draw(history, folder, f"{option}: {label}", NEAR))
        rows.append(np.concatenate(row, axis=1))
    save(folder / "realism_events.jpg", rows)

    if "inlet" in options:
        assert told["inlet", "periodic"][0].straight_below_head < 30.0 < told["inlet", "none"][0].straight_below_head
    if "chutes" in options:
        assert told["chutes", "0.01 a year"][0].oxbow_length < 0.8 * told["chutes", "0 a year"][0].oxbow_length
    if "widths" in options:
        assert np.ptp(told["widths", "lag 0"][1]) == 0.0 and np.ptp(told["widths", "lag 0.3"][1]) > 0.2 * WIDTH


def main(folder: Path, *options: str) -> None:
    every = {*OPTIONS, *EVENTS}
    chosen = set(options) or every
    if not chosen <= every:
        raise SystemExit(f"no option {', '.join(sorted(chosen - every))}; there are {', '.join(sorted(every))}")
    folder.mkdir(parents=True, exist_ok=True)
    for draw_rows, rows in ((draw_law, OPTIONS), (draw_events, EVENTS)):
        if chosen & set(rows):
            draw_rows(folder, chosen)
    print(f"drawn into {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"), *sys.argv[2:])
