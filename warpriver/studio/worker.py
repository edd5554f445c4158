"""The process that owns the simulation of a session: it steps, does what pages ask for, and sends what has changed."""

from __future__ import annotations

import dataclasses
import inspect
import json
import secrets
import shutil
import signal
import time
import zipfile
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.edits import Edit
from warpriver.edits.ground import edited_box
from warpriver.edits.values import edit_of
from warpriver.errors import InputError, WarpriverError
from warpriver.history import Avulsion, Collision, Cutoff, Event
from warpriver.hydrology import strahler_order
from warpriver.io import write_network, write_terrain
from warpriver.meander import Attractor, Control, ControlField, DampingRegion, ErodibilityField, Guide, Repeller
from warpriver.params import MeanderParams
from warpriver.raster import Raster
from warpriver.simulation import Simulation
from warpriver.studio.author import Author
from warpriver.studio.figures import FIGURES, Series, figures_of
from warpriver.studio.folder import (
    CHECKED,
    CHECKPOINT,
    EDITS,
    KEPT,
    RUN,
    SAVED,
    begin_folder,
    copy_session,
    read_checkpoint,
    taken_up,
)
from warpriver.studio.frames import State, as_earlier, encode_loops, encode_patch, encode_state
from warpriver.studio.generators import described
from warpriver.studio.journal import Journal
from warpriver.studio.limits import release_memory
from warpriver.studio.mapping import EVENTS, EXPORTS, MAPS, TARGETS, events_as_json
from warpriver.studio.news import REQUEST, News
from warpriver.studio.presets import PRESETS, SHOWN, constants_shown
from warpriver.studio.processes import name_process
from warpriver.studio.reel import REEL, Reel

__all__ = ["Worker", "work"]

# The ground as it is now, for the process that makes maps.
GROUND = "ground.npy"
# Steps a second at most, and frames that may be on their way.
RATE, WINDOW = 30.0, 2
# Seconds between two sets of figures for the plots, two notes of how far a run has come, and two maps of it; steps
# between two sets of figures at most.
STATS_SECONDS, KEEP_SECONDS, MAP_SECONDS = 0.5, 2.0, 2.0
STATS_STEPS = 50
# Seconds of play between two checkpoints, and how many times as long as one takes at least.
CHECK_SECONDS, CHECK_SHARE = 60.0, 50.0
# Lines left behind that a page is told when it begins: the latest ones.
LOOPS_TOLD = 2000
# Edits that carve the ground.
CARVING = ("AvulseChannel", "DivertChannel", "DeferJunction")
CONTROLS: dict[str, Callable[..., Control]] = {
    "Attractor": Attractor, "Repeller": Repeller, "Guide": Guide,
    "DampingRegion": DampingRegion, "ErodibilityField": ErodibilityField,
}  # fmt: skip


# Answer of a command that another process will answer.
LATER: dict[str, Any] = {}


