"""Migration, shortest paths and rings side by side: both solvers from the same line, and from the same ring.

Upper row: migration by upstream curvature; lower row: the curvature pushes, shortcuts join near strands, the shortest
path is the channel. On the right the river has no ends: its necks split the ring, and the longer part goes on.
"""

import sys
from pathlib import Path

import matplotlib.image
import numpy as np

import warpriver as wr

WIDTH, SPACING, YEARS = 60.0, 40.0, 300.0  # m, m, yr
LENGTH, RADIUS = 13_500.0, 2_000.0  # m, of the line and of the ring
# As large parts of the plain in all four, m: (west, south, east, north), and pixels.
LINE_WINDOW, LINE_SIZE = (-600.0, -3_600.0, 15_600.0, 3_600.0), (1500, 780)
RING_WINDOW, RING_SIZE = (-3_600.0, -3_600.0, 3_600.0, 3_600.0), (700, 780)
SOLVERS = {
    "Migration": wr.MeanderParams(spacing=SPACING, ring_policy="longer"),
    "Shortest paths": wr.PathMeander(spacing=SPACING, ring_policy="longer"),
}


def noisy_ring(seed: int) -> np.ndarray:
    """A circle with bumps of 3 to 60 waves round it, (n, 2) m; its first point is not repeated."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(round(2.0 * np.pi * RADIUS / SPACING)) / round(2.0 * np.pi * RADIUS / SPACING)
    bumps = sum(rng.normal(0.0, 15.0) * np.cos(k * angle + rng.uniform(0.0, 6.0)) for k in range(3, 60))
    return (RADIUS + bumps)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def simulate(params, xy: np.ndarray, closed: bool) -> wr.History:
    network = wr.RiverNetwork.from_polylines([xy], width=WIDTH, closed=closed)
    return wr.Simulation(network, params).run(years=YEARS, record_every=wr.Every(years=4))


def draw(history: wr.History, folder: Path, title: str, closed: bool) -> np.ndarray:
    """Draw a belt and return the picture."""
    picture = folder / "belt.png"
    window, size = (RING_WINDOW, RING_SIZE) if closed else (LINE_WINDOW, LINE_SIZE)
    wr.viz.draw_belt(history, picture, window=window, size=size, dpi=110.0, title=title)
    image = matplotlib.image.imread(picture)
    picture.unlink()
    return image


def measure(history: wr.History, closed: bool) -> tuple[float, float, float]:
    """Mean sinuosity and wavelength, in widths, over the second half of a run; geometric mean of loops in widths."""
    lines = [network.polylines()[0] for network in history.networks[len(history) // 2 :]]
    sinuosity = np.mean([wr.metrics.sinuosity(xy, closed) for xy in lines])
    wave = np.mean([wr.metrics.wavelength(xy, WIDTH, closed=closed) for xy in lines]) / WIDTH
    loops = wr.metrics.oxbow_lengths(history.cutoffs) / WIDTH
    return float(sinuosity), float(wave), float(np.exp(np.mean(np.log(loops))))


def check(history: wr.History, sinuosity: float, wave: float, closed: bool) -> None:
    """What must hold of each of the four."""
    assert history.stop_reason is wr.history.StopReason.COMPLETED and len(history.cutoffs) > 5
    assert 1.7 < sinuosity < 3.8 and 7.0 < wave < 30.0
    first, last = (history.networks[k].polylines()[0] for k in (0, -1))
    if closed:
        assert history.networks[-1].channel_closed.all() and np.hypot(*(last[0] - last[-1])) < 2.0 * SPACING
        radius = np.hypot(*(last - last.mean(axis=0)).T).mean()
        print(f"    mean radius {RADIUS:.0f} -> {radius:.0f} m")
        assert 0.7 * RADIUS < radius < 1.4 * RADIUS, "it neither shrinks away nor runs off"
    else:
        assert (first[[0, -1]] == last[[0, -1]]).all(), "the pinned ends do not move at all"
    if isinstance(history.params, wr.PathMeander):
        assert all((c.xy[0] == c.xy[-1]).all() for c in history.cutoffs), "every oxbow is a closed loop"


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    starts = {
        False: wr.generate.noisy_line(LENGTH, spacing=SPACING, amplitude=0.5 * WIDTH, seed=5),
        True: noisy_ring(1),
    }
    rows = []
    for name, params in SOLVERS.items():
        row = []
        for closed, xy in starts.items():
            history = simulate(params, xy, closed)
            kind = "ring" if closed else "line"
            sinuosity, wave, loop = measure(history, closed)
            print(
                f"{name}, a {kind}: sinuosity {sinuosity:.2f}, wavelength {wave:.1f} widths, "
                f"{len(history.cutoffs)} oxbows of {loop:.0f} widths"
            )
            check(history, sinuosity, wave, closed)
            row.append(draw(history, folder, f"{name}, a {kind}", closed))
        rows.append(np.concatenate(row, axis=1))
    matplotlib.image.imsave(folder / "side_by_side.png", np.concatenate(rows))
    print(f"drawn into {folder / 'side_by_side.png'}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
