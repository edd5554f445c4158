"""Channel lines from and to files: the suffix names the format, and what is read is checked before it is a network."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import warp as wp

from warpriver.channel_table import JOINT_LOCK, JOINT_NONE, JOINT_THROUGH
from warpriver.crs import CRSLike
from warpriver.errors import InputError, InputTypeError, warn
from warpriver.extras import need
from warpriver.files import beside, check_place
from warpriver.graph.edits import valid_joints
from warpriver.io.crs import one_crs, reproject, settled_crs
from warpriver.io.files import check_readable
from warpriver.io.vector.attributes import ROLES
from warpriver.io.vector.direction import tell_direction
from warpriver.io.vector.extras import check_extra, extra_columns
from warpriver.io.vector.layers import JSON, NEEDS, OGR, PARQUET
from warpriver.io.vector.network_layers import write_features, write_geojson
from warpriver.io.vector.read_features import read_geojson, read_ogr, read_parquet
from warpriver.io.vector.settle import (
    SHORT,
    PerChannel,
    clean,
    drop_points,
    fill_by_laws,
    fill_widths,
    has_gaps,
    override,
    settle_short,
)
from warpriver.io.vector.source import Line, Source
from warpriver.io.vector.text import TEXT, read_text, write_text
from warpriver.io.vector.topology import TOPOLOGIES, Connections, connect
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.validate import shown

__all__ = ["check_network_file", "line_formats", "read_network", "write_network"]

PACKABLE = (*TEXT, *JSON)
SUFFIXES = (*PACKABLE, *OGR, PARQUET)
KNOWN = ", ".join(SUFFIXES) + " (text and GeoJSON also with .gz)"

REPEATED = ("drop", "error")


def line_formats() -> dict[str, bool]:
    """Return the suffixes of line files, each with whether the modules that it needs are installed here."""
    return {s: all(importlib.util.find_spec(m) for m in NEEDS.get(s, ())) for s in SUFFIXES}


@public
def read_network(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    width: PerChannel | None = None,
    depth: PerChannel | None = None,
    discharge: PerChannel | None = None,
    missing_width: float | None = None,
    layer: str | None = None,
    crs: CRSLike | None = None,
    to_crs: CRSLike | None = None,
    dtype: Literal["float64", "float32"] = "float64",
    device: wp.DeviceLike = "cpu",
    repeated: Literal["drop", "error"] = "drop",
    short: Literal["error", "drop", "narrow", "keep"] = "error",
    topology: Literal["file", "ends"] = "file",
    reverse: bool = False,
    closed: bool | None = None,
    extra: Iterable[str] | None = None,
) -> RiverNetwork:
    """Read channels that run downstream from a file, or from several files of one CRS.

    The suffix names the format. ``.csv``, ``.txt``, ``.dat``, ``.xy`` and ``.geojson``, ``.json`` (all also with
    ``.gz``) need nothing but NumPy; ``.gpkg``, ``.shp``, ``.fgb``, ``.parquet`` need ``warpriver[gis]``.

    *Attributes* are found by name, in any case; the first name that holds a value counts. A file with ``HYRIV_ID`` is
    one of HydroRIVERS, with ``COMID`` or ``NHDPlusID`` of NHDPlus, with ``reach_id`` and ``facc``, ``n_rch_up`` or
    ``n_rch_dn`` of SWORD, with ``LINKNO`` and ``DSLINKNO`` of TauDEM, with ``COMID`` and ``NextDownID`` of
    MERIT-Basins: its own names and units are then understood beside ours [Lehner2013, McKay2012, Altenau2021]. So are
    our names as a shapefile cuts them. An empty field, words such as "n/a", -999, -9998, -9999, -99999 and -999900 mean
    that nothing is known, as do a width, depth, discharge or drainage area that is not positive.

    ============ ================= ================================================================================
    file         what              attribute or column, unit if it is another
    ============ ================= ================================================================================
    any file     width, m          width_m, width, width1, mean_width_m, median_width_m, point_width_m, point_width
    any file     depth, m          depth_m, depth, point_depth_m, point_depth
    any file     discharge, m3/s   discharge_m3s, discharge, dis_m3s
    any file     drainage area, m2 drainage_area_m2, area_m2, drainage_area_km2 (km2), area_km2 (km2)
    any file     slope, m/m        slope
    any file     channel id        channel_id, seg_id
    any file     next down         next_down, down_id
    any file     from node         from_node
    any file     to node           to_node
    any file     closed            closed
    any file     joint             joint
    HydroRIVERS  discharge, m3/s   DIS_AV_CMS
    HydroRIVERS  drainage area, m2 UPLAND_SKM (km2)
    HydroRIVERS  channel id        HYRIV_ID
    HydroRIVERS  next down         NEXT_DOWN
    MERIT-Basins drainage area, m2 uparea (km2)
    MERIT-Basins channel id        COMID
    MERIT-Basins next down         NextDownID
    TauDEM       drainage area, m2 DSContArea
    TauDEM       channel id        LINKNO
    TauDEM       next down         DSLINKNO
    NHDPlus      discharge, m3/s   QE_MA (ft3/s), QEMA (ft3/s), QA_MA (ft3/s), QAMA (ft3/s)
    NHDPlus      drainage area, m2 TotDASqKm (km2), DivDASqKm (km2)
    NHDPlus      slope, m/m        SLOPE
    NHDPlus      channel id        COMID, NHDPlusID
    NHDPlus      next down         ToCOMID
    NHDPlus      from node         FromNode
    NHDPlus      to node           ToNode
    SWORD        width, m          width
    SWORD        drainage area, m2 facc (km2)
    SWORD        slope, m/m        slope (m/km)
    SWORD        channel id        reach_id
    SWORD        next down         rch_id_dn_main, rch_id_dn, rch_id_dn_1, rch_id_dn1
    ============ ================= ================================================================================

    Width: where neither argument nor file gives it, it follows from the bankfull discharge by w = 7.2 Q^0.5, or without
    one from the drainage area by w = c A^0.5 (:func:`warpriver.hydrology.channel_width`); a line without either gets
    ``missing_width``, or else the narrowest width of the others if most lines have one. A warning says so. Depth and
    discharge follow from the width where the file has none. The discharges of HydroRIVERS, NHDPlus, SWORD and
    MERIT-Basins are long-term means. They are taken as they are; a width follows from one only where there is no
    drainage area, and is then on the low side. Lengths and orders in a file are not read: they follow from the lines.

    *Free columns.* What ``write_network`` wrote of them comes back with its kind. Of other files ``extra`` names
    attributes to keep, ``extra=["GNIS_Name"]``: as flags, numbers or words, whichever holds them all; where a channel
    has none it is NaN or "".

    *Elevations.* Where every point has a third coordinate, or in text a column z, z_m, elevation, elevation_m or
    point_z, they become ``point_z``, in the unit of the file; else there are none.

    *Topology.* Channels are joined as the file says: by its nodes, if most lines have both; else by the channel
    downstream; else where ends meet. A line that its file shows to run upstream is turned, as those of SWORD, TauDEM
    and files that were edited in a GIS are. An end up to a width (and half its line) away from its node is brought
    there; one further away is left free, with a warning. A channel downstream that the file does not hold (a clipped
    basin, or 0) makes an outlet, a channel that is joined to none is a basin of its own. Where several lie downstream
    (SWORD), the one that drains most counts. Lines without an identity or nodes, and further lines of one identity, as
    a feature of several parts or a line that was cut has them, are numbered anew and joined where they meet the
    others, with a warning; the others keep what the file says. Channels downstream that form a circle are refused.
    ``topology="ends"`` joins lines where their ends meet and nothing else; so it is for several files at once. Lines
    that seem to run upstream, as a tree that parts instead of meeting, are told with a warning.

    *Text files.* Columns are separated by commas, semicolons (then 1,5 is one and a half), tabs or spaces. ``#`` starts
    a comment. Coordinates are the columns x, x_m, easting, east, x_coord or point_x, and y likewise, or longitude (lon,
    longitude, long, lng) and latitude (lat, latitude), else the first two. Channels are told by a column channel,
    channel_id, seg_id, segment_id, reach_id, river_id, stream_id, line_id, comid or linkno; or id, fid, objectid, gid,
    river, name and their kin, which number points if they differ in every row; else by blank lines, of which there may
    be one after every row. Where a line without such a column jumps many times its usual spacing a warning says so. A
    comment that holds ``crs=EPSG:32619`` gives the CRS (``crs_wkt=`` takes the rest of the line), ``units=`` must say
    metres or degrees, and ``order=upstream`` turns the lines round. Lines before the numbers that start with a word and
    name no columns, like ``RMTEXT 350 2``, are passed over. The rows of a channel stand together. Width and depth may
    vary along a channel; discharge and slope are averaged, the drainage area is that of the last point; rows without a
    value are passed over, and get the width and depth between the others, with a warning.

    *GIS files.* LineString and MultiLineString; m is dropped, other geometries passed over. Parts of a MultiLineString
    that follow end to start become one channel, each other part is a channel of its own. Widths are in metres, whatever
    the unit of the coordinates. ``point_width_m`` and ``point_depth_m`` are lists (or JSON text), a number a point, as
    ``write_network`` writes them where the section varies; in a GeoPackage the layer "<layer>_points" has them. Where
    an edit in a GIS has changed the points they are interpolated along the line; where the line was cut the width of
    the whole channel counts. Both is told. Of several layers of lines the one with a layer "<layer>_nodes" is read.

    *Coordinates* must be metres. Refused unless ``to_crs`` is given: a geographic CRS; another unit; a projection whose
    lengths are off by more than 5 % at the mean point, as Web Mercator's are beyond 17 degrees of latitude (from 1 % on
    it warns). Without pyproj only common geographic codes and EPSG:3857 are known. A GeoJSON without a "crs" member is
    longitude and latitude unless its numbers exceed 180 and 90; ``"crs": null`` means unknown. Numbers of unknown CRS
    are taken as metres with one exception: all within 360 and 90, while half or more of the lines are shorter than they
    are wide. That can only be degrees. Longitudes may run to 180 or to 360. Coordinates of a local system in another
    unit are scaled to metres, with a warning.

    A line of two points gets a third in its middle.

    Args:
        path: File name, or a list of file names.
        width: Bankfull width in m: one number, one a channel in file order, or one (n,) array a channel with a number
            for each point of the file; overrides the file. Channels whose number is None or NaN keep what they have.
        depth: Bankfull depth in m, in the same forms; overrides the file.
        discharge: Bankfull discharge in m3/s, one number or one a channel; overrides the file.
        missing_width: Bankfull width in m of channels for which neither the file nor ``width`` gives one and none
            follows from discharge or drainage area.
        layer: Layer of a GeoPackage; needed only where several hold lines.
        crs: CRS of a file that states none, or only in a .prj beside it, which is overruled.
        to_crs: CRS to reproject to: "EPSG:...", WKT, or "utm" for the WGS 84 / UTM zone of the mean point.
        dtype: Precision on the device, "float64" or "float32".
        device: Warp device name, "cpu" or "cuda:0".
        repeated: What to do about points that stand twice in a row: "drop" (the count is logged) or "error".
        short: What to do about channels shorter than they are wide, as linework has at junctions: "error", "drop"
            (leaves gaps in the network), "narrow" (the width becomes the length; depth and discharge stay those of the
            full width), or "keep". For files that ``write_network`` wrote "error" is "keep" unless ``width`` is given,
            since collisions leave such channels. Lines of no length are refused by "error" and left out by the others.
        topology: "file": channels are joined as the file says; "ends": where their ends meet.
        reverse: Turn all lines round, of a file whose lines run upstream.
        closed: Which channels are rings: those that the file marks (None), also every one whose first point is repeated
            at its end (True), or none (False).
        extra: Names of attributes to keep as free columns of the channels, in any case; by default those that
            ``write_network`` wrote as such.

    Returns:
        The network; its ``crs`` is "EPSG:..." where the authority has a code for it, else WKT, or None.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: The format, or ``to_crs``, needs a module that is not installed.
        ValueError: The file is empty, cut short, not of its format, has no lines, no width, no attribute that ``extra``
            names, or points that are not finite; several line layers and none named; a CRS unknown, not metric, or in
            conflict; or channels downstream that form a circle.
    """
    for name, value, choices in (
        ("repeated", repeated, REPEATED), ("short", short, SHORT), ("topology", topology, TOPOLOGIES),
    ):  # fmt: skip
        if value not in choices:
            raise InputError(f"{name} is {shown(value)}; use one of {', '.join(map(repr, choices))}")
    given_paths = [path] if isinstance(path, (str, os.PathLike)) else list(path)
    wrong = [p for p in given_paths if not isinstance(p, (str, os.PathLike))]
    if wrong:
        raise InputTypeError(f"path holds {shown(wrong[0])}; give a path, or a list of paths")
    paths = [Path(p) for p in given_paths]
    if not paths:
        raise InputError("no file to read: the list of paths is empty")
    given = {"width": width, "depth": depth, "discharge": discharge}
    wanted = tuple(role for role in ROLES if role not in given or has_gaps(given[role]))
    asked = None if extra is None else tuple(extra)
    sources = [_read_source(p, layer, wanted, asked) for p in paths]
    if short == "error" and width is None and all(source.ours for source in sources):
        short = "keep"
    label = str(paths[0]) if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more"
    found = _placed(sources, crs, to_crs)
    lines = [line for source in sources for line in source.lines]
    for source in sources:
        for line in source.lines if source.family.mean_flow else ():
            line.mean_flow = line.discharge is not None
    for role, numbers in given.items():
        if numbers is not None:
            override(lines, role, numbers)
    for line in lines if reverse else ():
        line.reverse()
    lines = drop_points(lines, short, label)
    fill_widths(lines, missing_width, label)
    clean(lines, repeated, label)
    fill_by_laws(lines)
    lines = settle_short(lines, short, found, label)
    joined = connect(lines, sources, topology, label)
    origin = _near_origin(sources[0], lines) if len(sources) == 1 else None
    place = {"origin": origin, "crs": found, "dtype": dtype, "device": device}
    try:
        network = _build(lines, sources, joined, closed, short == "keep", label, place)
    except ValueError as error:
        raise InputError(f"{label}: {error}") from error
    if not reverse:
        tell_direction(network, label)
    return network


def _placed(sources: list[Source], crs: CRSLike | None, to_crs: CRSLike | None) -> str | None:
    """Bring the lines of all files into one metric CRS, and return it."""
    for source in sources:
        source.crs, factor = settled_crs(source, crs)
        source.scale_place(factor)
    return one_crs(sources) if to_crs is None else reproject(sources, to_crs)


def _near_origin(source: Source, lines: list[Line]) -> tuple[float, float] | None:
    """Return the zero of the device coordinates that a file states, unless the lines were moved away from it since."""
    if source.origin is None:
        return None
    low = np.min([line.xy.min(axis=0) for line in lines], axis=0)
    high = np.max([line.xy.max(axis=0) for line in lines], axis=0)
    far = np.abs(0.5 * (low + high) - source.origin) > (high - low).sum() + 1.0
    return None if far.any() else source.origin


@public
def write_network(network: RiverNetwork, path: str | os.PathLike[str], *, layer: str = "channels") -> None:
    """Write channels to a file whose suffix names the format; ``read_network`` reads it back.

    GIS formats hold a LineString a channel with

    ================= ==== ===============================================================
    attribute         unit what
    ================= ==== ===============================================================
    channel_id        -    identity of the channel
    next_down         -    identity of the channel downstream; -1 for none
    from_node         -    node at the upstream end
    to_node           -    node at the downstream end
    length_m          m    length of the line
    sinuosity         -    length over the distance of the ends; empty for a ring
    width_m           m    bankfull width, the mean
    depth_m           m    bankfull depth, the mean
    discharge_m3s     m3/s bankfull discharge at the downstream end
    drainage_area_km2 km2  drainage area at the downstream end
    drainage_area_m2  m2   the same to the last bit; read first
    slope             m/m  drop over length; empty where it is not known
    closed            -    1 for a ring, whose line ends at its first point; else 0
    joint             -    2: its lower end is a locked point, 1: a through node; else 0
    strahler          -    Strahler order
    shreve            -    Shreve magnitude
    horton            -    Horton order
    main_stem         -    identity of the lowest channel of the stem (Hack) it belongs to
    point_width_m     m    a list, a number a point, where the width varies; see below
    point_depth_m     m    a list, a number a point, where the depth varies; see below
    ================= ==== ===============================================================

    Free columns of the channels become attributes of their names, elevations of the points (``point_z``) the third
    coordinate. Drainage areas, joints, orders and lists are left out where there are none; a network in which channels
    part or flow in a circle has no orders. Where several channels begin at a node, the one with most discharge is
    downstream.

    Every format gives back the same coordinates, widths, depths, discharges, drainage areas, slopes, identities, free
    columns and graph, to the bit, except shapefiles (see below); in text the width and depth of a channel are the means
    of its points'.

    *Where the section varies*, a GeoPackage has a layer of points, "<layer>_points", with channel_id, point (from 0),
    distance_m (along the channel), width_m and depth_m. GeoJSON and GeoParquet have lists of numbers, FlatGeobuf the
    same as JSON text. A shapefile has the means alone, with a warning.

    *GeoPackage.* A layer "<layer>_nodes" has the nodes as points, with node_id and kind (source, junction, outlet); the
    table ``layer_styles`` the style in which QGIS opens the layers. An existing file keeps its other layers, and styles
    that were saved there. It is written through SQLite: another program may have it open; while one writes, it is
    refused.

    *GeoJSON* keeps the coordinates as they are and names their CRS in a "crs" member, which GDAL and QGIS read (RFC
    7946 knows longitude and latitude only); an unknown CRS is ``"crs": null``. GeoJSON, GeoParquet and FlatGeobuf have
    the nodes in a member "warpriver", in which a GeoPackage too states the zero of the device coordinates (``origin``)
    and the free columns.

    *Text* has a row a point: channel_id, x, y, z where known, width_m, depth_m, discharge_m3s, drainage_area_m2 and
    slope where known, from_node, to_node and free columns, in digits that give back the same numbers. CRS, units,
    order, origin and the kinds of free columns stand in comments above them; in a .csv, whose first line other programs
    take for the names of the columns, in a last column "warpriver", once a channel. Nodes lie where the ends of their
    channels do, to within rounding.

    *Shapefile.* Names have at most 10 characters: dis_m3s, area_km2 and area_m2. Numbers have up to 15 decimals, as
    their fields have room for; coordinates may differ in the last bit, and short channels need ``short="keep"`` to be
    read. It does not say which attributes are free columns: name those in ``read_network(extra=)``.

    Names and words that a format cannot hold are refused.

    The file is written beside its place and then renamed, so that a failure leaves the old one as it was. A path is a
    path, whatever stands in it: none is taken for an archive or an address.

    Args:
        network: What to write.
        path: File name.
        layer: Name of the layer in a GeoPackage, and of the collection in GeoJSON.

    Raises:
        ImportError: The format needs a module that is not installed.
        OSError: The file cannot be written there, or another program is writing into it.
        ValueError: Unknown suffix, or a CRS or a free column that the format cannot hold.
    """
    path = Path(path)
    suffix = _suffix(path)
    check_extra(network.channels, path, suffix, text=suffix in TEXT)
    if suffix in NEEDS:
        write_features(network, path, layer)
        return
    with beside(path) as temporary:
        if suffix in TEXT:
            write_text(network, temporary, suffix)
        else:
            write_geojson(network, temporary, layer)


def check_network_file(path: str | os.PathLike[str]) -> None:
    """Raise what ``write_network`` would for a file that cannot be written: to be told before a network is computed.

    Args:
        path: File name.

    Raises:
        ImportError: The format needs a module that is not installed.
        OSError: No file can be written there.
        ValueError: Unknown suffix.
    """
    suffix = _suffix(Path(path))
    need(f"writing {suffix}", *NEEDS.get(suffix, ()))
    check_place(Path(path))


def _suffix(path: Path) -> str:
    """Return the lower-case suffix that names the format, without .gz, or raise ``ValueError``."""
    suffixes = [s.lower() for s in path.suffixes]
    packed = suffixes[-1:] == [".gz"]
    suffix = (suffixes[:-1] if packed else suffixes)[-1:]
    if not suffix or suffix[0] not in (PACKABLE if packed else SUFFIXES):
        raise InputError(f"{path}: {''.join(suffixes[-2:]) or 'no suffix'} names no format; known are {KNOWN}")
    return suffix[0]


def _read_source(path: Path, layer: str | None, wanted: Sequence[str], asked: Sequence[str] | None) -> Source:
    """Read one file; ``wanted`` are the roles to look for beyond the coordinates, ``asked`` names of free columns."""
    suffix = _suffix(path)
    check_readable(path)
    if layer is not None and suffix not in OGR:
        raise InputError(f"{path}: {suffix} has no layers; leave layer={layer!r} out")
    if suffix in TEXT:
        return read_text(path, wanted, asked)
    if suffix in JSON:
        return read_geojson(path, wanted, asked)
    if suffix in OGR:
        return read_ogr(path, suffix, layer, wanted, asked)
    return read_parquet(path, wanted, asked)


def _build(
    lines: list[Line],
    sources: list[Source],
    joined: Connections,
    closed: bool | None,
    allow_short: bool,
    label: str,
    place: dict[str, Any],
) -> RiverNetwork:
    """Make the network of lines that have all that one needs."""
    areas = [np.nan if line.drainage_area is None else line.drainage_area for line in lines]
    network = RiverNetwork.from_polylines(
        [line.xy for line in lines],
        width=[line.width for line in lines],
        depth=[line.depth for line in lines],
        discharge=[line.discharge for line in lines],
        drainage_area=None if np.isnan(areas).all() else areas,
        slope=[np.nan if line.slope is None else line.slope for line in lines],
        z=_elevations(lines, label),
        extra=extra_columns(sources, [line.extra for line in lines], label),
        channel_id=joined.channel_id,
        nodes=joined.nodes,
        closed=[_is_ring(line, closed) for line in lines],
        allow_short=allow_short,
        **place,
    )
    # A simulation keeps the width of a channel apart from those of its points: what the file says of it stands.
    stated: dict[str, Any] = {}
    for name in ("width", "depth"):
        means = [getattr(line, f"mean_{name}") for line in lines]
        known = [c for c, mean in enumerate(means) if mean is not None and mean > 0.0]
        if known:
            stated[name] = network.channels[name].copy()
            stated[name][known] = [means[c] for c in known]
    if any(line.joint for line in lines) and all(source.ours for source in sources):
        kinds = (JOINT_THROUGH, JOINT_LOCK)
        joint = np.array([int(line.joint) if line.joint in kinds else JOINT_NONE for line in lines])
        stated["joint"] = valid_joints(joint, network.channel_from, network.channel_to)
    return network.with_channels(network.channels.replace(**stated)) if stated else network


def _elevations(lines: list[Line], label: str) -> list[np.ndarray] | None:
    """Return the elevations of all points, None unless every point has one."""
    known = [line.z is not None and bool(np.isfinite(line.z).all()) for line in lines]
    if any(known) and not all(known):
        warn(f"{label}: {sum(known)} of {len(lines)} channels have elevations at all points; none is kept")
    return [line.z for line in lines if line.z is not None] if all(known) else None


def _is_ring(line: Line, closed: bool | None) -> bool:
    """Tell whether a line is a ring, as the argument ``closed`` of ``read_network`` has it."""
    marked = closed is not False and bool(line.closed)
    return marked or (closed is True and bool((line.xy[0] == line.xy[-1]).all()))
