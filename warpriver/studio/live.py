"""A session on the server's side: its worker process, and the pages that watch it."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import json
import multiprocessing
import threading
from pathlib import Path
from typing import Any

from warpriver.errors import InputError
from warpriver.studio.frames import STATE
from warpriver.studio.worker import SAVED, copy_session, work

__all__ = ["LiveSession", "Watcher"]

# Frames with states that may be on their way to a page, commands of a page that wait for their answer, and messages
# that wait for a page: one that is further behind is let go.
WINDOW, PENDING, BACKLOG = 2, 64, 2000
WATCHERS = 32


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


class LiveSession:
    """One session: a folder, a process that has its simulation, and any number of pages."""

    def __init__(self, folder: Path):
        """Take a folder that :func:`warpriver.studio.worker.begin_folder` has made."""
        self.folder = folder
        self.watchers: set[Watcher] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._process: Any = None
        self._connection: Any = None
        self._numbers: dict[int, tuple[Watcher, Any]] = {}
        self._number = 0
        self._owed = 0

    # ---- the process

    def start(self) -> None:
        """Start the process, unless it runs."""
        if self._process is not None and self._process.is_alive():
            return
        self._loop = asyncio.get_running_loop()
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=work, args=(theirs, str(self.folder)), daemon=True)
        self._process.start()
        theirs.close()
        self._owed = 0
        threading.Thread(target=self._read, args=(self._connection, self._process), daemon=True).start()

    def stop(self) -> None:
        """End the process."""
        self._give(b"Q")
        process = self._process
        self._connection = self._process = None
        if process is not None:
            process.join(2.0)
            if process.is_alive():
                process.kill()
                process.join()
        for watcher, number in self._numbers.values():
            watcher.pending -= 1
            watcher.tell(_text(type="answer", number=number, error="the session was begun anew"))
        self._numbers.clear()

    def _read(self, connection: Any, process: Any) -> None:
        """Hand over what the process sends; runs in a thread of its own."""
        assert self._loop is not None
        while True:
            try:
                message = connection.recv_bytes()
            except (EOFError, OSError):
                break
            try:
                self._loop.call_soon_threadsafe(self._received, connection, message)
            except RuntimeError:  # the loop has ended
                return
        connection.close()
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._ended, process)

    def _received(self, connection: Any, message: bytes) -> None:
        if connection is not self._connection:
            return
        if message[:1] == b"B":
            frame = message[1:]
            if int.from_bytes(frame[:4], "little") == STATE:
                self._owed += 1
                for watcher in self.watchers:
                    watcher.show(frame)
                self._pay()
            else:
                for watcher in self.watchers:
                    watcher.tell(frame)
            return
        if message[:1] == b"R":
            # Asked for: no later state takes its place. Pages that did not ask pass over it.
            for watcher in self.watchers:
                watcher.tell(message[1:])
            return
        text = message[1:].decode()
        if text.startswith('{"type": "answer"'):
            told = json.loads(text)
            asked = self._numbers.pop(told["number"], None)
            if asked is not None:
                watcher, told["number"] = asked
                watcher.pending -= 1
                watcher.tell(json.dumps(told))
            return
        for watcher in self.watchers:
            watcher.tell(text)

    def _pay(self) -> None:
        """Let the process send further states, as soon as a page has taken the last one."""
        if self._owed and any(watcher.latest is None or watcher.credits > 0 for watcher in self.watchers):
            for _ in range(self._owed):
                self._give(b"A")
            self._owed = 0

    def _ended(self, process: Any) -> None:
        if process is not self._process:
            return
        process.join(1.0)
        self._process = None
        for watcher, number in self._numbers.values():
            watcher.pending -= 1
            watcher.tell(_text(type="answer", number=number, error="the simulation's process has ended"))
        self._numbers.clear()
        for watcher in self.watchers:
            watcher.tell(_text(type="crashed", exit=process.exitcode))

    def _give(self, message: bytes) -> bool:
        if self._connection is None:
            return False
        try:
            self._connection.send_bytes(message)
        except (OSError, ValueError):
            return False
        return True

    # ---- pages

    def join(self) -> Watcher | None:
        """Return a new watcher, who is told the scene; None where there are too many."""
        if len(self.watchers) >= WATCHERS:
            return None
        watcher = Watcher()
        self.watchers.add(watcher)
        self.start()
        self._give(b"S")
        self._pay()
        return watcher

    def leave(self, watcher: Watcher) -> None:
        """Forget a watcher."""
        self.watchers.discard(watcher)
        for number in [k for k, (asker, _) in self._numbers.items() if asker is watcher]:
            del self._numbers[number]

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
            self._answer_own(watcher, number, own, told)
            return
        if watcher.pending >= PENDING:
            watcher.tell(_text(type="answer", number=number, error="too many commands wait for their answer"))
            return
        self._number += 1
        message = json.dumps({"number": self._number, "command": told}).encode()
        if not self._give(b"C" + message):
            watcher.tell(_text(type="answer", number=number, error="the simulation does not run; restart the session"))
            return
        self._numbers[self._number] = (watcher, number)
        watcher.pending += 1

    def _answer_own(self, watcher: Watcher, number: Any, own: Any, told: dict[str, Any]) -> None:
        try:
            answer = own(**{key: value for key, value in told.items() if key != "do"})
        except (TypeError, ValueError, OSError) as error:
            answer = {"error": f"{told['do']}: {error}"}
        watcher.tell(_text(type="answer", number=number, **answer))

    def _restart(self) -> dict[str, Any]:
        """Take the session up again from its folder, after its process has ended."""
        self.start()
        self._give(b"S")
        return {}

    def _open_saved(self, saved: Any) -> dict[str, Any]:
        """Go on with a session that was kept."""
        place = self.folder / SAVED / str(saved)
        if not isinstance(saved, str) or not saved.isalnum() or not place.is_dir():
            raise InputError(f"no session {str(saved)[:40]!r} was saved here")
        self.replace(place)
        return {"saved": saved}

    def replace(self, place: Path) -> None:
        """Begin anew with what another folder holds."""
        self.stop()
        copy_session(place, self.folder)
        self.start()
        self._give(b"S")


def _text(**told: Any) -> str:
    return json.dumps(told)
