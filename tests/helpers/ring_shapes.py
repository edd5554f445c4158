"""Rings for the tests of both solvers, and what holds of them among other channels."""

import numpy as np
from devices import assert_bits, is_cpu

from warpriver import RiverNetwork


def circle(count, radius, turn=1.0, middle=(0.0, 0.0)):
    angle = 2.0 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), turn * np.sin(angle)], axis=1) + middle


def noisy_ring(radius=3000.0, spacing=40.0, noise=40.0, seed=1, middle=(0.0, 0.0)):
    """A circle with bumps of 3 to 60 waves round it."""
    rng = np.random.default_rng(seed)
    count = round(2.0 * np.pi * radius / spacing)
    angle = 2.0 * np.pi * np.arange(count) / count
    bumps = sum(rng.normal(0.0, noise) * np.cos(k * angle + rng.uniform(0.0, 6.0)) for k in range(3, 60))
    return circle(count, 1.0) * (radius + bumps)[:, None] + middle


def ring_network(xy, width=60.0, **options):
    return RiverNetwork.from_polylines([xy], width=width, closed=True, **options)


def assert_as_alone(both, alone, single, steps, device):
    """Run simulations of a ring between two lines, of the lines and of the ring: the channels do as they do alone.

    To the bit on the CPU. On a GPU sums along a channel are made of chunks, and where they begin depends on the other
    channels: noisy bends amplify the rounding, to 1e-6 m in 20 steps, so that is when it is looked at.
    """
    early = steps if is_cpu(device) else 20
    for sim in (both, alone, single):
        sim.run(steps=early)
    line, ring, other_line = both.network.polylines()
    expected = (*alone.network.polylines(), *single.network.polylines())
    for found, other in zip((line, other_line, ring), expected, strict=True):
        assert_bits(found, other, device, 1e-4)
    both.run(steps=steps - early)
    assert {c.channel for c in both.history.cutoffs} == {0, 1, 2} and not both.history.collisions
    assert both.network.channel_closed.tolist() == [False, True, False]
