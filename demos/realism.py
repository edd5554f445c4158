"""What makes a river believable: each option off, as by default and strong, one row an option, the rest left alone."""

import sys
from pathlib import Path

import matplotlib.image
import numpy as np

import warpriver as wr

WIDTH, YEARS = 100.0, 1000.0
WINDOW = (-1_000.0, -5_000.0, 19_000.0, 5_000.0)  # m
OPTIONS = {
    "curvature_saturation": (0.0, 0.3, 0.1),
    "memory_length": (1.2, 2.2, 4.0),
    "inlet_curvature": (0.0, 0.1, 0.3),
    "bank_spread": (0.0, 0.6, 1.0),
}


def simulate(params: wr.MeanderParams) -> wr.History:
    line = wr.generate.noisy_line(25_000.0, spacing=50.0, amplitude=20.0, seed=3)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=WIDTH), params, seed=2)
    return sim.run(years=YEARS, record_every=wr.Every(years=20))


def draw(history: wr.History, folder: Path, title: str) -> np.ndarray:
    picture = folder / "option.png"
    wr.viz.draw_belt(history, picture, window=WINDOW, title=title, size=(800, 450), dpi=80.0, legend=False)
    image = matplotlib.image.imread(picture)
    picture.unlink()
    return image


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rows, told = [], {}
    usual = simulate(wr.MeanderParams())
    middle = draw(usual, folder, "all as by default")
    for option, values in OPTIONS.items():
        row = []
        for value in values:
            is_default = value == getattr(wr.MeanderParams(), option)
            history = usual if is_default else simulate(wr.MeanderParams(**{option: value}))
            found = told[option, value] = wr.metrics.statistics(history)
            print(
                f"{option} {value:g}: {found.bends:.0f} bends of {found.bend_length:.1f} w, R {found.radius:.1f} w, "
                f"straight below the head {found.straight_below_head:.0f} w, {found.oxbows:.0f} oxbows"
            )
            row.append(middle if is_default else draw(history, folder, f"{option.replace('_', ' ')} {value:g}"))
        rows.append(np.concatenate(row, axis=1))
    matplotlib.image.imsave(folder / "realism.png", np.concatenate(rows))
    print(f"drawn into {folder / 'realism.png'}")

    usual = told["bank_spread", 0.6]
    assert 8.0 < usual.bend_length < 16.0 and 2.2 < usual.radius < 4.0 and usual.straight_below_head < 30.0
    assert told["inlet_curvature", 0.0].straight_below_head > 30.0, "nothing grows below a head that nothing disturbs"
    assert told["bank_spread", 0.0].bend_length > usual.bend_length, "strong banks cut long bends up"
    short, _, long = (told["memory_length", value].bend_length for value in OPTIONS["memory_length"])
    assert short < long, "a longer memory makes longer bends"


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
