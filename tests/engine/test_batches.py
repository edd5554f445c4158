"""What a batch of sub-steps asks of a GPU: launches, memory and bytes read back, counted in its layout on the CPU."""

import collections

import models
import numpy as np
import pytest
import warp as wp
from insides import loops_of, tighten

from warpriver.engine import scans
from warpriver.engine import state as buffers
from warpriver.kernels.status import CUT_POINTS_NEEDED, CUTS_NEEDED, DONE, FAULT, FAULT_OXBOWS_FULL, STATUS_SIZE

# Launches and memsets of one sub-step of networks of some hundred points, each a node of a recording; before scans of
# our own there were 39 to 51, of which those of the library's scans allocated.
NODES = {"plain": 25, "on hills": 26, "tree": 41, "paths": 31, "rings": 27}


@pytest.fixture
def chunked(monkeypatch):
    """Points are dealt out in chunks of 32, as on a GPU."""
    monkeypatch.setattr(buffers, "CPU_CHUNK", 32)


def count_nodes(sim, monkeypatch):
    """Launches and memsets of a sub-step, by kind; anything that allocates raises."""
    counts = collections.Counter()
    launch, zero = wp.launch, wp.array.zero_

    def refuse(*_, **__):
        raise AssertionError("memory is allocated within a step")

    def counted(kernel, *args, **options):
        counts[kernel.key] += 1
        return launch(kernel, *args, **options)

    def zeroed(self):
        counts["memset"] += 1
        return zero(self)

    stages = sim.stepper.stages()
    with monkeypatch.context() as patch:
        patch.setattr(wp, "launch", counted)
        patch.setattr(wp.array, "zero_", zeroed)
        patch.setattr(wp.array, "__init__", refuse)
        patch.setattr(wp.utils, "array_scan", refuse)
        for stage in stages:
            stage.run(sim.stepper.state.whole)
    return counts


@pytest.mark.parametrize("name", NODES)
def test_a_sub_step_has_few_nodes_and_allocates_nothing(chunked, monkeypatch, name):
    sim = models.MODELS[name][0](capture=False, threads=1)
    sim.step()
    counts = count_nodes(sim, monkeypatch)
    assert sum(counts.values()) <= NODES[name], counts
    assert counts["memset"] <= (5 if name == "tree" else 3)  # links of stems hand on their memory in eight


def test_scans_of_a_large_network_take_three_launches_each(chunked, monkeypatch):
    """Three levels at most, whatever the size, and two launches more for each scan than of a small one."""
    sim = models.plain(capture=False, threads=1)
    small = sum(count_nodes(sim, monkeypatch).values())
    monkeypatch.setattr(scans, "SERIAL", 4)
    tighten(sim, 64, 4096)
    large = count_nodes(sim, monkeypatch)
    scanned = sum(count for key, count in large.items() if "scan_" in key)
    assert sum(count for key, count in large.items() if "sum_" in key) <= 2 * scanned
    assert small < sum(large.values()) <= small + 2 * scanned


def test_a_calm_row_reads_back_a_few_hundred_bytes(chunked, monkeypatch):
    """The status block, whose size does not depend on the network; all else is read after an event alone."""
    sim = models.plain(threads=1)
    sim.stepper.batch_limit = buffers.MAX_BATCH
    sim.run(steps=40, record_every=10_000)
    read, numpy = [], wp.array.numpy

    def counted(array):
        values = numpy(array)
        read.append(values.nbytes)
        return values

    monkeypatch.setattr(wp.array, "numpy", counted)
    status = sim.stepper._launch(buffers.MAX_BATCH, buffers.MAX_BATCH)
    assert status[DONE] == buffers.MAX_BATCH
    assert read == []
    assert 4 * len(sim.stepper.state.status.array) < 256


def test_a_row_that_cuts_reads_back_what_it_cut(chunked, monkeypatch):
    """Only the records and points of the loops, not all the room that there is for them."""
    sim = models.plain(threads=1)
    read, numpy = [], wp.array.numpy
    monkeypatch.setattr(wp.array, "numpy", lambda array: read.append(array.size) or numpy(array))
    while not len(sim.history.cutoffs):
        read.clear()
        sim.step()
        assert sim.step_count < 250
    loops = [len(cutoff.xy) for cutoff in sim.history.cutoffs]
    assert sorted(read) == sorted([len(loops), sum(loops)])
    assert sum(loops) < loops_of(sim).oxbow_capacity


def test_a_full_row_keeps_its_recordings(chunked):
    """Where all sub-steps of a batch together cut more than fits, but none alone does, nothing is made anew."""
    sim = models.tree(threads=1)
    sim.stepper.batch_limit = 8
    sim.run(steps=20, record_every=10_000)
    state, loops, replays = sim.stepper.state, loops_of(sim), sim.stepper._replays
    edition, points = state.edition, state.point_moved
    status = np.zeros(STATUS_SIZE, np.int32)
    status[[FAULT, CUTS_NEEDED, CUT_POINTS_NEEDED]] = FAULT_OXBOWS_FULL, 1, 8
    sim.stepper._make_room(status.tolist())
    assert state.edition == edition and sim.stepper._replays is replays and replays
    status[CUTS_NEEDED] = loops.cut_capacity + 1
    sim.stepper._make_room(status.tolist())
    assert state.edition > edition and state.point_moved is points, "points are not copied for want of cutoffs"
    assert loops.cut_capacity == 2 * int(status[CUTS_NEEDED])
