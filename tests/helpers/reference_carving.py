"""Carving in NumPy, cell by cell over all segments: the twin of ``kernels/carving.py``."""

import numpy as np

HEAD, FOOT = 1, 2


def falling(part):
    p = np.clip(part, 0.0, 1.0)
    return 1.0 - p * p * (3.0 - 2.0 * p)


def at(pair, part):
    return pair[:, 0] + part * (pair[:, 1] - pair[:, 0])


def row_depth(section, row, y):
    places = section.shape[1] - 1
    k = np.clip(y, 0.0, 1.0) * places
    low = np.minimum(k.astype(int), places - 1)
    return section[row, low] + (k - low) * (section[row, low + 1] - section[row, low])


def form_depth(seg, section, part, y):
    weight = at(seg["part"], part)
    a, b = row_depth(section, seg["row"][:, 0], y), row_depth(section, seg["row"][:, 1], y)
    return a + weight * (b - a)


def section_depths(seg, section, xy, cell):
    """Depth of the section of each segment at a place, (S,)."""
    along, offset = seg["last"] - seg["first"], xy - seg["first"]
    length = np.hypot(*along.T)
    side = (along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / length
    before = (offset * seg["first_tangent"]).sum(axis=1)
    behind = ((seg["last"] - xy) * seg["last_tangent"]).sum(axis=1)
    out = (before < 0.0) & (seg["ends"] & HEAD == 0) | (behind < 0.0) & (seg["ends"] & FOOT == 0)
    u, v = np.maximum(before, 0.0), np.maximum(behind, 0.0)
    part = u / np.maximum(u + v, 1e-30)
    half = at(seg["half"], part)
    capped = (before < 0.0) | (behind < 0.0)
    round_off = np.where(behind < 0.0, np.hypot(*(seg["last"] - xy).T), np.hypot(*offset.T))
    away = np.where(capped, round_off, np.abs(side))
    lean = np.where(capped, np.abs(side) / np.maximum(away, 1e-30), 1.0)
    across = np.abs(along).sum(axis=1) / length
    core = 0.5 * across * cell * falling((half / cell - 2.5) / 3.5)
    o = 0.5 * np.maximum(away - core, 0.0) / np.maximum(half - core, 1e-30)
    o = np.where(side > 0.0, -o, o)
    form = 0.5 * (
        (1.0 + lean) * form_depth(seg, section, part, 0.5 + o) + (1.0 - lean) * form_depth(seg, section, part, 0.5 - o)
    )
    return np.where(out | (away >= half), 0.0, at(seg["depth"], part) * form)


def water_at(seg, section, xy, cell):
    """Level (NaN out of reach), cut, depth, and the weights of bank and wall at a place."""
    along, offset = seg["last"] - seg["first"], xy - seg["first"]
    part = np.clip((offset * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    away = np.hypot(*(offset - part[:, None] * along).T)
    reach, half, bank = (at(seg[name], part) for name in ("reach", "half", "bank"))
    near = away < reach
    if not near.any():
        return np.nan, 0.0, 0.0, 0.0, 0.0
    weight = (1.0 - (away / reach) ** 2) ** 2 / (1.0 + (away / (0.35 * bank)) ** 2) ** 4
    weight = np.where(near, weight * np.minimum(np.hypot(*along.T), bank), 0.0)
    level, cut = ((weight * at(seg[name], part)).sum() / weight.sum() for name in ("level", "cut"))
    inside = near & (away < half + cell)
    depth = np.where(inside, section_depths(seg, section, xy, cell), 0.0).max()
    bank = np.where(near, falling((away - half) / (bank - half)), 0.0).max()
    wall = np.where(near, falling((away - half) / (reach - half)), 0.0).max()
    return level, cut, depth, *((1.0, 1.0) if depth > 0.0 else (bank, wall))


def carved_height(height, level, cut, depth, bank, wall, max_cut):
    over = height - level
    walled = np.clip(over, -cut, cut)
    lowered = wall * walled + bank * (over - walled)
    return height - np.where(depth > 0.0, lowered, np.minimum(lowered, max_cut)) - depth


def materials(depth, bank, wall, steepness, change):
    """(bed, bank, wall) in 255ths of a cell; ``steepness``: slope over that of the angle of repose."""

    def rising(p):
        return 1.0 - falling(p)

    bed = 255.0 if depth > 0.0 else 0.0
    walls = np.floor((255.0 - bed) * wall * rising(2.0 * abs(change)) * rising((steepness - 0.35) / 0.5) + 0.5)
    return bed, np.floor((255.0 - bed - walls) * bank + 0.5), walls
