"""A session on the server's side: its worker process, and the pages that watch it."""

from __future__ import annotations

import asyncio
import collections
import json
import queue
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from warpriver.errors import InputError
from warpriver.studio.folder import SAVED, copy_session
from warpriver.studio.frames import STATE
from warpriver.studio.mapping import map_process
from warpriver.studio.news import REQUEST
from warpriver.studio.processes import context
from warpriver.studio.worker import work

__all__ = ["LiveSession", "Watcher"]

# Frames with states that may be on their way to a page, commands of a page that wait for their answer, and messages
# that wait for a page: one that is further behind is let go.
WINDOW, PENDING, BACKLOG = 2, 64, 2000
WATCHERS = 32
# Bytes that may wait for a process.
QUEUED_BYTES = 64 * 2**20


class Watcher:
    """A page: what is to be sent to it. Of states it gets the latest one; nothing else is left out."""

    def __init__(self) -> None:
        self.outbox: collections.deque[bytes | str] = collections.deque()
        self.latest: bytes | None = None
        self.credits = WINDOW
        self.pending = 0
        self.lost = False
        self._wake = asyncio.Event()

    def tell(self, message: bytes | str) -> None:
        """Send a message after those before it."""
        if len(self.outbox) >= BACKLOG:
            self.lost = True
        else:
            self.outbox.append(message)
        self._wake.set()

    def show(self, frame: bytes) -> None:
        """Send a state, unless a later one comes first."""
        self.latest = frame
        self._wake.set()

    def acknowledge(self) -> None:
        """Note that the page has drawn a state."""
        self.credits = min(WINDOW, self.credits + 1)
        self._wake.set()

    async def next(self) -> bytes | str | None:
        """Return what is to be sent next; None where the page is too far behind."""
        while True:
            if self.lost:
                return None
            if self.outbox:
                return self.outbox.popleft()
            if self.latest is not None and self.credits > 0:
                frame, self.latest = self.latest, None
                self.credits -= 1
                return frame
            self._wake.clear()
            await self._wake.wait()


class _Process:
    """A process of a session, with a thread that reads what it sends and one that writes what it is sent.

    So the loop of the server never waits for a pipe.
    """

    def __init__(
        self,
        target: Callable[[Connection, str], None],
        folder: Path,
        received: Callable[[_Process, bytes], None],
        ended: Callable[[_Process, int | None], None],
    ):
        """Start it; ``received`` and ``ended`` are called on the present loop."""
        self._loop = asyncio.get_running_loop()
        self._connection, self._theirs = context().Pipe()
        arguments = (self._theirs, str(folder))
        self._process = context().Process(target=target, args=arguments, daemon=True)  # type: ignore[attr-defined]
        self._started = threading.Event()
        self._queue: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        # Bytes that were given to it, and that it has taken; each is counted by one thread alone.
        self._given = self._taken = 0
        self._received, self._ended = received, ended
        for task in (self._read, self._write):
            threading.Thread(target=task, daemon=True).start()

    @property
    def alive(self) -> bool:
        """Whether it runs, or is about to."""
        return not self._started.is_set() or bool(self._process.is_alive())

    def give(self, message: bytes) -> bool:
        """Send it a message; False where too much waits already, or it does not run."""
        if self._given - self._taken + len(message) > QUEUED_BYTES or not self.alive:
            return False
        self._given += len(message)
        self._queue.put(message)
        return True

    def end(self) -> None:
        """Ask it to end, and kill it if it does not; takes up to two seconds, so no loop may do it."""
        self._queue.put(None)
        self._started.wait()
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _write(self) -> None:
        while True:
            message = self._queue.get()
            try:
                self._connection.send_bytes(message if message is not None else b"Q")
            except (OSError, ValueError):
                return
            if message is None:
                return
            self._taken += len(message)

    def _read(self) -> None:
        # Here, since it may have to wait until there is a process to fork from.
        self._process.start()
        self._started.set()
        self._theirs.close()
        while True:
            try:
                message = self._connection.recv_bytes()
            except (EOFError, OSError):
                break
            if not self._call(self._received, message):
                return
        self._process.join(2.0)
        self._queue.put(None)
        self._call(self._ended, self._process.exitcode)

    def _call(self, what: Callable[[_Process, Any], None], told: Any) -> bool:
        try:
            self._loop.call_soon_threadsafe(what, self, told)
        except RuntimeError:  # the loop has ended
            return False
        return True


