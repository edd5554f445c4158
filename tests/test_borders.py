"""What users may give by mistake: every public function refuses it by name, and none ends in an error from within.

``CALLS`` has one good call of each public function. In it one argument at a time is replaced by each of ``WRONG``; the
function then works, or raises a ``WarpriverError``.
"""

import functools
import inspect
import traceback
import warnings

import numpy as np
import pytest

import warpriver as wr
from warpriver.errors import WarpriverError
from warpriver.history import History

WRONG = {
    "None": None,
    "text": "x",
    "flag": True,
    "minus one": -1,
    "zero": 0,
    "NaN": float("nan"),
    "infinity": float("inf"),
    "huge": 1e300,
    "tiny": 5e-324,
    "beyond floats": 10**400,
    "fraction": 0.5,
    "empty list": [],
    "words": ["a", "b"],
    "complex": 1j,
    "array": np.zeros((3, 3)),
    "vector": np.array([1.0, np.nan, 3.0]),
    "masked": np.ma.masked_array([[1.0, -9999.0], [1.0, 1.0]], [[False, True], [False, False]]),
    "bytes": b"x",
    "mapping": {"a": 1},
    "object": object(),
    "class": wr.Terrain,
    "network": "NETWORK",
    "terrain": "TERRAIN",
}


@pytest.fixture(scope="module")
def things(tmp_path_factory):
    folder = tmp_path_factory.mktemp("borders")
    line = wr.generate.noisy_line(2000.0, 50.0, 40.0, 0)
    x = np.linspace(0.0, 1500.0, 40)
    lines = [
        np.column_stack([x - 1500.0, 0.5 * x - 750.0]),
        np.column_stack([x - 1500.0, 750.0 - 0.5 * x]),
        np.column_stack([x, 0.1 * x * (1500.0 - x) / 1500.0]),
    ]
    network = wr.RiverNetwork.from_polylines(lines, width=[30.0, 40.0, 50.0], drainage_area=[1e6, 2e6, 3e6])
    terrain = wr.generate.fluvial_terrain((24, 30), 50.0, 100.0, 1)
    flow = wr.hydrology.route(terrain, depressions="fill")
    history = wr.Simulation(network, threads=1).run(steps=2, record_every=1)
    valley = wr.synthetic_valley("S1", length=60.0)
    params = wr.valley.ValleyParams()
    eroded = wr.erode(wr.generate.erosion_plane((12, 16)), events=20, record_every=10)
    wr.write_network(network, folder / "a.csv")
    wr.write_terrain(terrain, folder / "a.npz")
    wr.io.write_raster(terrain.raster, folder / "raster.npz")
    wr.io.write_valley(params, folder / "a.toml")
    wr.write_mesh(terrain, folder / "a.obj")
    (folder / "scene.toml").write_text(
        "[[network.channel]]\npoints = [[0, 0], [900, 0]]\nwidth = 20\n[run]\nsteps = 1\n"
    )
    history.save(folder / "run.npz")
    wr.edits.write_edits(folder / "a.json", [(1, wr.edits.RemoveChannel(0))])
    (bridge,) = (wr.valley.levee(valley),)
    bends = wr.generate.sine_generated(600.0, 0.9, 8, 20.0)
    meander = wr.RiverNetwork.from_polylines([bends], width=40.0)
    grown = wr.Simulation(meander, threads=1)
    grown.step(3)
    slope = wr.generate.tilted_plain((24, 50), 10.0, 0.02)
    brook = wr.RiverNetwork.from_polylines([line * 0.1 + (60.0, 120.0)], width=4.0, slope=[0.02])
    reach = wr.riverscape.example("C")
    river = wr.Riverscape(reach.terrain, reach.courses)
    river.save(folder / "river.json")
    wr.riverscape.FlowMap.of(river, (10.0, 4.0, 12.0, 6.0), 0.5).save(folder / "flow.png")
    return {
        "folder": folder,
        "river": river,
        "line": line,
        "network": network,
        "terrain": terrain,
        "flow": flow,
        "history": history,
        "valley": valley,
        "valley_params": params,
        "eroded": eroded,
        "riverscape": wr.Riverscape(slope, brook, wr.classify_rivers(brook, slope, flow=1.0), flow=1.0, detail=2.0),
        "stamp": bridge,
        "simulation": wr.Simulation(network, threads=1),
        "grid": valley.grid(),
        "meander": meander,
        "grown": grown.network,
        "fit": wr.calibrate(meander, grown.network, grown.time, fit=["migration_rate"]),
        "carved": wr.landscape.carve(wr.landscape.plain_under(network, 60.0), network),
        "wide": wr.Terrain(np.add.outer(np.zeros(80), 0.02 * np.arange(80.0)[::-1]), 50.0, (-2000.0, 2000.0)),
    }


def topology(t):
    return {"channel_from": t["network"].channel_from, "channel_to": t["network"].channel_to}


def locked(t):
    sim = wr.Simulation(t["network"], threads=1)
    sim.lock(0, 600.0)
    return sim


