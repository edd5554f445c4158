"""Labels of a river network: flow, slope, stream power and order of its channels, flow and slope of its nodes.

They are what the type and the size of a river follow from [Peytavie2019, Sec. 4].
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.hydraulic_geometry import discharge
from warpriver.hydrology.drape import drape
from warpriver.hydrology.orders import strahler_order
from warpriver.hydrology.routing import drainage_area
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain
from warpriver.validate import floats, positive

__all__ = ["ChannelLabels", "label_channels", "river_mask"]


# Cells along the longest channel below which a terrain shows none.
LEAST_CELLS = 2.0


@dataclasses.dataclass(frozen=True)
class ChannelLabels:
    """What a network's channels and nodes carry.

    Attributes:
        flow: (C,) mean discharge phi along each channel, m3/s.
        slope: (C,) drop over length, m/m, 0 or more.
        power: (C,) mean of A^(1/2) S along each channel, with A in m2: m. NaN where no area is known.
        order: (C,) Strahler order.
        node_flow: (N,) discharge at each node, m3/s: the largest that arrives, at a source that of its channel.
        node_slope: (N,) slope of the ground at each node, m/m; without ground the mean of its channels.
        point_flow: (P,) discharge along the channels, m3/s.
        point_z: (P,) height of the channels' lines, which never rises downstream, m; None without ground and heights.
        source: "area" where the flow follows from drainage areas, "discharge" where the channels state it, "given".
    """

    flow: FloatArray
    slope: FloatArray
    power: FloatArray
    order: NDArray[np.int64]
    node_flow: FloatArray
    node_slope: FloatArray
    point_flow: FloatArray
    point_z: FloatArray | None
    source: str


@public
def river_mask(terrain: Terrain, min_drainage_area: float) -> Raster:
    """Return the cells that are river by multiple flow directions: 1 where the area is large enough, else 0.

    On valley floors the water spreads there, so that areas fall below those of single directions. It is a layer to look
    at; the network and its flows are those of single directions.

    Args:
        terrain: The ground.
        min_drainage_area: m2.

    Returns:
        Raster of uint8.
    """
    from warpriver.hydrology.depressions import fill_depressions

    limit = positive(min_drainage_area, "min_drainage_area", "m2")
    area = drainage_area(fill_depressions(terrain), method="mfd", exponent=1.1).numpy()
    return terrain.raster.like((np.nan_to_num(area) >= limit).astype(np.uint8), name="river")


@public
def label_channels(
    network: RiverNetwork, terrain: Terrain | None = None, *, flow: ArrayLike | None = None
) -> ChannelLabels:
    """Give the channels and nodes of a network their flow, slope, power and order.

        phi = 0.42 A^0.69, A in km2        P = A^(1/2) S

    Areas are those of the network's channels; along a channel whose width varies they grow as its square, else evenly
    from what arrives above. phi does not add up at junctions: it leaves room for infiltration and evaporation. Without
    areas the flow is the discharge of the channels, as it is for lines that a user drew.

    Args:
        network: A forest of channels.
        terrain: The ground, for slopes that the network does not know and for those of nodes.
        flow: (C,) discharges in m3/s to use instead.

    Raises:
        ValueError: Channels that part or flow in a circle, lines off the ground, cells too wide to show any of them, or
            a discharge that is not positive.
    """
    _require_shown(network, terrain)
    order = strahler_order(network.channel_from, network.channel_to)
    start, count = network.starts().astype(np.int64), network.channel_count
    channel = np.repeat(np.arange(count), np.diff(start))
    along, length = _along(network, start)
    z = _heights(network, terrain)
    area = _point_area(network, along / length[channel], channel)
    if flow is not None:
        given = floats(flow, "flow")
        if given.shape not in ((), (count,)) or not (np.isfinite(given) & (given > 0.0)).all():
            raise InputError(f"flow has shape {given.shape}; give positive numbers in m3/s, one or {count}")
        point_flow, source = np.broadcast_to(given, (count,))[channel].astype(np.float64), "given"
    elif area is not None:
        point_flow, source = discharge(area), "area"
    else:
        point_flow, source = network.channel_discharge[channel].copy(), "discharge"
    slope = network.channel_slope.copy()
    if z is not None:
        drop = np.maximum(z[start[:-1]] - z[start[1:] - 1], 0.0) / length
        slope = np.where(np.isfinite(slope), slope, drop)
    slope = np.maximum(slope, 0.0)
    return ChannelLabels(
        flow=_mean(point_flow, start),
        slope=slope,
        power=_power(area, z, start, along, slope),
        order=order,
        node_flow=_node_flow(network, point_flow, start),
        node_slope=_node_slope(network, terrain, slope),
        point_flow=point_flow,
        point_z=z,
        source=source,
    )


def _require_shown(network: RiverNetwork, terrain: Terrain | None) -> None:
    """Raise ``ValueError`` where cells are so wide that no channel has a slope or a valley on the terrain."""
    longest = float(network.channel_lengths().max())
    if terrain is not None and longest < LEAST_CELLS * terrain.cell_size:
        raise InputError(
            f"the terrain's cells are {terrain.cell_size:g} m wide and the longest channel is {longest:.4g} m long, so "
            "that neither its slope nor its valley can be seen; use a finer terrain"
        )


def _along(network: RiverNetwork, start: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Distance of each point from its channel's head, (P,) m, and the channels' lengths."""
    step = np.append(np.hypot(*np.diff(network.points(), axis=0).T), 0.0)
    total = np.concatenate([[0.0], np.cumsum(step)])[:-1]
    counts = np.diff(start)
    along = total - np.repeat(total[start[:-1]], counts)
    return along, along[start[1:] - 1]


