"""Stems: at each junction the larger tributary and the channel downstream are one river."""

from __future__ import annotations

import dataclasses

import numpy as np

from warpriver.channel_table import JOINT_NONE
from warpriver.network import RiverNetwork

__all__ = ["Stems", "find_stems"]


@dataclasses.dataclass(frozen=True)
class Stems:
    """Which channels follow each other as the links of one river, from a source to a mouth.

    Attributes:
        upper: (C,) int32, the link upstream of each channel, -1 where it begins at a source.
        lower: (C,) int32, the link downstream, -1 where the channel ends at an outlet, or at the mouth of a tributary.
        top: (C,) int32, the first link of each channel's stem, itself where there is none upstream.
        bottom: (C,) int32, the last link of each channel's stem.
    """

    upper: np.ndarray
    lower: np.ndarray
    top: np.ndarray
    bottom: np.ndarray


def find_stems(network: RiverNetwork, alone: np.ndarray | None = None, *, through_only: bool = False) -> Stems:
    """Return the stems of a network: at a junction the tributary with the most discharge, of equal ones the first.

    Rings are stems of their own. A stem ends where channels part, and where they flow in a circle.

    Args:
        network: The network.
        alone: (C,) bool, further channels that are stems of their own; none by default.
        through_only: Stems go on at through nodes and locked points alone, and end at junctions.
    """
    count, nodes = network.channel_count, network.node_count
    lines = np.flatnonzero(~network.channel_closed)
    order = lines[np.lexsort((lines, -network.channel_discharge[lines], network.channel_to[lines]))]
    foot, first = np.unique(network.channel_to[order], return_index=True)
    largest = np.full(nodes, -1)
    largest[foot] = order[first]
    largest[np.bincount(network.channel_from[lines], minlength=nodes) != 1] = -1
    upper, lower = np.full(count, -1), np.full(count, -1)
    upper[lines] = largest[network.channel_from[lines]]
    if through_only:
        upper[network.channel_joint[upper] == JOINT_NONE] = -1
    if alone is not None:
        upper[alone | alone[upper]] = -1
    joined = np.flatnonzero(upper >= 0)
    lower[upper[joined]] = joined
    in_circle = upper[_last_along(upper)] >= 0
    upper[in_circle] = lower[in_circle] = -1
    links = upper, lower, _last_along(upper), _last_along(lower)
    return Stems(*(each.astype(np.int32) for each in links))


def _last_along(following: np.ndarray) -> np.ndarray:
    """Last channel that each one leads to; any one of a circle. By doubling: after k rounds 2^k channels farther."""
    last = np.where(following >= 0, following, np.arange(len(following)))
    for _ in range(len(following).bit_length()):
        last = last[last]
    return last
