"""Can this machine draw off-screen?

A missing OpenGL library kills the process that opens a window, so a second process is sent to find out.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence

__all__ = ["Probe", "probe"]

ADVICE = "on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri"

# Draws one small picture the way the previews do.
SCRIPT = """
import vtk
window = vtk.vtkRenderWindow()
window.SetOffScreenRendering(1)
window.SetSize(16, 16)
window.AddRenderer(vtk.vtkRenderer())
window.Render()
print("drawn")
"""


@dataclasses.dataclass(frozen=True)
class Probe:
    """What a test picture said.

    Attributes:
        ok: True when off-screen drawing works.
        message: What was found, and what to install where it does not work.
    """

    ok: bool
    message: str


def window_environment(environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the variables that VTK needs to draw on Linux without a screen; empty elsewhere.

    Args:
        environment: The variables that are set; by default those of this process.
    """
    known = os.environ if environment is None else environment
    screen = known.get("DISPLAY") or known.get("WAYLAND_DISPLAY")
    if not sys.platform.startswith("linux") or screen or known.get("VTK_DEFAULT_OPENGL_WINDOW"):
        return {}
    return {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}


def probe(command: Sequence[str] | None = None, timeout: float = 60.0) -> Probe:
    """Draw a test picture of 16 x 16 pixels in a second process; asked once per process, then remembered.

    Args:
        command: Command to run in place of the test picture; it succeeds by exit status 0 and the word
            "drawn".
        timeout: Time in s after which the answer is no.

    Returns:
        Probe. A crash, a missing package and a time-out are answers, not exceptions.
    """
    return _ask(tuple(command) if command is not None else (sys.executable, "-c", SCRIPT), timeout)


@functools.cache
def _ask(words: tuple[str, ...], timeout: float) -> Probe:
    """Run the command and judge how it ended."""
    environment = {**os.environ, **window_environment()}
    try:
        done = subprocess.run(
            words, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=timeout
        )
    except subprocess.TimeoutExpired:
        return Probe(False, f"no off-screen OpenGL: the test picture took longer than {timeout:g} s; {ADVICE}")
    except OSError as error:
        return Probe(False, f"no off-screen OpenGL: the test picture could not be started ({error}); {ADVICE}")
    if done.returncode == 0 and "drawn" in done.stdout:
        return Probe(True, "off-screen OpenGL works")
    if "No module named 'vtk" in done.stderr:
        return Probe(False, 'previews need pyvista: pip install "warpriver[viz]"')
    return Probe(False, f"no off-screen OpenGL: the test picture {_how_it_ended(done)}; {ADVICE}")


def _how_it_ended(done: subprocess.CompletedProcess[str]) -> str:
    """Say in a few words how the second process ended."""
    if done.returncode < 0:
        return "crashed, as VTK does where OpenGL libraries are missing"
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return f"ended with status {done.returncode}" + (f" ({lines[-1][:160]})" if lines else "")