def drawn(function, first):
    return lambda t: (function, {first[0]: t[first[1]], "path": t["folder"] / "a.png"})


# One good call of each public function, and of the methods that users call.
CALLS = {
    "RiverNetwork": lambda t: (
        wr.RiverNetwork,
        {
            "point_xy": t["line"],
            "channel_start": [0, len(t["line"])],
            "origin": (0.0, 0.0),
            "channel_width": [80.0],
            "channel_depth": [3.0],
            "channel_discharge": [100.0],
            "channel_closed": [False],
            "point_section": np.full((len(t["line"]), 2), 5.0),
            "point_z": np.zeros(len(t["line"])),
        },
    ),
    "from_polylines": lambda t: (
        wr.RiverNetwork.from_polylines,
        {
            "polylines": [t["line"]],
            "width": 50.0,
            "depth": 2.0,
            "discharge": 10.0,
            "drainage_area": [1e6],
            "slope": [0.01],
            "z": [np.zeros(len(t["line"]))],
            "channel_id": [3],
            "extra": {"a": [1]},
            "origin": (0.0, 0.0),
            "closed": False,
            "marks": None,
            "crs": "EPSG:32619",
        },
    ),
    "with_elevations": lambda t: (t["network"].with_elevations, {"point_z": np.zeros(t["network"].point_count)}),
    "Simulation": lambda t: (
        wr.Simulation,
        {"network": t["network"], "params": wr.MeanderParams(), "terrain": None, "seed": 0, "threads": 1, "phases": ()},
    ),
    "step": lambda t: (t["simulation"].step, {"count": 1}),
    "run": lambda t: (
        t["simulation"].run,
        {"steps": 1, "record_every": 1, "store": None, "callbacks": (), "progress": False},
    ),
    "run for years": lambda t: (t["simulation"].run, {"years": 0.3}),
    "resume": lambda t: (
        wr.Simulation.resume,
        {"history": t["history"], "params": None, "terrain": None, "change_terrain": False, "threads": 1},
    ),
    "replay": lambda t: (
        wr.Simulation.replay,
        {
            "start": t["history"],
            "edits": [(1, wr.edits.SplitChannel(0, 500.0))],
            "steps": 2,
            "terrain": None,
            "record_every": 1,
            "threads": 1,
            "phases": (),
        },
    ),
    "apply": lambda t: (t["simulation"].apply, {"edit": wr.edits.SetChannel(0, width=31.0)}),
    "lock": lambda t: (wr.Simulation(t["network"], threads=1).lock, {"channel": 0, "at": 600.0}),
    "unlock": lambda t: (locked(t).unlock, {"channel": 0, "at": 600.0}),
    "write_edits": lambda t: (
        wr.edits.write_edits,
        {"path": t["folder"] / "b.json", "edits": [(1, wr.edits.RemoveChannel(0))], "seed": 1, "steps": 2},
    ),
    "read_edits": lambda t: (wr.edits.read_edits, {"path": t["folder"] / "a.json"}),
    "LockPoint": lambda t: (wr.edits.LockPoint, {"channel": 1, "at": (3.0, 4.0)}),
    "MovePoint": lambda t: (wr.edits.MovePoint, {"channel": 1, "at": 5.0, "to": (3.0, 4.0), "radius": 5.0}),
    "SplitChannel": lambda t: (wr.edits.SplitChannel, {"channel": 1, "at": 5.0, "width_above": 3.0}),
    "JoinChannels": lambda t: (wr.edits.JoinChannels, {"upper": 1, "lower": 2}),
    "AddChannel": lambda t: (
        wr.edits.AddChannel,
        {"xy": t["line"], "width": 3.0, "depth": 1.0, "discharge": 2.0, "ends": "any", "max_rise": 1.0},
    ),
    "CutLoop": lambda t: (wr.edits.CutLoop, {"channel": 1, "at": 500.0, "to": 900.0}),
    "RedrawSection": lambda t: (wr.edits.RedrawSection, {"channel": 1, "xy": t["line"]}),
    "SetChannel": lambda t: (wr.edits.SetChannel, {"channel": 1, "width": 3.0, "reach": (0.0, (3.0, 4.0))}),
    "EditTerrain": lambda t: (
        wr.edits.EditTerrain,
        {"operation": "flatten", "center": (0.0, 0.0), "radius": 5.0, "amount": 0.5, "level": 3.0},
    ),
    "EditTerrain ridge": lambda t: (
        wr.edits.EditTerrain,
        {"operation": "ridge", "line": t["line"], "height": 5.0, "width": 5.0},
    ),
    "Session": lambda t: (wr.edits.Session, {"edits": ((1, wr.edits.RemoveChannel(0)),), "seed": 1, "steps": 3}),
    "Every": lambda t: (wr.Every, {"steps": 1}),
    "Every years": lambda t: (wr.Every, {"years": 1.0}),
    "History": lambda t: (wr.History, {"params": wr.MeanderParams(), "origin": (0.0, 0.0), "crs": None, "seed": 0}),
    "History.network": lambda t: (t["history"].network, {"index": 0}),
    "History.save": lambda t: (t["history"].save, {"path": t["folder"] / "saved.npz"}),
    "History.load": lambda t: (History.load, {"path": t["folder"] / "run.npz"}),
    "read_history": lambda t: (wr.read_history, {"path": t["folder"] / "run.npz"}),
    "Terrain": lambda t: (
        wr.Terrain,
        {"height": np.zeros((4, 5)), "cell_size": 10.0, "origin": (0.0, 0.0), "crs": "EPSG:32619"},
    ),
    "sample": lambda t: (t["terrain"].sample, {"xy": np.array([[100.0, 100.0]])}),
    "gradient": lambda t: (t["terrain"].gradient, {"xy": np.array([[100.0, 100.0]])}),
    "brush": lambda t: (
        t["terrain"].copy().brush,
        {"kind": "raise", "center": (100.0, 100.0), "radius": 100.0, "amount": 1.0},
    ),
    "add_ridge": lambda t: (
        t["terrain"].copy().add_ridge,
        {"line": [[100.0, 100.0], [500.0, 500.0]], "height": 1.0, "width": 100.0},
    ),
    "resampled": lambda t: (t["terrain"].resampled, {"cell_size": 60.0}),
    "crop": lambda t: (t["terrain"].crop, {"bounds": (100.0, 100.0, 600.0, 600.0)}),
    "erode": lambda t: (
        wr.erode,
        {
            "terrain": t["eroded"],
            "params": wr.LehenyParams(),
            "events": 5,
            "seed": 0,
            "batch": 1,
            "base_level": None,
            "record_every": None,
            "dtype": "float64",
            "edges": None,
            "fill": False,
        },
    ),
    "erode_ensemble": lambda t: (
        wr.erosion.erode_ensemble,
        {"terrain": t["eroded"], "params": wr.LehenyParams(), "events": 5, "seeds": [1, 2]},
    ),
    "extract_network": lambda t: (
        wr.extract_network,
        {
            "terrain": t["terrain"],
            "min_drainage_area": 5e4,
            "width_coefficient": 0.002,
            "spacing": None,
            "smoothing": 2,
            "edges": "open",
            "max_cut": None,
            "area": None,
            "flow": None,
        },
    ),
    "read_network": lambda t: (
        wr.read_network,
        {"path": t["folder"] / "a.csv", "width": 40.0, "missing_width": 3.0, "crs": "EPSG:32619", "layer": None},
    ),
    "write_network": lambda t: (wr.write_network, {"network": t["network"], "path": t["folder"] / "b.csv"}),
    "read_terrain": lambda t: (
        wr.read_terrain,
        {"path": t["folder"] / "a.npz", "cell_size": 50.0, "crs": None, "z_factor": 1.0, "nodata": -9999.0, "band": 1},
    ),
    "write_terrain": lambda t: (wr.write_terrain, {"terrain": t["terrain"], "path": t["folder"] / "b.npz"}),
    "read_raster": lambda t: (wr.io.read_raster, {"path": t["folder"] / "raster.npz", "nodata": None, "band": 1}),
    "write_raster": lambda t: (
        wr.io.write_raster,
        {"raster": t["terrain"].raster, "path": t["folder"] / "raster2.npz"},
    ),
    "write_mesh": lambda t: (
        wr.write_mesh,
        {"surface": t["terrain"], "path": t["folder"] / "b.obj", "origin": (0.0, 0.0)},
    ),
    "read_mesh": lambda t: (wr.io.read_mesh, {"path": t["folder"] / "a.obj"}),
    "to_xarray": lambda t: (wr.to_xarray, {"terrain": t["terrain"]}),
    "from_xarray": lambda t: (
        wr.from_xarray,
        {"array": wr.to_xarray(t["terrain"]), "cell_size": None, "z_factor": 1.0, "nodata": None},
    ),
    "raster_from_xarray": lambda t: (wr.io.raster_from_xarray, {"array": wr.to_xarray(t["terrain"]), "nodata": None}),
    "read_scene": lambda t: (wr.scenes.read_scene, {"path": t["folder"] / "scene.toml", "folders": ()}),
    "describe_scene": lambda t: (wr.scenes.describe_scene, {"scene": wr.read_scene(t["folder"] / "scene.toml")}),
    "read_valley": lambda t: (wr.io.read_valley, {"path": t["folder"] / "a.toml"}),
    "write_valley": lambda t: (wr.io.write_valley, {"params": t["valley_params"], "path": t["folder"] / "b.toml"}),
    "write_points": lambda t: (wr.io.write_points, {"grid": t["grid"], "path": t["folder"] / "b.csv"}),
    "write_breaklines": lambda t: (
        wr.io.write_breaklines,
        {"lines": t["valley"].breaklines(), "path": t["folder"] / "b.geojson", "crs": None},
    ),
    "write_history": lambda t: (
        wr.io.write_history,
        {"history": t["history"], "path": t["folder"] / "h.geojson", "every": 1},
    ),
    "synthetic_valley": lambda t: (
        wr.synthetic_valley,
        {"valley": "S1", "cell_size": None, "origin": (0.0, 0.0), "crs": None, "length": 60.0, "slope": 0.005},
    ),
    "levee": lambda t: (
        wr.valley.levee,
        {"valley": t["valley"], "side": "left", "start": 0.1, "end": 0.9, "offset": 2.0, "height": 1.0, "crest": 1.0},
    ),
    "bridge": lambda t: (wr.valley.bridge, {"valley": t["valley"], "station": 0.5, "width": 4.0, "piers": 1}),
    "sine": lambda t: (wr.valley.sine, {"amplitude": 1.0, "frequency": 2, "phase": 0.0}),
    "cosine": lambda t: (wr.valley.cosine, {"amplitude": 1.0, "frequency": 2, "phase": 0.0}),
    "strongest_harmonics": lambda t: (
        wr.valley.strongest_harmonics,
        {"values": np.sin(np.linspace(0.0, 20.0, 64)), "count": 2},
    ),
    "cone": lambda t: (wr.generate.cone, {"shape": (10, 12), "cell_size": 5.0, "slope": 0.1}),
    "erosion_peak": lambda t: (wr.generate.erosion_peak, {"shape": (11, 11), "cell_size": 1.0, "slope": 1.0}),
    "erosion_plane": lambda t: (wr.generate.erosion_plane, {"shape": (11, 12), "cell_size": 1.0, "slope": 1.0}),
    "fluvial_terrain": lambda t: (
        wr.generate.fluvial_terrain,
        {"shape": (16, 16), "cell_size": 20.0, "relief": 50.0, "seed": 1, "concavity": 0.45},
    ),
    "fractal_terrain": lambda t: (
        wr.generate.fractal_terrain,
        {"shape": (16, 16), "cell_size": 20.0, "relief": 50.0, "seed": 1, "roughness": 0.45, "octaves": 3},
    ),
    "intermontane_basin": lambda t: (
        wr.generate.intermontane_basin,
        {"cell_size": 400.0, "seed": 1, "relief": 1000.0},
    ),
    "mountain_front": lambda t: (wr.generate.mountain_front, {"cell_size": 200.0, "seed": 0}),
    "mountain_front_line": lambda t: (wr.generate.mountain_front_line, {"spacing": 50.0, "seed": 0}),
    "read_sample_dem": lambda t: (wr.generate.read_sample_dem, {"cell_size": 300.0}),
    "tilted_plain": lambda t: (
        wr.generate.tilted_plain,
        {"shape": (10, 10), "cell_size": 10.0, "slope": 0.01, "direction": 0.0},
    ),
    "kinoshita": lambda t: (
        wr.generate.kinoshita,
        {"wavelength": 100.0, "angle": 1.0, "wavelengths": 2, "spacing": 2.0, "skewness": 0.03, "flatness": 0.005},
    ),
    "sine_generated": lambda t: (
        wr.generate.sine_generated,
        {"wavelength": 100.0, "angle": 1.0, "wavelengths": 2, "spacing": 2.0},
    ),
    "straight_line": lambda t: (wr.generate.straight_line, {"length": 100.0, "spacing": 5.0}),
    "noisy_line": lambda t: (
        wr.generate.noisy_line,
        {"length": 1000.0, "spacing": 20.0, "amplitude": 5.0, "seed": 0, "correlation": 50.0, "taper": 0.1},
    ),
    "valley_line": lambda t: (
        wr.generate.valley_line,
        {"length": 1000.0, "spacing": 20.0, "amplitude": 5.0, "wavelength": 500.0, "seed": 0},
    ),
    "bankfull_discharge": lambda t: (wr.hydrology.bankfull_discharge, {"width": 3.0}),
    "channel_width": lambda t: (wr.hydrology.channel_width, {"area": 1e6, "coefficient": 0.002}),
    "discharge": lambda t: (wr.hydrology.discharge, {"area": 1e6}),
    "width_of_discharge": lambda t: (wr.hydrology.width_of_discharge, {"flow": 1e2}),
    "carve_depressions": lambda t: (
        wr.hydrology.carve_depressions,
        {"terrain": t["terrain"], "edges": "open", "nodata": "outlet", "max_depth": 1.0, "max_length": 100.0},
    ),
    "fill_depressions": lambda t: (
        wr.hydrology.fill_depressions,
        {"terrain": t["terrain"], "epsilon": True, "edges": "open", "nodata": "outlet"},
    ),
    "drainage_area": lambda t: (
        wr.hydrology.drainage_area,
        {"surface": t["flow"], "method": "d8", "exponent": 1.1, "edges": None, "nodata": None},
    ),
    "drape": lambda t: (wr.hydrology.drape, {"network": t["network"], "terrain": t["terrain"]}),
    "exceedance": lambda t: (wr.hydrology.exceedance, {"area": np.arange(1.0, 200.0), "low": 2.0, "high": 100.0}),
    "flow_directions": lambda t: (wr.hydrology.flow_directions, {"terrain": t["terrain"], "edges": "open"}),
    "flow_length": lambda t: (wr.hydrology.flow_length, {"surface": t["flow"], "downstream": True}),
    "hack_exponent": lambda t: (
        wr.hydrology.hack_exponent,
        {"length": np.arange(1.0, 9.0), "area": np.arange(1.0, 9.0) ** 1.7},
    ),
    "hand": lambda t: (
        wr.hydrology.hand,
        {"surface": t["flow"], "channels": wr.hydrology.drainage_area(t["flow"]).numpy() > 2e5},
    ),
    "horton_order": lambda t: (wr.hydrology.horton_order, {**topology(t), "area": t["network"].channel_drainage_area}),
    "horton_ratios": lambda t: (
        wr.hydrology.horton_ratios,
        {**topology(t), "length": t["network"].channel_lengths(), "area": t["network"].channel_drainage_area},
    ),
    "main_stem": lambda t: (wr.hydrology.main_stem, {**topology(t), "area": t["network"].channel_drainage_area}),
    "main_stem_length": lambda t: (
        wr.hydrology.main_stem_length,
        {**topology(t), "length": t["network"].channel_lengths(), "area": t["network"].channel_drainage_area},
    ),
    "network_laws": lambda t: (wr.hydrology.network_laws, {"flow": t["flow"], "min_drainage_area": 2e4}),
    "route": lambda t: (
        wr.hydrology.route,
        {"terrain": t["terrain"], "depressions": "fill", "max_cut": None, "neighbors": 8, "ties": "hash", "seed": 0},
    ),
    "shreve_magnitude": lambda t: (wr.hydrology.shreve_magnitude, topology(t)),
    "strahler_order": lambda t: (wr.hydrology.strahler_order, topology(t)),
    "tokunaga": lambda t: (wr.hydrology.tokunaga, topology(t)),
    "stream_power": lambda t: (wr.hydrology.stream_power, {"surface": t["flow"], "area": None, "m": 0.5, "n": 1.0}),
    "make_app": lambda t: (
        wr.studio.make_app,
        {
            "start": t["network"],
            "token": "a secret",
            "terrain": None,
            "folder": t["folder"] / f"studio-{len(list(t['folder'].iterdir()))}",
            "hosts": ("localhost",),
        },
    ),
    "arrival_angles": lambda t: (wr.meander.arrival_angles, {"network": t["network"], "reach": 1.5}),
    "to_xarray_history": lambda t: (t["history"].to_xarray, {"every": 1}),
    "to_zarr": lambda t: (t["history"].to_zarr, {"path": t["folder"] / f"{len(list(t['folder'].iterdir()))}.zarr"}),
    "erodibility": lambda t: (
        wr.landscape.erodibility,
        {
            "maps": wr.landscape_maps(t["history"], None, 80.0, bounds=(-500.0, -500.0, 500.0, 500.0)),
            "strength": 0.5,
            "reach": 100.0,
        },
    ),
    "simulate_with_plants": lambda t: (
        wr.landscape.simulate_with_plants,
        {
            "simulation": wr.Simulation(t["network"], threads=1),
            "years": 0.5,
            "bounds": (-200.0, -200.0, 200.0, 200.0),
            "every": 0.3,
            "strength": 0.5,
            "cell_size": 100.0,
            "record_every": 1,
        },
    ),
    "landscape_maps": lambda t: (
        wr.landscape_maps,
        {
            "history": t["history"],
            "terrain": None,
            "cell_size": 40.0,
            "params": wr.landscape.LandscapeParams(),
            "bounds": (-200.0, -200.0, 200.0, 200.0),
            "until": -1,
            "window": 2,
            "moisture_falloff": wr.landscape.moisture_falloff,
            "sediment_falloff": wr.landscape.sediment_falloff,
            "device": "cpu",
            "threads": 1,
        },
    ),
    "levee_falloff": lambda t: (wr.landscape.levee_falloff, {"widths": [0.0, 1.0]}),
    "moisture_falloff": lambda t: (wr.landscape.moisture_falloff, {"widths": [0.0, 1.0]}),
    "sediment_falloff": lambda t: (wr.landscape.sediment_falloff, {"widths": [0.0, 1.0]}),
    "SectionTable": lambda t: (wr.landscape.SectionTable, {"depth": [[0.0, 1.0, 0.0]], "row": [0, 0]}),
    "SectionTable.of": lambda t: (
        wr.landscape.SectionTable.of,
        {"forms": [lambda y: y * (1.0 - y)], "row": None, "places": 9},
    ),
    "carve": lambda t: (
        wr.landscape.carve,
        {
            "terrain": t["wide"],
            "network": t["network"],
            "params": None,
            "sections": None,
            "deposits": None,
            "history": t["history"],
        },
    ),
    "plain_under": lambda t: (
        wr.landscape.plain_under,
        {"network": t["network"], "cell_size": 50.0, "slope": 1e-3, "margin": 100.0, "history": None},
    ),
    "ground_of_run": lambda t: (wr.landscape.ground_of_run, {"history": t["history"], "terrain": None}),
    "channel_ribbons": lambda t: (wr.landscape.channel_ribbons, {"network": t["network"]}),
    "channel_splines": lambda t: (wr.landscape.channel_splines, {"network": t["network"]}),
    "landscape_surfaces": lambda t: (wr.landscape.landscape_surfaces, {"carved": t["carved"], "max_points": 1000}),
    "write_surfaces": lambda t: (
        wr.landscape.write_surfaces,
        {
            "surfaces": wr.landscape.landscape_surfaces(t["carved"]),
            "path": t["folder"] / "a.glb",
            "origin": (0.0, 0.0),
            "y_up": False,
        },
    ),
    "export_landscape": lambda t: (
        wr.landscape.export_landscape,
        {
            "carved": t["carved"],
            "folder": t["folder"] / "land",
            "targets": ["mesh"],
            "history": t["history"],
            "maps": None,
            "size": None,
            "every": None,
        },
    ),
    "junction_angles": lambda t: (wr.meander.junction_angles, {"network": t["network"], "params": None}),
    "shape_junctions": lambda t: (wr.meander.shape_junctions, {"network": t["network"], "params": None}),
    "migration_rate": lambda t: (
        wr.meander.migration_rate,
        {"network": t["network"], "params": wr.MeanderParams(), "terrain": None},
    ),
    "stable_dt": lambda t: (wr.meander.stable_dt, {"width": 50.0, "depth": 2.0, "params": wr.MeanderParams()}),
    "step_limits": lambda t: (wr.meander.step_limits, {"width": 50.0, "depth": 2.0, "params": wr.MeanderParams()}),
    "mapped_banks": lambda t: (
        wr.meander.mapped_banks,
        {"before": t["history"].networks[0], "after": t["history"].networks[-1], "params": None, "smoothing": 3.0},
    ),
    "taubin_smooth": lambda t: (
        wr.meander.taubin_smooth,
        {"channels": t["line"], "passes": 3, "strength": 0.5, "pass_band": None, "closed": False},
    ),
    **{
        name: lambda t, name=name: (getattr(wr.metrics, name), {"xy": t["line"], "width": 20.0})
        for name in ("bend_radius", "bend_sinuosity", "bends", "inflection_points", "wavelength")
    },
    **{
        name: lambda t, name=name: (getattr(wr.metrics, name), {"xy": t["line"]})
        for name in ("arc_length", "curvature", "sinuosity")
    },
    "lag": lambda t: (
        wr.metrics.lag,
        {
            "curvature_values": np.sin(np.arange(200.0) / 9.0),
            "rate_values": np.sin(np.arange(200.0) / 9.0 - 0.3),
            "spacing": 10.0,
            "max_lag": 200.0,
        },
    ),
    "lognormal_fit": lambda t: (wr.metrics.lognormal_fit, {"lengths": [1.0, 2.0, 4.0]}),
    "migration": lambda t: (
        wr.metrics.migration,
        {"before": t["line"], "after": t["line"] + 1.0, "years": 2.0, "max_distance": 50.0},
    ),
    "oxbow_lengths": lambda t: (wr.metrics.oxbow_lengths, {"cutoffs": t["history"].cutoffs}),
    "statistics": lambda t: (wr.metrics.statistics, {"river": t["network"], "later": t["network"]}),
    "compare": lambda t: (wr.metrics.compare, {"a": t["network"], "b": t["history"]}),
    "sinuosity_window": lambda t: (wr.metrics.sinuosity_window, {"xy": t["line"], "window": 300.0}),
    "wavelength_range": lambda t: (wr.metrics.wavelength_range, {"width": 20.0}),
    "classify_rivers": lambda t: (
        wr.riverscape.classify_rivers,
        {
            "network": t["network"],
            "terrain": None,
            "values": {"slope": 0.01},
            "flow": 3.0,
            "grain_size": 20.0,
            "shows": "water",
            "params": None,
        },
    ),
    "classify_values": lambda t: (
        wr.riverscape.classify_values,
        {
            "entrenchment": [3.0],
            "width_to_depth": [20.0],
            "sinuosity": [1.4],
            "slope": [0.01],
            "flow": 3.0,
            "order": 2.0,
            "grain_size": 20.0,
            "params": None,
        },
    ),
    "entrenchment_ratio": lambda t: (
        wr.riverscape.entrenchment_ratio,
        {"network": t["network"], "terrain": t["terrain"], "shows": "bed", "params": None},
    ),
    "label_channels": lambda t: (
        wr.riverscape.label_channels,
        {"network": t["network"], "terrain": None, "flow": [1.0, 2.0, 3.0]},
    ),
    "river_mask": lambda t: (wr.riverscape.river_mask, {"terrain": t["terrain"], "min_drainage_area": 1e5}),
    "unit_sections": lambda t: (wr.riverscape.unit_sections, {}),
    "uniform_flow": lambda t: (
        wr.riverscape.uniform_flow,
        {"flow": [2.0], "slope": [0.01], "width_to_depth": [20.0], "params": None},
    ),
    "blend": lambda t: (wr.riverscape.blend, {"under": wr.riverscape.primitives("calm", (0.0, 0.0), 1.0)}),
    "example": lambda t: (wr.riverscape.example, {"name": "C", "seed": 0}),
    "primitives": lambda t: (
        wr.riverscape.primitives,
        {"kind": "wave", "center": (0.0, 0.0), "radius": 1.0, "velocity": (1.0, 0.0), "length": 0.5, "seed": 0},
    ),
    "read_flow_map": lambda t: (wr.riverscape.read_flow_map, {"path": t["folder"] / "flow.png"}),
    "read_riverscape": lambda t: (wr.riverscape.read_riverscape, {"path": t["folder"] / "river.json"}),
    "seed_water": lambda t: (
        wr.riverscape.seed_water,
        {"courses": t["river"].courses, "detail": 2.0, "seed": 0, "params": None},
    ),
    "write_frames": lambda t: (
        wr.riverscape.write_frames,
        {
            "scene": t["river"],
            "folder": t["folder"] / "frames",
            "times": [0.0],
            "cell_size": 0.5,
            "bounds": (10.0, 4.0, 12.0, 6.0),
            "suffix": ".npz",
        },
    ),
    "to_glb": lambda t: (
        t["river"].to_glb,
        {"path": t["folder"] / "a.glb", "bounds": (10.0, 4.0, 12.0, 6.0), "cell_size": 0.5, "time": 0.0},
    ),
    "patches": lambda t: (
        t["river"].patches,
        {
            "eye": (10.0, 4.0, 3.0),
            "bounds": (10.0, 4.0, 30.0, 14.0),
            "cell_size": 1.0,
            "angle": 0.1,
            "time": 0.0,
            "heading": 0.0,
            "field": 60.0,
        },
    ),
    "Riverscape.within": lambda t: (t["river"].within, {"bounds": (10.0, 4.0, 12.0, 6.0)}),
    "Riverscape.replay": lambda t: (t["river"].replay, {"edits": [wr.riverscape.AddRock((12.0, 6.0), 0.4)]}),
    "AddRock": lambda t: (wr.riverscape.AddRock, {"center": (12.0, 6.0), "diameter": 0.4, "height": 0.1}),
    "AddLog": lambda t: (
        wr.riverscape.AddLog,
        {"start": (12.0, 6.0), "end": (14.0, 6.0), "diameter": 0.4, "height": 0.1},
    ),
    "AddWater": lambda t: (
        wr.riverscape.AddWater,
        {
            "tree": wr.riverscape.primitives("calm", (0.0, 0.0), 1.0),
            "layer": "pond",
            "operator": "merge",
            "relative": False,
        },
    ),
    "ChangeWater": lambda t: (
        wr.riverscape.ChangeWater,
        {"layer": "body", "kind": "calm", "set": {"velocity": (1.0, 0.0)}, "times": {"amplitude": 2.0}},
    ),
    "MoveWater": lambda t: (
        wr.riverscape.MoveWater,
        {"layer": "body", "center": (0.0, 0.0), "radius": 2.0, "by": (1.0, 0.0)},
    ),
    "ReplaceWater": lambda t: (
        wr.riverscape.ReplaceWater,
        {"layer": "body", "tree": wr.riverscape.primitives("calm", (0.0, 0.0), 1.0), "relative": False},
    ),
    "MoveObstacle": lambda t: (wr.riverscape.MoveObstacle, {"at": (0.0, 0.0), "to": (1.0, 0.0)}),
    "RetypeChannel": lambda t: (wr.riverscape.RetypeChannel, {"channel": 0, "type": "C"}),
    "RedrawCourse": lambda t: (
        wr.riverscape.RedrawCourse,
        {"channel": 0, "xy": [(0.0, 0.0), (5.0, 1.0), (9.0, 0.0)]},
    ),
    "hillshade": lambda t: (
        wr.viz.hillshade,
        {"terrain": t["terrain"], "azimuth": 315.0, "altitude": 45.0, "exaggeration": 1.0},
    ),
    "calibrate": lambda t: (
        wr.calibration.calibrate,
        {
            "before": t["meander"],
            "after": t["grown"],
            "years": 5.0,
            "params": None,
            "fit": ["migration_rate"],
            "vary": [],
            "length": 50.0,
            "smoothing": 0.5,
            "offset": True,
        },
    ),
    "write_fit": lambda t: (
        wr.calibration.write_fit,
        {"fit": t["fit"], "folder": t["folder"] / "fit", "network": t["grown"], "years": 3.0},
    ),
    "draw_bed": lambda t: (
        wr.viz.draw_bed,
        {"scene": t["riverscape"], "path": t["folder"] / "a.png", "bounds": (60.0, 0.0, 400.0, 240.0), "water": True},
    ),
    "draw_river_types": lambda t: (
        wr.viz.draw_river_types,
        {"types": t["riverscape"].types, "network": t["riverscape"].network, "path": t["folder"] / "a.png"},
    ),
    "draw_belt": drawn(wr.viz.draw_belt, ("history", "history")),
    "draw_before_after": drawn(wr.viz.draw_before_after, ("history", "history")),
    "draw_drainage": drawn(wr.viz.draw_drainage, ("flow", "flow")),
    "draw_elevation": drawn(wr.viz.draw_elevation, ("terrain", "terrain")),
    "draw_landscape": lambda t: (
        functools.partial(wr.viz.draw_landscape, window=(-300.0, -200.0, 300.0, 200.0)),
        {"history": t["history"], "path": t["folder"] / "a.png"},
    ),
    "draw_network": lambda t: (
        wr.viz.draw_network,
        {
            "network": t["network"],
            "path": t["folder"] / "a.png",
            "window": (-300.0, -200.0, 300.0, 200.0),
        },
    ),
    "draw_valley": drawn(wr.viz.draw_valley, ("valley", "valley")),
    "draw_valley_sections": drawn(wr.viz.draw_valley_sections, ("valley", "valley")),
}
# Those of which every call takes a second or more, or that share what is tested with others: their types are tested.
SLOW = {
    "draw_ordered_network", "draw_riverscape", "erosion_movie", "movie", "render_riverscape", "render_scene",
    "riverscape_movie",
    "harmonics_for_covariance", "harmonics_for_covariances", "draw_fit", "draw_fit_map", "draw_hindcast", "hindcast",
    "line_formats", "posterior", "write_hindcast", "mountain_front_zones", "scene_schema", "draw_landscape",
    "simulate_with_plants", "draw_bed", "landscape_maps",
}  # fmt: skip


