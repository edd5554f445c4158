"""Traces of events: old courses and crevasse lobes as segments that are laid onto the cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from warpriver.extras import IMPORTING
from warpriver.history.events import Collision, Crevasse
from warpriver.hydraulic_geometry import bankfull_depth
from warpriver.kernels.covers import BANK
from warpriver.landscape.splatting import Segments
from warpriver.network import RiverNetwork

__all__ = ["lobes_of", "old_courses_of"]

# A lobe widens from the breach to its front, both in widths of the channel, and thins to so much of its height.
BREACH_WIDTH, FRONT_WIDTH, FRONT_PART, LOBE_SEGMENTS = 0.5, 3.0, 0.4, 6


def old_courses_of(events: Sequence[Any]) -> Segments:
    """Return the courses that cutoffs, collisions and avulsions left, with the distance of each point from its ends."""
    lines, sections, times = [], [], []
    for event in events:
        pieces = event.pieces() if isinstance(event, Collision) else [event.xy]
        along = event.section
        if along is None:
            depth = event.depth if event.depth is not None else float(bankfull_depth(event.width))
            along = np.tile([event.width, depth], (len(event.xy), 1))
        parts = np.split(along, event.start[1:-1]) if isinstance(event, Collision) else [along]
        for xy, section in zip(pieces, parts, strict=True):
            if len(xy) > 1:
                lines.append(xy)
                sections.append(section)
                times.append(event.time)
    if not lines:
        return nothing()
    count = np.array([len(line) for line in lines])
    start = np.concatenate([[0], np.cumsum(count)])
    xy, section = np.concatenate(lines), np.concatenate(sections)
    head = np.delete(np.arange(start[-1]), start[1:] - 1)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    owner = np.repeat(np.arange(len(lines)), count)
    from_end = np.minimum(arc - arc[start[owner]], arc[start[owner + 1] - 1] - arc) / section[:, 0]
    pair = (head, head + 1)
    return Segments(
        np.hstack([xy[k] for k in pair]),
        np.hstack([section[k] for k in pair]),
        np.stack([from_end[k] for k in pair], axis=1),
        np.zeros((len(head), 2)),
        np.array(times)[owner[head]],
        np.zeros((len(head), 2)),
    )


def lobes_of(events: Sequence[Crevasse], network: RiverNetwork, length: float, height: float) -> Segments:
    """Return the lobes of crevasses: segments from the breach outward that widen and thin.

    Args:
        events: The crevasses.
        network: The channels at the record before, which tell the direction of the bank.
        length: How far a lobe reaches from the bank, in widths.
        height: Its thickness at the bank, in depths.
    """
    if not events or length == 0.0 or height == 0.0:
        return nothing()
    with IMPORTING:
        from scipy.spatial import cKDTree

    xy, start = network.points(), network.starts()
    nearest = cKDTree(xy).query([(event.x, event.y) for event in events])[1]
    owner = np.searchsorted(start, nearest, side="right") - 1
    first, last = np.maximum(nearest - 1, start[owner]), np.minimum(nearest + 1, start[owner + 1] - 1)
    along = xy[last] - xy[first]
    along /= np.maximum(np.hypot(*along.T), 1e-12)[:, None]
    side = np.sign([event.curvature for event in events])[:, None]
    # Outward: to the right where the channel turns left.
    out = side * np.stack([along[:, 1], -along[:, 0]], axis=1)
    width = np.array([event.width for event in events])
    part = np.linspace(0.0, 1.0, LOBE_SEGMENTS + 1)
    place = np.array([(event.x, event.y) for event in events])
    away = width[:, None] * (BANK + length * part)
    line = place[:, None, :] + away[..., None] * out[:, None, :]
    wide = width[:, None] * (BREACH_WIDTH + (FRONT_WIDTH - BREACH_WIDTH) * np.sqrt(part))
    thick = height * bankfull_depth(width)[:, None] * (1.0 + (FRONT_PART - 1.0) * part)
    ends = (slice(None, -1), slice(1, None))
    segments = np.concatenate([line[:, k] for k in ends], axis=2).reshape(-1, 4)
    sections = np.stack([v[:, k] for k in ends for v in (wide, thick)], axis=2).reshape(-1, 4)
    time = np.repeat([event.time for event in events], LOBE_SEGMENTS)
    bend, moved, sag = np.zeros((3, len(segments), 2))
    return Segments(segments, sections, bend, moved, time, sag)


def nothing() -> Segments:
    """Return no segments."""
    line, section, *pairs = np.empty((0, 4)), np.empty((0, 4)), *np.empty((3, 0, 2))
    return Segments(line, section, pairs[0], pairs[1], np.empty(0), pairs[2])