class LiveSession:
    """One session: a folder, a process that has its simulation, one that makes maps of it, and any number of pages."""

    def __init__(self, folder: Path):
        """Take a folder that :func:`warpriver.studio.folder.begin_folder` has made."""
        self.folder = folder
        self.watchers: set[Watcher] = set()
        self._worker: _Process | None = None
        self._mapper: _Process | None = None
        # Commands that wait for their answers: who asked, under which number; and which of them the mapper has.
        self._numbers: dict[int, tuple[Watcher, Any]] = {}
        self._mapped: set[int] = set()
        self._number = 0
        self._owed = 0
        self._exchange = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    # ---- the processes

    def start(self) -> None:
        """Start the simulation's process, unless it runs."""
        if self._worker is None or not self._worker.alive:
            self._worker = _Process(work, self.folder, self._received, self._worker_ended)
            self._owed = 0

    async def stop(self) -> None:
        """End the processes."""
        ended = [process for process in (self._worker, self._mapper) if process is not None]
        self._worker = self._mapper = None
        self._fail(list(self._numbers), "the session was begun anew")
        await asyncio.gather(*(asyncio.to_thread(process.end) for process in ended))

    def _received(self, process: _Process, message: bytes) -> None:
        if process not in (self._worker, self._mapper):
            return
        kind = message[:1]
        if kind == b"B":
            frame = message[1:]
            if int.from_bytes(frame[:4], "little") == STATE:
                self._owed += 1
                for watcher in self.watchers:
                    watcher.show(frame)
                self._pay()
            else:
                for watcher in self.watchers:
                    watcher.tell(frame)
        elif kind == b"R":
            # Asked for: no later state takes its place. Pages that did not ask pass over it.
            for watcher in self.watchers:
                watcher.tell(message[1:])
        elif kind == b"M":
            self._map(message[1:])
        elif kind == b"I":
            self._give(b"I")
        else:
            self._tell_text(message[1:].decode())

    def _tell_text(self, text: str) -> None:
        if text.startswith('{"type": "answer"'):
            told = json.loads(text)
            asked = self._numbers.pop(told["number"], None)
            self._mapped.discard(told["number"])
            if asked is not None:
                # "command" is the number by which states tell that they hold it.
                told["command"] = told["number"]
                watcher, told["number"] = asked
                watcher.pending -= 1
                watcher.tell(json.dumps(told))
            return
        for watcher in self.watchers:
            watcher.tell(text)

    def _map(self, message: bytes) -> None:
        """Hand on to the mapper what the simulation's process wants of it."""
        if self._mapper is None or not self._mapper.alive:
            self._mapper = _Process(map_process, self.folder, self._received, self._mapper_ended)
        (number,) = REQUEST.unpack_from(message)
        if number >= 0:
            self._mapped.add(number)
        if not self._mapper.give(message[REQUEST.size :]) and number >= 0:
            self._fail([number], "too much waits to be made; ask again later")

    def _pay(self) -> None:
        """Let the process send further states, as soon as a page has taken the last one."""
        ready = any(watcher.latest is None or watcher.credits > 0 for watcher in self.watchers)
        if self._owed and (ready or not self.watchers):
            for _ in range(self._owed):
                self._give(b"A")
            self._owed = 0

    def _worker_ended(self, process: _Process, code: int | None) -> None:
        if process is not self._worker:
            return
        self._worker = None
        self._fail([k for k in self._numbers if k not in self._mapped], "the simulation's process has ended")
        for watcher in self.watchers:
            watcher.tell(_text(type="crashed", exit=code))

    def _mapper_ended(self, process: _Process, code: int | None) -> None:
        if process is not self._mapper:
            return
        self._mapper = None
        self._fail(list(self._mapped), f"what was to be made was given up: its process ended ({code})")
        self._give(b"N")

    def _fail(self, numbers: list[int], why: str) -> None:
        """Answer commands that nobody will answer any more."""
        for number in numbers:
            self._mapped.discard(number)
            asked = self._numbers.pop(number, None)
            if asked is not None:
                asked[0].pending -= 1
                asked[0].tell(_text(type="answer", number=asked[1], error=why))

    def _give(self, message: bytes) -> bool:
        return self._worker is not None and self._worker.give(message)

    # ---- pages

    def join(self) -> Watcher | None:
        """Return a new watcher, who is told the scene; None where there are too many."""
        if len(self.watchers) >= WATCHERS:
            return None
        watcher = Watcher()
        self.watchers.add(watcher)
        if not self._exchange.locked():  # else it is started when another session lies in the folder
            self.start()
        self._give(b"S")
        self._pay()
        return watcher

    def leave(self, watcher: Watcher) -> None:
        """Forget a watcher."""
        self.watchers.discard(watcher)
        for number in [k for k, (asker, _) in self._numbers.items() if asker is watcher]:
            del self._numbers[number]
        # It may have been the one for which the process waits.
        self._pay()

    def take(self, watcher: Watcher, text: str) -> None:
        """Do what a page asks for in a text."""
        try:
            told = json.loads(text)
        except (ValueError, RecursionError):
            watcher.tell(_text(type="error", text="that is no JSON"))
            return
        if not isinstance(told, dict):
            watcher.tell(_text(type="error", text="a message is an object"))
            return
        if "ack" in told:
            watcher.acknowledge()
            self._pay()
            return
        number = told.pop("number", None)
        if not isinstance(number, (int, str)) or isinstance(number, bool):
            watcher.tell(_text(type="error", text="a command needs a number, which its answer has"))
            return
        own = {"restart": self._restart, "open_saved": self._open_saved}.get(str(told.get("do")))
        if own is not None:
            task = asyncio.get_running_loop().create_task(self._answer_own(watcher, number, own, told))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            return
        if watcher.pending >= PENDING:
            watcher.tell(_text(type="answer", number=number, error="too many commands wait for their answer"))
            return
        self._number += 1
        message = json.dumps({"number": self._number, "command": told}).encode()
        if not self._give(b"C" + message):
            why = "the simulation does not run, or too much waits for it"
            watcher.tell(_text(type="answer", number=number, error=why))
            return
        self._numbers[self._number] = (watcher, number)
        watcher.pending += 1

    async def _answer_own(self, watcher: Watcher, number: Any, own: Any, told: dict[str, Any]) -> None:
        try:
            answer = await own(**{key: value for key, value in told.items() if key != "do"})
        except (TypeError, ValueError, OSError) as error:
            answer = {"error": f"{told['do']}: {error}"}
        watcher.tell(_text(type="answer", number=number, **answer))

    async def _restart(self) -> dict[str, Any]:
        """Take the session up again from its folder, after its process has ended."""
        async with self._exchange:
            self.start()
            self._give(b"S")
        return {}

    async def _open_saved(self, saved: Any) -> dict[str, Any]:
        """Go on with a session that was kept."""
        place = self.folder / SAVED / str(saved)
        if not isinstance(saved, str) or not saved.isalnum() or not place.is_dir():
            raise InputError(f"no session {str(saved)[:40]!r} was saved here")
        await self.replace(place)
        return {"saved": saved}

    async def replace(self, place: Path) -> None:
        """Begin anew with what another folder holds."""
        async with self._exchange:
            await self.stop()
            await asyncio.to_thread(copy_session, place, self.folder)
            self.start()
            self._give(b"S")


def _text(**told: Any) -> str:
    return json.dumps(told)
