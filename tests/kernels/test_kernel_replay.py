"""The kernels that replay launches of the CPU: run_launches and zero_memory."""

import ctypes

import numpy as np
import warp as wp
from devices import need_cpu

from warpriver.engine.replay import LaunchList
from warpriver.engine.stages import launch, noted_launches
from warpriver.kernels import replay


@wp.struct
class Scaling:
    """A factor and where it is counted."""

    factor: wp.float64
    calls: wp.array[int]


@wp.kernel(enable_backward=False)
def scale_and_add(scaling: Scaling, shift: wp.vec2d, missing: wp.array[int], value_io: wp.array[wp.vec2d]):
    """Value by a factor, and a shift added; arguments of every kind that a step has."""
    i = wp.tid()
    value_io[i] = value_io[i] * scaling.factor + shift
    wp.atomic_add(scaling.calls, 0, 1)
    if missing:
        missing[i] = 1


def test_run_launches_does_what_the_launches_do_in_their_order(device):
    """x a + b for several a and b: no other order has the same result."""
    need_cpu(device, "launches are noted on the CPU alone")
    rng = np.random.default_rng(5)
    start, factors, shifts = rng.normal(size=(17, 2)), rng.normal(size=9), rng.normal(size=(9, 2))
    value, calls = wp.array(start, dtype=wp.vec2d, device="cpu"), wp.zeros(1, dtype=int, device="cpu")
    with noted_launches() as launches:
        for factor, shift in zip(factors, shifts, strict=True):
            scaling = Scaling()
            scaling.factor, scaling.calls = factor, calls
            launch(scale_and_add, 17, [scaling, wp.vec2d(*shift), None], [value], value.device)
            launch(scale_and_add, 0, [scaling, wp.vec2d(*shift), None], [value], value.device)
    np.testing.assert_array_equal(value.numpy(), start, "nothing is done while launches are noted")
    assert len(launches) == 9
    replayed, expected = LaunchList(launches), start.copy()
    for _ in range(3):
        replayed.run()
        for factor, shift in zip(factors, shifts, strict=True):
            expected = expected * factor + shift
    np.testing.assert_allclose(value.numpy(), expected, rtol=1e-14)
    assert calls.numpy()[0] == 3 * 9 * 17


def test_run_launches_runs_but_the_first(device):
    need_cpu(device, "launches are noted on the CPU alone")
    value, calls = wp.zeros(1, dtype=wp.vec2d, device="cpu"), wp.zeros(1, dtype=int, device="cpu")
    scaling = Scaling()
    scaling.factor, scaling.calls = 1.0, calls
    command = wp.launch(
        scale_and_add, 1, [scaling, wp.vec2d(1.0, 2.0), None, value], device="cpu", block_dim=1, record_cmd=True
    )
    fields = [(f"field_{k}", type(p)) for k, p in enumerate(command.params[1:])]
    arguments = type("Arguments", (ctypes.Structure,), {"_fields_": fields})(*command.params[1:])
    addresses = [
        ctypes.cast(command.hooks.forward, ctypes.c_void_p).value,
        ctypes.addressof(command.params[0]),
        ctypes.addressof(arguments),
    ]
    table = np.array(addresses * 5, np.uint64)
    wp.launch(replay.build(wp.float64).run_launches, 1, [wp.uint64(table.ctypes.data), 3], device="cpu")
    assert value.numpy().tolist() == [[3.0, 6.0]]


def test_zero_memory_clears_just_so_many_bytes(device):
    need_cpu(device, "a GPU clears its memory itself")
    for kind in (np.uint8, np.int32, np.float64):
        value = wp.array(np.ones(40, kind), device="cpu")
        size = 7 * np.dtype(kind).itemsize
        place = value.ptr + 5 * np.dtype(kind).itemsize
        wp.launch(replay.build(wp.float64).zero_memory, 1, [wp.uint64(place), wp.uint64(size)], device="cpu")
        assert np.flatnonzero(value.numpy() == 0).tolist() == list(range(5, 12))
