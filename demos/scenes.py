"""Scenes in the manner of the figures of [Paris2023]: each is a file in `demos/scenes`, run, drawn, and checked here.

Call it as `python demos/scenes.py FOLDER NAME ...`; without names it runs all of them.
"""

import dataclasses
import sys
from pathlib import Path

import numpy as np

import warpriver as wr

SCENES = Path(__file__).resolve().parent / "scenes"


def sinuosities(network: wr.RiverNetwork) -> np.ndarray:
    return np.array([wr.metrics.sinuosity(xy) for xy in network.polylines()])


def widths(scene, sim, folder) -> str:
    """Fig. 10: 40 to 70 cutoffs, sinuosity 1.9 to 3.8; wider rivers have longer bends."""
    network, cutoffs = sim.network, len(sim.history.cutoffs)
    waves = [wr.metrics.wavelength(*each) for each in zip(network.polylines(), network.channel_width, strict=True)]
    found = sinuosities(network)
    assert 40 <= cutoffs <= 70 and found.min() > 1.9 and found.max() < 3.8 and (np.diff(waves) > 0.0).all()
    return f"{cutoffs} cutoffs, sinuosity {found.min():.2f} to {found.max():.2f}, waves of {np.round(waves)} m"


def one_river(scene, sim, folder) -> str:
    """Fig. 11: sinuosity 2.1 to 2.7, wavelength 1,600 to 2,200 m, up to 3 cutoffs."""
    xy, cutoffs = sim.network.polylines()[0], len(sim.history.cutoffs)
    found, wave = wr.metrics.sinuosity(xy), wr.metrics.wavelength(xy, 200.0)
    assert 2.1 < found < 2.7 and 1600.0 < wave < 2200.0 and cutoffs <= 3
    return f"sinuosity {found:.2f}, wavelength {wave:.0f} m, {cutoffs} cutoffs"


def front(scene, sim, folder) -> str:
    """Figs 13 and 27: straight on the steep front, below 1.1; free in the plain, above 1.8."""
    xy, found = sim.network.polylines()[0], {}
    for name, (west, east) in wr.generate.mountain_front_zones().items():
        inside = np.flatnonzero((xy[:, 0] > west) & (xy[:, 0] < east))
        found[name] = wr.metrics.sinuosity(xy[inside[0] : inside[-1] + 1])
    assert found["front"] < 1.1 and found["plain"] > 1.8 and found["valley"] < found["plain"]
    return ", ".join(f"{name} {value:.2f}" for name, value in found.items())


def repeller(scene, sim, folder) -> str:
    """Fig. 14: points near a repeller lie 20 % farther from it than without, none within 0.3 of its radius."""
    near, least = _distances(scene, sim)
    assert near[1] > 1.2 * near[0] and least[1] > 0.3
    return (
        f"mean distance {near[1] / near[0]:.2f} times that without, least {least[1]:.2f} radii ({least[0]:.2f} without)"
    )


def attractor(scene, sim, folder) -> str:
    """Fig. 14: points near an attractor lie closer to it than without."""
    near, least = _distances(scene, sim)
    assert near[1] < near[0] and least[1] < least[0]
    return f"mean distance {near[1] / near[0]:.2f} times that without, {least[1]:.2f} radii at least"


def _distances(scene, sim) -> tuple[list[float], list[float]]:
    """Mean distance from the control of points within 2 radii, and the least, without it and with it; in radii."""
    control = scene.controls[0].control
    without = dataclasses.replace(scene, controls=()).run().networks[-1]
    away = [np.hypot(*(n.points() - control.center).T) / control.radius for n in (without, sim.network)]
    return [float(d[d < 2.0].mean()) for d in away], [float(d.min()) for d in away]


def oxbows(scene, sim, folder) -> str:
    """Fig. 16: loops that meet themselves are cut off, and lie as lakes beside the river."""
    loops, width = sim.history.cutoffs, sim.network.channel_width[0]
    necks = np.array([np.hypot(*(loop.xy[0] - loop.xy[-1])) for loop in loops]) / width
    lengths = wr.metrics.oxbow_lengths(loops) / width
    assert len(loops) > 20 and necks.max() < 3.0 and (folder / "oxbows_oxbows.geojson").exists()
    return f"{len(loops)} lakes, median length {np.median(lengths):.0f} widths, necks up to {necks.max():.1f} widths"


