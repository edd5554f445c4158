"""A page without a browser: a socket that asks, waits for answers, and takes frames."""

import contextlib
import itertools
import json
import re
import subprocess
import sys
import time
from types import SimpleNamespace

from websockets.sync.client import connect

from warpriver.studio.frames import EARLIER, FLAGS, MAP, STATE, decode_state


class Talk:
    """A connection to a studio."""

    def __init__(self, served, **headers):
        """Connect as a page of the studio would."""
        origin = f"http://127.0.0.1:{served.port}"
        given = {"Origin": origin, "Cookie": f"warpriver_studio={served.token}"} | headers
        self._connection = connect(
            f"ws://127.0.0.1:{served.port}/live",
            additional_headers=given,
            max_size=None,
            compression=None,
            open_timeout=30,
            close_timeout=1,
            ping_interval=None,
        )
        self.socket = self._connection.__enter__()
        self.earlier, self.maps = [], []
        self.numbers, self.state, self.told, self.frames = itertools.count(1), None, {}, 0

    def close(self):
        """Close it."""
        self._connection.__exit__(None, None, None)

    def receive(self, seconds=60.0):
        """Take one message; states are kept and acknowledged."""
        message = self.socket.recv(timeout=seconds)
        if isinstance(message, str):
            told = json.loads(message)
            self.told[told["type"]] = told
            return told
        if int.from_bytes(message[:4], "little") == STATE and message[FLAGS] & EARLIER:
            self.earlier.append(decode_state(message))
            return message
        if int.from_bytes(message[:4], "little") == STATE:
            self.state = decode_state(message)
            self.frames += 1
            self.socket.send(json.dumps({"ack": self.state.sequence}))
            return self.state
        if int.from_bytes(message[:4], "little") == MAP:
            self.maps.append((message[56:72].rstrip(b"\0").decode(), message))
        return message

    def ask(self, what, **rest):
        """Ask for something and return the answer; errors too."""
        number = next(self.numbers)
        self.socket.send(json.dumps({"number": number, "do": what, **rest}))
        while True:
            told = self.receive()
            if isinstance(told, dict) and told["type"] == "answer" and told["number"] == number:
                return told

    def until(self, true, seconds=60.0):
        """Receive until something is true of this connection."""
        end = time.monotonic() + seconds
        while not true(self):
            assert time.monotonic() < end, "it did not come"
            self.receive(seconds)


@contextlib.contextmanager
def serving(*arguments, folder):
    """Serve a studio: ``link``, ``port``, ``token``, ``folder``, ``process``."""
    command = [sys.executable, "-m", "warpriver", "studio", *arguments, "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    line = process.stdout.readline()
    found = re.search(r"http://127\.0\.0\.1:(\d+)/\?token=(\S+)", line)
    if not found:
        process.kill()
        raise RuntimeError(f"no link: {line} {process.stderr.read()}")
    yield SimpleNamespace(link=found[0], port=int(found[1]), token=found[2], folder=folder, process=process)
    process.terminate()
    assert process.wait(20) is not None
