"""The table of what a step moves, against the kernels themselves."""

import ast
import functools
import importlib
import inspect
import textwrap

import numpy as np
import pytest
import roofline
import warp as wp
from plain import plain_params

from warpriver import RiverNetwork, Simulation, generate
from warpriver.engine import state as buffers


def launched(monkeypatch, sim):
    """Names of the kernels of a step, by phase, in order."""
    names, launch = [], wp.launch
    for stage in sim.stepper.stages():
        monkeypatch.setattr(
            wp, "launch", lambda k, *a, _p=stage.phase, **o: (names.append((_p, k)), launch(k, *a, **o))
        )
        sim.stepper.state.run([stage])
    monkeypatch.setattr(wp, "launch", launch)
    return list(dict.fromkeys((phase, kernel.key.rpartition("__")[2]) for phase, kernel in names))


@pytest.mark.parametrize(("chunk", "division"), [(0, "slabs"), (int(roofline.CHUNK_POINTS), "chunks")])
def test_the_table_holds_the_kernels_of_a_step_in_order(monkeypatch, chunk, division):
    """Of as many channels and chunks as running sums need to be done in groups."""
    monkeypatch.setattr(buffers, "CPU_CHUNK", chunk)
    lines = [generate.noisy_line(3000.0, 50.0, 50.0, k) + [0.0, 3000.0 * k] for k in range(70)]
    sim = Simulation(RiverNetwork.from_polylines(lines, width=50.0, device="cpu"), plain_params())
    expected = [(x.phase, x.kernel) for x in roofline.STEP if x.only in ("", division)]
    assert launched(monkeypatch, sim) == expected


def test_chunks_are_those_of_a_gpu():
    assert roofline.CHUNK_POINTS == buffers.CUDA_CHUNK


def members_used(function, found):
    """Members of structs that a kernel reads or writes, itself or by the functions that it calls: (struct, member)."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function.func))).body[0]
    closure = inspect.getclosurevars(function.func)
    known = {**closure.globals, **closure.nonlocals}
    kinds = function.func.__annotations__
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            kind = kinds.get(node.value.id)
            if isinstance(kind, roofline.Struct):
                found.add((kind.key, node.attr))
        if isinstance(node, ast.Call):
            name, *members = ast.unparse(node.func).split(".")
            called = functools.reduce(lambda a, b: getattr(a, b, None), members, known.get(name))
            if isinstance(called, wp.Function) and name != "wp":
                members_used(called, found)
    return found


def used_arrays(launch, sizes):
    """Array arguments of a kernel, and of those in structs the ones that it uses."""
    kernel = getattr(importlib.import_module(f"warpriver.kernels.{launch.file}").build(wp.float64), launch.kernel)
    kinds, used = {a.label: a.type for a in kernel.adj.args}, members_used(kernel, set())
    for label in sizes:
        name, *member = label.split(".")
        if not member or (kinds[name].key, member[0]) in used:
            yield label


@pytest.mark.parametrize("launch", roofline.STEP, ids=lambda x: x.kernel)
def test_the_table_has_each_array_of_a_kernel_once_and_as_it_is_used(launch):
    """Arrays ending in _out are written only, those in _io may be both, all others are read only."""
    sizes = roofline.argument_sizes(launch, "float64")
    assert sorted(m.argument for m in launch.moved) == sorted(used_arrays(launch, sizes))
    for m in launch.moved:
        name = m.argument.split(".")[0]
        if name.endswith("_out"):
            assert m.read == 0.0, m
        elif not name.endswith("_io"):
            assert m.written == 0.0, m
        if m.per != "event":
            assert m.read + m.written > 0.0, m
        if m.argument.startswith(("channel_", "channels.")):
            assert m.per in ("channel", "ring", "link", "event"), m
        if m.argument.startswith(("point_", "points.", "moved_")):
            assert m.per != "channel" or m.argument in ("point_arc", "point_moved"), m


def test_bytes_of_kernels_counted_by_hand():
    """float64: x and y are 16 bytes, an arc length 8; float32 halves all but integers and arc lengths."""
    by_name = {x.kernel: x for x in roofline.STEP}
    endless = {"channel_points": np.inf}
    assert roofline.bytes_per_point(by_name["compute_velocity"], **endless) == (16.0, 16.0)
    assert roofline.bytes_per_point(by_name["compute_velocity"], "float32", **endless) == (8.0, 8.0)
    assert roofline.bytes_per_point(by_name["move_points"], **endless) == (32.0, 16.0)
    assert roofline.bytes_per_point(by_name["move_points"], varying=True, terrain=True, **endless) == (80.0, 32.0)
    assert roofline.bytes_per_point(by_name["insert_points"], **endless) == (20.0, 24.0)
    # Buckets of two fields: set to 0, four of them a point, and both changed by the point.
    assert roofline.bytes_per_point(by_name["insert_points"], chunk_points=32.0, **endless) == (24.0, 44.0)
    # A chunk has its mark and its cuts, two integers each, from which the marks' running sums and places are made.
    assert roofline.bytes_per_point(by_name["find_necks"], **endless) == (36.0, 4.0)
    chunked = by_name["find_necks_in_chunks"]
    assert roofline.bytes_per_point(chunked, chunk_points=32.0, **endless) == (36.0, 4.0 + 16.0 / 32.0)
    sums = [roofline.bytes_per_point(by_name[x], chunk_points=32.0) for x in ("sum_marks", "scan_marks", "list_marks")]
    assert sums == [(8.0 / 32.0, 0.0), (8.0 / 32.0, 8.0 / 32.0), (8.0 / 32.0, 4.0 / 32.0)]
    assert roofline.argument_sizes(by_name["select_cuts"], "float64")["marks.place"] == 4
    assert roofline.bytes_per_point(by_name["measure_arcs"], "float32", **endless) == (8.0, 8.0)
    assert roofline.bytes_per_point(by_name["resample_points"], **endless) == (24.0, 16.0)
    # A channel's width, depth, widest and spacing, its start, its even spacing and its step.
    read, _ = roofline.bytes_per_point(by_name["compute_velocity"], channel_points=100.0)
    assert read == pytest.approx(16.0 + (4 + 32 + 8 + 8) / 100.0)


@pytest.mark.parametrize(("chunk_points", "division"), [(np.inf, "slabs"), (roofline.CHUNK_POINTS, "chunks")])
def test_phases_add_up(chunk_points, division):
    """What is not launched moves nothing: either search for necks counts, never both."""
    phases = roofline.phase_bytes(chunk_points=chunk_points)
    assert list(phases) == ["migrate", "cut off", "resample", "collide"]
    each = {x: sum(roofline.bytes_per_point(x, chunk_points=chunk_points)) for x in roofline.STEP}
    assert sum(phases.values()) == pytest.approx(sum(each.values()))
    for launch, moved in each.items():
        assert moved == 0.0 or launch.only in ("", division), launch.kernel
        assert moved > 0.0 or launch.only != division or launch.kernel == "count_contacts", launch.kernel
