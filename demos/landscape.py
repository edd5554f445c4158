"""Beds, bars, lakes and water: two rivers meander over a plain for 200 years, and are carved into their deposits.

Call it as `python demos/landscape.py FOLDER`.
"""

import sys
import warnings
from pathlib import Path

import matplotlib
import numpy as np

import warpriver as wr
from warpriver.landscape import LandscapeMaps, carve, export_landscape, landscape_maps

matplotlib.use("Agg")
from matplotlib import pyplot as plt

CELL, SHAPE, SLOPE = 6.0, (640, 1500), 5e-4
# Colours of the materials, and of shallow and deep water.
COLORS = {"ground": "#a3ab7a", "bank": "#c9bb92", "wall": "#a58a6a", "deposit": "#d8c9a0", "bed": "#8aa7a4"}
SHALLOW, DEEP, PLANTS = "#7fa9ad", "#1f4e66", "#4f6b3a"


def rivers() -> wr.RiverNetwork:
    """A river that comes from beyond the map and leaves it, and one half as wide that joins it from the south."""
    main = wr.generate.noisy_line(12_400.0, 30.0, 60.0, 2) + [-2_700.0, -1_700.0]
    joint = len(main) * 3 // 5
    side = wr.generate.noisy_line(float(np.hypot(3_400.0, 2_600.0)), 15.0, 30.0, 5)
    turn = np.arctan2(2_600.0, 3_400.0)
    side = side @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    side += main[joint] - side[-1]
    return wr.RiverNetwork.from_polylines([main[: joint + 1], side, main[joint:]], [55.0, 26.0, 62.0])


def draw(carved: wr.landscape.Carved, maps: LandscapeMaps, path: Path) -> None:
    """Materials under their plants, in the light of the hillshade, and water that is darker where it is deeper."""
    rgb = sum(np.array(matplotlib.colors.to_rgb(COLORS[name])) * raster.numpy()[..., None] / 255.0
              for name, raster in carved.materials.items())  # fmt: skip
    cover = 0.5 * np.nan_to_num(maps.vegetation.numpy())[..., None]
    rgb += cover * (np.array(matplotlib.colors.to_rgb(PLANTS)) - rgb)
    light = wr.viz.hillshade(carved.terrain, exaggeration=22.0) / np.sin(np.radians(45.0))
    rgb *= (0.5 + 0.5 * np.clip(light, 0.0, 1.4))[..., None]
    depth = carved.depth.numpy()
    part = np.clip(depth / np.nanmax(depth), 0.0, 1.0)[..., None]
    water = [np.array(matplotlib.colors.to_rgb(color)) for color in (SHALLOW, DEEP)]
    rgb = np.where(np.isfinite(depth)[..., None], water[0] + part * (water[1] - water[0]), rgb)
    west, south, east, north = (1e-3 * v for v in carved.terrain.bounds)
    figure, axes = plt.subplots(figsize=(12.0, 5.6), dpi=110)
    axes.imshow(np.clip(rgb, 0.0, 1.0), extent=(west, east, south, north))
    axes.set(xlabel="easting, km", ylabel="northing, km", title="Carved into their deposits after 200 years")
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    plain = wr.generate.tilted_plain(SHAPE, CELL, SLOPE)
    knolls = wr.generate.fractal_terrain(SHAPE, CELL, 5.0, 4).to_numpy()
    ground = wr.Terrain(plain.to_numpy() + knolls - knolls.min(), CELL)
    params = wr.MeanderParams(spacing_in_widths=0.5, migration_rate=45.0)
    sim = wr.Simulation(rivers(), params, seed=1)
    history = sim.run(years=200, record_every=wr.Every(years=5), progress=True)

    maps = landscape_maps(history, ground, CELL)
    change = maps.elevation_change
    deposits = change.like(np.maximum(change.numpy(), 0.0), unit="m")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # no cut is held up
        carved = carve(ground, sim.network, deposits=deposits, history=history)
    print(f"{sim.network!r}\n{carved.report}")
    draw(carved, maps, folder / "landscape.png")
    layers = {"vegetation": maps.vegetation}
    files = export_landscape(carved, folder / "landscape", targets=["blender"], history=history, maps=layers)
    print(f"{len(files)} files in {folder / 'landscape'}; see {folder / 'landscape.png'}")

    level, network = carved.network.point_z, carved.network
    rise = np.diff(level)
    rise[network.starts()[1:-1] - 1] = 0.0
    assert rise.max() <= 0.0, "water never rises downstream"
    mouths = level[network.starts()[1:] - 1]
    assert mouths[0] >= level[network.starts()[2]] and mouths[1] >= level[network.starts()[2]], "nor into a junction"
    outside = carved.support.numpy() == 0
    laid = ground.to_numpy() + deposits.numpy()
    assert (carved.terrain.to_numpy() == laid)[outside].all(), "beyond the banks nothing changes"
    assert carved.report.lakes >= 3 and 0.02 < 1.0 - outside.mean() < 0.5


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
