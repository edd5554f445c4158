"""A river of your own: read its line, let it migrate for two centuries, draw what it leaves.

Call it as `python demos/real_river.py FOLDER river.csv WIDTH`; without a file it makes a river up and reads that.
"""

import sys
from pathlib import Path

import numpy as np

import warpriver as wr


def synthetic_river(folder: Path) -> Path:
    """Write a wandering river of varying width, as a survey would give it."""
    xy = wr.generate.valley_line(20_000.0, spacing=40.0, amplitude=600.0, wavelength=6_000.0, seed=2)
    width = 80.0 + 15.0 * np.sin(np.linspace(0.0, 20.0, len(xy)))
    network = wr.RiverNetwork.from_polylines([xy + [600_000.0, 200_000.0]], width=[width], crs="EPSG:32619")
    wr.write_network(network, folder / "synthetic_river.csv")
    return folder / "synthetic_river.csv"


def main(folder: Path, source: Path | None = None, width: float | None = None) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    network = wr.read_network(source or synthetic_river(folder), width=width)
    print(network)
    narrowest = min(float(w.min()) for w in network.point_widths())
    sim = wr.Simulation(network, wr.MeanderParams(spacing=min(50.0, narrowest)))
    history = sim.run(years=200, record_every=wr.Every(years=2), progress=True)
    wr.viz.draw_belt(history, folder / "real_river.png")
    wr.write_network(sim.network, folder / "after_200_years.csv")

    before, after = (n.polylines()[0] for n in (history.networks[0], history.networks[-1]))
    print(f"sinuosity {wr.metrics.sinuosity(before):.2f} -> {wr.metrics.sinuosity(after):.2f}, {history!r}")
    print(f"drawn into {folder / 'real_river.png'}")

    assert history.stop_reason is wr.history.StopReason.COMPLETED
    assert np.isfinite(after).all() and (after[[0, -1]] == before[[0, -1]]).all()
    assert sim.network.crs == network.crs


if __name__ == "__main__":
    given = sys.argv[1:] + ["out/demos"][len(sys.argv) - 1 :]
    main(Path(given[0]), Path(given[1]) if len(given) > 1 else None, float(given[2]) if len(given) > 2 else None)
