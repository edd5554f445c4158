"""What each knob of the shortest-path solver does: one row a knob, low, default and high, the rest left alone.

``python demos/path_knobs.py FOLDER cone_angle smoothing`` draws these knobs only.
"""

import sys
from pathlib import Path

import matplotlib.image
import numpy as np

import warpriver as wr

WIDTH, YEARS = 100.0, 350.0
WINDOW = (-1_000.0, -3_000.0, 13_000.0, 3_000.0)  # m
KNOBS = {
    "displacement_rate": (20.0, 60.0, 120.0),
    "smoothing": (0.2, 0.35, 0.5),
    "blur_length": (1.0, 1.5, 2.2),
    "search_radius": (1.0, 1.5, 3.0),
    "cone_angle": (5.0, 45.0, 90.0),
    "downstream_share": (0.2, 0.9, 1.5),
}


def simulate(params: wr.PathMeander) -> wr.History:
    line = wr.generate.noisy_line(12_000.0, spacing=50.0, amplitude=50.0, seed=3)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=WIDTH), params)
    return sim.run(years=YEARS, record_every=wr.Every(years=10))


def draw(history: wr.History, folder: Path, title: str) -> np.ndarray:
    picture = folder / "knob.png"
    wr.viz.draw_belt(history, picture, window=WINDOW, title=title, size=(800, 450), dpi=80.0, legend=False)
    image = matplotlib.image.imread(picture)
    picture.unlink()
    return image


def main(folder: Path, *knobs: str) -> None:
    chosen = set(knobs) or set(KNOBS)
    if not chosen <= set(KNOBS):
        raise SystemExit(f"no knob {', '.join(sorted(chosen - set(KNOBS)))}; there are {', '.join(KNOBS)}")
    folder.mkdir(parents=True, exist_ok=True)
    rows, oxbows, wave, neck = [], {}, {}, {}
    usual = simulate(wr.PathMeander())
    middle = draw(usual, folder, "all as by default")
    for knob, values in KNOBS.items():
        if knob not in chosen:
            continue
        row = []
        for value in values:
            is_default = value == getattr(wr.PathMeander(), knob)
            history = usual if is_default else simulate(wr.PathMeander(**{knob: value}))
            oxbows[knob, value] = len(history.cutoffs)
            grown = [wr.metrics.wavelength(n.polylines()[0], WIDTH) for n in history.networks[-10:]]
            wave[knob, value] = np.mean(grown)
            print(f"{knob} {value:g}: wavelength {wave[knob, value]:.0f} m, {oxbows[knob, value]} oxbows", end="")
            if history.cutoffs:
                neck[knob, value] = np.mean([np.hypot(*(c.xy[-1] - c.xy[-2])) for c in history.cutoffs])
                print(f", cut where strands are {neck[knob, value]:.0f} m apart", end="")
            print()
            title = f"{knob.replace('_', ' ')} {value:g}"
            row.append(middle if is_default else draw(history, folder, title))
        rows.append(np.concatenate(row, axis=1))
    matplotlib.image.imsave(folder / "path_knobs.png", np.concatenate(rows))
    print(f"drawn into {folder / 'path_knobs.png'}")

    if "displacement_rate" in chosen:
        rate = [oxbows["displacement_rate", v] for v in KNOBS["displacement_rate"]]
        assert rate[0] < rate[1] < rate[2], "a stronger push cuts sooner"
    for knob, order in (("cone_angle", "a wider cone"), ("search_radius", "a longer reach")):
        if knob in chosen:
            low, middle, high = (neck[knob, v] for v in KNOBS[knob])
            assert low < middle <= high + 1.0, f"{order} joins strands sooner"
    for knob in {"smoothing", "blur_length"} & chosen:
        low, middle, high = (wave[knob, v] for v in KNOBS[knob])
        assert low < middle < high, f"more {knob} makes longer bends"


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"), *sys.argv[2:])
