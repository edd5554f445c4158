"""Scenes in files: what a riverscape is made of as JSON, its arrays beside that as npz."""

from __future__ import annotations

import dataclasses
import json
import os
import pathlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpriver.channel_table import ChannelTable
from warpriver.edits.values import Edit, edit_of
from warpriver.errors import InputError, PathError
from warpriver.files import beside
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.riverscape.before import Profile
from warpriver.riverscape.courses import Course, CourseFrame, Log, Rock
from warpriver.riverscape.layout import BedParams, Layout
from warpriver.riverscape.made import Made
from warpriver.riverscape.primitives import Merge, Node, Primitives, Replace
from warpriver.riverscape.profiles import ProfileParams
from warpriver.riverscape.programs import TileFrame
from warpriver.riverscape.rivers import Rivers
from warpriver.riverscape.scene import Riverscape
from warpriver.riverscape.seeding import SeedingParams
from warpriver.riverscape.stations import Stations
from warpriver.riverscape.templates import FlowParams
from warpriver.riverscape.trajectories import TrajectoryParams
from warpriver.terrain import Terrain

__all__ = ["read_riverscape", "write_scene"]


FORMAT = 2
COURSE_ARRAYS = ("xy", "level", "width", "depth", "speed", "form", "falls")
LAYOUT_PARAMS = {"flow": FlowParams, "trajectory": TrajectoryParams, "profile": ProfileParams, "bed": BedParams}
# Columns of a network's table that are kept; its nodes are kept beside them.
COLUMNS = ("width", "depth", "discharge", "drainage_area", "slope", "id", "from_node", "to_node", "closed", "joint")


def write_scene(scene: Riverscape, path: str | os.PathLike[str]) -> None:
    """Write a scene; see :meth:`Riverscape.save`."""
    target = pathlib.Path(path)
    if target.suffix.lower() != ".json":
        raise InputError(f"{target} ends in {target.suffix or 'nothing'}; a scene is a .json, with a .npz beside it")
    made = scene.made
    rivers, raster = made.rivers, made.terrain.raster
    arrays: dict[str, NDArray[Any]] = {"terrain": raster.values.numpy()}
    arrays |= {f"laid.{name}": values for name, values in rivers.stations.to_arrays().items()}
    told: dict[str, Any] = {
        "format": FORMAT,
        "kind": "riverscape",
        "detail": made.detail,
        "seed": made.seed,
        "params": dataclasses.asdict(made.params),
        "terrain": {"cell_size": raster.cell_size, "origin": list(raster.origin), "crs": raster.crs},
        "obstacles": [{"is": type(each).__name__} | dataclasses.asdict(each) for each in rivers.obstacles],
        "tree": None if made.tree is None else _listed(made.tree, arrays),
        "water_edits": [edit.as_json() for edit in made.water_edits],
        "edits": [edit.as_json() for edit in scene.edits],
        "frames": _frames(made, arrays),
    }
    if rivers.network is None:
        courses = rivers.courses()
        told["courses"] = [course.channel_type for course in courses]
        for k, course in enumerate(courses):
            arrays |= {f"course{k}_{name}": np.asarray(getattr(course, name)) for name in COURSE_ARRAYS}
    else:
        assert rivers.profile is not None
        arrays |= {"profile.start": rivers.profile.start, "profile.level": rivers.profile.level}
        told["network"] = _network(rivers.network, arrays)
        told["types"] = rivers.type_words()
        told["flow"] = None if rivers.flow is None else np.asarray(rivers.flow, np.float64).tolist()
        told["layout"] = {"width": rivers.layout.width, "planform": rivers.layout.planform} | {
            name: dataclasses.asdict(getattr(rivers.layout, name)) for name in LAYOUT_PARAMS
        }
    with beside(target, (".npz",)) as temporary:
        temporary.write_text(json.dumps(told, indent=1) + "\n")
        np.savez_compressed(temporary.with_suffix(".npz"), **arrays)  # type: ignore[arg-type]


def _frames(made: Made, arrays: dict[str, NDArray[Any]]) -> dict[str, Any] | None:
    """What bits are relative to, of a scene that was edited."""
    if made.frames is None:
        return None
    course, tile = made.frames
    arrays |= {"frame.tile": tile.tile, "frame.datum": tile.datum}
    return {
        "origin": list(course.origin),
        "size": course.size,
        "cell_size": tile.cell_size,
        "corner": [int(v) for v in tile.origin],
    }


