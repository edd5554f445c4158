"""Vegetation in the belts of rivers, in the manner of [Paris2023, Figs. 27 and 28]: two runs and their pictures.

The first river comes from a valley between mountains, runs straight down a steep slope and meanders over a plain; the
second begins as a straight line and meanders for 100 steps. Call it as `python demos/vegetation.py FOLDER`.
"""

import sys
from pathlib import Path

import numpy as np

import warpriver as wr
from warpriver.landscape import GROUND, LandscapeMaps, LandscapeParams, landscape_maps
from warpriver.landscape.falloff import smoothstep

CELL = 100.0


def valley() -> wr.Terrain:
    """35 x 20 km: mountains around a valley in the east, a steep slope, a plain in the west."""
    rows, columns = 200, 350
    x = (np.arange(columns) + 0.5) * CELL
    y = (rows - np.arange(rows) - 0.5)[:, None] * CELL
    rise = np.interp(x, [0.0, 17_000.0, 20_000.0, 35_000.0], [0.0, 8.0, 158.0, 166.0])
    middle = 10_000.0 + 1_200.0 * np.sin(x / 2_400.0)
    # How far into the mountains: their foot lies 1.5 km beside the valley's middle, their front at 19 km, unevenly.
    uneven = wr.generate.fractal_terrain((rows, columns), CELL, 1_600.0, 5).to_numpy()
    uneven -= uneven.mean()
    away = np.minimum(np.abs(y - middle) - 1_500.0, x - 18_500.0 + uneven)
    inward = smoothstep(away / 3_500.0)
    # Ridges and the valleys between them.
    ridges = wr.generate.fluvial_terrain((rows, columns), CELL, 1_100.0, 3).to_numpy()
    height = rise + inward * (ridges - ridges.min()) + 0.05 * np.maximum(away, 0.0)
    return wr.Terrain(height, CELL, (0.0, rows * CELL))


def constrained() -> tuple[wr.History, wr.Terrain]:
    """1,134 steps of a river 200 m wide from the valley to the plain."""
    ground = valley()
    x = np.linspace(34_900.0, 100.0, 350)
    bend = 10_000.0 + np.where(x > 19_000.0, 1_200.0, 400.0) * np.sin(x / 2_400.0)
    line = np.stack([x, bend + np.random.default_rng(2).normal(0.0, 15.0, len(x))], axis=1)
    network = wr.RiverNetwork.from_polylines([line], width=200.0)
    sim = wr.Simulation(network, wr.MeanderParams(migration_rate=150.0), terrain=ground, seed=1)
    return sim.run(steps=1134, record_every=60, progress=True), ground


def from_straight() -> wr.History:
    """100 steps of a river 60 m wide that was straight but for the roughness of its banks."""
    line = wr.generate.noisy_line(length=9_000.0, spacing=30.0, amplitude=30.0, seed=7)
    network = wr.RiverNetwork.from_polylines([line], width=60.0)
    sim = wr.Simulation(network, wr.MeanderParams(migration_rate=200.0), seed=1)
    return sim.run(steps=100, record_every=5, progress=True)


def cover_ratio(maps: LandscapeMaps) -> float:
    """Mean density of vegetation in the belt, over that where no river was ever felt."""
    belt, density = maps.belt.numpy() == 1, maps.vegetation.numpy()
    outside = ~belt & (maps.moisture.numpy() <= 0.0)
    return float(density[belt].mean() / density[outside].mean())


def oldest_hollow(maps: LandscapeMaps, depth: float) -> float:
    """Age in lifetimes of lakes of the oldest oxbow that lies lower than the bars, by a tenth of the river's depth."""
    ground, height = maps.ground.numpy(), maps.elevation_change.numpy()
    bars = float(height[ground == GROUND.index("point bar")].mean())
    old = (ground == GROUND.index("oxbow lake")) & (height < bars - 0.1 * depth)
    return float(maps.age.numpy()[old].max() / maps.params.lake_time) if old.any() else 0.0


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    history, ground = constrained()
    # Without the streams of the ground: outside the belt grows what needs no river.
    maps = landscape_maps(history, cell_size=CELL, bounds=ground.bounds, params=LandscapeParams(lake_time=30.0))
    ratio = cover_ratio(maps)
    oldest = oldest_hollow(maps, float(history.networks[-1].channel_depth[0]))
    print(f"{history!r}\nvegetation in the belt: {ratio:.1f} times that outside; "
          f"oxbows are hollows up to {oldest:.1f} lifetimes of lakes")  # fmt: skip
    assert ratio >= 3.0 and oldest >= 2.0
    wr.viz.draw_landscape(
        history, folder / "valley.png", terrain=ground, size=(1000, 640), dpi=90, title="From a valley to a plain"
    )
    history = from_straight()
    print(history)
    rain = LandscapeParams(moisture_rate=0.2, dry_cover=0.9, cover_time=8.0)
    wr.viz.draw_landscape(
        history, folder / "forest.png", size=(1000, 420), dpi=90, params=rain, title="100 steps from a straight line"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
