"""Warp as a part of the package: what it says of itself is not for those who use rivers."""

import subprocess
import sys

import pytest

FIRST_USES = {
    "network": "wr.RiverNetwork.from_polylines([wr.generate.straight_line(3000, 50)], width=60.0)",
    "simulation": "wr.Simulation(wr.RiverNetwork.from_polylines([wr.generate.noisy_line(900, 50, 9, 0)], 60.0)).step()",
    "terrain": "wr.generate.fractal_terrain((30, 40), 25.0, 90.0, seed=3)",
    "heights": "wr.hydrology.fill_depressions(wr.Terrain([[1.0, 2.0], [3.0, 4.0]], 10.0))",
    "valley": "wr.synthetic_valley('S1', length=200.0)",
    "erosion": "wr.erode(wr.generate.erosion_plane((20, 30)), events=5)",
}


def said_by(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.mark.parametrize("use", FIRST_USES)
def test_the_first_use_of_warp_says_nothing(use):
    """Neither Warp's greeting nor its modules nor the native line about a driver that is not there."""
    assert said_by(f"import warpriver as wr; {FIRST_USES[use]}") == ""


def test_what_others_say_of_warp_is_not_lost():
    """Its warnings are let through, a level of one's own stands, and so does what native code writes meanwhile."""
    code = """
import os, warp as wp
from warpriver import device
wp.config.log_level = wp.LOG_DEBUG
start = wp.init
def noisy():
    os.write(2, b"Warp CUDA warning: no CUDA driver\\nsomething else\\n")
wp.init = noisy
device._has_driver = lambda: False
device.start_warp()
device.start_warp()
assert wp.config.log_level == wp.LOG_DEBUG
wp.init = start
"""
    assert said_by(code) == "something else\n"
