"""The process beside the simulation that makes what takes longer than a step: maps, river types, movies and exports.

It reads the states of the run from the disk, and is told its events; so the run goes on while a map is made.
"""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError, WarpriverError
from warpriver.history import Avulsion, Collision, Crevasse, Cutoff, Event, History
from warpriver.landscape import CarveParams, Landscape, carve, export_landscape, landscape_maps, plain_under
from warpriver.network import RiverNetwork
from warpriver.raster import Raster
from warpriver.riverscape import Riverscape, classify_rivers
from warpriver.studio.author import EVENTS_KEPT
from warpriver.studio.frames import decode_state, encode_map
from warpriver.studio.limits import limit_memory, release_memory
from warpriver.studio.processes import name_process
from warpriver.studio.reel import REEL, state_file
from warpriver.terrain import Terrain
from warpriver.validate import finite_numbers, positive

__all__ = ["EVENTS", "EXPORTS", "MAPS", "events_as_json", "map_process"]

# Maps that a page can show: title, unit, and the range of values; None stands for what the map holds.
MAPS: dict[str, tuple[str, str, float | None, float | None]] = {
    "moisture": ("Soil moisture", "-", 0.0, None),
    "sediment": ("Deposits", "m", 0.0, None),
    "vegetation": ("Density of vegetation", "-", 0.0, 1.0),
    "age": ("Years since the channel left", "yr", 0.0, None),
    "belt": ("Where channels have been", "-", 0.0, 1.0),
    "elevation_change": ("Change of height", "m", None, None),
    "sand": ("Fraction of sand", "-", 0.0, 1.0),
}
# What is made here to be downloaded.
MOVIES = {"run.gif": ".gif", "run.mp4": ".mp4"}
TARGETS = {
    "gis": "a GIS", "mesh": "3-D programs (meshes)", "paraview": "ParaView", "unreal": "Unreal Engine",
    "unity": "Unity", "godot": "Godot", "blender": "Blender", "houdini": "Houdini",
}  # fmt: skip
EXPORTS = (*MOVIES, *(f"landscape-{name}.zip" for name in TARGETS), "water.png")
# Cells along the longer side of a map, and across the narrowest channel; states that a map is led through at most to
# come up with the run; states of a movie, and of the ground's export.
MAP_CELLS, CELLS_ACROSS, CATCH_UP = 768, 3.0, 400
# States that a map is led through from one time to the next, and steps between two of them where there are more.
UPDATE, UPDATE_STEPS = 20, 10
MOVIE_STATES, EXPORT_STATES = 120, 60
MOVIE_SIZE, WATER_SIZE = (1280, 720), (960, 540)
# How far the reach whose water is drawn goes on beside what is seen, the cells of ground around it, and how many times
# the least piece of water goes into what is seen.
REACH_VIEWS, RIM_CELLS, WATER_DETAILS = 1.5, 4.0, 250.0
# Bytes of memory that the process may take.
MEMORY = 8 * 2**30
# Where the values of a map without a limit end, as a percentile.
TOP = 99.5
# Kinds of events that maps take.
EVENTS: dict[str, type[Event]] = {each.__name__: each for each in (Cutoff, Collision, Avulsion, Crevasse)}


class StoredRun(History):
    """The run as a history whose states are read from the disk when they are asked for."""

    def __init__(self, start: History, folder: Path, origin: np.ndarray):
        """Begin without states.

        Args:
            start: The run at its beginning: its constants and its CRS.
            folder: Where the states are.
            origin: Origin of the map, m, to which states are relative.
        """
        super().__init__(start.params, seed=start.seed, origin=start.origin, crs=start.crs)
        self._states: list[tuple[int, float]] = []
        self._place, self._map_origin = folder, origin

    def of(self, states: Sequence[tuple[int, float]]) -> StoredRun:
        """Return the run with some of its states only, and the same events."""
        part = StoredRun(self, self._place, self._map_origin)
        part._states = list(states)
        part.share_events(self)
        return part

    @property
    def times(self) -> np.ndarray:
        """Times of the states in yr."""
        return np.array([time for _, time in self._states])

    @property
    def steps(self) -> np.ndarray:
        """Steps done at the states."""
        return np.array([step for step, _ in self._states], np.int64)

    def __len__(self) -> int:
        return len(self._states)

    def network(self, index: int) -> RiverNetwork:
        """Return the network of one state."""
        state = decode_state(state_file(self._place, self._states[index][0]).read_bytes())
        width, depth, discharge, _ = np.asarray(state.channel_size, np.float64).T
        section = None
        if state.point_width is not None:
            start = state.channel_start.astype(np.int64)
            section = np.stack([state.point_width, np.repeat(depth, start[1:] - start[:-1])], axis=1)
        return RiverNetwork(
            np.asarray(state.point_xy, np.float64),
            state.channel_start.astype(np.int32),
            point_section=section,
            origin=self._map_origin,
            crs=self.crs,
            channel_width=width,
            channel_depth=depth,
            channel_discharge=discharge,
            channel_id=state.channel_id.astype(np.int64),
        )