class Worker:
    """A session in its process."""

    def __init__(self, folder: Path, send: Callable[[bytes], None]):
        """Take up the session of a folder.

        Args:
            folder: Folder of the session.
            send: Sends a message: "J" and a text in JSON, "B" and a frame, "R" and the frame of an earlier state, or
                "M" and what the process that makes maps shall do.
        """
        self.folder, self._send = folder, send
        self.playing, self.rate = False, RATE
        self.credits = WINDOW
        self._sequence = self._command = 0
        self._step_ms = 0.0
        self._changed, self._due, self._told, self._kept = True, 0.0, 0.0, 0.0
        self._order: tuple[int, np.ndarray] = (-1, np.empty(0))
        self._origin = np.zeros(2)
        self._reel, self._series, self._figured = Reel(folder / REEL), Series(), (-STATS_STEPS, 0.0)
        self._news = News()
        # The ground as pages show it.
        self._shown = np.empty((0, 0), np.float32)
        # The frame of the present state, where it has been made already.
        self._made: bytes | None = None
        self._checked, self._check_due = time.monotonic(), CHECK_SECONDS
        word = self._take_up()
        self.tell_scene()
        if word is not None:
            self._tell(type="error", text=word)

    def _take_up(self) -> str | None:
        """Take up the session of the folder; returns a word on what is missing of it."""

        def begin(author: Author) -> None:
            self.author = author
            west, south, east, north = self._bounds()
            self._origin = np.array([0.5 * (west + east), 0.5 * (south + north)])
            author.stepped, author.returned = self._keep_fresh, self._go_back
            self._reel.clear()
            self._series = Series()
            self._keep_fresh()
            # Those up to a checkpoint, from which it is taken up; others are noted as steps are done again.
            checked = read_checkpoint(self.folder)
            if checked is not None:
                self._series.read(self.folder / FIGURES, checked.steps)

        _, word = taken_up(self.folder, begin)
        self._journal = self._open_journal()
        return word

    # ---- the loop

    def wait(self) -> float | None:
        """Return the seconds until there is something to do; None if only a command can bring that."""
        if self._changed and self.credits > 0:
            return 0.0
        now = time.monotonic()
        dues = [self._due] if self.playing else []
        dues += [self._news.asked + MAP_SECONDS] if self._map_is_due() else []
        return max(0.0, min(dues) - now) if dues else None

    def turn(self) -> None:
        """Do a step if one is due, and send what has changed."""
        # What was edited is shown before the next step.
        self._show()
        now = time.monotonic()
        if self.playing and now >= self._due:
            # At most one period late, so that a slow step is not followed by a burst.
            self._due = max(self._due + 1.0 / self.rate, now)
            self._step()
            self._show()
        if now - self._told >= STATS_SECONDS:
            self._tell_figures(now)
        if self.playing and now - self._kept >= KEEP_SECONDS:
            self._keep()
        if self.playing and now - self._checked >= self._check_due:
            self._check()
        self._ask_for_map(now)

    def _show(self) -> None:
        """Send the present state, if it has changed and one may be on its way."""
        if self._changed and self.credits > 0:
            self.credits -= 1
            self._changed = False
            self._send(b"B" + self._present())

    def _present(self) -> bytes:
        """Return the frame of the present state."""
        if self._made is None:
            self._made = self._frame()
        return self._made

    def _open_journal(self) -> Journal:
        simulation = self.author.simulation
        return Journal(self.folder / EDITS, simulation.seed, self.author.entries, simulation.step_count)

    def _keep(self) -> None:
        """Note edits and steps in the folder, from which the session is taken up again."""
        self._journal.note(self.author.entries, self.author.simulation.step_count)
        self._kept = time.monotonic()

    def _check(self) -> None:
        """Keep the run as it is now, so that little is to be done again when the session is taken up."""
        begin = time.monotonic()
        fresh = self.folder / f"{CHECKPOINT}.new"
        shutil.rmtree(fresh, ignore_errors=True)
        told = self.author.save_checkpoint(fresh)
        (self.folder / CHECKED).unlink(missing_ok=True)
        shutil.rmtree(self.folder / CHECKPOINT, ignore_errors=True)
        fresh.rename(self.folder / CHECKPOINT)
        self._series.write(self.folder / FIGURES)
        (self.folder / CHECKED).write_text(json.dumps(told))
        release_memory()
        self._checked = time.monotonic()
        self._check_due = max(CHECK_SECONDS, CHECK_SHARE * (self._checked - begin))

    def _step(self, count: int = 1) -> None:
        begin = time.perf_counter()
        try:
            events = self.author.step(count)
        except FloatingPointError as error:
            self.playing = False
            self._tell(type="error", text=f"the run has stopped: {error}")
            return
        self._step_ms = 1e3 * (time.perf_counter() - begin) / count
        self._changed = True
        self._tell_events(events)

    # ---- commands

    def obey(self, number: int, command: Any) -> None:
        """Do what a page asks for; an answer tells that it is done, or why it cannot be."""
        self._command, self._made = number, None
        try:
            answer = self._do(command)
        except (WarpriverError, ValueError, OSError) as error:
            self._answer(number, error=str(error))
            return
        if answer is not LATER:
            self._answer(number, **(answer or {}))

    def _do(self, command: Any) -> dict[str, Any] | None:
        if not isinstance(command, dict) or not isinstance(command.get("do"), str):
            raise InputError("a command is an object with the key 'do'")
        name = command["do"]
        method = getattr(self, f"do_{name}", None)
        if method is None:
            names = ", ".join(sorted(each[3:] for each in dir(self) if each.startswith("do_")))
            raise InputError(f"there is no command {name[:40]!r}; there are {names}")
        arguments = {key: value for key, value in command.items() if key != "do"}
        takes = inspect.signature(method)
        try:
            takes.bind(**arguments)
        except TypeError as error:
            known = ", ".join(takes.parameters) or "nothing"
            raise InputError(f"{name} has wrong arguments: {error}; it takes {known}") from error
        answer: dict[str, Any] | None = method(**arguments)
        return answer

    def do_play(self, rate: float | None = None) -> None:
        """Go on by itself, at so many steps a second."""
        if rate is not None:
            self.rate = _rate(rate)
        if not self.playing:
            self.playing, self._due = True, time.monotonic()
        self._tell_session()

    def do_pause(self) -> None:
        """Stand still."""
        self.playing, self._changed = False, True
        self._tell_session()

    def do_step(self, count: int = 1) -> None:
        """Do so many steps."""
        if not isinstance(count, int) or not 1 <= count <= 10_000:
            raise InputError(f"count is {count!r}; give 1 to 10,000 steps")
        self._step(count)

    def do_rate(self, rate: float) -> None:
        """Set the steps a second."""
        self.rate = _rate(rate)
        self._tell_session()

    def do_scene(self) -> None:
        """Tell everything again."""
        self.tell_scene()

    def do_edit(self, edit: Any, group: Any = None) -> None:
        """Do an edit, as ``warpriver.edits`` describes it in JSON."""
        value = edit_of(edit)
        before = self._ground_sum() if value.name in CARVING else None
        self.author.apply(value, _group(group))
        self._after_edit(value, before)

    def do_paint(self, center: Any, radius: Any, amount: Any, group: Any = None) -> None:
        """Paint on the control field."""
        had = self._field() is not None
        for each in self.author.paint(center, radius, amount, _group(group)):
            self._after_edit(each, None)
        if not had:
            self.tell_scene()

    def do_controls(self, controls: Any) -> None:
        """Let other controls steer the channels."""
        if not isinstance(controls, list):
            raise InputError("controls is a list of objects with the key 'kind'")
        self._after_edit(self.author.set_controls([_control_of(each) for each in controls]), None)

    def do_undo(self) -> None:
        """Take the last edit back."""
        self._back(self.author.undo)

    def do_redo(self) -> None:
        """Do it again."""
        self._back(self.author.redo)

    def do_rewind(self, step: Any) -> dict[str, Any]:
        """Go on from an earlier step; edits after it are forgotten."""
        lost = self.author.rewind(step)
        self._news.begin()
        self._tell_all_again()
        return {"forgotten": lost}

    def do_params(self, **constants: Any) -> None:
        """Begin anew from the rivers as they are now, with other constants."""
        now = self.author.simulation
        names = set(SHOWN)
        if unknown := sorted(set(constants) - names):
            raise InputError(f"there is no constant {unknown[0]!r}; there are {', '.join(sorted(names))}")
        params = MeanderParams(**{**{name: getattr(now.params, name) for name in _params_fields()}, **constants})
        self.begin(Simulation(now.network, params, terrain=now.terrain, seed=now.seed, controls=now.controls))

    def do_preset(self, name: Any) -> dict[str, Any]:
        """Begin anew from the rivers as they are now, with the constants of a preset."""
        if name not in PRESETS:
            raise InputError(f"there is no preset {str(name)[:40]!r}; there are {', '.join(PRESETS)}")
        now = self.author.simulation
        params, told = PRESETS[name].params(), {}
        narrowest = min(float(width.min()) for width in now.network.point_widths())
        if params.spacing_in_widths == 0.0 and params.spacing > narrowest:
            # One spacing for all, as it asks for, and none wider than a river.
            params = params.replace(spacing=narrowest)
            told = {"note": f"points lie {narrowest:.3g} m apart, the width of the narrowest river"}
        self.begin(Simulation(now.network, params, terrain=now.terrain, seed=now.seed, controls=now.controls))
        return told

    def do_map(self, name: Any = None) -> None:
        """Show a map of the ground, or none."""
        if name is not None and name not in MAPS:
            raise InputError(f"there is no map {str(name)[:40]!r}; there are {', '.join(MAPS)}")
        self._news.map, self._news.asked = name, -1.0
        self._tell_session()

    def do_types(self, on: Any = True) -> None:
        """Colour the channels by their type, or no longer."""
        self._news.types, self._news.asked = bool(on), -1.0
        self._tell_session()

    def do_save(self) -> dict[str, Any]:
        """Keep the session as it is now under a new name."""
        self._keep()
        self._check()
        name = secrets.token_hex(8)
        copy_session(self.folder, self.folder / SAVED / name)
        return {"saved": name}

    def do_record(self, index: Any) -> None:
        """Send a state of the timeline."""
        shown = self._reel.shown()
        if not isinstance(index, int) or not 0 <= index < len(shown):
            raise InputError(f"index is {index!r}; the timeline has {len(shown)} states")
        self._send(b"R" + as_earlier(self._reel.frame(shown[index][0])))

    def do_export(self, name: str, center: Any = None, width: Any = 200.0) -> dict[str, Any]:
        """Write a file into the folder of the session, and return its name."""
        exports = {
            "rivers.gpkg": lambda path: write_network(self.author.simulation.network, path),
            "rivers.geojson": lambda path: write_network(self.author.simulation.network, path),
            "terrain.tif": self._write_terrain,
            "terrain.png": self._write_terrain,
            "edits.json": self.author.write_session,
            "session.zip": self._write_archive,
        }
        if name in EXPORTS:
            self._keep_record(always=True)
            self._ask_mapper("export", {"name": name, "center": center, "width": width}, self._command)
            return LATER
        if name not in exports:
            raise InputError(f"there is no export {name!r}; there are {', '.join([*exports, *EXPORTS])}")
        place = self.folder / "exports"
        place.mkdir(exist_ok=True)
        exports[name](place / name)
        return {"file": name}

    def _write_archive(self, path: Path) -> None:
        """Write the session as one file, which opens anywhere to the same bits."""
        self._keep()
        self._check()
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name in KEPT:
                place = self.folder / name
                for file in sorted(place.rglob("*")) if place.is_dir() else [place]:
                    if file.is_file():
                        archive.write(file, file.relative_to(self.folder))

    def begin(self, simulation: Simulation) -> None:
        """Begin the session anew from a simulation."""
        fresh = self.folder.with_name(self.folder.name + ".new")
        shutil.rmtree(fresh, ignore_errors=True)
        begin_folder(fresh, simulation)
        self._journal.close()
        copy_session(fresh, self.folder)
        shutil.rmtree(fresh, ignore_errors=True)
        self._take_up()
        self._news.forget()
        self._tell_all_again()

    def _write_terrain(self, path: Path) -> None:
        if self.author.simulation.terrain is None:
            raise InputError("this session has no terrain")
        write_terrain(self.author.simulation.terrain, path)

    def _back(self, way: Callable[[], object]) -> None:
        """Undo or redo, which may change everything."""
        ground, field = self._ground_sum(), self._field_sum()
        way()
        self._news.take_back(*self._happened())
        if self._ground_sum() != ground:
            self._send_carved()
        painted = self._field_sum()
        if (painted is None) != (field is None):
            self.tell_scene()
        elif painted != field:
            self._send_raster("control")
        self._changed = True
        self._tell_loops()
        self._news.begin()
        self._keep()
        self._tell_session()

    def _after_edit(self, edit: Edit, ground: int | None) -> None:
        self._changed, self._made = True, None
        self._show()
        self._keep_record()
        box = _touched(edit)
        if edit.name == "EditTerrain":
            self._send_raster("height", box)
        elif edit.name in CARVING and ground != self._ground_sum():
            self._send_carved()
        elif edit.name == "PaintControl":
            self._send_raster("control", window=edit.window)  # type: ignore[attr-defined]
        if edit.name == "EditTerrain" or edit.name in CARVING:
            self._news.ground = None
        if edit.name in (*CARVING, "CutLoop"):
            self._tell_loops()
        self._keep()
        self._tell_session()

    # ---- what pages are told

    def tell_scene(self) -> None:
        """Tell a page all that it needs to begin."""
        simulation = self.author.simulation
        terrain, network = simulation.terrain, simulation.network
        self._tell(
            type="scene",
            origin=self._origin.tolist(),
            bounds=list(self._bounds()),
            crs=network.crs,
            terrain=_place(None if terrain is None else terrain.raster),
            control=_place(self._field()),
            params={name: getattr(simulation.params, name, None) for name in SHOWN},
            constants=constants_shown(),
            presets=[[name, preset.title, preset.doc] for name, preset in PRESETS.items()],
            maps=[[name, title] for name, (title, *_) in MAPS.items()],
            targets=[[f"landscape-{name}.zip", word] for name, word in TARGETS.items()],
            generators=described(),
            series=self._series.told(),
            time_step=simulation.params.time_step,
        )
        self._send_raster("height")
        self._send_raster("control")
        self._tell_loops()
        self._tell_session()
        self._changed = True

    def _tell_all_again(self) -> None:
        self._keep()
        self.tell_scene()

    def _tell_session(self) -> None:
        author = self.author
        controls = [_described(each) for each in author.simulation.controls if not isinstance(each, ControlField)]
        locks = [tuple(float(v) for v in xy - self._origin) for xy in _locked(author.simulation)]
        self._tell(
            type="session", playing=self.playing, rate=self.rate, undo=author.undoable, redo=author.redoable,
            edits=[[step, edit.name] for step, edit in author.edits[-50:]], controls=controls, locks=locks,
            records=self._reel.shown(), map=self._news.map, types=self._news.types,
        )  # fmt: skip

    def _note_figures(self) -> None:
        """Note the figures of the present state."""
        network, author = self.author.simulation.network, self.author
        step = author.simulation.step_count
        self._figured = (step, time.monotonic())
        sinuosity, wave = figures_of(network)
        self._series.note(step, author.simulation.time, sinuosity, author.count(Cutoff), wave)

    def _tell_figures(self, now: float) -> None:
        self._told = now
        author, network = self.author, self.author.simulation.network
        if not network.channel_count:
            return
        if self._figured[0] != author.simulation.step_count or not self._series.rows:
            self._note_figures()
        _, at, sinuosity, cutoffs, wave = self._series.rows[-1]
        self._tell(
            type="figures", time=at, sinuosity=sinuosity, wavelength=wave, cutoffs=cutoffs,
            collisions=author.count(Collision), avulsions=author.count(Avulsion), points=network.point_count,
            channels=network.channel_count, step_ms=self._step_ms, records=self._reel.shown(),
        )  # fmt: skip

    def _tell_loops(self) -> None:
        history = self.author.simulation.history
        cutoffs = list(history.cutoffs[-LOOPS_TOLD:])
        self._send(b"B" + self._loops(cutoffs, 2))
        courses = list(history.avulsions[-LOOPS_TOLD:])
        self._send(b"B" + self._loops(courses, 3))

    def _loops(self, left: Sequence[Cutoff | Avulsion], kind: int) -> bytes:
        return encode_loops(
            [each.xy for each in left], [each.width for each in left], [each.time for each in left], kind, self._origin
        )

    def _tell_events(self, events: list[Event]) -> None:
        cutoffs = [event for event in events if isinstance(event, Cutoff)]
        avulsions = [event for event in events if isinstance(event, Avulsion)]
        if cutoffs:
            self._send(b"B" + self._loops(cutoffs, 0))
        if avulsions:
            self._send(b"B" + self._loops(avulsions, 1))
            self._send_carved()
        told = [[event.kind, event.time] for event in events if event.kind in ("cutoff", "collision", "avulsion")]
        if told:
            self._tell(type="events", events=told)

    def _frame(self) -> bytes:
        self._sequence += 1
        simulation = self.author.simulation
        network = simulation.network
        section = network.point_section
        size = np.stack(
            [network.channel_width, network.channel_depth, network.channel_discharge, self._orders(network)], axis=1
        )
        state = State(
            sequence=self._sequence,
            edits=self._command,
            step=simulation.step_count,
            time=simulation.time,
            step_ms=self._step_ms,
            playing=self.playing,
            channel_id=network.channel_id,
            channel_size=size,
            channel_start=network.starts(),
            point_xy=network.points() - self._origin,
            point_width=None if section is None else section[: network.point_count].numpy()[:, 0],
        )
        return encode_state(state)

    def _orders(self, network: Any) -> np.ndarray:
        """Strahler orders, which only edits of the graph change."""
        key = hash((network.channel_from.tobytes(), network.channel_to.tobytes()))
        if self._order[0] != key:
            self._order = (key, strahler_order(network.channel_from, network.channel_to))
        return self._order[1]

    def _keep_fresh(self) -> None:
        """Keep the state that the run has come to."""
        self._made = None
        self._keep_record()

    def _keep_record(self, always: bool = False) -> None:
        """Put the present state on the reel, if it is one of those that are kept; always where that is asked for.

        After an edit it takes the place of the one before it.
        """
        step = self.author.simulation.step_count
        if step == self._reel.last or (step > self._reel.last and (always or self._reel.wants(step))):
            self._reel.keep(step, self.author.simulation.time, self._present())
        since, at = step - self._figured[0], time.monotonic() - self._figured[1]
        if not 0 <= since < STATS_STEPS or (since and at >= STATS_SECONDS):
            self._note_figures()

    def _go_back(self, step: int) -> None:
        """Forget the states from a step on, from which the run is done again."""
        self._reel.rewind(step - 1)
        self._series.rewind(step - 1)
        self._figured = (self._series.rows[-1][0] if self._series.rows else -STATS_STEPS, 0.0)
        self._news.take_back(*self._happened())

    # ---- maps

    def _ask_for_map(self, now: float) -> None:
        """Let maps be made of where the run stands, if they are shown and behind."""
        news = self._news
        if not self._map_is_due() or now - news.asked < MAP_SECONDS:
            return
        news.made, news.asked, news.busy = self._map_key(), now, 0
        for name, wanted in (("map", news.map is not None), ("types", news.types)):
            if wanted:
                news.busy += 1
                self._ask_mapper(name, {"name": news.map} if name == "map" else {})

    def _map_key(self) -> tuple[object, ...]:
        news = self._news
        return (news.epoch, self.author.simulation.step_count, len(self.author.entries), news.map, news.types)

    def _map_is_due(self) -> bool:
        news = self._news
        return not news.busy and (news.map is not None or news.types) and news.made != self._map_key()

    def _ask_mapper(self, what: str, arguments: dict[str, Any], number: int | None = None) -> None:
        """Tell the mapper where the run stands, and what it shall make."""
        news, simulation = self._news, self.author.simulation
        terrain = simulation.terrain
        if terrain is not None and news.ground is None:
            np.save(self.folder / GROUND, terrain.to_numpy())
            news.begin()
            raster = terrain.raster
            file = str(self.folder / GROUND)
            news.ground = {"file": file, "cell": raster.cell_size, "origin": list(raster.origin)}
        told = {
            "epoch": news.epoch, "run": RUN, "edits": len(self.author.entries), "origin": self._origin.tolist(),
            "ground": news.ground, "states": self._reel.states, "known": news.known,
            "events": events_as_json(self.author.events_after(news.events)),
        }  # fmt: skip
        news.events, news.known = self._happened()
        request = json.dumps({"do": what, "with": arguments, "number": number, "news": told})
        self._send(b"M" + REQUEST.pack(-1 if number is None else number) + request.encode())

    def _happened(self) -> tuple[int, int]:
        """Return how many events the run has had, and how many of them maps take."""
        return self.author.events, sum(self.author.count(kind) for kind in EVENTS.values())

    def mapped(self, lost: bool = False) -> None:
        """Note that the mapper has made something, or that its process is gone."""
        news = self._news
        news.busy = 0 if lost else max(0, news.busy - 1)
        if lost:
            news.forget()
            if news.map is not None or news.types:
                news.map, news.types = None, False
                self._tell(type="error", text="the map was given up: its process ended")
                self._tell_session()

    def _send_raster(self, name: str, box: Any = None, window: Any = None) -> None:
        terrain = self.author.simulation.terrain
        raster = (terrain.raster if terrain is not None else None) if name == "height" else self._field()
        if raster is None:
            return
        if window is None:
            window = (0, 0, *raster.shape) if box is None else raster.window(*box)
        if window is None:
            return
        values = raster.cells(window).astype(np.float32)
        self._send(b"B" + encode_patch(name, window, values))
        if name == "height":
            row, column, rows, columns = window
            if self._shown.shape != raster.shape:
                self._shown = np.empty(raster.shape, np.float32)
            self._shown[row : row + rows, column : column + columns] = values

    def _send_carved(self) -> None:
        """Send the part of the ground that is not as pages show it: a channel that was carved is a small part of it."""
        terrain = self.author.simulation.terrain
        if terrain is None:
            return
        now = terrain.raster.values.numpy().astype(np.float32)
        if now.shape != self._shown.shape:
            self._send_raster("height")
            return
        differs = now.view(np.uint32) != self._shown.view(np.uint32)
        (rows,), (columns,) = differs.any(axis=1).nonzero(), differs.any(axis=0).nonzero()
        if len(rows):
            first, left = int(rows[0]), int(columns[0])
            self._send_raster("height", window=(first, left, int(rows[-1]) + 1 - first, int(columns[-1]) + 1 - left))

    def _field(self) -> Raster | None:
        return next((c.raster for c in self.author.simulation.controls if isinstance(c, ControlField)), None)

    def _ground_sum(self) -> int | None:
        terrain = self.author.simulation.terrain
        return None if terrain is None else _sum(terrain.raster)

    def _field_sum(self) -> int | None:
        field = self._field()
        return None if field is None else _sum(field)

    def _bounds(self) -> tuple[float, float, float, float]:
        """Bounds of the map: of the ground, or of the rivers as they were at the beginning."""
        simulation = self.author.simulation
        return simulation.history.network(0).bounds() if simulation.terrain is None else simulation.terrain.bounds

    def _answer(self, number: int, **told: Any) -> None:
        self._tell(type="answer", number=number, **told)

    def _tell(self, **told: Any) -> None:
        self._send(b"J" + json.dumps(told, allow_nan=False, default=float).encode())


