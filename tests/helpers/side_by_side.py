"""Jobs of many kinds in the threads of a fresh process, all at once, and then one after the other; prints what differs.

``test_threads.py`` starts this: where threads get in each other's way the process may die.
"""

import hashlib
import json
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
from plain import plain_params

import warpriver as wr
from warpriver.errors import WarpriverError


def digest(*arrays):
    """Of the bits of arrays."""
    total = hashlib.sha256()
    for array in arrays:
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()


def model(name):
    """A job that runs one of the models of the tests for some steps."""

    def run():
        from models import MODELS

        sim = MODELS[name][0]()
        sim.run(steps=25, record_every=10)
        history = sim.history
        return digest(sim.network.points(), sim.network.starts(), history.times) + f" {len(history.events)}"

    return run


def stored():
    """A run that is streamed to a folder and goes on from there."""
    from models import MODELS

    with tempfile.TemporaryDirectory() as folder:
        sim = MODELS["tree"][0](threads=1)
        sim.run(steps=10, record_every=2, store=Path(folder) / "run")
        again = wr.Simulation.resume(Path(folder) / "run")
        again.run(steps=10, record_every=2)
        return digest(*(network.points() for network in again.history.networks))


def hydrology():
    """The rivers of a terrain."""
    basin = wr.generate.intermontane_basin(cell_size=400.0, seed=1)
    rivers = wr.extract_network(basin, min_drainage_area=8e6)
    flow = wr.hydrology.route(wr.hydrology.fill_depressions(basin))
    return digest(rivers.points(), wr.hydrology.drainage_area(flow).numpy())


def ground():
    """A terrain that is brushed and sampled."""
    land = wr.generate.fractal_terrain((80, 90), 25.0, 90.0, seed=3)
    points = np.random.default_rng(2).uniform(300.0, 1500.0, (500, 2)) - [0.0, 2000.0]
    for k in range(5):
        land.brush("smooth", (900.0 + 10.0 * k, -900.0), radius=200.0, amount=0.5)
    return digest(land.to_numpy(), land.sample(points), land.gradient(points))


def rain():
    """Rain on a plane, one after the other and in batches."""
    plane = wr.generate.erosion_plane((60, 80), cell_size=100.0, slope=0.001)
    params = wr.LehenyParams().scaled(0.1)
    lands = [wr.erode(plane, params, events=400, seed=0, batch=batch) for batch in (1, 20)]
    return digest(*(land.to_numpy() for land in lands))


def valley():
    """A valley of the paper's."""
    made = wr.synthetic_valley("S3", length=300.0)
    return digest(made.terrain.to_numpy(), made.network.points())


def rates():
    """Rates of a network as it stands."""
    line = wr.generate.sine_generated(wavelength=1_500, angle=1.2, wavelengths=4, spacing=25)
    network = wr.RiverNetwork.from_polylines([line], width=80.0)
    return digest(*wr.meander.migration_rate(network, plain_params()))


def files():
    """A network and a terrain, written and read in many formats."""
    line = wr.generate.noisy_line(3000, 50, 30, 4)
    network = wr.RiverNetwork.from_polylines([line], width=60.0)
    land = wr.generate.fractal_terrain((30, 40), 25.0, 90.0, seed=3)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".csv", ".geojson", ".gpkg", ".fgb", ".parquet"):
            wr.write_network(network, Path(folder) / f"river{suffix}")
            found.append(wr.read_network(Path(folder) / f"river{suffix}").points())
        for suffix in (".asc", ".tif", ".npz", ".png"):
            wr.write_terrain(land, Path(folder) / f"land{suffix}")
            found.append(wr.read_terrain(Path(folder) / f"land{suffix}").to_numpy())
    return digest(*found)


def pictures():
    """A map and a movie of a run."""
    line = wr.generate.noisy_line(3000, 50, 30, 4)
    history = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=60.0), plain_params()).run(
        steps=20, record_every=10
    )
    with tempfile.TemporaryDirectory() as folder:
        wr.viz.draw_belt(history, Path(folder) / "belt.png", dpi=40)
        wr.viz.movie(history, Path(folder) / "belt.gif", size=(300, 240))
        return digest(
            *(np.frombuffer((Path(folder) / name).read_bytes(), np.uint8) for name in ("belt.png", "belt.gif"))
        )


def refused():
    """Work that ends in an error, in the middle of the others."""
    told = []
    for width in (1e9, -1.0):
        try:
            wr.Simulation(
                wr.RiverNetwork.from_polylines([wr.generate.noisy_line(3000, 50, 30, 0)], width=width), plain_params()
            ).step()
        except WarpriverError as error:
            told.append(str(error))
    return told


JOBS = {
    "plain": model("plain"),
    "tree": model("tree"),
    "on hills": model("on hills"),
    "paths": model("paths"),
    "single precision": model("single precision"),
    "rings in two": model("rings in two"),
    "stored": stored,
    "hydrology": hydrology,
    "ground": ground,
    "rain": rain,
    "valley": valley,
    "rates": rates,
    "files": files,
    "pictures": pictures,
    "refused": refused,
}


def at_once(names):
    """What each job comes to in a thread of its own, all of them released together; errors as text."""
    gate, found = threading.Barrier(len(names)), [None] * len(names)

    def work(k):
        gate.wait()
        try:
            found[k] = JOBS[names[k]]()
        except BaseException as error:
            found[k] = f"{type(error).__name__}: {error}"

    threads = [threading.Thread(target=work, args=(k,)) for k in range(len(names))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found


def main():
    """Rounds of the jobs that are named, at once and then alone."""
    names, rounds = sys.argv[2:], int(sys.argv[1])
    sys.setswitchinterval(1e-4)
    found = [at_once(names) for _ in range(rounds)]
    alone = {name: JOBS[name]() for name in dict.fromkeys(names)}
    wrong = [
        f"round {k}, {name}: {result}"
        for k, results in enumerate(found)
        for name, result in zip(names, results, strict=True)
        if result != alone[name]
    ]
    print(json.dumps({"alone": alone, "wrong": wrong}))


if __name__ == "__main__":
    main()
