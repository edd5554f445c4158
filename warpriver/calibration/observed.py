"""What two surveys of a river say of how it moved: even lines, displacements, and where they are to be believed."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FloatArray
from warpriver.calibration.courses import Lines
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.graph.stems import find_stems
from warpriver.metrics.changes import Match, match_lines
from warpriver.metrics.lines import arc_length_of, norm
from warpriver.network import RiverNetwork

__all__ = ["Observed", "Survey", "left_normals", "match_all", "observe", "survey"]

# Points a width along the lines.
POINTS_A_WIDTH = 3.0
# A line is shorter than this: no bend fits in, and no point is far enough from its ends.
SHORTEST_LINE = 30.0  # widths
# What is left out of the score: near the ends of a line, where what comes from upstream is not known, and on both
# sides of what was cut off, where a channel adjusts to its new course.
END_MARGIN, CUTOFF_MARGIN = 10.0, 6.0  # widths
# Widths of river at least of which the score is made.
LEAST_SCORED = 40.0
# The smoothing's kernel is cut off at so many standard deviations.
KERNEL_REACH = 5.0


@dataclasses.dataclass(frozen=True)
class Survey:
    """The rivers of a network as even, smoothed lines, each from a source to a mouth.

    Attributes:
        lines: The lines.
        channel: (N,) channel of the network that each point belongs to.
        crs: Coordinate reference system of the network, or None.
    """

    lines: Lines
    channel: NDArray[np.intp]
    crs: str | None

    def polylines(self) -> list[FloatArray]:
        """Return the lines, a list of (n, 2) arrays in m."""
        return np.split(self.lines.xy, self.lines.start[1:-1])


@dataclasses.dataclass(frozen=True)
class Observed:
    """How far the points of a survey had moved at a later one.

    Attributes:
        before: The first survey.
        years: Time between both, yr.
        displacement: (N,) displacement across the channel, m, > 0 to the left; nan where a point has no counterpart.
        normal: (N, 2) unit vectors across the channel, to the left.
        scored: (N,) bool, where the displacement is believed: away from cutoffs and from the ends of lines.
        after: The line of the later survey on which each line's counterpart lies, a list of (n, 2) arrays, m.
    """

    before: Survey
    years: float
    displacement: FloatArray
    normal: FloatArray
    scored: NDArray[np.bool_]
    after: list[FloatArray]

    def shifted(self, offset: FloatArray) -> Observed:
        """What would have been observed had the later survey lain elsewhere by minus the offset, (2,) m."""
        after = [xy - offset for xy in self.after]
        displacement = np.concatenate([match.distance for match in match_all(self.before.lines, after)])
        scored = self.scored & np.isfinite(displacement)
        return dataclasses.replace(self, displacement=displacement, scored=scored, after=after)


def survey(network: RiverNetwork, name: str, smoothing: float) -> Survey:
    """Return the rivers of a network as even lines.

    The channels of a stem make one line. It is sampled on the cubic through its points and smoothed by a Gaussian of
    so many mean widths, applied a second time to what it took away: that leaves bends as they are (a wave of ten
    widths loses a part in a thousand) and takes out the steps of pixels.

    Args:
        network: The network; rings are refused.
        name: What it is called in messages.
        smoothing: Standard deviation of the Gaussian in widths; 0: none.
    """
    if network.channel_closed.any():
        c = int(network.channel_id[np.flatnonzero(network.channel_closed)[0]])
        raise InputError(f"{name}: channel {c} is a ring; only rivers with two ends can be calibrated")
    polylines, widths, depths = network.polylines(), network.point_widths(), network.point_depths()
    parts = []
    for links in _stems(network):
        xy = np.concatenate([polylines[links[0]]] + [polylines[c][1:] for c in links[1:]])
        owner = np.repeat(links, [len(polylines[c]) - (c != links[0]) for c in links])
        width, depth = (np.concatenate([v[links[0]]] + [v[c][1:] for c in links[1:]]) for v in (widths, depths))
        mean = float(width.mean())
        if arc_length_of(xy)[-1] >= SHORTEST_LINE * mean:
            parts.append(_even(xy, width, depth, owner, mean, smoothing))
    if not parts:
        raise InputError(
            f"{name}: no river of it is {SHORTEST_LINE:g} widths long; join its channels at their ends, or check the "
            "width"
        )
    start = np.concatenate([[0], np.cumsum([len(part[0]) for part in parts])]).astype(np.int32)
    points, width, depth, channel = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Survey(Lines(start, points, width, depth), channel.astype(np.intp), network.crs)


def observe(before: Survey, after: Survey, years: float) -> Observed:
    """Return how far the points of a survey had moved at a later one.

    Raises:
        ValueError: The surveys have different systems, lie elsewhere, or run in opposite directions, or too little of
            the river can be told from cutoffs.
    """
    if before.crs is not None and after.crs is not None and before.crs != after.crs:
        raise InputError(f"before has the CRS {before.crs}, after {after.crs}; reproject one of them")
    lines = before.lines
    later = after.polylines()
    counterpart = [later[k] for k in _counterparts(before, after)]
    found = match_all(lines, counterpart)
    displacement = np.concatenate([match.distance for match in found])
    scored, margins = np.isfinite(displacement), lines.mean_width() / lines.spacing()
    for k in range(lines.count):
        part = slice(lines.start[k], lines.start[k + 1])
        scored[part] = _away_from_gaps(scored[part], margins[k])
    _check_overlap(before, after, displacement, scored)
    normal = np.concatenate([left_normals(xy) for xy in np.split(lines.xy, lines.start[1:-1])])
    return Observed(before, years, displacement, normal, scored, counterpart)


def match_all(lines: Lines, later: list[FloatArray]) -> list[Match]:
    """Return the counterparts of the points of each line on its later one."""
    earlier = np.split(lines.xy, lines.start[1:-1])
    return [match_lines(a, b) for a, b in zip(earlier, later, strict=True)]


def _stems(network: RiverNetwork) -> list[list[int]]:
    """The channels of each stem in downstream order."""
    stems = find_stems(network)
    found = []
    for top in np.flatnonzero(stems.upper < 0).tolist():
        links = [top]
        while stems.lower[links[-1]] >= 0:
            links.append(int(stems.lower[links[-1]]))
        found.append(links)
    return found


def _even(
    xy: FloatArray, width: FloatArray, depth: FloatArray, owner: NDArray[np.intp], mean: float, smoothing: float
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.intp]]:
    """Even points along a line, smoothed, with width, depth and channel."""
    with IMPORTING:
        from scipy.interpolate import CubicSpline

    s = arc_length_of(xy)
    count = max(8, round(POINTS_A_WIDTH * s[-1] / mean))
    # As many points between two of them that none of those given is passed over.
    fine = max(1, int(np.ceil((len(xy) - 1) / count)))
    t = np.linspace(0.0, s[-1], count * fine + 1)
    points = _smooth(CubicSpline(s, xy)(t), smoothing * mean / (s[-1] / (count * fine)))
    arc = arc_length_of(points)
    even = np.linspace(0.0, arc[-1], count + 1)
    points = CubicSpline(arc, points)(even)
    along = np.interp(even, arc, t)
    nearest = np.clip(np.searchsorted(s, along, side="right") - 1, 0, len(s) - 2)
    return points, np.interp(along, s, width), np.interp(along, s, depth), owner[nearest + 1]


def _smooth(points: FloatArray, sigma: float) -> FloatArray:
    """Points smoothed along the line; it is continued by its point reflection at both ends, which stay."""
    with IMPORTING:
        from scipy.ndimage import gaussian_filter1d

    if sigma < 0.2:
        return points
    reach = min(int(np.ceil(2.0 * KERNEL_REACH * sigma)), len(points) - 1)
    head = 2.0 * points[0] - points[reach:0:-1]
    foot = 2.0 * points[-1] - points[-2 : -reach - 2 : -1]
    wide = np.concatenate([head, points, foot])
    once = gaussian_filter1d(wide, sigma, axis=0, truncate=KERNEL_REACH)
    twice = once + gaussian_filter1d(wide - once, sigma, axis=0, truncate=KERNEL_REACH)
    smooth = np.asarray(twice[reach : reach + len(points)])
    smooth[[0, -1]] = points[[0, -1]]
    return smooth


def _counterparts(before: Survey, after: Survey) -> list[int]:
    """The later line that most points of each line are nearest to."""
    with IMPORTING:
        from scipy.spatial import cKDTree

    nearest = cKDTree(after.lines.xy).query(before.lines.xy)[1]
    votes = np.split(after.lines.owner()[nearest], before.lines.start[1:-1])
    return [int(np.bincount(each).argmax()) for each in votes]


def _away_from_gaps(found: NDArray[np.bool_], points_a_width: float) -> NDArray[np.bool_]:
    """Points that are far enough from those without a counterpart, and from the ends."""
    with IMPORTING:
        from scipy.ndimage import binary_erosion

    margin = int(np.ceil(CUTOFF_MARGIN * points_a_width))
    kept = np.asarray(binary_erosion(found, np.ones(2 * margin + 1, bool), border_value=1))
    end = int(np.ceil(END_MARGIN * points_a_width))
    kept[:end] = kept[len(kept) - end :] = False
    return kept


def left_normals(xy: FloatArray) -> FloatArray:
    """Unit vectors across a line to the left at its points, (n, 2)."""
    chord = np.gradient(xy, axis=0)
    return np.asarray(np.stack([-chord[:, 1], chord[:, 0]], axis=1) / norm(chord)[:, None])


def _check_overlap(before: Survey, after: Survey, displacement: FloatArray, scored: NDArray[np.bool_]) -> None:
    """Raise ``ValueError`` where two surveys do not show the same river."""
    lines = before.lines
    in_widths = (lines.spacing() / lines.mean_width())[lines.owner()]
    if float(in_widths[scored].sum()) >= LEAST_SCORED:
        return
    (w, s), (e, n) = lines.xy.min(axis=0), lines.xy.max(axis=0)
    (w2, s2), (e2, n2) = after.lines.xy.min(axis=0), after.lines.xy.max(axis=0)
    if w2 > e or w > e2 or s2 > n or s > n2:
        reason = (
            f"they do not overlap: before lies within x {w:.0f} to {e:.0f}, y {s:.0f} to {n:.0f}, after within x "
            f"{w2:.0f} to {e2:.0f}, y {s2:.0f} to {n2:.0f}; check their coordinate systems"
        )
    elif _found_upstream(before, after) > 2.0 * np.isfinite(displacement).mean():
        reason = "they run in opposite directions; reverse one of them"
    else:
        reason = (
            f"only {float(in_widths[scored].sum()):.0f} widths of river lie away from its ends and from cutoffs, and "
            f"{LEAST_SCORED:g} are needed; give a longer reach, or surveys that are closer in time"
        )
    raise InputError(f"before and after cannot be compared: {reason}")


def _found_upstream(before: Survey, after: Survey) -> float:
    """Part of the points that had a counterpart if the later survey ran the other way."""
    later = [xy[::-1] for xy in after.polylines()]
    found = match_all(before.lines, [later[k] for k in _counterparts(before, after)])
    return float(np.isfinite(np.concatenate([match.distance for match in found])).mean())