def _rate(rate: Any) -> float:
    if not isinstance(rate, (int, float)) or not 0.1 <= rate <= 240.0:
        raise InputError(f"rate is {rate!r}; give 0.1 to 240 steps a second")
    return float(rate)


def _group(group: Any) -> str | None:
    if group is not None and (not isinstance(group, str) or len(group) > 80):
        raise InputError("group is a short text")
    return group


def _params_fields() -> list[str]:
    return [field.name for field in dataclasses.fields(MeanderParams) if field.init]


def _place(raster: Raster | None) -> dict[str, Any] | None:
    """Size and place of a raster, for a page."""
    if raster is None:
        return None
    (rows, columns), (west, north) = raster.shape, raster.origin
    return {"rows": rows, "columns": columns, "cell": raster.cell_size, "west": west, "north": north}


def _sum(raster: Raster) -> int:
    return int(raster.numpy().view(np.uint64).sum()) if raster.dtype == np.float64 else hash(raster.numpy().tobytes())


def _touched(edit: Any) -> tuple[float, float, float, float] | None:
    """Bounds of what an edit of the ground changes, m; None for all of it."""
    if edit.name != "EditTerrain":
        return None
    (west, south), (east, north) = edited_box(edit)
    return float(west), float(south), float(east), float(north)


