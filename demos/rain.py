"""Rain makes the rivers: it carves a network into a tilted plane, whose rivers then meander for two centuries.

Call it as `python demos/rain.py FOLDER`.
"""

import sys
from pathlib import Path

import numpy as np

import warpriver as wr

CELL, SLOPE = 150.0, 2e-4
EVENTS, RIVER = 12_000, 300
# A unit of height of 3 cm, a cell's fall: canyons of thousands of units become valleys of up to 300 m.
UNIT = SLOPE * CELL


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    # Rain and rivers. The sides are walls, so that every river lies on the map in one piece.
    edges = {"north": "closed", "south": "open", "east": "closed", "west": "closed"}
    plane = wr.generate.erosion_plane((160, 240), CELL, SLOPE)
    params = wr.LehenyParams().scaled(UNIT)
    land = wr.erode(plane, params, events=EVENTS, seed=5, edges=edges, record_every=EVENTS // 12)
    flow, threshold = land.flow(), RIVER * CELL**2
    network = wr.extract_network(land, flow=flow, min_drainage_area=threshold, width_coefficient=0.006)
    laws = wr.hydrology.network_laws(flow, 10.0 * CELL**2)
    print(f"{land!r}\n{network!r}")
    print(f"{len(laws.streams)} orders, bifurcation ratio {laws.bifurcation_ratio:.2f}, Hack {laws.hack_exponent:.2f}")
    wr.viz.draw_elevation(land, folder / "rain_elevation.png", title="Carved by rain")
    wr.viz.erosion_movie(land, folder / "rain.gif", min_drainage_area=threshold, fps=4.0, size=(840, 640))

    # The rivers live on, without the ground: the walls of the model's canyons are too steep for bends.
    sim = wr.Simulation(network, wr.MeanderParams(spacing_in_widths=1.0, migration_rate=25.0), seed=0)
    history = sim.run(years=200, record_every=wr.Every(years=10), progress=True)
    wr.viz.draw_belt(history, folder / "rain.png", title="Rivers from rain, after 200 years")
    before, after = (np.mean([wr.metrics.sinuosity(xy) for xy in n.polylines()]) for n in (network, sim.network))
    print(f"mean sinuosity {before:.3f} -> {after:.3f}, {len(history.cutoffs)} cutoffs; see {folder / 'rain.png'}")

    receiver = flow.receiver.numpy()
    stays = receiver == np.arange(receiver.size).reshape(receiver.shape)
    assert stays[-1].all() and not stays[:-1].any(), "all water leaves in the south: there is no pit"
    assert 3 <= len(laws.streams) <= 6 and 3.0 < laws.bifurcation_ratio < 9.0 and 0.55 < laws.hack_exponent < 0.8
    mouth = network.channel_to[~np.isin(network.channel_to, network.channel_from)]
    assert np.allclose(network.node_xy[mouth, 1], 0.5 * CELL), "every river goes from its mouth up in one piece"
    assert history.stop_reason is wr.history.StopReason.COMPLETED and after > before


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