def public_functions():
    """Functions that the rooms export, by name."""
    rooms = [wr, *(getattr(wr, name) for name in wr._ROOMS)]
    found = {name: getattr(room, name) for room in rooms for name in room.__all__}
    return {name: thing for name, thing in found.items() if inspect.isfunction(thing)}


def test_every_public_function_is_called_with_wrong_arguments():
    assert set(public_functions()) <= set(CALLS) | SLOW, set(public_functions()) - set(CALLS) - SLOW


def test_every_public_function_holds_its_arguments_against_their_annotations():
    unguarded = [name for name, f in public_functions().items() if inspect.signature(f).parameters
                 and not hasattr(f, "__wrapped__")]  # fmt: skip
    assert unguarded == []


@pytest.mark.usefixtures("coarse_pictures")
@pytest.mark.parametrize("name", CALLS)
def test_what_is_wrong_is_refused_by_name(name, things, monkeypatch):
    """One argument at a time; what is left over is an error of ours, whose message is one line that is not long."""
    monkeypatch.chdir(things["folder"])  # where a text that is taken for a path may be written
    function, good = CALLS[name](things)
    faults = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        function(**good)
        for argument in good:
            for what, value in WRONG.items():
                value = things[what] if isinstance(value, str) and value in ("NETWORK", "TERRAIN") else value
                try:
                    function(**{**CALLS[name](things)[1], argument: value})
                except WarpriverError as error:
                    said = str(error)
                    if not (8 < len(said) < 600 and "\n" not in said):
                        faults.append(f"{name}({argument}={what}) says: {said[:700]!r}")
                except Exception as error:
                    place = traceback.extract_tb(error.__traceback__)[-1]
                    faults.append(f"{name}({argument}={what}): {place.filename}:{place.lineno}: {error!r}")
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize("name", [name for name in CALLS if name.startswith("draw_")])
def test_a_place_where_no_picture_can_go_is_refused_before_anything_is_drawn(name, things, monkeypatch):
    import matplotlib.figure
    import warp as wp

    function, good = CALLS[name](things)
    for drawn in ((matplotlib.figure.Figure, "__init__"), (wp, "launch")):
        monkeypatch.setattr(*drawn, lambda *_, **__: pytest.fail("drawn before it was known where to"))
    for path, said in ((things["folder"] / "a.bmp", "must end in"), (things["folder"] / "none" / "a.png", "folder")):
        with pytest.raises(WarpriverError, match=said):
            function(**{**good, "path": path})


def test_warnings_tell_the_line_of_the_user(tmp_path):
    """Not one within warpriver, however deep the function lies that warns."""
    wr.write_network(
        wr.RiverNetwork.from_polylines([[[0.0, 0.0], [900.0, 0.0], [1800.0, 9.0]]], 30.0), tmp_path / "a.csv"
    )
    text = (tmp_path / "a.csv").read_text().replace("width_m", "other").replace("depth_m", "another")
    (tmp_path / "a.csv").write_text(text)
    with pytest.warns(UserWarning, match="no width") as told:
        wr.read_network(tmp_path / "a.csv")
    assert {warning.filename for warning in told} == {__file__}