def _heights(network: RiverNetwork, terrain: Terrain | None) -> FloatArray | None:
    if terrain is not None:
        network = drape(network, terrain)
    return None if network.point_z is None else np.asarray(network.point_z)


def _point_area(network: RiverNetwork, way: FloatArray, channel: NDArray[np.int64]) -> FloatArray | None:
    """Drainage area at each point, (P,) m2, or None where that of a channel is not known."""
    area = network.channel_drainage_area
    if area is None or not np.isfinite(area).all():
        return None
    start = network.starts().astype(np.int64)
    if network.point_section is not None:
        width = np.concatenate(network.point_widths())
        shares: FloatArray = area[channel] * np.minimum(width / width[start[1:] - 1][channel], 1.0) ** 2
        return shares
    above = np.zeros(network.node_count)
    np.add.at(above, network.channel_to, area)
    head = np.minimum(above[network.channel_from], area)
    head = np.where(head > 0.0, head, 0.5 * area)
    found: FloatArray = head[channel] + way * (area - head)[channel]
    return found


def _mean(values: FloatArray, start: NDArray[np.int64]) -> FloatArray:
    return np.add.reduceat(values, start[:-1]) / np.diff(start)


def _power(
    area: FloatArray | None, z: FloatArray | None, start: NDArray[np.int64], along: FloatArray, slope: FloatArray
) -> FloatArray:
    if area is None:
        return np.full(len(slope), np.nan)
    local = np.repeat(slope, np.diff(start))
    if z is not None:
        # The slope from point to point; at the end of a channel that of its last step.
        with np.errstate(invalid="ignore", divide="ignore"):
            fall = -np.diff(z) / np.diff(along)
        fall = np.append(fall, 0.0)
        fall[start[1:] - 1] = fall[start[1:] - 2]
        local = np.where(np.isfinite(fall), np.maximum(fall, 0.0), local)
    return _mean(np.sqrt(area) * local, start)


def _node_flow(network: RiverNetwork, point_flow: FloatArray, start: NDArray[np.int64]) -> FloatArray:
    flow = np.zeros(network.node_count)
    np.maximum.at(flow, network.channel_to, point_flow[start[1:] - 1])
    source = flow == 0.0
    head = np.zeros(network.node_count)
    np.maximum.at(head, network.channel_from, point_flow[start[:-1]])
    return np.where(source, head, flow)


def _node_slope(network: RiverNetwork, terrain: Terrain | None, slope: FloatArray) -> FloatArray:
    """Slope of the ground at the nodes; beside cells without data, and without ground, the mean of their channels."""
    total, count = np.zeros(network.node_count), np.zeros(network.node_count)
    known = np.isfinite(slope)
    for node in (network.channel_from, network.channel_to):
        np.add.at(total, node[known], slope[known])
        np.add.at(count, node[known], 1.0)
    mean = np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan)
    if terrain is None:
        return mean
    found = np.hypot(*terrain.gradient(network.node_xy).T)
    return np.where(np.isfinite(found), found, mean)
