"""Small models in which all that a step does happens: the tests of how a step is done run each of them."""

import numpy as np
from plain import plain_params
from trees import random_tree

from warpriver import PathMeander, RiverNetwork, Simulation, Terrain, generate
from warpriver.meander.controls import Attractor, ControlField, DampingRegion, ErodibilityField, Guide, Repeller
from warpriver.params import AvulsionParams


def many_channels(count=14, width=30.0, spacing=25.0, apart=2500.0, **options):
    """Noisy channels of 1 to 3 km, far enough apart not to meet."""
    rng = np.random.default_rng(5)
    lines = [
        generate.noisy_line(float(rng.uniform(1000.0, 3000.0)), spacing, width, k) + [0.0, apart * k]
        for k in range(count)
    ]
    if options.pop("varied", False):
        width = [width * rng.uniform(0.9, 1.3, len(xy)) for xy in lines]
    return RiverNetwork.from_polylines(lines, width=width, **options)


def hills(network, steepest=0.2, cell=50.0):
    """Ground under a network: waves of up to that slope, some of it flat, with a hole."""
    west, south, east, north = network.bounds()
    x, y = np.meshgrid(np.arange(west - 500.0, east + 500.0, cell), np.arange(north + 500.0, south - 500.0, -cell))
    wave = 3000.0 / (2.0 * np.pi)
    height = steepest * wave * np.maximum(np.sin(y / wave + 0.3 * x / wave), 0.0)
    height[10:14, 10:14] = np.nan
    return Terrain(height, cell, origin=(west - 500.0, north + 500.0))


def plain(**options):
    return Simulation(many_channels(), plain_params(spacing=25.0), **options)


def varied(**options):
    return Simulation(many_channels(varied=True), plain_params(spacing=25.0, time_step=1.0), **options)


def on_hills(**options):
    network = many_channels(varied=True)
    return Simulation(network, plain_params(spacing=25.0, time_step=1.0), terrain=hills(network), **options)


def tree(**options):
    network = random_tree(14, sources=8, size=8000.0, width=25.0)
    return Simulation(network, plain_params(spacing=20.0, reference_width=0.0), **options)


def tree_in_parts(**options):
    """Channels of very different widths, steps of many parts, and ground: some rest while others join."""
    network = random_tree(11, sources=8, size=6000.0, width=12.0)
    params = plain_params(spacing_in_widths=0.8, reference_width=0.0, time_step=1.0)
    return Simulation(network, params, terrain=hills(network, 0.25), **options)


def paths(**options):
    """Meanders by shortest paths, on channels of varying width."""
    return Simulation(many_channels(varied=True), PathMeander(spacing=25.0), **options)


def paths_in_parts(**options):
    """The same on a tree of narrow channels, in long steps, over ground: some rest while others join."""
    network = random_tree(11, sources=8, size=6000.0, width=12.0)
    params = PathMeander(spacing_in_widths=0.8, time_step=1.0)
    return Simulation(network, params, terrain=hills(network, 0.16), **options)


def some_controls(network):
    """Controls of every kind, here and there along a network, some of them on top of each other."""
    west, south, east, north = network.bounds()
    rng = np.random.default_rng(8)
    place = rng.uniform((west, south), (east, north), (16, 2)).tolist()
    found = [(Attractor, Repeller)[k % 2](tuple(p), rng.uniform(400.0, 1200.0)) for k, p in enumerate(place)]
    middle = 0.5 * (west + east)
    painted = ControlField.blank((west, south, middle, north), 40.0, device=network.device.alias)
    for x, y in place[:6]:
        painted.paint((0.5 * (x + west), y), 600.0, 200.0)
    square = np.array([[-700.0, -700.0], [700.0, -700.0], [700.0, 700.0], [-700.0, 700.0]])
    return [
        *found,
        painted,
        Guide(place[6:9], 500.0, -0.5),
        DampingRegion(square + place[9], 0.1, blend=300.0),
        ErodibilityField(square + place[10], 2.5, blend=200.0),
    ]


def steered(**options):
    """Channels under controls of every kind, over ground."""
    network = many_channels(varied=True)
    params, ground = plain_params(spacing=25.0, time_step=1.0), hills(network)
    return Simulation(network, params, terrain=ground, controls=some_controls(network), **options)


def avulsing(**options):
    """Channels that often leave their courses, over ground that falls gently and is carved."""
    network = many_channels()
    west, south, east, north = network.bounds()
    x = np.arange(west - 1500.0, east + 1500.0, 30.0)
    rough = np.random.default_rng(3).normal(0.0, 0.1, (int((north - south + 3000.0) / 30.0), len(x)))
    terrain = Terrain(60.0 - 5e-4 * (x - west) + rough, 30.0, (west - 1500.0, north + 1500.0))
    avulsions = AvulsionParams(crevasse_rate=0.03, avulsion_probability=0.8)
    return Simulation(network, plain_params(spacing=25.0, avulsions=avulsions), terrain=terrain, **options)


