"""A river without ends: a ring grows bends, splits at its necks, and leaves lakes; of the parts the longer goes on."""

import sys
from pathlib import Path

import numpy as np

import warpriver as wr

WIDTH, RADIUS, SPACING = 60.0, 3_000.0, 40.0  # m


def noisy_ring(seed: int) -> np.ndarray:
    """A circle with bumps of 3 to 60 waves round it, (n, 2) m; its first point is not repeated."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(round(2.0 * np.pi * RADIUS / SPACING)) / round(2.0 * np.pi * RADIUS / SPACING)
    bumps = sum(rng.normal(0.0, 20.0) * np.cos(k * angle + rng.uniform(0.0, 6.0)) for k in range(3, 60))
    return (RADIUS + bumps)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    network = wr.RiverNetwork.from_polylines([noisy_ring(seed=1)], width=WIDTH, closed=True)
    sim = wr.Simulation(network, wr.MeanderParams(spacing=SPACING, ring_policy="longer"))
    history = sim.run(years=180, record_every=wr.Every(years=2))
    print(sim)
    wr.viz.draw_belt(history, folder / "ring.png", title="A ring, 180 years")

    ring = sim.network.polylines()[0]
    radius = np.hypot(*(ring - ring.mean(axis=0)).T).mean()
    sinuosity = wr.metrics.sinuosity(ring, closed=True)
    wave = wr.metrics.wavelength(ring, WIDTH, closed=True)
    print(f"mean radius {radius:.0f} m, sinuosity {sinuosity:.2f}, wavelength {wave / WIDTH:.1f} widths")
    print(f"{len(history.cutoffs)} lakes; drawn into {folder / 'ring.png'}")

    seam = np.hypot(*(ring[0] - ring[-1]))
    assert sim.network.channel_closed.all() and seam < 2.0 * SPACING, "still a ring"
    assert 0.7 * RADIUS < radius < 1.3 * RADIUS, "it neither shrinks away nor runs off"
    assert len(history.cutoffs) > 3 and 1.5 < sinuosity < 4.0
    for lake in history.cutoffs:
        assert np.hypot(*(lake.xy[0] - lake.xy[-1])) < WIDTH, "a lake's ends are a neck apart"


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
