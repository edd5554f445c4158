"""Running sums, ``sum_groups`` and ``scan_groups`` for each type, against NumPy's; recorded and not."""

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import SCALARS, chunk_count, to_device, unwritten

from warpriver.engine.scans import SERIAL, Scan
from warpriver.kernels import scans

KINDS = {"counts": wp.int32, "lengths": wp.int64, "pairs": wp.vec2i, "marks": wp.vec2i}
# About the sizes at which there is another level of groups, and far beyond.
SIZES = (1, 2, SERIAL - 1, SERIAL, SERIAL + 1, SERIAL**2, SERIAL**2 + 1, 300_000)


def values_of(kind, count, seed=0):
    """Numbers to add up, (count,) or (count, 2); their sums need all of an integer, and greatest ones are sparse."""
    rng = np.random.default_rng(seed)
    if kind == "lengths":
        return rng.integers(0, 2**62 // count, count)
    if kind == "counts":
        return rng.integers(0, 2**31 // count, count)
    if kind == "pairs":
        # What is taken back counts below 0.
        return rng.integers(-(2**31) // count, 2**31 // count, (count, 2))
    return np.stack([rng.integers(0, 2, count), rng.integers(0, 2**31, count) * (rng.random(count) < 0.2)], axis=1)


def expected(kind, values):
    if kind == "marks":
        return np.stack([np.cumsum(values[:, 0]), np.maximum.accumulate(values[:, 1])], axis=1)
    return np.cumsum(values, axis=0)


@pytest.mark.parametrize("serial", [True, False])
@pytest.mark.parametrize("count", SIZES)
@pytest.mark.parametrize("kind", KINDS)
def test_running_sums_are_numpys(device, kind, count, serial):
    """To the bit, twice from other values, and into a part of an array, beyond which nothing is written."""
    value, room = (unwritten(n, KINDS[kind], device) for n in (count, count + 2))
    beyond = room.numpy()[0].tolist()
    scan = Scan(kind, value, room[1 : count + 1], wp.float64, serial=serial)
    for seed in (1, 2):
        given_values = values_of(kind, count, seed)
        value.assign(given_values)
        scan.run()
        found = room.numpy()
        np.testing.assert_array_equal(found[1:-1], expected(kind, given_values))
        assert found[0].tolist() == found[-1].tolist() == beyond
        np.testing.assert_array_equal(value.numpy(), given_values)


@pytest.mark.parametrize("serial", [True, False])
def test_all_kinds_can_be_recorded_together(device, dtype, serial):
    """A recording tells kernels of a module apart by name: replayed, each kind goes on with its own operation."""
    made = []
    for count in (5, SERIAL + 6, SERIAL**2 + 300):
        for kind, word in KINDS.items():
            value, out = (unwritten(count, word, device) for _ in range(2))
            made.append((kind, value, out, Scan(kind, value, out, SCALARS[dtype], serial=serial)))
    with wp.ScopedCapture(device=device) as recording:
        for *_, scan in made:
            scan.run()
    for seed in (3, 4):
        for kind, value, out, _ in made:
            value.assign(values_of(kind, len(value), seed))
            out.zero_()
        wp.capture_launch(recording.graph)
        for kind, value, out, _ in made:
            np.testing.assert_array_equal(out.numpy(), expected(kind, value.numpy()))


def test_the_kernels_of_each_kind_have_names_of_their_own(dtype):
    built = vars(scans.build(SCALARS[dtype]))
    assert set(built) == {f"{verb}_{kind}" for verb in ("sum", "scan") for kind in KINDS}
    assert all(kernel.key.rpartition("__")[2] == name for name, kernel in built.items())


def test_no_value_has_no_sum(device):
    """A launch without threads would surface as an error later on."""
    for serial in (True, False):
        empty = [wp.zeros(0, dtype=wp.int32, device=device) for _ in range(2)]
        Scan("counts", *empty, wp.float64, serial=serial).run()


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(
    kind=st.sampled_from(sorted(KINDS)),
    count=st.integers(1, 400),
    group=st.integers(1, 500),
    upper_group=st.integers(1, 60),
    levels=st.integers(1, 3),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_groups_give_the_same_sums(kind, count, group, upper_group, levels, seed):
    """One group of all, groups, or groups of groups, whatever their sizes: fuller and emptier than others, or alone."""
    kernel = scans.build(wp.float64)
    sum_groups, scan_groups = getattr(kernel, f"sum_{kind}"), getattr(kernel, f"scan_{kind}")
    host = values_of(kind, count, seed)
    value, out = to_device(host, KINDS[kind], "cpu"), unwritten(count, KINDS[kind], "cpu")
    group = count if levels == 1 else group
    groups, totals, uppers = chunk_count(count, group), None, None
    if levels > 1:
        totals = unwritten(groups, KINDS[kind], "cpu")
        wp.launch(sum_groups, groups, inputs=[group, value], outputs=[totals], device="cpu")
        last = [min((g + 1) * group, count) - 1 for g in range(groups)]
        np.testing.assert_array_equal(expected(kind, totals.numpy()), expected(kind, host)[last])
    if levels > 2:
        uppers = unwritten(chunk_count(groups, upper_group), KINDS[kind], "cpu")
        wp.launch(sum_groups, len(uppers), inputs=[upper_group, totals], outputs=[uppers], device="cpu")
    wp.launch(scan_groups, groups, inputs=[group, upper_group, value, totals, uppers], outputs=[out], device="cpu")
    np.testing.assert_array_equal(out.numpy(), expected(kind, host))
