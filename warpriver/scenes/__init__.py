"""Scenes: terrain, rivers, constants, controls, edits and outputs of a run in one TOML file.

:func:`read_scene` reads one, ``scene.run("out/folder")`` does it, ``scene.simulation()`` prepares it to be stepped by
hand. :func:`scene_schema` lists every key.
"""

from warpriver.scenes.describe import describe_scene, scene_schema
from warpriver.scenes.parts import (
    GroundSource,
    Line,
    Outputs,
    Picture,
    RiverSource,
    RunPlan,
    TimedControl,
    TimedEdit,
)
from warpriver.scenes.reading import read_scene
from warpriver.scenes.scene import Scene

__all__ = [
    "GroundSource",
    "Line",
    "Outputs",
    "Picture",
    "RiverSource",
    "RunPlan",
    "Scene",
    "TimedControl",
    "TimedEdit",
    "describe_scene",
    "read_scene",
    "scene_schema",
]
