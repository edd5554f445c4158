"""Made-up river trees, and the invariants that a network keeps through every edit."""

from __future__ import annotations

import numpy as np

from warpriver import RiverNetwork


def assert_forest(network, binary=True):
    """A forest of binary trees whose channel ends meet their nodes, with flow that grows downstream."""
    above, below = network.channel_from, network.channel_to
    outgoing = np.bincount(above, minlength=network.node_count)
    arriving = np.bincount(below, minlength=network.node_count)
    assert (outgoing <= 1).all(), "water leaves a node by one channel"
    assert (outgoing + arriving > 0).all(), "every node has a channel"
    if binary:
        assert (arriving <= 2).all(), "two channels meet at most"
        assert not ((arriving == 1) & (outgoing == 1)).any(), "no node without a junction"
    down = np.full(network.node_count, -1)
    down[above] = below
    here = np.arange(network.node_count)
    for _ in range(network.node_count + 1):
        here = np.where(here >= 0, down[here], -1)
        if (here < 0).all():
            break
    else:
        raise AssertionError("the graph has a cycle")
    for line, a, b in zip(network.polylines(), above, below, strict=True):
        assert np.isfinite(line).all() and len(line) >= 3
        assert np.hypot(*(line[0] - network.node_xy[a])) < 1e-3
        assert np.hypot(*(line[-1] - network.node_xy[b])) < 1e-3
    flow = network.channel_flow()
    assert (flow > 0).all() and np.isfinite(flow).all()
    total = np.bincount(below, weights=flow, minlength=network.node_count)
    inner = arriving[above] > 0
    assert (flow[inner] >= total[above[inner]] * (1 - 1e-9)).all(), "a channel carries what arrives"
    assert (network.channel_width > 0).all() and (network.channel_discharge > 0).all()
    assert len(set(network.channel_id.tolist())) == network.channel_count


def random_tree(seed, sources=6, size=12_000.0, width=20.0, spacing=20.0, noise=0.6):
    """A binary tree of noisy channels that flows south over a square, its junctions placed at random."""
    rng = np.random.default_rng(seed)
    # Join neighbours in pairs, row by row, until one channel is left.
    tips = [(x, size) for x in np.sort(rng.uniform(0.0, size, sources))]
    areas = list(rng.uniform(1.0, 4.0, sources) * 1e6)
    lines, widths, flows = [], [], []

    def channel(a, b, area):
        n = max(6, round(np.hypot(b[0] - a[0], b[1] - a[1]) / spacing))
        t = np.linspace(0.0, 1.0, n + 1)[:, None]
        xy = np.array(a) * (1 - t) + np.array(b) * t
        w = width * np.sqrt(area / 1e6)
        xy[1:-1] += rng.normal(0.0, noise * w, (n - 1, 2)) * np.minimum(1.0, 6 * np.minimum(t, 1 - t))[1:-1]
        lines.append(xy)
        widths.append(w)
        flows.append(area)

    level = size
    while len(tips) > 1:
        k = int(rng.integers(0, len(tips) - 1))
        level = min(min(tips[k][1], tips[k + 1][1]) - rng.uniform(0.05, 0.2) * size, level)
        x = 0.5 * (tips[k][0] + tips[k + 1][0]) + rng.normal(0.0, 0.02 * size)
        node = (x, level)
        for m in (k, k + 1):
            channel(tips[m], node, areas[m])
        merged = areas[k] + areas[k + 1] + rng.uniform(0.0, 0.5) * 1e6
        tips[k : k + 2], areas[k : k + 2] = [node], [merged]
    channel(tips[0], (tips[0][0], level - 0.3 * size), areas[0])
    return RiverNetwork.from_polylines(lines, width=widths, drainage_area=flows)
