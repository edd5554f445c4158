"""Geometry of bands: lines refined, offset by their width, and outlined as paths that can be filled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["Window", "band_outlines", "bank_lines", "meet_window", "refine_lines", "select_inside", "taper_ends"]

Window = tuple[float, float, float, float]  # west, south, east, north in m

# The codes of matplotlib.path.Path.
MOVE, LINE, CLOSE = 1, 2, 79

# A disc of this many sides stands at channel ends, sharp corners and where a bank folds.
DISC_SIDES = 24


def refine_lines(
    lines: Sequence[np.ndarray], widths: Sequence[np.ndarray], step: float
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Add points along Catmull-Rom curves until they stand about ``step`` m apart, up to eightfold.

    Args:
        lines: (n, 2) points of each channel, m.
        widths: (n,) width at each point, m.
        step: Wanted spacing, m.

    Returns:
        The lines and widths, unchanged where they are dense enough.
    """
    counts = np.array([len(xy) for xy in lines])
    xy, width = np.concatenate(lines), np.concatenate(widths)
    start = np.concatenate([[0], np.cumsum(counts)])
    first = np.arange(len(xy))
    segment = np.delete(first, start[1:] - 1)
    spacing = np.median(np.hypot(*(xy[segment + 1] - xy[segment]).T))
    pieces = int(np.clip(np.ceil(spacing / step), 1, 8))
    if pieces == 1:
        return list(lines), list(widths)
    owner = np.repeat(np.arange(len(counts)), counts)[segment]
    b, c = xy[segment], xy[segment + 1]
    at_head, at_tail = segment == start[owner], segment + 2 == start[owner + 1]
    a = np.where(at_head[:, None], 2.0 * b - c, xy[segment - 1])
    d = np.where(at_tail[:, None], 2.0 * c - b, xy[np.minimum(segment + 2, len(xy) - 1)])
    t = (np.arange(pieces) / pieces)[None, :, None]
    a, b, c, d = (p[:, None, :] for p in (a, b, c, d))
    curve = 0.5 * (2.0 * b + t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a))))
    blend = width[segment, None] + t[..., 0] * (width[segment + 1] - width[segment])[:, None]
    new_counts = (counts - 1) * pieces + 1
    new_start = np.concatenate([[0], np.cumsum(new_counts)])
    slot = (new_start[owner] + (segment - start[owner]) * pieces)[:, None] + np.arange(pieces)
    new_xy, new_width = np.empty((new_start[-1], 2)), np.empty(new_start[-1])
    new_xy[slot], new_width[slot] = curve, blend
    new_xy[new_start[1:] - 1], new_width[new_start[1:] - 1] = xy[start[1:] - 1], width[start[1:] - 1]
    return np.split(new_xy, new_start[1:-1]), np.split(new_width, new_start[1:-1])


