"""Runs whole models with the threads of each launch in several orders, and prints digests of all that comes of it.

On a GPU the threads of a launch come in any order, and fresh memory holds anything. Warp's CPU device runs them one by
one from 0 on, and often gets memory that is still zero: what relies on either is not seen there. So here the generated
code permutes the thread index, and fresh memory is filled. ``test_thread_order.py`` starts this and compares.
"""

import dataclasses
import functools
import hashlib
import json
import sys
import time

import numpy as np
import warp as wp
from insides import tighten
from models import MODELS
from patched_warp import Preamble, fill_fresh_memory
from plain import plain_params

from warpriver import (
    LehenyParams,
    PathMeander,
    RiverNetwork,
    Simulation,
    Terrain,
    bench,
    erode,
    generate,
    synthetic_valley,
)
from warpriver.engine import state as buffers

SOURCE = """
extern "C" { WP_API uint64_t thread_order = 0; }

// A bijection of 0 .. count - 1: bits are mixed, again and again where that leads beyond the last.
static inline size_t permuted(size_t turn, size_t count)
{
    if (thread_order == 0)
        return turn;
    if (thread_order == 1)
        return count - 1 - turn;
    const int bits = 64 - __builtin_clzll((count - 1) | 1);
    const size_t mask = (size_t(1) << bits) - 1;
    do {
        for (int round = 0; round < 2; ++round) {
            turn = (turn * thread_order + bits) & mask;
            turn ^= turn >> ((bits + 1) / 2);
        }
    } while (turn >= count);
    return turn;
}

#undef builtin_tid1d
#undef builtin_tid2d
#undef builtin_tid3d
#undef builtin_tid4d
#define builtin_tid1d() wp::linear_tid<wp_linear_tid>(permuted(task_index, dim.size), dim)
#define builtin_tid2d(x, y) wp::tid(x, y, permuted(task_index, dim.size), dim)
#define builtin_tid3d(x, y, z) wp::tid(x, y, z, permuted(task_index, dim.size), dim)
#define builtin_tid4d(x, y, z, w) wp::tid(x, y, z, w, permuted(task_index, dim.size), dim)
"""
# Order of the threads (0, 1, or an odd number that scrambles), and the byte that fresh memory is filled with. 0xFF
# makes -1 of an integer, which often stands for none, so it is not the only one.
WAYS = {"in order": (0, None), "reversed": (1, 0xFF), "scrambled": (0x9E3779B97F4A7C15, 0x55)}
CHUNK = 32  # points of a thread on a GPU


# ---- what shows that the ways differ


@wp.kernel(enable_backward=False)
def note_turn(counter_io: wp.array[int], turn_out: wp.array[int]):
    """Note when each thread comes."""
    i = wp.tid()
    turn_out[i] = wp.atomic_add(counter_io, 0, 1)


@wp.kernel(enable_backward=False)
def note_turn_of_cell(counter_io: wp.array[int], turn_out: wp.array2d[int]):
    """Note when each thread of a grid comes."""
    i, j = wp.tid()
    turn_out[i, j] = wp.atomic_add(counter_io, 0, 1)


@wp.kernel(enable_backward=False)
def note_turn_of_voxel(counter_io: wp.array[int], turn_out: wp.array3d[int]):
    """Note when each thread of a block comes."""
    i, j, k = wp.tid()
    turn_out[i, j, k] = wp.atomic_add(counter_io, 0, 1)


def turns(*shape):
    """When each thread of a launch comes."""
    kernel = (note_turn, note_turn_of_cell, note_turn_of_voxel)[len(shape) - 1]
    counter, turn = wp.zeros(1, dtype=int), wp.full(shape, -1, dtype=int)
    wp.launch(kernel, shape, [counter, turn])
    return turn.numpy().ravel().tolist()


def bytes_of(array):
    """Which bytes there are in an array."""
    return np.unique(array.numpy().view(np.uint8)).tolist()


# ---- what is compared


def digest(values):
    """Digest of all bits of an array, or of bytes."""
    data = values if isinstance(values, bytes) else np.ascontiguousarray(values).tobytes()
    return hashlib.sha256(data).hexdigest()[:16]


def event_bytes(event):
    """All fields of an event, end to end."""
    return b"".join(np.ascontiguousarray(getattr(event, field.name)).tobytes() for field in dataclasses.fields(event))


def outcome_of(sim):
    """What tells all of a simulation's state and history, and how much happened in it."""
    network, points, channels = sim.network, sim.network.point_count, sim.network.channel_count
    found = {
        "points": network.point_xy.numpy()[:points],
        "starts": network.starts(),
        "spacings": sim.stepper.state.spacing.numpy()[:channels],
        "nodes": network.node_xy,
    }
    if network.point_section is not None:
        found["sections"] = network.point_section.numpy()[:points]
    for name in ("id", "width", "depth", "discharge", "from", "to"):
        found[f"channel {name}"] = getattr(network, f"channel_{name}")
    happened = {"points": points, "channels": channels, "substeps": sim.substeps}
    for kind in ("cutoffs", "collisions", "splits"):
        events = getattr(sim.history, kind)
        found[kind] = b"".join(event_bytes(event) for event in events)
        happened[kind] = len(events)
    return found, happened