def single_precision(**options):
    params = plain_params(spacing=20.0, reference_width=0.0)
    return Simulation(random_tree(3, sources=6, size=6000.0, width=25.0), params, dtype="float32", **options)


def rings(**options):
    """Rings and lines of points of their own widths, in steps of several parts."""
    rng = np.random.default_rng(9)
    lines = [generate.noisy_line(2500.0, 25.0, 30.0, k) + [0.0, 3500.0 * k] for k in range(6)]
    for k in range(1, 6, 2):
        angle = 2.0 * np.pi * np.arange(140) / 140
        radius = 600.0 + sum(rng.normal(0.0, 14.0) * np.cos(m * angle + rng.uniform(0.0, 6.0)) for m in range(3, 20))
        lines[k] = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1) + [0.0, 3500.0 * k]
    width = [30.0 * rng.uniform(0.9, 1.3, len(xy)) for xy in lines]
    network = RiverNetwork.from_polylines(lines, width, closed=[k % 2 == 1 for k in range(6)])
    return Simulation(network, plain_params(spacing=25.0, time_step=1.0), **options)


def rings_in_two(**options):
    """Rings of which both parts go on, smoothed: channels are added while others move."""
    rng = np.random.default_rng(4)
    angle = 2.0 * np.pi * np.arange(300) / 300
    radius = 1200.0 + sum(rng.normal(0.0, 25.0) * np.cos(m * angle + rng.uniform(0.0, 6.0)) for m in range(3, 30))
    ring = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    network = RiverNetwork.from_polylines([ring, ring + [9000.0, 0.0]], 30.0, closed=True)
    return Simulation(network, plain_params(spacing=25.0, ring_policy="both", taubin_passes=1), **options)


def path_rings_in_two(**options):
    """Rings by shortest paths, among lines, of which both parts go on."""
    sim = rings_in_two(threads=1)
    line = generate.noisy_line(5000.0, 25.0, 30.0, 2) + [0.0, 4000.0]
    lines = [*sim.network.polylines(), line]
    network = RiverNetwork.from_polylines(lines, 30.0, closed=[True, True, False])
    return Simulation(network, PathMeander(spacing=25.0, ring_policy="both"), **options)


# Each with a number of steps in which more than ten times happens what it is there for.
MODELS = {
    "plain": (plain, 250),
    "varied": (varied, 80),
    "on hills": (on_hills, 80),
    "steered": (steered, 80),
    "avulsing": (avulsing, 250),
    "tree": (tree, 130),
    "tree in parts": (tree_in_parts, 40),
    "single precision": (single_precision, 100),
    "paths": (paths, 150),
    "paths in parts": (paths_in_parts, 40),
    "rings": (rings, 80),
    "rings in two": (rings_in_two, 200),
    "path rings in two": (path_rings_in_two, 50),
}


def assert_same(a, b):
    """Both simulations hold the same bits and went through the same events."""
    assert a.step_count == b.step_count and a.network.point_count == b.network.point_count
    n = a.network.point_count
    np.testing.assert_array_equal(a.network.point_xy.numpy()[:n], b.network.point_xy.numpy()[:n])
    if a.network.point_section is not None:
        np.testing.assert_array_equal(a.network.point_section.numpy()[:n], b.network.point_section.numpy()[:n])
    np.testing.assert_array_equal(a.network.starts(), b.network.starts())
    channels = a.network.channel_count
    np.testing.assert_array_equal(*(sim.stepper.state.spacing.numpy()[:channels] for sim in (a, b)))
    for name in ("channel_id", "channel_width", "channel_depth", "channel_discharge", "channel_from", "channel_to"):
        np.testing.assert_array_equal(getattr(a.network, name), getattr(b.network, name))
    np.testing.assert_array_equal(a.network.node_xy, b.network.node_xy)
    assert list(a.history.crevasses) == list(b.history.crevasses)
    if a.terrain is not None and b.terrain is not None:
        np.testing.assert_array_equal(a.terrain.to_numpy(), b.terrain.to_numpy())
    for kind in ("cutoffs", "collisions", "splits", "avulsions"):
        events = [getattr(sim.history, kind) for sim in (a, b)]
        assert [(e.time, e.channel, e.width, e.xy.tobytes()) for e in events[0]] == [
            (e.time, e.channel, e.width, e.xy.tobytes()) for e in events[1]
        ]
