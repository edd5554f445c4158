"""Simulation: runs of many steps, recorded, interrupted and resumed."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import warp as wp

from warpriver import progress as progress_bar
from warpriver.editing import EditStack, untold
from warpriver.edits.session import session_of
from warpriver.edits.values import Edit, LockPoint, PaintControl, UnlockPoint
from warpriver.engine.checks import PhaseError
from warpriver.engine.phase import Phase
from warpriver.engine.saved import check_saved
from warpriver.engine.stepper import Stepper, check_ground
from warpriver.errors import InputError, InputTypeError, warn
from warpriver.history import ControlChange, ControlStroke, Ground, History, ParameterChange, Record, StopReason
from warpriver.history.changes import ground_after, params_after
from warpriver.history.schedule import Every
from warpriver.meander.control_edit import SetControls
from warpriver.meander.controls import Control
from warpriver.meander.steering import Steering
from warpriver.models import Model, model_of
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams, PathMeander
from warpriver.public import public
from warpriver.resume import continued, edits_after, ground_again, ground_changes, parameter_changes
from warpriver.terrain import Terrain
from warpriver.validate import MAX_SEED, not_negative, shown, whole

__all__ = ["Simulation"]

# Steps of a run, all its continuations together; the fastest take 20 us each.
MAX_STEPS = 2**31 - 1


class Simulation:
    """A river network that migrates and cuts off its loops, step by step.

    All attributes but ``controls`` are read-only. A simulation goes on with other constants, or over other ground, by
    :meth:`resume`.

    Attributes:
        network: The network as it is now; the one given to the constructor is left as it was.
        params: Constants; their type says which solver moves the channels.
        history: What has been recorded so far.
        step_count: Number of steps done.
        substeps: Number of equal sub-steps in which the last step was done. A channel takes as many of them as its
            width, its depth and its maximum speed in the step before require, spread evenly, and is inactive in the
            others; where the ground is too steep for it to move, in all.
        terrain: The ground, or None for a plain.
        controls: What attracts, repels or damps the channels; others may be set between two steps, and fields painted.
        stable_dt: Longest sub-step in yr that any bend of any channel may need on flat ground.
        threads: Maximum number of threads of a step; the results do not depend on it.
        seed: Seed of the random numbers that phases draw; those of the two models draw none.
        check: Whether every phase of every step is checked.
        stepper: Does the steps; most programs need not look at it.
    """

    @public
    def __init__(
        self,
        network: RiverNetwork,
        params: MeanderParams | PathMeander | None = None,
        *,
        terrain: Terrain | None = None,
        seed: int = 0,
        device: wp.DeviceLike = None,
        dtype: str | None = None,
        check: bool = False,
        capture: bool = True,
        threads: int | None = None,
        phases: Sequence[Phase] = (),
        controls: Control | Sequence[Control] = (),
    ):
        """Prepare a run; the network's channels are resampled to the spacing, their ends kept.

        Args:
            network: Where to start from. Elevations of its points, ``point_z``, are dropped: they are those of the line
                as it was given.
            params: Constants, of migration (by default those of [Paris2023]) or of meandering by shortest paths.
            terrain: Ground under the network, in the same CRS: migration fades with its slope and stops beyond its edge
                and where it has no data. A terrain on the network's device is shared, not copied: brush it between
                steps, and the channels feel it; avulsions carve it. From another device it is copied once; then brush
                ``simulation.terrain``, which is the copy.
            seed: Seed of the random numbers that ``phases`` draw.
            device: Warp device, by default the network's.
            dtype: "float64" or "float32", by default the network's.
            check: Check every phase of every step, slowly, and stop at the first that breaks its promise.
            capture: Record the step once and replay it, where the device allows; same results, less overhead.
            threads: Maximum number of threads on the CPU, by default one for each core that the process may use.
            phases: Processes beyond those of the model, see :class:`warpriver.engine.phase.Phase`; they work on the
                points of every sub-step right after these have moved.
            controls: What attracts, repels or damps the channels, see :mod:`warpriver.meander.controls`.

        Raises:
            ValueError: The spacing exceeds a channel's width, a channel that is no ring ends where it begins, channels
                part or flow in a circle, the terrain lies elsewhere or in another CRS, or the time step is out of all
                proportion; or a control is none, or in another CRS.
        """
        params = params if params is not None else MeanderParams()
        self._added = _checked_phases(phases)
        model = model_of(params).with_phases(self._added)
        params = params.for_widths(network.channel_width)
        _check_network(network, params, model)
        check_ground(network, terrain)
        own = network.to(device, dtype)
        own.point_z = None  # of the line as given, whose points are about to move
        seed = whole(seed, "seed", maximum=MAX_SEED)
        ground = None if terrain is None else Ground.of(terrain)
        self._steering = Steering(own, terrain, controls)
        options: dict[str, Any] = {"seed": seed, "check": check, "capture": capture, "threads": threads}
        options["controls"] = self._steering.map
        self._stepper = Stepper(own, params, terrain, model.phases, model.limits, **options)
        self._history = History(params, seed=seed, origin=own.origin, crs=own.crs, dtype=own.dtype, ground=ground)
        self._history.events.extend(self._steering.begin(0.0))
        self._ground, self._ground_sum = ground, _sum_of(terrain)
        self._edits = self._new_stack()
        self._record()

    @classmethod
    @public
    def resume(
        cls,
        history: History | str | os.PathLike[str],
        *,
        params: MeanderParams | PathMeander | None = None,
        terrain: Terrain | None = None,
        change_terrain: bool = False,
        device: wp.DeviceLike = "cpu",
        check: bool = False,
        capture: bool = True,
        threads: int | None = None,
        phases: Sequence[Phase] = (),
    ) -> Simulation:
        """Go on from the last record of a history, to the bit as if the run had not stopped there.

        Other constants, or other ground, are taken from there on and recorded as events of the history
        (``ParameterChange``, ``GroundChange``).

        Args:
            history: A history, or the path of a saved or streamed run; a streamed one grows when run again.
            params: Constants to go on with, by default those of the run. The time step and the type of the constants
                cannot change.
            terrain: The ground of the run; by default it is read again from the file that it came from. Another one is
                refused.
            change_terrain: Take the terrain that is given, or the plain that is given by none, also if it is not the
                ground of the run.
            device: Warp device.
            check: As in the constructor.
            capture: As in the constructor.
            threads: As in the constructor.
            phases: As in the constructor, and the same.

        Raises:
            ValueError: The history is empty or damaged, its terrain is not found or is another one, or constants are
                given that cannot change in a run.
        """
        if not isinstance(history, History):
            history = History.load(history)
        record = history.record(-1)
        before = history.events[: record.events_before]
        old_params, old_ground = params_after(history.params, before), ground_after(history.ground, before)
        params = continued(old_params, params)
        changes = parameter_changes(record.time, old_params, params)
        if changes:
            _check_network(history.network_of(record), params, model_of(params))
        terrain = ground_again(history.ground, before, terrain, change_terrain, device)
        ground = None if terrain is None else Ground.of(terrain)
        changes += ground_changes(record.time, old_ground, ground)
        self = cls.__new__(cls)
        options = {"check": check, "capture": capture, "threads": threads}
        self._take_up(history, record, params, terrain, device, phases, **options)
        self._ground = ground
        # What was done after the record, before the next step.
        again = edits_after(history, record)
        history.rewind()
        history.events.extend(changes)
        self._edits = self._new_stack()
        for edit in again:
            self.apply(edit)
        self._edits = self._new_stack()
        return self

    @classmethod
    @public
    def replay(
        cls,
        start: Simulation | History | str | os.PathLike[str],
        edits: object,
        *,
        steps: int | None = None,
        terrain: Terrain | None = None,
        device: wp.DeviceLike = "cpu",
        record_every: int | Every = 10,
        check: bool = False,
        capture: bool = True,
        threads: int | None = None,
        phases: Sequence[Phase] = (),
    ) -> Simulation:
        """Do a session again: the steps of a run, and between them its edits, to the same bits.

        It ends early where :meth:`run` does; ``history.stop_reason`` says why.

        Args:
            start: Where it begins: a simulation, which does the steps; or a history, or the path of a stored run, whose
                first record is taken up in a history of its own.
            edits: A :class:`warpriver.edits.Session` or the file of one, a history, or (step, edit) pairs.
            steps: Steps done at the end, by default as many as the session did.
            terrain: The ground at the beginning of the history; by default it is read again from the file that it came
                from. A simulation has its own.
            device: Warp device, unless a simulation is given; so are the following.
            record_every: As in :meth:`run`.
            check: As in the constructor.
            capture: As in the constructor.
            threads: As in the constructor.
            phases: As in the constructor.

        Raises:
            ValueError: An edit cannot be done, or comes before the simulation's present step; the seeds differ; or the
                ground is not the one of the run, or its constants or its ground changed by other means than edits.
        """
        if isinstance(start, Simulation):
            self = start
        else:
            options = {"check": check, "capture": capture, "threads": threads}
            self = cls._from_start(start, terrain, device, phases, **options)
        session = session_of(edits, self.seed)
        if session.seed != self.seed:
            raise InputError(f"the session has the seed {session.seed}, the run {self.seed}; start it with that one")
        for step, edit in session.edits:
            if step < self.step_count:
                raise InputError(f"{edit.name} was done after {step} steps, and {self.step_count} are done already")
            if step > self.step_count:
                self.run(steps=step - self.step_count, record_every=record_every)
            if step > self.step_count:
                return self  # interrupted, or no longer finite: the history says why
            self.apply(edit)
        left = (session.steps if steps is None else whole(steps, "steps")) - self.step_count
        if left > 0:
            self.run(steps=left, record_every=record_every)
        return self

    @classmethod
    def _from_start(
        cls,
        history: History | str | os.PathLike[str],
        terrain: Terrain | None,
        device: Any,
        phases: Sequence[Phase],
        **options: Any,
    ) -> Simulation:
        """Take up the first record of a history in a new one."""
        if not isinstance(history, History):
            history = History.load(history)
        record = history.record(0)
        before = history.events[: record.events_before]
        if history.events.of(ParameterChange):
            raise InputError(
                "the constants of the run changed on its way, which is no edit; replay it from a simulation"
            )
        terrain = ground_again(history.ground, before, terrain, False, device)
        fresh = History(
            history.params,
            seed=history.seed,
            origin=history.origin,
            crs=history.crs,
            dtype=history.dtype,
            ground=history.ground,
        )
        fresh.events.extend(before.of(ControlChange, ControlStroke))
        self = cls.__new__(cls)
        self._take_up(fresh, record, history.params, terrain, device, phases, **options)
        self._ground = history.ground
        self._edits = self._new_stack()
        self._record()
        return self

    def _take_up(
        self,
        history: History,
        record: Record,
        params: MeanderParams | PathMeander,
        terrain: Terrain | None,
        device: Any,
        phases: Sequence[Phase],
        **options: Any,
    ) -> None:
        """Go on from a record, and with the history that it belongs to."""
        self._added = _checked_phases(phases)
        network = history.network_of(record)
        # The record is on the scale of the constants that it was made with.
        check_saved(
            network, params_after(history.params, history.events[: record.events_before]), record.resume, record.step
        )
        network = network.to(device)
        check_ground(network, terrain)
        model = model_of(params).with_phases(self._added)
        self._steering = Steering(network, terrain, events=history.events[: record.events_before])
        options |= {"seed": history.seed, "saved": dict(record.resume), "controls": self._steering.map}
        self._stepper = Stepper(network, params, terrain, model.phases, model.limits, **options)
        self._stepper.step_count = record.step
        self._history, self._ground_sum = history, _sum_of(terrain)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and copy between two steps: the copy goes on to the same bits, and its history is stored nowhere."""
        stepper = self.stepper
        stepper.state.place_nodes()
        self._note_strokes()
        return {
            "history": self.history,
            "record": self._as_record(),
            "params": self.params,
            "ground": self._ground,
            "terrain": self.terrain,
            "device": self.device.alias,
            "phases": self._added,
            "options": {"check": stepper.check, "capture": stepper.capture, "threads": stepper.threads},
            "substeps": self.substeps,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        parts = (state[name] for name in ("history", "record", "params", "terrain", "device", "phases"))
        self._take_up(*parts, **state["options"])
        self._ground, self._ground_sum = state["ground"], None
        self._edits = self._new_stack()
        self.stepper.state.substeps = state["substeps"]

    # ---- state

    @property
    def params(self) -> MeanderParams | PathMeander:
        """Constants; their type says which solver moves the channels."""
        params: MeanderParams | PathMeander = self._stepper.state.params
        return params

    @params.setter
    def params(self, params: Any) -> None:
        raise AttributeError(
            "the constants of a simulation are read-only; go on with others by Simulation.resume(simulation.history, "
            "params=...)"
        )

    @property
    def history(self) -> History:
        """What has been recorded so far."""
        return self._history

    @property
    def stepper(self) -> Stepper:
        """What does the steps."""
        return self._stepper

    @property
    def seed(self) -> int:
        """Seed of the random numbers that phases draw."""
        return self._stepper.state.seed

    @property
    def network(self) -> RiverNetwork:
        """The network as it is now."""
        self.stepper.state.place_nodes()
        return self.stepper.state.network

    @property
    def terrain(self) -> Terrain | None:
        """The ground on the network's device, or None."""
        return self.stepper.state.terrain

    @property
    def controls(self) -> tuple[Control, ...]:
        """What attracts, repels or damps the channels.

        Set others between two steps, and the next one goes by them: that is an edit, which is recorded, taken back and
        replayed as any. A :class:`~warpriver.meander.controls.ControlField` may also be painted as it is; that cannot
        be taken back.
        """
        return self._steering.controls

    @controls.setter
    def controls(self, controls: Control | Sequence[Control]) -> None:
        self.apply(SetControls(controls))  # type: ignore[arg-type]

    @property
    def device(self) -> Any:
        """The Warp device of the run."""
        return self.network.device

    @property
    def step_count(self) -> int:
        """Steps done."""
        return self.stepper.step_count

    @property
    def substeps(self) -> int:
        """Equal parts in which the last step was done."""
        return self.stepper.state.substeps

    @property
    def stable_dt(self) -> float:
        """Longest sub-step in yr that any bend of any channel may need on flat ground."""
        return self.stepper.state.stable_dt

    @property
    def threads(self) -> int:
        """Greatest number of threads that a step is dealt out to."""
        return self.stepper.threads

    @property
    def check(self) -> bool:
        """Whether every phase of every step is checked."""
        return self.stepper.check

    @property
    def time(self) -> float:
        """Time now, yr."""
        return self.step_count * self.params.time_step

    def __repr__(self) -> str:
        p = self.params
        parts = f" in up to {self.substeps} sub-steps" if self.substeps > 1 else ""
        return (
            f"Simulation at {self.time:.4g} yr (step {self.step_count}) on {self.device.alias}, {self.network.dtype}\n"
            f"  network  {self.network!r}\n"
            f"  step     {p.time_step:.4g} yr{parts}, stable up to {self.stable_dt:.3g} yr; spacing {p.spacing:g} m\n"
            f"  history  {self.history!r}"
        )

    # ---- running

    @public
    def step(self, count: int = 1) -> None:
        """Advance by that many time steps: migrate, cut off, resample, join, in sub-steps as stability asks for.

        A GPU does a batch of sub-steps before the host looks at them, so that one call for 64 steps takes less time
        than 64 calls; the results are the same to the bit. Only events go to the history: :meth:`run` records states,
        too, and ends between two steps when it is interrupted.

        Args:
            count: Time steps, 1 or more.

        Raises:
            ValueError: ``count`` is no such number.
            FloatingPointError: A point is no longer finite; the state before that step is kept.
            AssertionError: ``check`` is on and a phase broke its promise.
        """
        self._advance(self._count_steps(None, whole(count, "count", 1, "time steps")))

    @public
    def run(
        self,
        years: float | None = None,
        *,
        steps: int | None = None,
        record_every: int | Every = 10,
        store: str | os.PathLike[str] | None = None,
        callbacks: Iterable[Callable[[Simulation], Any] | tuple[Every, Callable[[Simulation], Any]]] = (),
        progress: bool = False,
    ) -> History:
        """Run on and record; call it again to go on.

        Args:
            years: How long, in years; done in whole steps, so that the end may lie up to one step later.
            steps: How long, in steps, instead of years.
            record_every: Record every so many steps, or on a schedule; the state at the end is recorded always.
            store: Folder to stream the history into; without it the history stays in memory. No other process can
                write there while this runs.
            callbacks: Functions of the simulation called after every step, or (schedule, function) pairs; one that
                returns True ends the run.
            progress: Show a bar with rate and remaining time on standard error.

        Returns:
            The history; its ``stop_reason`` says why the run ended. Ctrl-C and SIGTERM end it at the next step
            boundary, with that state recorded and stored.

        Raises:
            ValueError: The arguments do not fit, or the run has been continued elsewhere since it was opened.
            OSError: ``store`` cannot be made, or another process writes there.
        """
        count = self._count_steps(years, steps)
        schedule = record_every if isinstance(record_every, Every) else Every(steps=record_every)
        hooks = [_hook(callback) for callback in callbacks]
        if store is not None:
            self.history.store_in(store)
        with self.history.writing():
            self.history.stop_reason = None
            self._edits = self._new_stack()
            self._note_ground()
            with _interruption() as interrupted, progress_bar.bar("steps", count, show=progress) as advance:
                try:
                    reason = self._run_steps(count, schedule, hooks, interrupted, advance)
                    self._record_end()
                    with _storing():
                        self.history.close(reason)
                except PhaseError:
                    self.history.close(StopReason.CHECK_FAILED)
                    raise
                except _StoreError as error:
                    self.history.stop_reason = StopReason.STORE_FAILED
                    warn(f"{error.__cause__}")
                except BaseException:
                    # Of a callback, or a second Ctrl-C: what was recorded before is not lost with it.
                    with contextlib.suppress(OSError):
                        self.history.flush()
                    raise
        return self.history

    # ---- edits

    @public
    def apply(self, edit: Edit) -> None:
        """Do an edit between two steps; it is recorded in the history with its time.

        All that it does not name stays as it is, to the bit. An edit of the ground changes ``terrain`` in place.

        Args:
            edit: One of :mod:`warpriver.edits`.

        Raises:
            ValueError: It cannot be done, and nothing has changed.
        """
        self._note_strokes()
        self._edits.apply(self.stepper, self.history, edit)

    @public
    def lock(self, channel: int, at: float | Sequence[float] | np.ndarray) -> None:
        """Hold a point of a channel in place; see :class:`warpriver.edits.LockPoint`."""
        self.apply(LockPoint(channel, at))  # type: ignore[arg-type]

    @public
    def unlock(self, channel: int, at: float | Sequence[float] | np.ndarray) -> None:
        """Let a locked point of a channel go; see :class:`warpriver.edits.UnlockPoint`."""
        self.apply(UnlockPoint(channel, at))  # type: ignore[arg-type]

    def undo(self) -> Edit:
        """Take the last edit back, to the bit, and return it.

        That goes as far back as the last step, or the last :meth:`run`: what the river has done with an edit cannot be
        taken from it. Replay the session without the edit for that: ``Simulation.replay(start, edits)``.

        Raises:
            ValueError: No edit was done since the last step.
        """
        self._note_strokes()
        return self._edits.undo(self.stepper, self.history)

    def redo(self) -> Edit:
        """Do the edit again that was taken back last, and return it.

        Raises:
            ValueError: None was taken back since the last edit or step.
        """
        self._note_strokes()
        return self._edits.redo(self.stepper, self.history)

    # ---- inside

    def _run_steps(
        self,
        count: int,
        schedule: Every,
        hooks: list[tuple[Every, Callable[[Simulation], Any]]],
        interrupted: threading.Event,
        advance: Callable[[int], None],
    ) -> StopReason:
        """Do so many steps, or fewer; return why they ended."""
        last, dues = self.step_count + count, [schedule, *(every for every, _ in hooks)]
        while self.step_count < last:
            if interrupted.is_set():
                return StopReason.INTERRUPTED
            # As far as nothing is to be done between the steps.
            until = self.step_count + 1
            while until < min(last, self.step_count + self.stepper.batch_limit) and not self._any_due(dues, until):
                until += 1
            steps = until - self.step_count
            try:
                self._advance(steps)
            except FloatingPointError:
                return StopReason.NOT_FINITE
            with _storing():
                self.history.relieve()
            if schedule.due(self.step_count, self.params.time_step):
                self._record()
            advance(steps)
            due = [hook for every, hook in hooks if every.due(self.step_count, self.params.time_step)]
            if any([hook(self) is True for hook in due]):
                return StopReason.CALLBACK
        return StopReason.COMPLETED

    def _any_due(self, schedules: list[Every], step: int) -> bool:
        return any(every.due(step, self.params.time_step) for every in schedules)

    def _advance(self, steps: int) -> None:
        """Do so many steps, and note their events also where the last one fails."""
        self._note_strokes()
        self._edits = self._new_stack()
        try:
            self.stepper.step(steps)
        finally:
            self.history.events.extend(untold(self.history.events, self.stepper.take_events()))

    def _set_controls(self, edit: SetControls) -> tuple[Callable[[], None], Edit]:
        """Do a change of controls as an edit; return what takes it back, and how it is told."""
        steering, stepper = self._steering, self.stepper
        before, controls, stamped = stepper.snapshot(), steering.controls, steering.map
        self.history.events.extend(steering.replace(edit.after(controls), stepper.state, self.time))

        def back() -> None:
            steering.put_back(controls, stamped, stepper.state)
            stepper.put_back(before)

        return back, edit.told_after(controls)

    def _paint_control(self, edit: PaintControl) -> tuple[Callable[[], None], Edit]:
        """Paint a control field as an edit; return what takes it back, and the edit."""
        before = self.stepper.snapshot()
        events, unpaint = self._steering.paint(edit, self.stepper.state)
        self.history.events.extend(events)

        def back() -> None:
            unpaint()
            self.stepper.put_back(before)

        return back, edit

    def _new_stack(self) -> EditStack:
        return EditStack(self._check, {SetControls: self._set_controls, PaintControl: self._paint_control})

    def _check(self, network: RiverNetwork) -> None:
        _check_network(network, self.params, model_of(self.params).with_phases(self._added))

    def _note_strokes(self) -> None:
        """Take up, and note in the history, what was painted since the last step."""
        if strokes := self._steering.take_strokes(self.stepper.state, self.time):
            self.history.events.extend(strokes)

    def _note_ground(self) -> None:
        """Note in the history that the ground has been edited since the last look at it."""
        total = _sum_of(self.terrain)
        if self.terrain is None or total == self._ground_sum:
            return
        self._ground_sum = total
        now = dataclasses.replace(Ground.of(self.terrain), path=None, options={})
        if changes := ground_changes(self.time, self._ground, now):
            self._ground = now
            self.history.events.extend(changes)

    def _record(self) -> None:
        self._note_ground()
        self._note_strokes()
        self.stepper.state.place_nodes()
        with _storing():
            self.history.append(self._as_record())

    def _as_record(self) -> Record:
        """The state as it is stored."""
        network, count = self.network, self.network.point_count
        section = None if network.point_section is None else network.point_section[:count].numpy().copy()
        return Record(
            step=self.step_count,
            time=self.time,
            events_before=len(self.history.events),
            point_xy=network.point_xy[:count].numpy().copy(),
            point_section=section,
            channel_start=network.starts(),
            channels=network.channels,
            node_xy=network.node_xy.copy(),
            resume=self.stepper.state.saved(),
        )

    def _record_end(self) -> None:
        if self.history.steps[-1] != self.step_count:
            self._record()

    def _count_steps(self, years: float | None, steps: int | None) -> int:
        if (years is None) == (steps is None):
            raise InputError("give run either years or steps")
        if steps is not None:
            count = whole(steps, "steps")
        else:
            # Of a time step of 1e-300 yr there are too many even for a float.
            needed = min(not_negative(years, "years") / self.params.time_step * (1.0 - 1e-12), 2.0 * MAX_STEPS)
            count = math.ceil(needed)
        if self.step_count + count > MAX_STEPS:
            given = f"steps is {steps}" if steps is not None else f"years is {years}"
            raise InputError(
                f"{given}; a run has at most {MAX_STEPS:,} steps, here of {self.params.time_step:g} yr, and "
                f"{self.step_count:,} are done"
            )
        return count


def _sum_of(terrain: Terrain | None) -> int | None:
    """A sum of the bits of all heights, which tells at little cost that some were edited."""
    return None if terrain is None else int(terrain.height.numpy().view(np.uint64).sum())


def _checked_phases(phases: Sequence[Phase]) -> tuple[Phase, ...]:
    """Return phases, or raise ``TypeError`` for what is none."""
    for phase in phases:
        if Phase not in type(phase).__mro__:
            raise InputTypeError(f"phases holds {shown(phase)}; give phases, see warpriver.engine.phase.Phase")
    return tuple(phases)


def _check_network(network: RiverNetwork, params: MeanderParams | PathMeander, model: Model) -> None:
    """Raise ``ValueError`` for a network that a simulation cannot take."""
    looped = (network.channel_from == network.channel_to) & ~network.channel_closed
    if looped.any():
        raise InputError(f"channel {int(looped.argmax())}: its ends coincide; make it a ring, closed=True, or open it")
    for phase in model.phases:
        phase.check_network(network)
    if params.spacing_in_widths > 0.0:
        return
    narrow = [float(w.min()) for w in network.point_widths()]
    c = int(np.argmin(narrow))
    if params.spacing > narrow[c]:
        kind = type(params).__name__
        raise InputError(
            f"spacing {params.spacing:g} m is coarser than channel {c} is wide ({narrow[c]:g} m): bends would "
            f"be missed; set {kind}(spacing=...) to {narrow[c]:g} or less, or spacing_in_widths=1"
        )


def _hook(callback: Any) -> tuple[Every, Callable[[Simulation], Any]]:
    """Return a callback with its schedule."""
    every, call = callback if isinstance(callback, tuple) and len(callback) == 2 else (Every(steps=1), callback)
    if not isinstance(every, Every) or not callable(call):
        raise InputTypeError(
            f"a callback is {shown(callback)}; give a function of the simulation, or a pair (Every(...), function)"
        )
    return every, call


class _StoreError(Exception):
    """The history could not be stored."""


@contextlib.contextmanager
def _storing() -> Iterator[None]:
    """Tell the failure to store a history from that of a callback, which is its caller's affair."""
    try:
        yield
    except OSError as error:
        raise _StoreError from error


@contextlib.contextmanager
def _interruption() -> Iterator[threading.Event]:
    """Catch the first Ctrl-C or SIGTERM as an event, so that a run stops between steps; the second acts at once."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    # None: a handler that was not set from Python, which cannot be set again from there.
    previous = {kind: signal.getsignal(kind) or signal.SIG_DFL for kind in (signal.SIGINT, signal.SIGTERM)}

    def give_back() -> None:
        for kind, handler in previous.items():
            signal.signal(kind, handler)

    def note(signum: int, frame: Any) -> None:
        event.set()
        give_back()

    for kind in previous:
        signal.signal(kind, note)
    try:
        yield event
    finally:
        give_back()