def bank_lines(lines: Sequence[np.ndarray], widths: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset all lines by half their width to either side, along mitred normals.

    Args:
        lines: (n, 2) points of each channel, m.
        widths: (n,) width at each point, m.

    Returns:
        The left and the right bank, each (P, 2) in m for the packed points, and a (P,) mask of the points
        where a round joint is needed: channel ends, sharp corners, and bends tighter than the half width.
    """
    counts = np.array([len(xy) for xy in lines])
    last = np.cumsum(counts) - 1
    first = last - counts + 1
    xy, half = np.concatenate(lines), 0.5 * np.concatenate(widths)
    ahead = np.empty_like(xy)
    ahead[:-1] = np.diff(xy, axis=0)
    ahead[last] = ahead[last - 1]
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-12)[:, None]
    behind = np.roll(ahead, 1, axis=0)
    behind[first] = ahead[first]
    along = ahead + behind
    size = np.hypot(*along.T)
    along = np.where((size > 1e-6)[:, None], along / np.maximum(size, 1e-6)[:, None], ahead)
    cosine = np.sum(along * ahead, axis=1)
    sharp = cosine < 0.9
    reach = (half / np.where(sharp, 1.0, cosine))[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1)
    left, right = xy + reach, xy - reach
    forward = np.minimum(
        np.sum(np.diff(left, axis=0) * ahead[:-1], axis=1),
        np.sum(np.diff(right, axis=0) * ahead[:-1], axis=1),
    )
    folded = forward <= 0.0
    folded[last[:-1]] = False
    round_joint = sharp
    round_joint[:-1] |= folded
    round_joint[1:] |= folded
    round_joint[first] = True
    round_joint[last] = True
    return left, right, round_joint


def band_outlines(
    lines: Sequence[np.ndarray], widths: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outline every channel at its width, as paths to be filled by the non-zero winding rule.

    The outline of a channel is its two banks and a disc at either end. Where a corner is sharp, or the inner
    bank of a tight bend folds over itself, discs and boxes keep the winding number positive, so that the
    filled shape is the true buffer of the line.

    Args:
        lines: (n, 2) points of each channel, m.
        widths: (n,) width at each point, m.

    Returns:
        Vertices (V, 2) in m, matplotlib path codes (V,), and the offsets (C + 1,) that cut both by channel.
    """
    left, right, joint = bank_lines(lines, widths)
    xy, half = np.concatenate(lines), 0.5 * np.concatenate(widths)
    counts = np.array([len(line) for line in lines])
    start = np.concatenate([[0], np.cumsum(counts)])
    owner = np.repeat(np.arange(len(counts)), counts)
    joints = np.flatnonzero(joint)
    inner = np.setdiff1d(joints, np.concatenate([start[:-1], start[1:] - 1]))
    boxed = np.union1d(inner - 1, inner)

    angle = 2.0 * np.pi * np.arange(DISC_SIDES) / DISC_SIDES
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    discs = xy[joints, None] + half[joints, None, None] * circle
    boxes = _segment_boxes(xy, half, boxed)
    pieces = np.concatenate([owner[joints], owner[boxed]])
    sides = np.concatenate([np.full(len(joints), DISC_SIDES), np.full(len(boxed), 4)]) + 1
    extra = np.bincount(pieces, weights=sides, minlength=len(counts)).astype(np.int64)
    offset = np.concatenate([[0], np.cumsum(2 * counts + 1 + extra)])

    vertices = np.zeros((offset[-1], 2))
    codes = np.full(offset[-1], LINE, np.uint8)
    inside = np.arange(len(owner)) - start[owner]
    vertices[offset[owner] + inside] = right
    vertices[offset[owner] + 2 * counts[owner] - 1 - inside] = left
    close = offset[:-1] + 2 * counts
    codes[offset[:-1]], codes[close] = MOVE, CLOSE
    # The pieces of each channel follow its outline, one after the other.
    order = np.argsort(pieces, kind="stable")
    before = np.cumsum(sides[order]) - sides[order]
    before -= (np.cumsum(extra) - extra)[pieces[order]]
    first = np.empty(len(pieces), np.int64)
    first[order] = close[pieces[order]] + 1 + before
    for begin, shapes in ((first[: len(joints)], discs), (first[len(joints) :], boxes)):
        corners = shapes.shape[1]
        vertices[begin[:, None] + np.arange(corners)] = shapes
        codes[begin], codes[begin + corners] = MOVE, CLOSE
    return vertices, codes, offset


def _segment_boxes(xy: np.ndarray, half: np.ndarray, segment: np.ndarray) -> np.ndarray:
    """Return the corners (n, 4, 2) of the bands of single segments, counter-clockwise."""
    step = xy[segment + 1] - xy[segment]
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.maximum(np.hypot(*step.T), 1e-12)[:, None]
    a, b = half[segment, None] * normal, half[segment + 1, None] * normal
    return np.stack([xy[segment] - a, xy[segment + 1] - b, xy[segment + 1] + b, xy[segment] + a], axis=1)


def taper_ends(xy: np.ndarray, width: float) -> np.ndarray:
    """Return the width along an abandoned loop in m; it closes over the last 1.5 widths, where plugs form."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    to_end = np.minimum(s, s[-1] - s) / (1.5 * width)
    half: np.ndarray = width * (0.15 + 0.85 * np.sqrt(np.clip(to_end, 0.0, 1.0)))
    return half


def select_inside(
    lines: Sequence[np.ndarray], widths: Sequence[np.ndarray], window: Window
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Keep the channels whose bounding box meets the window (m)."""
    kept = np.flatnonzero(meet_window(lines, widths, window)).tolist()
    return [lines[k] for k in kept], [widths[k] for k in kept]


def meet_window(lines: Sequence[np.ndarray], widths: Sequence[np.ndarray], window: Window) -> np.ndarray:
    """Tell whether the bounding box of each channel meets the window (m), (C,) bool."""
    if not len(lines):
        return np.zeros(0, bool)
    first = np.concatenate([[0], np.cumsum([len(xy) for xy in lines[:-1]], dtype=np.int64)])
    xy, width = np.concatenate(lines), np.concatenate(widths)
    reach = 0.5 * np.maximum.reduceat(width, first)[:, None]
    low, high = np.minimum.reduceat(xy, first) - reach, np.maximum.reduceat(xy, first) + reach
    return np.asarray(np.logical_and(low <= window[2:], high >= window[:2]).all(axis=1))
