"""The attribute table of river networks: what is written, and what is read from the files of others.

:data:`WRITTEN` and :data:`READ` are the only places that name attributes; writers, readers and the tables in the
documentation follow them. Units of the files of others are turned into ours by the factor beside the name: HydroRIVERS
[Lehner2013], NHDPlus [McKay2012], SWORD [Altenau2021], TauDEM and the networks made by it, MERIT-Basins.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from warpriver.errors import InputError, warn
from warpriver.hydrology.orders import horton_order, main_stem, shreve_magnitude, strahler_order
from warpriver.network import RiverNetwork
from warpriver.validate import shown

__all__ = [
    "FAMILIES",
    "GENERIC",
    "LISTS",
    "NO_VALUE",
    "NO_WORD",
    "READ",
    "ROLES",
    "SHORT_NAMES",
    "WRITTEN",
    "Attribute",
    "Family",
    "Name",
    "family_of",
    "is_no_value",
    "is_ours",
    "list_names",
    "next_downstream",
    "read_names",
    "read_role",
    "read_table",
    "tell_lost_names",
    "useful_names",
    "write_columns",
    "written_table",
]

SQUARE_KILOMETER = 1e6  # m2
CUBIC_FOOT = 0.3048**3  # m3
# What HydroSHEDS, the USGS, SWORD and others write for "no value", beside an empty field; and numbers beyond reason.
NO_VALUE = (-999.0, -9998.0, -9999.0, -99999.0, -999900.0, -999999.0)
BEYOND = 1e20
NO_WORD = {"", "-", "?", "*", "na", "n/a", "nan", "null", "none", "nil", "unknown", "<null>"}

# What is known of a channel; the last six say what it is joined to, closed that this is itself, joint by what.
ROLES = (
    "width",
    "depth",
    "discharge",
    "drainage_area",
    "slope",
    "channel_id",
    "next_down",
    "from_node",
    "to_node",
    "closed",
    "joint",
)
IDENTITIES = ("channel_id", "next_down", "from_node", "to_node")
# What cannot be 0 or less: such a number is none.
POSITIVE = ("width", "depth", "discharge", "drainage_area")
# Attributes that hold a list, a number a point.
LISTS = ("width", "depth")


class Attribute(NamedTuple):
    """One attribute as it is written.

    Attributes:
        name: Its name.
        short: Its name in a shapefile, of at most 10 characters.
        unit: "-" where there is none.
        meaning: What it holds.
    """

    name: str
    short: str
    unit: str
    meaning: str


WRITTEN = (
    Attribute("channel_id", "channel_id", "-", "identity of the channel"),
    Attribute("next_down", "next_down", "-", "identity of the channel downstream; -1 for none"),
    Attribute("from_node", "from_node", "-", "node at the upstream end"),
    Attribute("to_node", "to_node", "-", "node at the downstream end"),
    Attribute("length_m", "length_m", "m", "length of the line"),
    Attribute("sinuosity", "sinuosity", "-", "length over the distance of the ends; empty for a ring"),
    Attribute("width_m", "width_m", "m", "bankfull width, the mean"),
    Attribute("depth_m", "depth_m", "m", "bankfull depth, the mean"),
    Attribute("discharge_m3s", "dis_m3s", "m3/s", "bankfull discharge at the downstream end"),
    Attribute("drainage_area_km2", "area_km2", "km2", "drainage area at the downstream end"),
    Attribute("drainage_area_m2", "area_m2", "m2", "the same to the last bit; read first"),
    Attribute("slope", "slope", "m/m", "drop over length; empty where it is not known"),
    Attribute("closed", "closed", "-", "1 for a ring, whose line ends at its first point; else 0"),
    Attribute("joint", "joint", "-", "2: its lower end is a locked point, 1: a through node; else 0"),
    Attribute("strahler", "strahler", "-", "Strahler order"),
    Attribute("shreve", "shreve", "-", "Shreve magnitude"),
    Attribute("horton", "horton", "-", "Horton order"),
    Attribute("main_stem", "main_stem", "-", "identity of the lowest channel of the stem (Hack) it belongs to"),
    Attribute("point_width_m", "", "m", "a list, a number a point, where the width varies; see below"),
    Attribute("point_depth_m", "", "m", "a list, a number a point, where the depth varies; see below"),
)
SHORT_NAMES = {a.name: a.short for a in WRITTEN if a.short}
# By these a file is known as one that comes from us, also where a GIS has saved it anew.
OURS = {"channel_id", "next_down", "from_node", "to_node", "length_m", "sinuosity"}


class Name(NamedTuple):
    """One attribute as others write it.

    Attributes:
        name: Its name; case does not count.
        role: What it tells.
        unit: Its unit there.
        factor: What it is multiplied by to be in ours.
        listed: Whether the documentation lists it.
    """

    name: str
    role: str
    unit: str
    factor: float = 1.0
    listed: bool = True


class Family(NamedTuple):
    """A kind of file, known by attributes that only it has.

    Attributes:
        name: What people call it.
        marks: It is of this kind if it has all names of one of these sets.
        mean_flow: Whether its discharges are long-term means, not bankfull ones.
    """

    name: str
    marks: tuple[frozenset[str], ...]
    mean_flow: bool = False


def _marks(*sets: str) -> tuple[frozenset[str], ...]:
    return tuple(frozenset(names.split()) for names in sets)


GENERIC = Family("any file", ())
# The first that fits counts. SWOT's own products have reach_id as well, but not these beside it, and slopes in m/m.
FAMILIES = (
    Family("HydroRIVERS", _marks("hyriv_id"), mean_flow=True),
    Family("MERIT-Basins", _marks("comid nextdownid"), mean_flow=True),
    Family("TauDEM", _marks("linkno dslinkno")),
    Family("NHDPlus", _marks("comid", "nhdplusid"), mean_flow=True),
    Family("SWORD", _marks("reach_id n_rch_up", "reach_id n_rch_dn", "reach_id facc"), mean_flow=True),
)

# Names by kind of file. Of those with one role the first that holds a value counts.
READ: Mapping[str, tuple[Name, ...]] = {
    "any file": (
        Name("width_m", "width", "m"),
        Name("width", "width", "m"),
        Name("width1", "width", "m"),
        Name("mean_width_m", "width", "m"),
        Name("mean_width", "width", "m", listed=False),
        Name("median_width_m", "width", "m"),
        Name("median_wid", "width", "m", listed=False),
        Name("depth_m", "depth", "m"),
        Name("depth", "depth", "m"),
        Name("discharge_m3s", "discharge", "m3/s"),
        Name("discharge", "discharge", "m3/s"),
        Name("dis_m3s", "discharge", "m3/s"),
        # As GDAL cuts our names where it saves a shapefile: to ten characters, the second of two alike with a number.
        Name("discharge_", "discharge", "m3/s", listed=False),
        Name("drainage_area_m2", "drainage_area", "m2"),
        Name("area_m2", "drainage_area", "m2"),
        Name("drainage_1", "drainage_area", "m2", listed=False),
        Name("drainage_area_km2", "drainage_area", "km2", SQUARE_KILOMETER),
        Name("area_km2", "drainage_area", "km2", SQUARE_KILOMETER),
        Name("drainage_a", "drainage_area", "km2", SQUARE_KILOMETER, listed=False),
        Name("slope", "slope", "m/m"),
        Name("channel_id", "channel_id", "-"),
        Name("seg_id", "channel_id", "-"),
        Name("next_down", "next_down", "-"),
        Name("down_id", "next_down", "-"),
        Name("from_node", "from_node", "-"),
        Name("to_node", "to_node", "-"),
        Name("closed", "closed", "-"),
        Name("joint", "joint", "-"),
    ),
    "HydroRIVERS": (
        Name("UPLAND_SKM", "drainage_area", "km2", SQUARE_KILOMETER),
        Name("DIS_AV_CMS", "discharge", "m3/s"),
        Name("HYRIV_ID", "channel_id", "-"),
        Name("NEXT_DOWN", "next_down", "-"),
    ),
    "MERIT-Basins": (
        Name("uparea", "drainage_area", "km2", SQUARE_KILOMETER),
        Name("COMID", "channel_id", "-"),
        Name("NextDownID", "next_down", "-"),
    ),
    "TauDEM": (
        Name("DSContArea", "drainage_area", "m2"),
        Name("LINKNO", "channel_id", "-"),
        Name("DSLINKNO", "next_down", "-"),
    ),
    "NHDPlus": (
        Name("TotDASqKm", "drainage_area", "km2", SQUARE_KILOMETER),
        Name("DivDASqKm", "drainage_area", "km2", SQUARE_KILOMETER),
        Name("QE_MA", "discharge", "ft3/s", CUBIC_FOOT),
        Name("QEMA", "discharge", "ft3/s", CUBIC_FOOT),
        Name("QA_MA", "discharge", "ft3/s", CUBIC_FOOT),
        Name("QAMA", "discharge", "ft3/s", CUBIC_FOOT),
        Name("SLOPE", "slope", "m/m"),
        Name("COMID", "channel_id", "-"),
        Name("NHDPlusID", "channel_id", "-"),
        Name("FromNode", "from_node", "-"),
        Name("ToNode", "to_node", "-"),
        Name("ToCOMID", "next_down", "-"),
    ),
    "SWORD": (
        Name("width", "width", "m"),
        Name("facc", "drainage_area", "km2", SQUARE_KILOMETER),
        Name("slope", "slope", "m/km", 1e-3),
        Name("reach_id", "channel_id", "-"),
        Name("rch_id_dn_main", "next_down", "-"),
        Name("rch_id_dn", "next_down", "-"),
        Name("rch_id_dn_1", "next_down", "-"),
        Name("rch_id_dn1", "next_down", "-"),
    ),
}


def family_of(names: Iterable[str]) -> Family:
    """Return the kind of file that has these attributes."""
    there = {name.lower() for name in names}
    return next((family for family in FAMILIES if any(marks <= there for marks in family.marks)), GENERIC)


@functools.cache
def read_names(family: Family, role: str) -> tuple[Name, ...]:
    """Return the names under which a kind of file may tell something: its own first, then those of any file."""
    own = tuple(name for name in READ[family.name] if name.role == role)
    if family == GENERIC:
        return own
    taken = {name.name.lower() for name in own}
    return own + tuple(name for name in READ[GENERIC.name] if name.role == role and name.name not in taken)


def useful_names(names: Iterable[str], wanted: Iterable[str], extra: Iterable[str] = ()) -> set[str]:
    """Return those of a file's attributes, in its spelling, that are wanted or tell what kind of file it is.

    Args:
        names: All that it has.
        wanted: Roles to look for.
        extra: Names of free columns.
    """
    names = list(names)
    family = family_of(names)
    useful = {name.name.lower() for role in wanted for name in read_names(family, role)}
    useful |= {name for role in wanted if role in LISTS for name in list_names(role)}
    useful |= {name for marks in family.marks for name in marks} | {name.lower() for name in extra}
    return {name for name in names if name.lower() in useful}


def list_names(role: str) -> tuple[str, ...]:
    """Return the names of a list of one number a point; the last is the first as a shapefile cuts it."""
    return f"point_{role}_m", f"point_{role}", f"point_{role}_m"[:10]


def is_ours(names: Iterable[str]) -> bool:
    """Tell whether a file with these attributes comes from ``write_network``, whoever saved it last."""
    return {name.lower() for name in names} >= OURS


def tell_lost_names(path: object, names: Iterable[str], wanted: Iterable[str]) -> None:
    """Warn of a file of ours whose attributes were renamed beyond recognition, or so that they may mean two things.

    Args:
        path: The file.
        names: Its attributes.
        wanted: Roles that are read from it.
    """
    there = {name.lower() for name in names}
    if not is_ours(there):
        return
    lost = [
        role
        for role in ("width", "depth", "discharge")
        if role in wanted and not any(name.name.lower() in there for name in read_names(GENERIC, role))
    ]
    told = []
    if lost:
        told.append(
            f"it comes from write_network, but has lost its {' and '.join(lost)}, perhaps to a program that shortens "
            f"names; {'they follow' if len(lost) > 1 else 'it follows'} from what is left"
        )
    if "drainage_a" in there and not there & {"drainage_1", "area_m2", "area_km2"} and "drainage_area" in wanted:
        told.append("drainage_a is taken as drainage_area_km2")
    if told:
        warn(f"{path}: {'; '.join(told)}")


def is_no_value(numbers: np.ndarray, role: str) -> np.ndarray:
    """Return where numbers of a role stand for nothing: NaN, -9999 and its kin, and 0 or less where that cannot be."""
    none = ~(np.abs(numbers) < BEYOND) | np.isin(numbers, NO_VALUE)
    unknown: np.ndarray = none | (numbers <= 0.0) if role in POSITIVE else none
    return unknown


def _is_none(number: float, role: str) -> bool:
    """Return :func:`is_no_value` of one number, at a fraction of its cost."""
    return not abs(number) < BEYOND or number in NO_VALUE or (number <= 0.0 and role in POSITIVE)


def read_role(attributes: Mapping[str, Any], family: Family, role: str, where: str) -> Any:
    """Return what a feature tells, None if it tells nothing, or raise ``ValueError``.

    Args:
        attributes: Values by lower-case name.
        family: The kind of file.
        role: What to look for.
        where: File and feature, for messages.

    Returns:
        A float; for identities an int, or a tuple of them where several channels follow downstream.
    """
    for name in read_names(family, role):
        value = attributes.get(name.name.lower())
        if value is None or (isinstance(value, str) and value.strip().lower() in NO_WORD):
            continue
        if role in IDENTITIES:
            found = _identity(value)
            if found is not None:
                return found if role == "next_down" else found[0]
            continue
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError) as error:
            if role in ("closed", "joint"):  # a word of others, of a road or a lock for one
                continue
            raise InputError(f"{where}: {name.name.lower()} is {shown(value)}, not a number") from error
        if not _is_none(number, role):
            return number * name.factor
    return None


def _identity(value: Any) -> tuple[int, ...] | None:
    """Return whole numbers, or None where there is something else."""
    if isinstance(value, (list, tuple, np.ndarray)):
        words = list(value)
    else:
        words = str(value).replace(",", " ").split() if isinstance(value, str) else [value]
    found = tuple(_whole(word) for word in words)
    whole = tuple(number for number in found if number is not None)
    return whole if whole and len(whole) == len(found) and float(whole[0]) not in NO_VALUE else None


def _whole(word: Any) -> int | None:
    """Return a whole number, also one that is written with decimals of 0, or None."""
    try:
        number = int(word)
        return number if isinstance(word, str) or number == word else None
    except (TypeError, ValueError, OverflowError):
        pass
    try:
        return int(float(word)) if isinstance(word, str) and float(word).is_integer() else None
    except (ValueError, OverflowError):
        return None


def next_downstream(network: RiverNetwork) -> np.ndarray:
    """Return for each channel the index of the one that it flows into, -1 for none: (C,) int64.

    Where several begin at a node it is the one with most discharge, of equals the first.
    """
    heir = np.full(network.node_count, -1, np.int64)
    order = np.lexsort((-np.arange(network.channel_count), network.channel_discharge))
    order = order[network.channel_from[order] != network.channel_to[order]]
    heir[network.channel_from[order]] = order  # the last entry stays
    down: np.ndarray = heir[network.channel_to]
    down[down == np.arange(network.channel_count)] = -1
    return down


def write_columns(network: RiverNetwork) -> dict[str, Any]:
    """Return the attributes of all channels by name, in the order of :data:`WRITTEN`; lists a point stay lists.

    Without drainage areas or joints, or with sections that do not vary, their attributes are left out; so are orders
    and stems of a network in which channels part or flow in a circle. Free columns come last.
    """
    identity = network.channel_id
    down = next_downstream(network)
    xy, starts = network.points(), network.starts()
    length = network.channel_lengths()
    chord = np.hypot(*(xy[starts[1:] - 1] - xy[starts[:-1]]).T)
    ring = (chord == 0.0) | network.channel_closed
    columns: dict[str, Any] = {
        "channel_id": identity,
        "next_down": np.where(down < 0, -1, identity[down]),
        "from_node": network.channel_from.astype(np.int64),
        "to_node": network.channel_to.astype(np.int64),
        "length_m": length,
        "sinuosity": np.where(ring, np.nan, length / np.where(ring, 1.0, chord)),
        "width_m": network.channel_width,
        "depth_m": network.channel_depth,
        "discharge_m3s": network.channel_discharge,
    }
    area = network.channel_drainage_area
    if area is not None:
        columns["drainage_area_km2"] = area / SQUARE_KILOMETER
        columns["drainage_area_m2"] = area
    columns["slope"] = network.channel_slope
    columns["closed"] = network.channel_closed.astype(np.int64)
    if network.channel_joint.any():
        columns["joint"] = network.channel_joint.astype(np.int64)
    columns.update(_orders(network))
    if network.point_section is not None:
        for role, arrays in (
            ("width", network.point_widths(close=True)), ("depth", network.point_depths(close=True)),
        ):  # fmt: skip
            mean = columns[f"{role}_m"]
            columns[f"point_{role}_m"] = [
                None if (a == m).all() else a.tolist() for a, m in zip(arrays, mean, strict=True)
            ]
    return columns | dict(network.channels.extra)


def _orders(network: RiverNetwork) -> dict[str, np.ndarray]:
    """Orders and main stem of each channel; nothing for a graph that has none."""
    above, below, flow = network.channel_from, network.channel_to, network.channel_flow()
    try:
        return {
            "strahler": strahler_order(above, below),
            "shreve": shreve_magnitude(above, below),
            "horton": horton_order(above, below, flow),
            "main_stem": network.channel_id[main_stem(above, below, flow)],
        }
    except ValueError:
        return {}


def written_table() -> str:
    """Return what is written, as the documentation of ``write_network`` has it."""
    return _table(("attribute", "unit", "what"), [(a.name, a.unit, a.meaning) for a in WRITTEN])


def read_table() -> str:
    """Return what is read, as the documentation of ``read_network`` has it."""
    rows = []
    for family in (GENERIC, *FAMILIES):
        for role in ROLES:
            listed = [name for name in READ[family.name] if name.role == role and name.listed]
            names = [name.name + ("" if name.factor == 1.0 else f" ({name.unit})") for name in listed]
            if family is GENERIC and role in LISTS:
                names += list_names(role)[:2]
            if names:
                rows.append((family.name, f"{role.replace('_', ' ')}{_UNIT.get(role, '')}", ", ".join(names)))
    return _table(("file", "what", "attribute or column, unit if it is another"), rows)


_UNIT = {"width": ", m", "depth": ", m", "discharge": ", m3/s", "drainage_area": ", m2", "slope": ", m/m"}


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Return a table as plain text (reStructuredText)."""
    width = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    rule = tuple("=" * w for w in width)
    lines = [
        " ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)) for row in [rule, head, rule, *rows, rule]
    ]
    return "\n".join(line.rstrip() for line in lines)
