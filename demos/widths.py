"""Wider rivers make longer bends: three widths, the same noise, 400 years [Paris2023, Fig. 10]."""

import sys
from pathlib import Path

import numpy as np

import warpriver as wr

WIDTHS = (50.0, 100.0, 200.0)  # m


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        wr.generate.noisy_line(40_000.0, spacing=50.0, amplitude=width, seed=1) - [0.0, 7_000.0 * k]
        for k, width in enumerate(WIDTHS)
    ]
    sim = wr.Simulation(wr.RiverNetwork.from_polylines(lines, width=list(WIDTHS)))
    history = sim.run(years=400, record_every=wr.Every(years=6))
    print(sim)

    wr.viz.draw_belt(history, folder / "widths.png", title="50, 100 and 200 m wide, 400 years")
    waves = []
    for width, xy in zip(WIDTHS, sim.network.polylines(), strict=True):
        waves.append(wr.metrics.wavelength(xy, width))
        print(f"width {width:3.0f} m: sinuosity {wr.metrics.sinuosity(xy):.2f}, wavelength {waves[-1]:5.0f} m")
    print(f"drawn into {folder / 'widths.png'}")

    assert np.all(np.diff(waves) > 0.0), "a wider river has longer bends"
    assert all(1.5 < wr.metrics.sinuosity(xy) < 4.0 for xy in sim.network.polylines())


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