def avulsion(scene, sim, folder) -> str:
    """Figs 18 and 20: a bank breaks, the river takes a new course there, which is carved; the old one is kept."""
    history = sim.history
    for left in history.avulsions:
        assert (left.xy[[0, -1]] == left.course[[0, -1]]).all() and (np.diff(left.bed) < 0.0).all()
        assert any(c.time == left.time and c.outcome == "avulsion" for c in history.crevasses)
    middle = np.concatenate([left.course[2:-2] for left in history.avulsions])
    carved = scene.terrain.make().sample(middle) - sim.terrain.sample(middle)
    assert len(history.crevasses) > len(history.avulsions) >= 1 and carved.min() > -1e-9 and carved.max() > 0.0
    assert (folder / "avulsion_abandoned.geojson").exists()
    new, old = (sum(wr.metrics.arc_length(xy)[-1] for xy in each) for each in zip(
        *((left.course, left.xy) for left in history.avulsions), strict=True))  # fmt: skip
    return (
        f"{len(history.crevasses)} crevasses, {len(history.avulsions)} avulsions: {new:.0f} m in place of {old:.0f} m, "
        f"carved up to {carved.max():.2f} m"
    )


def junctions(scene, sim, folder) -> str:
    """Fig. 21: rivers of like flow arrive at 25 +- 5 degrees, a brook of a thousandth at 75 or more."""
    # The direction at the node itself, of the second order.
    ends = [3.0 * xy[-1] - 4.0 * xy[-2] + xy[-3] for xy in scene.network.make(None).polylines()]
    angles = [np.degrees(np.arctan2(abs(y), x)) for x, y in ends]
    like, brook = angles[:2], angles[4]
    assert all(20.0 < angle < 30.0 for angle in like) and brook > 75.0
    return f"like flows {like[0]:.0f} and {like[1]:.0f} degrees, a brook {brook:.0f}, beside it {angles[3]:.0f}"


def basin(scene, sim, folder) -> str:
    """Fig. 23: rivers meander in the plain, and stay as they were on steep ground; mouths arrive as in Fig. 21."""
    slope = np.array([np.hypot(*sim.terrain.gradient(xy).T).mean() for xy in sim.network.polylines()])
    long = sim.network.channel_lengths() > 20.0 * sim.network.channel_width
    plain, steep = (sinuosities(sim.network)[long & part] for part in (slope < 0.005, slope > 0.1))
    assert len(plain) > 5 and len(steep) > 5 and np.median(plain) > 1.5 and np.median(steep) < 1.15
    found, template = (np.degrees(f(sim.network)) for f in (wr.meander.arrival_angles, wr.meander.junction_angles))
    lesser = template > 27.0
    off = np.abs(found - template)[lesser].mean()
    assert off < 8.0 and found[lesser].min() > 25.0 and 75.0 < np.median(found[lesser]) < 95.0
    return (
        f"median sinuosity {np.median(plain):.2f} in the plain, {np.median(steep):.2f} where it is steep; tributaries "
        f"arrive at {np.median(found[lesser]):.0f} degrees, {off:.1f} off their templates"
    )


def session(scene, sim, folder) -> str:
    """Fig. 29: what was done is done again, from the scene and from its session, to the bit."""
    again = scene.run(threads=1).networks[-1]
    replayed = wr.Simulation.replay(scene.simulation(), folder / "session.json").network
    for other in (again, replayed):
        assert (other.points() == sim.network.points()).all() and (other.channel_id == sim.network.channel_id).all()
    raised = sim.terrain.to_numpy() - scene.terrain.make().to_numpy()
    assert raised.max() > 200.0 and 21 not in sim.network.channel_id and 24 in sim.network.channel_id
    names = [edit.edit.name for edit in sim.history.edits]
    return f"{', '.join(names)}: {sim.network.point_count} points, the same to the bit when done again and replayed"


def main(folder: Path, names: list[str]) -> None:
    for name in names or sorted(path.stem for path in SCENES.glob("*.toml")):
        scene, place = wr.read_scene(SCENES / f"{name}.toml"), folder
        place.mkdir(parents=True, exist_ok=True)
        sim = scene.simulation()
        scene.play(sim)
        scene.write(sim, place)
        print(f"{name}: {globals()[name](scene, sim, place)}; see {place / name}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"), sys.argv[2:])
