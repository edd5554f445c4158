"""Two ways to a meander belt from the same line: migration by upstream curvature, and shortest paths."""

import sys
from pathlib import Path

import matplotlib.image
import numpy as np

import warpriver as wr

WIDTH, YEARS = 100.0, 500.0
WINDOW = (-1_500.0, -4_500.0, 31_500.0, 4_500.0)  # the same part of the plain for both, m


def simulate(params, folder: Path, title: str) -> tuple[wr.History, np.ndarray]:
    """Run one solver from the line that both begin with; its history and the picture of its belt."""
    line = wr.generate.noisy_line(30_000.0, spacing=50.0, amplitude=50.0, seed=0)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=WIDTH), params)
    history = sim.run(years=YEARS, record_every=wr.Every(years=5))
    picture = folder / "belt.png"
    wr.viz.draw_belt(history, picture, window=WINDOW, title=title, dpi=100.0)
    image = matplotlib.image.imread(picture)
    picture.unlink()
    return history, image


def grown_means(history: wr.History) -> tuple[float, float]:
    """Mean sinuosity and wavelength in m over the second half of a run."""
    lines = [network.polylines()[0] for network in history.networks[len(history) // 2 :]]
    return (
        float(np.mean([wr.metrics.sinuosity(xy) for xy in lines])),
        float(np.mean([wr.metrics.wavelength(xy, WIDTH) for xy in lines])),
    )


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    solvers = {"migration": wr.MeanderParams(), "shortest paths": wr.PathMeander()}
    histories, images = {}, []
    for name, params in solvers.items():
        histories[name], image = simulate(params, folder, f"By {name}, {YEARS:.0f} years")
        images.append(image)
    matplotlib.image.imsave(folder / "shortest_path.png", np.concatenate(images))

    for name, history in histories.items():
        sinuosity, wavelength = grown_means(history)
        loops = [float(np.hypot(*np.diff(c.xy, axis=0).T).sum()) / WIDTH for c in history.cutoffs]
        print(
            f"{name}: sinuosity {sinuosity:.2f}, wavelength {wavelength / WIDTH:.1f} widths, "
            f"{len(loops)} oxbows of {np.exp(np.mean(np.log(loops))):.0f} widths"
        )
        assert 2.0 < sinuosity < 3.8 and len(loops) > 10
    print(f"drawn into {folder / 'shortest_path.png'}")

    history = histories["shortest paths"]
    assert 8.0 < grown_means(history)[1] / WIDTH < 13.0
    ends = [network.polylines()[0][[0, -1]] for network in history.networks]
    assert all((e == ends[0]).all() for e in ends), "the pinned ends do not move at all"
    assert all((c.xy[0] == c.xy[-1]).all() for c in history.cutoffs), "every oxbow is a closed loop"


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