class Mapper:
    """What the process knows of the run, and what it makes of it."""

    def __init__(self, folder: Path, send: Callable[[bytes], None]):
        """Take the folder of a session."""
        self._folder, self._send = folder, send
        self._epoch = -1
        self._run: StoredRun | None = None
        self._states: list[tuple[int, float]] = []
        # Events that the run has had before those that are remembered.
        self._dropped = 0
        self._ground: Terrain | None = None
        self._map: Landscape | None = None
        self._led: StoredRun | None = None
        # What the run stands at, and the ground carved there, which every target can be written from.
        self._stand: tuple[int, ...] = ()
        self._carved: tuple[tuple[int, ...], tuple[Any, ...]] | None = None

    # ---- what has happened

    def learn(self, news: dict[str, Any]) -> None:
        """Take in where the run stands: its states on the disk, and events since the last time."""
        states = [(int(step), float(time)) for step, time in news["states"]]
        if news["epoch"] != self._epoch or self._run is None:
            self._epoch = news["epoch"]
            origin = np.array(news["origin"])
            fresh = StoredRun(History.load(self._folder / news["run"]), self._folder / REEL, origin)
            if self._run is not None:
                fresh.share_events(self._run)
            self._run = fresh
            self._map = self._led = None
            self._ground = None
            if news["ground"] is not None:
                height = np.load(news["ground"]["file"], allow_pickle=False)
                self._ground = Terrain(height, news["ground"]["cell"], news["ground"]["origin"], self._run.crs)
        # Those that it knows and that have been taken back since are forgotten.
        known = int(news["known"])
        self._run.forget_events(max(0, known - self._dropped))
        self._dropped = known - len(self._run.events)
        self._run.events.extend(_event_of(told) for told in news["events"])
        if len(self._run.events) > 2 * EVENTS_KEPT:
            self._dropped += len(self._run.events) - EVENTS_KEPT
            # Those before have been laid down on the maps long ago, and their lakes are full.
            latest = list(self._run.events[-EVENTS_KEPT:])
            self._run.forget_events(0)
            self._run.events.extend(latest)
        self._states = states
        self._stand = (self._epoch, states[-1][0] if states else -1, int(news["edits"]))
        if self._carved is not None and self._carved[0] != self._stand:
            self._carved = None

    def _kept(self, most: int, after: int = -1) -> list[tuple[int, float]]:
        """Return states after a step that are on the disk, at most so many, the last one among them."""
        later = [state for state in self._states if state[0] > after]
        stride = max(1, -(-len(later) // most))
        chosen = later[len(later) - 1 :: -stride][::-1]
        assert self._run is not None
        return [state for state in chosen if self._is_kept(state)]

    def _is_kept(self, state: tuple[int, float]) -> bool:
        return state_file(self._folder / REEL, state[0]).exists()

    def _present(self, most: int) -> StoredRun:
        assert self._run is not None
        states = self._kept(most)
        if not states:
            raise InputError("no state of the run is kept yet; do a step")
        return self._run.of(states)

    # ---- maps

    def do_map(self, name: str) -> None:
        """Make a map of the ground, and send it."""
        maps = self._maps()
        raster: Raster = maps.rasters[name]
        title, unit, low, high = MAPS[name]
        values = np.asarray(raster.numpy(), np.float64)
        known = values[np.isfinite(values)]
        if name == "belt":
            raster = raster.like(np.where(values > 0.0, 1.0, np.nan))
        if low is None:
            most = float(np.percentile(np.abs(known), TOP)) if len(known) else 1.0
            low, high = -max(most, 0.1), max(most, 0.1)
        if high is None:
            felt = known[known > 0.0]
            high = float(np.percentile(felt, TOP)) if len(felt) else 1.0
        self._tell(type="map", name=name, title=title, unit=unit, low=low, high=high, time=maps.time)
        assert self._run is not None
        self._send(b"B" + encode_map(name, raster, low, high, self._run._map_origin))

    def _maps(self) -> Any:
        """Lead the cells up to the last state, and return the maps there."""
        assert self._run is not None
        if self._map is None or self._led is None:
            self._led = self._present(CATCH_UP)
            network = self._led.networks[0]
            west, south, east, north = self._bounds()
            size = max(east - west, north - south) / MAP_CELLS
            size = max(size, float(network.channel_width.min()) / CELLS_ACROSS)
            ground = self._ground
            self._map = Landscape(self._led, ground, size, bounds=(west, south, east, north), threads=1)
        else:
            last = self._led._states[-1][0]
            new = self._states[-1][0] - last
            self._led._states += self._kept(min(CATCH_UP, max(UPDATE, -(-new // UPDATE_STEPS))), last)
        for last_try in (False, False, True):
            # The run goes on, and may have given up some of the states since they were listed.
            ahead = self._led._states[self._map.record + 1 :]
            self._led._states[self._map.record + 1 :] = [state for state in ahead if self._is_kept(state)]
            try:
                self._map.lead_to(len(self._led) - 1)
                break
            except FileNotFoundError:
                if last_try:
                    raise
        return self._map.maps()

    def _bounds(self) -> tuple[float, float, float, float]:
        if self._ground is not None:
            return self._ground.bounds
        west, south, east, north = self._present(1).networks[0].bounds()
        margin = 0.1 * max(east - west, north - south)
        return west - margin, south - margin, east + margin, north + margin

    def do_types(self) -> None:
        """Give each channel its Rosgen type, and tell them."""
        network = self._present(1).networks[-1]
        types = classify_rivers(network, self._ground)
        told = {
            str(identity): [str(types.channel_type[k]), types.reasons(k)]
            for k, identity in enumerate(network.channel_id.tolist())
        }
        self._tell(type="river_types", types=told)

    # ---- files

    def do_export(self, name: str, center: Sequence[float] | None = None, width: float = 200.0) -> dict[str, Any]:
        """Write a file into the folder of exports, and return its name."""
        place = self._folder / "exports"
        place.mkdir(exist_ok=True)
        if name in MOVIES:
            self._write_movie(place / name)
        elif name == "water.png":
            self._draw_water(place / name, center, width)
        elif name in EXPORTS:
            self._write_landscape(place / name, name[len("landscape-") : -len(".zip")])
        else:
            raise InputError(f"there is no export {name!r}; there are {', '.join(EXPORTS)}")
        return {"file": name}

    def _write_movie(self, path: Path) -> None:
        from warpriver.viz import movie

        movie(self._present(MOVIE_STATES), path, terrain=self._ground, size=MOVIE_SIZE, fps=12.0, title="")

    def _write_landscape(self, path: Path, target: str) -> None:
        """Carve the ground and write it for another program, as one archive."""
        if self._carved is None:
            self._carved = (self._stand, self._carve())
        carved, run, maps = self._carved[1]
        made = path.with_suffix(".files")
        shutil.rmtree(made, ignore_errors=True)
        try:
            export_landscape(carved, made, targets=[target], history=run, maps=maps)
            fresh = path.with_suffix(".part")
            with zipfile.ZipFile(fresh, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
                for file in sorted(made.rglob("*")):
                    if file.is_file():
                        archive.write(file, file.relative_to(made))
            os.replace(fresh, path)
        finally:
            shutil.rmtree(made, ignore_errors=True)

    def _carve(self) -> tuple[Any, StoredRun, dict[str, Raster]]:
        """Return the carved ground, the run and its maps."""
        run = self._present(EXPORT_STATES)
        network = run.networks[-1]
        maps, deposits = {}, None
        ground = self._ground
        if ground is None:
            ground = plain_under(network, history=run)
        else:
            maps = landscape_maps(run, ground, ground.cell_size).rasters
            change = maps["elevation_change"]
            deposits = change.like(np.maximum(change.numpy(), 0.0), unit="m", name="deposits")
        return carve(ground, network, CarveParams(), deposits=deposits, history=run), run, maps

    def _draw_water(self, path: Path, center: Sequence[float] | None, width: float) -> None:
        """Draw the water of the river at a place, as a riverscape shows it."""
        from warpriver.viz import Camera, draw_riverscape

        network = self._present(1).networks[-1]
        if self._ground is None:
            raise InputError("this session has no terrain, from which its water could be drawn")
        at = np.array(finite_numbers(center, 2, "center"))
        view = positive(width, "width", "m")
        reach, heading = _reach_around(network, at, REACH_VIEWS * view)
        (west, south), (east, north) = reach.points().min(axis=0), reach.points().max(axis=0)
        rim = max(view, RIM_CELLS * self._ground.cell_size)
        ground = self._ground.crop((west - rim, south - rim, east + rim, north + rim))
        scene = Riverscape(
            ground, reach, planform="given", width="network", detail=max(0.5, view / WATER_DETAILS), seed=0
        )
        # Seen from aside, a little downstream.
        camera = Camera((float(at[0]), float(at[1])), heading=heading + 60.0, tilt=40.0, distance=1.2 * view)
        draw_riverscape(scene, path, camera=camera, size=WATER_SIZE)

    def _tell(self, **told: Any) -> None:
        self._send(b"J" + json.dumps(told, allow_nan=False, default=float).encode())


def _reach_around(network: RiverNetwork, at: np.ndarray, reach: float) -> tuple[RiverNetwork, float]:
    """Return the reach of the channel nearest to a place, so many m up and down, and its direction there, degrees."""
    lines = network.polylines()
    c = int(np.argmin([float(np.hypot(*(line - at).T).min()) for line in lines]))
    line, k = lines[c], int(np.argmin(np.hypot(*(lines[c] - at).T)))
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    first, last = np.searchsorted(arc, [arc[k] - reach, arc[k] + reach])
    part = slice(max(0, min(int(first), k - 1, len(line) - 3)), min(len(line), max(int(last) + 1, k + 2, 3)))
    along = line[min(k + 1, len(line) - 1)] - line[max(k - 1, 0)]
    made = RiverNetwork.from_polylines(
        [line[part]],
        width=[network.point_widths()[c][part]],
        depth=[network.point_depths()[c][part]],
        discharge=network.channel_discharge[c : c + 1],
        crs=network.crs,
    )
    return made, float(np.degrees(np.arctan2(along[1], along[0])))


def events_as_json(events: Sequence[Event]) -> list[dict[str, Any]]:
    """Return the events that maps take, as JSON can hold them."""
    found = []
    for event in events:
        name = type(event).__name__
        if name in EVENTS:
            fields = {key: v.tolist() if isinstance(v, np.ndarray) else v for key, v in vars(event).items()}
            found.append({"event": name} | fields)
    return found


def _event_of(told: dict[str, Any]) -> Event:
    fields = dict(told)
    kind = EVENTS[fields.pop("event")]
    arrays = {
        key: np.array(value, np.int64 if key == "start" else np.float64)
        for key, value in fields.items()
        if isinstance(value, list)
    }
    return kind(**fields | arrays)


def map_process(connection: Connection, folder: str) -> None:
    """Make what is asked for until the other end closes: the target of the process."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    name_process("wr-maps")
    os.nice(5)
    limit_memory(MEMORY)
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    mapper = Mapper(Path(folder), connection.send_bytes)
    ways: dict[str, Callable[..., dict[str, Any] | None]] = {
        "map": mapper.do_map,
        "types": mapper.do_types,
        "export": mapper.do_export,
    }
    try:
        while True:
            message = connection.recv_bytes()
            if message == b"Q":
                return
            told = json.loads(message)
            number = told.get("number")
            try:
                mapper.learn(told["news"])
                answer = ways[told["do"]](**told.get("with", {})) or {}
            except (WarpriverError, ValueError, OSError, ArithmeticError, ImportError, MemoryError) as error:
                answer = {"error": f"{error or type(error).__name__}"}
                if number is None:
                    connection.send_bytes(b"J" + json.dumps({"type": "error", "text": answer["error"]}).encode())
            if number is not None:
                connection.send_bytes(b"J" + json.dumps({"type": "answer", "number": number, **answer}).encode())
            connection.send_bytes(b"I")
            release_memory()
    except (EOFError, BrokenPipeError, OSError):
        return
