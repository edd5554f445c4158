"""Lines of files made fit for a network: widths that are missing, points that repeat, lines that are too short."""

from __future__ import annotations

import logging
import operator
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from warpriver.errors import InputError, warn
from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge, channel_width, width_of_discharge
from warpriver.io.crs import within_degrees
from warpriver.io.vector.source import Line
from warpriver.validate import floats, positive

__all__ = ["SHORT", "clean", "drop_points", "fill_by_laws", "fill_widths", "has_gaps", "override", "settle_short"]

log = logging.getLogger("warpriver")

SHORT = ("error", "drop", "narrow", "keep")
# A channel narrowed to its length: a hair less, so that rounding in a file does not make it wider again.
NARROWED = 1.0 - 1e-6
# So many of the lines may have no width that anything tells, and get one from the others.
FEW = 0.5

# A number for all channels, or one a channel, or an array a channel with a number a point; None and NaN leave it to the
# file.
PerChannel: TypeAlias = "float | Sequence[float | np.ndarray | None] | np.ndarray"


def has_gaps(value: PerChannel | None) -> bool:
    """Tell whether an argument leaves channels, by None or NaN, to what the file says."""
    if value is None:
        return True
    return _is_many(value) and any(_is_gap(item) for item in value)  # type: ignore[union-attr]


def _is_many(value: PerChannel) -> bool:
    return isinstance(value, (list, tuple)) or np.ndim(value) != 0  # type: ignore[arg-type]


def _is_gap(item: object) -> bool:
    return item is None or (isinstance(item, (float, np.floating)) and bool(np.isnan(item)))


def override(lines: list[Line], name: str, value: PerChannel) -> None:
    """Set width, depth or discharge of the lines from an argument, but where it leaves them to the file."""
    many = _is_many(value)
    values = list(value) if many else [value] * len(lines)  # type: ignore[arg-type]
    if len(values) != len(lines):
        raise InputError(f"{name}: {len(values)} values for {len(lines)} channels; give one number or one a channel")
    for c, (line, item) in enumerate(zip(lines, values, strict=True)):
        if many and _is_gap(item):
            continue
        array = floats(item, f"{name} of channel {c}", "one number, or one a point").copy()
        if array.ndim and (name == "discharge" or array.shape != (len(line.xy),)):
            fits = "one number" if name == "discharge" else f"one number or ({len(line.xy)},)"
            raise InputError(f"{name} of channel {c}: shape {array.shape} for {len(line.xy)} points; give {fits}")
        setattr(line, name, array)
        if name == "discharge":
            line.mean_flow = False
        if name in ("width", "depth"):
            setattr(line, f"mean_{name}", None)
            line.lists = tuple(other for other in line.lists if other != name)


def fill_widths(lines: list[Line], missing_width: float | None, label: str) -> None:
    """Give every line a width: that of its discharge or drainage area, or else ``missing_width``, and say so.

    Args:
        lines: All channels.
        missing_width: Width in m where nothing tells one; None: that of the narrowest of the others, if they are most.
        label: What to call the files in messages.

    Raises:
        ValueError: Lines without a width, and nothing to give them one.
    """
    if missing_width is not None:
        positive(missing_width, "missing_width", "m")
    _infer_widths(lines, label)
    missing = [line for line in lines if line.width is None]
    if missing and missing_width is None:
        if len(missing) == len(lines):
            raise InputError(f"{label}: the file gives no width; pass width= (bankfull width in m)")
        if len(missing) > FEW * len(lines):
            raise InputError(
                f"{missing[0].where}: no width ({len(missing)} of {len(lines)} lines have none); pass missing_width= "
                "(m) for those, or width= for all"
            )
        missing_width = min(float(np.min(line.width)) for line in lines if line.width is not None)
        warn(
            f"{label}: {len(missing)} of {len(lines)} channels have no width, discharge or drainage area (the first: "
            f"{missing[0].where.rpartition(', ')[2]}) and get {missing_width:.3g} m, the width of the narrowest. Pass "
            "missing_width= if you know better"
        )
    for line in missing:
        line.width = missing_width


def _infer_widths(lines: list[Line], label: str) -> None:
    """Give lines without a width that of their discharge or drainage area, and say so.

    The relation of width and discharge holds for bankfull discharges, so a drainage area comes before a mean one.
    """
    counts = {"bankfull discharge by w = 7.2 Q^0.5": 0, "drainage area by w = c A^0.5": 0}
    bankfull, area = counts
    mean = "long-term mean discharge by w = 7.2 Q^0.5, which makes them too narrow"
    counts[mean] = 0
    bare = [line for line in lines if line.width is None]
    for line in bare:
        if line.discharge is not None and not line.mean_flow:
            relation, line.width = bankfull, float(width_of_discharge(line.discharge))
        elif line.drainage_area:
            relation, line.width = area, float(channel_width(line.drainage_area))
        elif line.discharge is not None:
            relation, line.width = mean, float(width_of_discharge(line.discharge))
        else:
            continue
        counts[relation] += 1
    if found := {relation: count for relation, count in counts.items() if count}:
        relations = " and ".join(f"{count} from the {relation}" for relation, count in found.items())
        warn(
            f"{label}: {sum(found.values())} of {len(lines)} channels have no width; inferred {relations}. Pass width= "
            "if you know better"
        )


