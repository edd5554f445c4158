"""A headless Chromium, driven by its own protocol: pages are opened, used by pointer and keys, and looked at."""

import base64
import itertools
import json
import os
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from websockets.sync.client import connect

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
FLAGS = (
    "--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--no-first-run",
    "--disable-extensions", "--disable-background-networking", "--remote-debugging-port=0", "--mute-audio",
)  # fmt: skip


class Browser:
    """One browser with one page."""

    def __init__(self, width=1280, height=720):
        """Start it."""
        self.folder = tempfile.mkdtemp(prefix="chromium-")
        command = [CHROMIUM, *FLAGS, f"--user-data-dir={self.folder}", f"--window-size={width},{height}", "about:blank"]
        self.process = subprocess.Popen(
            command, stderr=subprocess.PIPE, text=True, env={**os.environ, "HOME": self.folder}
        )
        for line in self.process.stderr:
            if found := re.search(r"ws://[^/]+(?=/)", line):
                break
        else:
            raise RuntimeError("Chromium did not start")
        # Its messages have to be read, or it stops.
        import threading

        threading.Thread(target=lambda: [None for _ in self.process.stderr], daemon=True).start()
        import urllib.request

        pages = json.load(urllib.request.urlopen(found[0].replace("ws", "http", 1) + "/json/list"))
        address = next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
        self.socket = connect(address, max_size=None, ping_interval=None)
        self.numbers, self.console = itertools.count(1), []
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def close(self):
        """End it."""
        self.socket.close()
        self.process.terminate()
        self.process.wait(20)
        shutil.rmtree(self.folder, ignore_errors=True)

    def call(self, method, **params):
        """Call a method of the protocol and return its result."""
        number = next(self.numbers)
        self.socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            told = json.loads(self.socket.recv(timeout=60))
            if told.get("id") == number:
                if "error" in told:
                    raise RuntimeError(f"{method}: {told['error']['message']}")
                return told["result"]
            self._note(told)

    def _note(self, told):
        if told.get("method") == "Runtime.exceptionThrown":
            details = told["params"]["exceptionDetails"]
            self.console.append(details.get("exception", {}).get("description") or details["text"])
        elif told.get("method") == "Log.entryAdded" and told["params"]["entry"]["level"] == "error":
            self.console.append(f"{told['params']['entry']['text']} {told['params']['entry'].get('url', '')}")

    def open(self, address):
        """Open a page."""
        self.call("Page.navigate", url=address)

    def run(self, script):
        """Return what an expression of the page is, or what its promise becomes."""
        done = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in done:
            raise RuntimeError(done["exceptionDetails"].get("exception", {}).get("description", "an error of the page"))
        return done["result"].get("value")

    def wait(self, script, seconds=30.0):
        """Wait until an expression is true."""
        until = time.monotonic() + seconds
        while not self.run(f"Boolean({script})"):
            if time.monotonic() > until:
                raise TimeoutError(f"not within {seconds} s: {script}; {self.console}")
            time.sleep(0.05)

    def mouse(self, kind, x, y, buttons=0, **more):
        """Send an event of the mouse."""
        button = "left" if buttons or kind == "mouseReleased" else "none"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=buttons, clickCount=1, **more)

    def click(self, x, y):
        """Click at a place."""
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, 1)
        self.mouse("mouseReleased", x, y)

    def drag(self, x, y, to_x, to_y, steps=8):
        """Drag from a place to another one."""
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, 1)
        for k in range(1, steps + 1):
            self.mouse("mouseMoved", x + (to_x - x) * k / steps, y + (to_y - y) * k / steps, 1)
        self.mouse("mouseReleased", to_x, to_y)

    def press(self, selector):
        """Click an element."""
        self.run(f"document.querySelector({json.dumps(selector)}).click()")

    def key(self, key, code=None, modifiers=0):
        """Press a key."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code or key, modifiers=modifiers)

    def screenshot(self, path=None):
        """Return the page as (rows, columns, 3) numbers, once all is drawn; also as a file."""
        import io

        import numpy as np
        from PIL import Image

        self.wait("!window.studio || studio.scene.settled")
        self.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png", optimizeForSpeed=True)["data"])
        if path is not None:
            Path(path).write_bytes(data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
