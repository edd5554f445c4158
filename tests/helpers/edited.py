"""Rivers to be edited, what they hold to the bit, and random edits of them."""

import numpy as np
from models import hills
from plain import plain_params
from trees import random_tree

from warpriver import PathMeander, RiverNetwork, Simulation, edits, generate
from warpriver.errors import InputError


def river(length=12_000.0, width=60.0, spacing=50.0, seed=3, terrain=None, params=plain_params, **options):
    """One river of gentle noise."""
    line = generate.noisy_line(length, spacing, width, seed)
    network = RiverNetwork.from_polylines([line], width=width)
    return Simulation(network, params(spacing=spacing), terrain=terrain, **options)


def bends(count=3, weight=-1.0, **options):
    """Rivers of even, smooth bends, far apart from each other."""
    x = np.linspace(0.0, 12_000.0, 400)
    lines = [np.stack([x, 150.0 * np.sin(2.0 * np.pi * x / 1_500.0) + 5_000.0 * k], axis=1) for k in range(count)]
    params = plain_params(spacing=50.0, local_weight=weight)
    return Simulation(RiverNetwork.from_polylines(lines, width=60.0), params, **options)


def tree(seed=5, params=plain_params, ground=False, **options):
    """Eight sources and what they flow into."""
    network = random_tree(seed, sources=8, size=9000.0, width=25.0)
    return Simulation(network, params(spacing=20.0), terrain=hills(network, 0.1) if ground else None, **options)


def bits(sim):
    """All that a simulation goes on from, as bytes."""
    state = sim.stepper.snapshot()
    arrays = [state.point_xy, state.channel_start, state.node_xy]
    arrays += [state.channels[name] for name in state.channels] + [state.saved[name] for name in sorted(state.saved)]
    if state.point_section is not None:
        arrays.append(state.point_section)
    if sim.terrain is not None:
        arrays.append(sim.terrain.to_numpy())
    return [array.tobytes() for array in arrays]


def lines(sim):
    """The lines of the channels by identity."""
    return dict(zip(sim.network.channel_id.tolist(), sim.network.polylines(), strict=True))


def random_edit(sim, rng):
    """An edit that may or may not be possible."""
    network = sim.network
    ids = network.channel_id
    c = int(rng.integers(len(ids)))
    channel, line = int(ids[c]), network.polylines()[c]
    width = float(network.channel_width[c])
    point = line[int(rng.integers(len(line)))]
    at = (float(point[0]), float(point[1]))
    shift = rng.normal(0.0, 2.0 * width, 2)
    kind = rng.choice(["lock", "unlock", "move", "split", "join", "add", "remove", "redraw", "set", "reach", "ground"])
    if kind == "lock":
        return edits.LockPoint(channel, at)
    if kind == "unlock":
        return edits.UnlockPoint(channel, at)
    if kind == "move":
        return edits.MovePoint(channel, at, tuple(point + shift), float(rng.uniform(5.0, 30.0) * width))
    if kind == "split":
        return edits.SplitChannel(channel, at, width_above=width * float(rng.uniform(0.8, 1.2)))
    if kind == "join":
        below = np.flatnonzero(network.channel_from == network.channel_to[c])
        return edits.JoinChannels(channel, int(ids[below[0]]) if len(below) else channel)
    if kind == "add":
        source = point + rng.normal(0.0, 20.0 * width, 2)
        return edits.AddChannel([source, 0.5 * (source + point) + shift, point], width=float(rng.uniform(20.0, 30.0)))
    if kind == "remove":
        return edits.RemoveChannel(channel)
    if kind == "redraw":
        i, j = sorted(rng.integers(len(line), size=2).tolist())
        middle = 0.5 * (line[i] + line[j]) + shift
        return edits.RedrawSection(channel, [line[i], middle, line[j]])
    if kind == "set":
        return edits.SetChannel(
            channel, width=width * float(rng.uniform(0.8, 1.2)), discharge=float(rng.uniform(5.0, 50.0))
        )
    if kind == "reach":
        i, j = sorted(rng.integers(len(line), size=2).tolist())
        return edits.SetChannel(channel, depth=float(rng.uniform(1.0, 3.0)), reach=(tuple(line[i]), tuple(line[j])))
    return edits.EditTerrain(
        "raise", center=at, radius=float(rng.uniform(100.0, 600.0)), amount=float(rng.uniform(0, 9))
    )


def do_random(sim, rng, count):
    """Do so many edits that are possible; what is not must be told as such."""
    done = 0
    while done < count:
        try:
            sim.apply(random_edit(sim, rng))
            done += 1
        except InputError as error:
            assert "\n" not in str(error)


SOLVERS = {"migration": plain_params, "paths": PathMeander}
