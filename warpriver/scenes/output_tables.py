"""The table [output] of a scene."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from warpriver.errors import InputError, MissingExtraError
from warpriver.history.tables import FEATURES
from warpriver.io.raster.terrains import SUFFIXES, terrain_formats
from warpriver.io.tables import check_keys, list_of_tables, nearest, shown
from warpriver.io.vector.histories import HISTORY_SUFFIXES
from warpriver.io.vector.layers import NEEDS
from warpriver.io.vector.networks import line_formats
from warpriver.scenes.outputs import MAPS, PICTURES, picture_options
from warpriver.scenes.parts import Outputs, Picture
from warpriver.validate import finite_numbers, not_negative, whole

__all__ = ["OUTPUT", "PICTURE", "default_outputs", "read_outputs"]

# Keys of [output], and of each [[output.picture]].
OUTPUT = {
    "run": ("true", "store the run itself, in the folder run"),
    "lines": ("(none)", "file of the rivers at the end (.csv, .geojson, .gpkg ...)"),
    "gis": ("(none)", "file of rivers, courses, oxbow lakes and abandoned courses (.gpkg, .geojson ...)"),
    "layers": ("(all)", f"which of these are written beside the rivers: {', '.join(FEATURES)}"),
    "terrain": ("(none)", "file of the ground at the end (.tif, .asc, .npz ...)"),
    "session": ("(none)", "JSON file of the edits, to be replayed"),
}
PICTURE = {
    "file": "name of the picture",
    "of": "belt, before_after, network, movie or preview; by default as the ending says: belt or movie",
    "relief": "draw the ground (default true)",
    "controls": "draw the outlines of the controls that work then: of belt, before_after and network (default false)",
    "until": "time that is shown in yr (default: the end)",
}
MOVIE_NEEDS, PICTURE_NEEDS = {".mp4": ("imageio_ffmpeg",)}, {"preview": ("pyvista",)}
TEXTS, WHOLE = ("title", "color"), ("every",)
FLAGS, LISTS = ("legend", "frame", "flow_arrow"), {"size": 2, "window": 4}
COLORS = ("water", "discharge", "width", "area", "order")


def default_outputs() -> Outputs:
    """Return what is written where a scene does not say it: as ``warpriver simulate`` writes of lines."""
    whole_gis = all(importlib.util.find_spec(module) for module in ("pyogrio", "shapely"))
    drawn = importlib.util.find_spec("matplotlib") is not None
    return Outputs(
        lines="channels.csv",
        gis="rivers.gpkg" if whole_gis else None,
        pictures=(Picture("belt.png"),) if drawn else (),
    )


def read_outputs(path: Path, table: Mapping[str, Any], given: Any, has_terrain: bool) -> Outputs:
    """Return what a table says that is to be written; names, formats and what they need are checked."""
    if given is None:
        return default_outputs()
    where = f"{path}: output"
    check_keys(table, [*OUTPUT, "picture"], where)
    run = table.get("run", True)
    if not isinstance(run, bool):
        raise InputError(f"{where}.run = {shown(run)}; give true or false")
    gis = {suffix: _installed(NEEDS.get(suffix, ("shapely",))) for suffix in HISTORY_SUFFIXES}
    ground = {suffix: good for suffix, good in terrain_formats().items() if suffix in SUFFIXES}
    files = {
        "lines": line_formats(),
        "gis": gis,
        "terrain": ground,
        "session": {".json": True},
    }
    names = {key: _name(table[key], f"{where}.{key}", formats) for key, formats in files.items() if key in table}
    if "terrain" in names and not has_terrain:
        raise InputError(f"{where}.terrain = {shown(names['terrain'])}; the scene has no [terrain]; leave it out")
    layers = table.get("layers")
    if layers is not None:
        if "gis" not in names:
            raise InputError(f"{where}.layers = {shown(layers)} are those of gis; give its file, too")
        if not isinstance(layers, list):
            raise InputError(f"{where}.layers = {shown(layers)}; give a list of {', '.join(FEATURES)}")
        for layer in layers:
            if layer not in tuple(FEATURES):
                raise InputError(f"{where}.layers has {shown(layer)}; {nearest(str(layer), FEATURES)}")
    pictures = tuple(
        _picture(row, f"{where}.picture[{k}]", has_terrain)
        for k, row in enumerate(list_of_tables(path, "output.picture", table.get("picture", [])))
    )
    outputs = Outputs(run=run, layers=None if layers is None else tuple(layers), pictures=pictures, **names)
    twice = [name for name in outputs.names() if outputs.names().count(name) > 1]
    if twice:
        raise InputError(f"{where} names {twice[0]} twice; choose another name")
    return outputs


def _installed(modules: Iterable[str]) -> bool:
    return all(importlib.util.find_spec(module) for module in modules)


def _name(name: Any, where: str, formats: Mapping[str, bool]) -> str:
    """A plain name of a file in the folder of the results, of a format that can be written."""
    if not isinstance(name, str) or not name or PurePosixPath(name).name != name or "\\" in name:
        raise InputError(f"{where} = {shown(name)}; give the plain name of a file: it goes into the folder of results")
    suffixes = [suffix.lower() for suffix in Path(name).suffixes]
    if suffixes[-1:] == [".gz"] and ".gz" not in formats:
        suffixes.pop()
    ending = suffixes[-1] if suffixes else ""
    if ending not in formats:
        raise InputError(f"{where} = {shown(name)}; {ending or 'no ending'} is none of {', '.join(formats)}")
    if not formats[ending]:
        raise MissingExtraError(f'{where} = {shown(name)}; {ending} needs an extra: pip install "warpriver[gis]"')
    return name


def _picture(row: Mapping[str, Any], where: str, has_terrain: bool) -> Picture:
    if "file" not in row:
        raise InputError(f"{where}.file is missing; give the name of the picture")
    ending = Path(str(row["file"])).suffix.lower()
    of = row.get("of", "movie" if ending in PICTURES["movie"][1] else "belt")
    if not isinstance(of, str) or of not in PICTURES:
        raise InputError(f"{where}.of = {shown(of)}; {nearest(str(of), PICTURES)}")
    name = _name(row["file"], f"{where}.file", dict.fromkeys(PICTURES[of][1], True))
    needed = ("matplotlib", *MOVIE_NEEDS.get(ending, ()), *PICTURE_NEEDS.get(of, ()))
    if not _installed(needed):
        extra = "movie" if ending in MOVIE_NEEDS else "viz"
        raise MissingExtraError(
            f'{where}.file = {shown(name)}: pictures need an extra: pip install "warpriver[{extra}]"'
        )
    options = picture_options(of)
    check_keys(row, [*PICTURE, *options], where)
    relief = row.get("relief", has_terrain)
    if not isinstance(relief, bool):
        raise InputError(f"{where}.relief = {shown(relief)}; give true or false")
    if relief and not has_terrain:
        raise InputError(f"{where}.relief = true; the scene has no [terrain]; leave it out")
    until = None if "until" not in row else not_negative(row["until"], f"{where}.until", "years")
    if until is not None and of == "movie":
        raise InputError(f"{where}.until = {until:g}; a movie shows all times; leave it out")
    controls = row.get("controls", False)
    if not isinstance(controls, bool) or (controls and of not in MAPS):
        raise InputError(
            f"{where}.controls = {shown(controls)}; give true or false, and true of {', '.join(MAPS)} only"
        )
    return Picture(
        name, of, relief, controls, until, {key: _option(key, row[key], where) for key in options if key in row}
    )


def _option(key: str, value: Any, where: str) -> Any:
    label = f"{where}.{key}"
    if key in LISTS:
        numbers = finite_numbers(value, LISTS[key], label)
        return tuple(whole(v, label, 16, "pixels") for v in numbers) if key == "size" else tuple(numbers)
    if key in FLAGS:
        if not isinstance(value, bool):
            raise InputError(f"{label} = {shown(value)}; give true or false")
        return value
    if key in TEXTS:
        if not isinstance(value, str):
            raise InputError(f"{label} = {shown(value)}; give text")
        if key == "color" and value not in COLORS:
            raise InputError(f"{label} = {shown(value)}; {nearest(value, COLORS)}")
        return value
    return whole(value, label, 1) if key in WHOLE else not_negative(value, label)