def drop_points(lines: list[Line], short: str, label: str) -> list[Line]:
    """Return the lines without those of no length, which are told, or refused where ``short`` is "error"."""
    empty = [line for line in lines if (line.xy == line.xy[0]).all()]
    if not empty:
        return lines
    text = f"no length, only one distinct point ({len(empty)} of {len(lines)} lines are like that)"
    if short == "error" or len(empty) == len(lines):
        advice = "" if len(empty) == len(lines) else "; pass short='drop' to leave such lines out"
        raise InputError(f"{empty[0].where}: {text}{advice}")
    if short == "drop":
        log.info("%s: %s; dropped", label, text)
    else:
        warn(f"{empty[0].where}: {text}; they are left out")
    return [line for line in lines if not (line.xy == line.xy[0]).all()]


def clean(lines: list[Line], repeated: str, label: str) -> None:
    """Remove points that stand twice in a row, and give lines of two points a third."""
    dropped = added = 0
    for line in lines:
        same = (np.diff(line.xy, axis=0) == 0.0).all(axis=1)
        if same.any():
            k = int(same.argmax())
            if repeated == "error":
                raise InputError(
                    f"{line.where}: points {k} and {k + 1} are both at ({line.xy[k, 0]:g}, "
                    f"{line.xy[k, 1]:g}); remove one, or pass repeated='drop'"
                )
            dropped += int(same.sum())
            line.map_points(operator.itemgetter(np.concatenate([[True], ~same])))
        if len(line.xy) == 2:
            added += 1
            line.map_points(lambda a: np.stack([a[0], 0.5 * (a[0] + a[1]), a[1]]))
    if dropped:
        log.info("%s: %d points that stood twice in a row were dropped", label, dropped)
    if added:
        log.info("%s: %d lines of two points got a third in the middle", label, added)


def fill_by_laws(lines: list[Line]) -> None:
    """Set depth and discharge from the width where neither file nor argument gives them.

    Beside long-term mean discharges a missing one is that of the width, scaled as those of the other lines are, so that
    no network mixes mean and bankfull discharges.
    """
    # From arrays, as from_polylines has it: powers of single numbers differ from those in the last bit.
    with np.errstate(invalid="ignore"):  # a width below zero is told by from_polylines
        flows = bankfull_discharge(np.array([np.mean(line.width) for line in lines]))
        means = [line.discharge / flow for line, flow in zip(lines, flows, strict=True) if line.mean_flow]
        scale = float(np.median(means)) if means else 1.0
        for line, flow in zip(lines, flows, strict=True):
            if line.depth is None:
                line.depth = bankfull_depth(np.broadcast_to(line.width, len(line.xy)).copy())
            if line.discharge is None:
                line.discharge = flow * scale


def settle_short(lines: list[Line], short: str, crs: str | None, label: str) -> list[Line]:
    """Deal with lines that are shorter than they are wide, as the argument ``short`` says."""
    lengths = [float(np.hypot(*np.diff(line.xy, axis=0).T).sum()) for line in lines]
    wide = [bool(np.max(line.width) > length) for line, length in zip(lines, lengths, strict=True)]
    count = sum(wide)
    if not count or short == "keep":
        return lines
    if crs is None and 2 * count >= len(lines) and within_degrees(lines, 360.0):
        raise InputError(
            f"{label}: x and y look like longitude and latitude (within 360 and 90, lines shorter than wide) "
            'and no CRS is stated; pass crs="EPSG:4326" and to_crs="utm", or check the unit of the width'
        )
    if short == "error" or count == len(lines):
        first = wide.index(True)
        advice = "" if count == len(lines) else ", or pass short='narrow', 'drop' or 'keep'"
        raise InputError(
            f"{lines[first].where}: {lengths[first]:g} m long but {np.max(lines[first].width):g} m wide "
            f"({count} of {len(lines)} lines are like that); check the units of both{advice}"
        )
    log.info("%s: %d of %d lines are shorter than wide; short=%r", label, count, len(lines), short)
    if short == "drop":
        return [line for line, w in zip(lines, wide, strict=True) if not w]
    for line, w, length in zip(lines, wide, lengths, strict=True):
        if w:
            line.width, line.mean_width = np.minimum(line.width, NARROWED * length), None
    return lines
