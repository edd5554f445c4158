"""What a record holds for the steps to go on from, checked before any of it reaches a kernel."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from warpriver.engine.state import NARROWEST, SHALLOWEST, WANTED, WIDEST
from warpriver.errors import InputError
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams, PathMeander

__all__ = ["SavedError", "check_saved"]

# Factor by which widths, depths and target spacings may differ from those of the network: they are older than it.
SCALE = 1e3
# Factor by which the length of a channel may differ from its spacing times its segments, and a spacing from its target.
LENGTH_SCALE = 10.0
# Identities at most that channels younger than all of the network had, which are gone.
MAX_GONE = 10**7


class SavedError(InputError):
    """A record that does not have what its run needs to go on."""

    def __init__(self, name: str, record: str = "its record"):
        """Name what is wrong with a record."""
        super().__init__(
            f"the run cannot go on from {record}: {name} is missing or damaged; resume from a copy of the run"
        )


def check_saved(
    network: RiverNetwork, params: MeanderParams | PathMeander, saved: Mapping[str, np.ndarray], step: int
) -> None:
    """Raise ``ValueError`` unless a record has what a run needs to go on from it, on the scale of its network.

    Kernels take sizes of grids and numbers of points from these arrays, so that a wrong one would end the process.

    Args:
        network: The network of the record.
        params: Constants of the run.
        saved: ``Record.resume``.
        step: Step of the record.
    """
    count = network.channel_count
    width, depth = network.channel_width, network.channel_depth
    target = np.full(count, params.spacing)
    if params.spacing_in_widths > 0.0:
        target = np.minimum(target, params.spacing_in_widths * width)
    spacing = _array(saved, "channel_spacing", (count,), step)
    fixed = _array(saved, "channel_fixed", (count, 4), step)
    expected = np.empty((count, 4))
    expected[:, NARROWEST], expected[:, SHALLOWEST], expected[:, WIDEST], expected[:, WANTED] = (
        width, depth, width, target
    )  # fmt: skip
    _require(_near(fixed, expected, SCALE).all(), "channel_fixed", step)
    _require((fixed[:, NARROWEST] <= fixed[:, WIDEST]).all(), "channel_fixed", step)
    if network.point_section is not None:
        section = network.point_section[: network.point_count].numpy()
        ratio = section / np.repeat(np.column_stack([width, depth]), np.diff(network.starts()), axis=0)
        _require(_near(ratio, np.ones_like(ratio), SCALE).all(), "point_section", step)
    length = spacing * (np.diff(network.starts()) - ~network.channel_closed)
    _require(_near(length, network.channel_lengths(), LENGTH_SCALE).all(), "channel_spacing", step)
    _require((spacing <= LENGTH_SCALE * fixed[:, WANTED]).all(), "channel_spacing", step)
    _require((_array(saved, "channel_max_speed", (count,), step) >= 0.0).all(), "channel_max_speed", step)
    following = _array(saved, "next_identity", (1,), step)
    newest = int(network.channel_id.max())
    _require(following.dtype.kind == "i" and newest < following[0] <= newest + MAX_GONE, "next_identity", step)
    if "channel_nodes" in saved:  # else channels never join
        labels = _array(saved, "channel_nodes", (count, 2), step)
        _require(labels.dtype.kind == "i" and bool((labels >= -1).all()), "channel_nodes", step)


def _array(saved: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], step: int) -> np.ndarray:
    """Return an array of finite numbers of that shape."""
    array = np.asarray(saved.get(name, np.empty(0)))
    fits = array.dtype.kind in "if" and array.shape == shape and bool(np.isfinite(array).all())
    _require(fits, name, step)
    return array


def _near(values: np.ndarray, expected: np.ndarray, factor: float) -> np.ndarray:
    with np.errstate(over="ignore"):
        return (values > 0.0) & (values <= factor * expected) & (factor * values >= expected)


def _require(good: bool | np.bool_, name: str, step: int) -> None:
    if not good:
        raise SavedError(name, f"its record of step {step}")