# ---- scenes


def run_model(name, way):
    """One of the models of the tests of stages; scrambled, its sub-steps are done in rows, in buffers that grow."""
    make, steps = MODELS[name]
    sim = make(threads=1)
    if sim.stepper.state.whole.point_threads < sim.network.point_count // CHUNK:
        raise RuntimeError(f"{name}: points are not dealt out in chunks of {CHUNK}")
    if way == "scrambled":
        sim.stepper.batch_limit = 1 if "in two" in name else 8
        tighten(sim)
    sim.run(steps=steps, record_every=10_000)
    return outcome_of(sim)


def run_many(kind, **wider):
    """90,000 points in 300 channels: many chunks in each of many channels.

    Necks that are farther apart are cut than in the river that the channels are taken from, so that there are many.
    """
    lines = bench.lay_out(bench.cut_lines([300] * 300, river_points=5_000, years=200.0))
    network = RiverNetwork.from_polylines(lines, bench.WIDTH)
    sim = Simulation(network, kind(spacing=bench.SPACING, **wider), threads=1)
    sim.run(steps=4, record_every=10_000)
    return outcome_of(sim)


def rain():
    """Batches of rain on a small plane, with slides."""
    plane = generate.erosion_plane((30, 40), cell_size=10.0)
    land = erode(plane, LehenyParams(slide_threshold=100.0), events=1500, seed=2, batch=64)
    return {"height": land.to_numpy()}, {"visits": land.visits, "slides": land.slides}


def valley():
    """Raster, heights at points and curvilinear grid of a meandering valley."""
    made = synthetic_valley("S3", length=300.0)
    raster = made.raster(5.0)
    west, south, east, north = raster.bounds
    xy = np.random.default_rng(0).uniform((west, south), (east, north), (5000, 2))
    heights = made.height(xy)
    found = {"raster": raster.to_numpy(), "heights": heights, "grid": made.grid().xyz}
    return found, {"cells": raster.to_numpy().size, "places": int(np.isfinite(heights).sum())}


def ground():
    """All that a terrain answers and does."""
    rng = np.random.default_rng(3)
    height = rng.normal(0.0, 2.0, (90, 120)).cumsum(axis=0).cumsum(axis=1)
    height[20:24, 30:37] = np.nan
    land = Terrain(height, 10.0, origin=(500.0, 2000.0))
    xy = rng.uniform((450.0, 1050.0), (1750.0, 2050.0), (5000, 2))
    for kind, amount in (("raise", 3.0), ("smooth", 0.7), ("flatten", 0.5)):
        land.brush(kind, center=(1100.0, 1500.0), radius=150.0, amount=amount)
    land.add_ridge(xy[:9], 20.0, 60.0)
    found = {
        "height": land.to_numpy(),
        "sample": land.sample(xy),
        "gradient": land.gradient(xy),
        "slope": land.slope(),
        "finer": land.resampled(4.0).to_numpy(),
        "coarser": land.resampled(27.0).to_numpy(),
    }
    return found, {"places": int(np.isfinite(found["sample"]).sum())}


SCENES = {name: functools.partial(run_model, name) for name in MODELS} | {
    "many points": lambda way: run_many(plain_params, cutoff_distance=1.3),
    "many points by paths": lambda way: run_many(PathMeander, search_radius=2.0),
    "rain": lambda way: rain(),
    "valley": lambda way: valley(),
    "ground": lambda way: ground(),
}


def main(names):
    """Run scenes in every way and print what came of them, with what shows that the ways differ."""
    preamble, memory = Preamble(SOURCE, "thread_order"), fill_fresh_memory()
    buffers.CPU_CHUNK = CHUNK
    told = {}
    for way, (order, memory.byte) in WAYS.items():
        preamble.set(order)
        told[way] = {
            "turns": [turns(n) for n in (1, 2, 3, 100)] + [turns(5, 7), turns(2, 3, 4)],
            "fresh": bytes_of(wp.empty(5000, dtype=wp.float64)),
            "zeros": bytes_of(wp.zeros(5000, dtype=wp.float64)),
            "scenes": {},
        }
        for name in names:
            print(f"{name}, {way}", file=sys.stderr, flush=True)  # what came last, where all ends here
            begin = time.perf_counter()
            found, happened = SCENES[name](way)
            seconds = time.perf_counter() - begin
            digests = {what: digest(values) for what, values in found.items()}
            told[way]["scenes"][name] = {"digests": digests, "happened": happened, "seconds": seconds}
    print(json.dumps(told))


if __name__ == "__main__":
    with wp.ScopedDevice("cpu"):
        main(sys.argv[1:])