def _network(network: RiverNetwork, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    count = network.point_count
    arrays["network.point_xy"] = network.point_xy[:count].numpy()
    arrays["network.start"] = network.starts()
    arrays["network.node_xy"] = network.node_xy
    if network.point_section is not None:
        arrays["network.section"] = network.point_section[:count].numpy()
    if network.point_z is not None:
        arrays["network.z"] = network.point_z
    table = network.channels
    arrays |= {f"network.{name}": table[name] for name in COLUMNS if table[name] is not None}
    return {"origin": [float(v) for v in network.origin], "crs": network.crs, "dtype": network.dtype}


def _network_of(told: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], device: wp.DeviceLike) -> RiverNetwork:
    columns: dict[str, Any] = {name: arrays[f"network.{name}"] for name in COLUMNS if f"network.{name}" in arrays}
    return RiverNetwork(
        arrays["network.point_xy"],
        arrays["network.start"],
        ChannelTable(**columns),
        node_xy=arrays["network.node_xy"],
        point_section=arrays.get("network.section"),
        point_z=arrays.get("network.z"),
        origin=told["origin"],
        crs=told["crs"],
        dtype=told["dtype"],
        device=device,
    )


def _listed(node: Node, arrays: dict[str, NDArray[Any]]) -> dict[str, object]:
    """A tree as what JSON holds; its arrays go into the other file."""
    if isinstance(node, Primitives):
        name = f"primitives{sum(key.endswith('_radius') for key in arrays)}"
        for field in dataclasses.fields(Primitives):
            arrays[f"{name}_{field.name}"] = getattr(node, field.name)
        return {"primitives": name}
    if isinstance(node, Merge):
        return {"merge": [_listed(child, arrays) for child in node.children]}
    return {"replace": [_listed(node.under, arrays), _listed(node.over, arrays)]}


def _tree_of(told: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Node:
    if "primitives" in told:
        return Primitives(*(arrays[f"{told['primitives']}_{field.name}"] for field in dataclasses.fields(Primitives)))
    if "merge" in told:
        return Merge(tuple(_tree_of(child, arrays) for child in told["merge"]))
    under, over = (_tree_of(child, arrays) for child in told["replace"])
    return Replace(under, over)


def _obstacle_of(told: dict[str, Any]) -> Rock | Log:
    values: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in told.items() if name != "is"}
    kinds: dict[str, type[Rock] | type[Log]] = {"Rock": Rock, "Log": Log}
    return kinds[told["is"]](**values)


@public
def read_riverscape(path: str | os.PathLike[str], *, device: wp.DeviceLike = "cpu") -> Riverscape:
    """Read a scene that :meth:`Riverscape.save` wrote; bed and water are those of the scene, to the bit.

    Its edits are known, and further ones can be done; those that were done before cannot be taken back.

    Args:
        path: The ``.json`` file.
        device: Warp device.

    Raises:
        OSError: A file is missing.
        ValueError: It is no scene.
    """
    source = pathlib.Path(path)
    try:
        told = json.loads(source.read_text())
        with np.load(source.with_suffix(".npz")) as file:
            arrays = dict(file)
    except OSError as error:
        raise PathError.of(error, "give the .json of a scene, with its .npz beside it") from error
    except ValueError as error:
        raise InputError(f"{source} is no scene ({error}); Riverscape.save writes one") from error
    try:
        if told["kind"] != "riverscape" or told["format"] != FORMAT:
            raise KeyError("format")
        made = _made_of(told, arrays, device)
        edits: list[Edit] = [edit_of(values) for values in told["edits"]]
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{source} is no scene of this version ({error}); Riverscape.save writes one") from error
    return Riverscape.of_made(made, edits)


def _made_of(told: dict[str, Any], arrays: dict[str, NDArray[Any]], device: wp.DeviceLike) -> Made:
    place = told["terrain"]
    terrain = Terrain(arrays["terrain"], place["cell_size"], place["origin"], place["crs"], device=device)
    prefix = "laid."
    laid = {name.removeprefix(prefix): v for name, v in arrays.items() if name.startswith(prefix)}
    obstacles = [_obstacle_of(each) for each in told["obstacles"]]
    courses = None
    if "courses" in told:
        courses = [
            Course(channel_type=kind, **{name: arrays[f"course{k}_{name}"] for name in COURSE_ARRAYS})
            for k, kind in enumerate(told["courses"])
        ]
    rivers = Rivers.of_stations(terrain, Stations.from_arrays(laid), courses, obstacles)
    if courses is None:
        network = _network_of(told["network"], arrays, device)
        params = {name: kind(**told["layout"][name]) for name, kind in LAYOUT_PARAMS.items()}
        layout = Layout(told["detail"], told["seed"], told["layout"]["width"], told["layout"]["planform"], **params)
        profile = Profile(arrays["profile.start"], arrays["profile.level"])
        rivers.take_network(network, told["types"], layout, profile, told["flow"])
    frames = None
    if told["frames"] is not None:
        kept = told["frames"]
        corner = (int(kept["corner"][0]), int(kept["corner"][1]))
        tile = TileFrame(kept["cell_size"], corner, arrays["frame.tile"], arrays["frame.datum"])
        frames = (CourseFrame((kept["origin"][0], kept["origin"][1]), kept["size"]), tile)
    return Made(
        terrain,
        rivers,
        told["detail"],
        told["seed"],
        SeedingParams(**told["params"]),
        None if told["tree"] is None else _tree_of(told["tree"], arrays),
        tuple(edit_of(values) for values in told["water_edits"]),
        frames,
    )