def _control_of(values: Any) -> Control:
    if not isinstance(values, dict) or values.get("kind") not in CONTROLS:
        raise InputError(f"a control needs a kind: {', '.join(CONTROLS)}")
    fields = {key: value for key, value in values.items() if key != "kind"}
    return CONTROLS[values["kind"]](**fields)


def _described(control: Control) -> dict[str, Any]:
    told: dict[str, Any] = {"kind": type(control).__name__}
    for name in ("center", "radius", "strength", "factor", "blend"):
        if hasattr(control, name):
            value = getattr(control, name)
            told[name] = list(value) if isinstance(value, tuple) else value
    for name, key in (("xy", "xy"), ("polygon", "area")):
        if getattr(control, name, None) is not None:
            told[key] = np.asarray(getattr(control, name)).tolist()
    return told


def _locked(simulation: Simulation) -> list[np.ndarray]:
    """Places of the locked points, m."""
    network = simulation.network
    from warpriver.channel_table import JOINT_LOCK

    ends = network.channel_to[network.channel_joint == JOINT_LOCK]
    return [network.node_xy[node] for node in ends]


def work(connection: Connection, folder: str) -> None:
    """Run a session until the other end closes: the target of its process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    name_process("wr-simulation")
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR

    def send(message: bytes) -> None:
        connection.send_bytes(message)

    try:
        worker = Worker(Path(folder), send)
        while True:
            while connection.poll(worker.wait()):
                message = connection.recv_bytes()
                if message[:1] == b"A":
                    worker.credits = min(WINDOW, worker.credits + 1)
                elif message[:1] == b"S":
                    worker.tell_scene()
                elif message[:1] in (b"I", b"N"):
                    worker.mapped(lost=message[:1] == b"N")
                elif message[:1] == b"Q":
                    return
                else:
                    told = json.loads(message[1:])
                    worker.obey(int(told["number"]), told["command"])
                if worker.playing:
                    break
            worker.turn()
    except (EOFError, BrokenPipeError, OSError):
        return
