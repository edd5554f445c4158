"""Bends move downstream: the bank moves by the curvature upstream of it, so erosion peaks past the apex."""

import sys
from pathlib import Path

import numpy as np

import warpriver as wr

WIDTH = 100.0  # m


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    start = wr.generate.sine_generated(wavelength=1600.0, angle=1.0, wavelengths=8, spacing=25.0)
    # All bends alike: neither banks of their own nor what enters upstream.
    params = wr.MeanderParams(spacing=25.0, time_step=0.1, bank_spread=0.0, inlet="none")
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([start], width=WIDTH), params)
    history = sim.run(years=60, record_every=wr.Every(years=3))
    print(sim)
    wr.viz.draw_belt(history, folder / "downstream.png", title="Eight bends, 60 years")

    before, after = history.networks[0].polylines()[0], history.networks[1].polylines()[0]
    rate = wr.metrics.migration(before, after, years=history.times[1])
    curvature = wr.metrics.curvature(before)
    inner = slice(len(before) // 4, -len(before) // 4)  # away from the held ends
    # The bends repeat every wavelength, so a lag is only told apart within half a bend.
    lag = wr.metrics.lag(curvature[inner], rate[inner], spacing=params.spacing, max_lag=600.0)
    apex = [float(np.median(wr.metrics.inflection_points(n.polylines()[0], WIDTH).xy[:, 0])) for n in history.networks]
    celerity = (apex[5] - apex[0]) / history.times[5]
    print(f"the bank moves fastest {lag:.0f} m ({lag / WIDTH:.1f} widths) past the apex")
    print(f"the bends move downstream by {celerity:.0f} m a year; drawn into {folder / 'downstream.png'}")

    assert 0.0 < lag < 6.0 * WIDTH
    assert celerity > 0.0


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
