"""Whole models in the layout of a GPU come to the same bits in whatever order the threads of a launch come.

They run on the CPU, in a process in which the order of the threads is ours: see ``thread_order.py``.
"""

import patched_warp
import pytest
from models import MODELS

# Not "in order": that is the one that is compared with.
OTHERS = ("reversed", "scrambled")
FILLED = {"reversed": [0xFF], "scrambled": [0x55]}


def run_scenes(*names):
    """Run scenes in all orders; return what happened in each of them."""
    told = patched_warp.run("thread_order.py", *names)
    assert_ways_differ(told)
    ways = {way: told[way]["scenes"] for way in told}
    for way in OTHERS:
        for name in names:
            digests, usual = ways[way][name]["digests"], ways["in order"][name]["digests"]
            assert digests.keys() == usual.keys()
            other = [what for what in digests if digests[what] != usual[what]]
            assert not other, f"{name}: {', '.join(other)} are other bits where threads come {way}"
            assert ways[way][name]["happened"] == ways["in order"][name]["happened"]
    return {name: ways["in order"][name]["happened"] for name in names}


def assert_ways_differ(told):
    """Else the comparison would say nothing: threads came in those orders, and fresh memory was filled."""
    assert list(told) == ["in order", *OTHERS]
    for turns, backwards, mixed in zip(*(told[way]["turns"] for way in told), strict=True):
        count = len(turns)
        assert turns == list(range(count)), "Warp runs threads in another order than it did: look at patched_warp.py"
        assert backwards == turns[::-1], "the thread index is not permuted: look at thread_order.py"
        assert sorted(mixed) == turns, "not every thread came once"
        if count > 20:
            assert mixed not in (turns, backwards)
            assert sum(abs(a - b) == 1 for a, b in zip(mixed[1:], mixed[:-1], strict=True)) < count // 5
    for way in OTHERS:
        assert told[way]["fresh"] == FILLED[way], "fresh memory is not filled: look at patched_warp.py"
        assert told[way]["zeros"] == [0]


def test_models_come_to_the_same_bits_in_any_order():
    """As they are, and with 90,000 points, by migration and by shortest paths; and all that can happen does."""
    happened = run_scenes(*MODELS, "many points", "many points by paths")
    for name, count in happened.items():
        assert "in two" in name or count["cutoffs"] > 5, name
        assert "in two" not in name or count["splits"] > 5, name
        assert ("tree" not in name and name != "paths in parts") or count["collisions"] > 2, name
        assert "in parts" not in name or count["substeps"] > 1, name
        assert "many" not in name or (count["points"] > 80_000 and count["cutoffs"] > 8), name


def test_land_comes_to_the_same_bits_in_any_order():
    """Rain in batches, rasters of a synthetic valley, and a terrain."""
    happened = run_scenes("rain", "valley", "ground")
    assert happened["rain"]["visits"] > 10_000 and happened["rain"]["slides"] > 10_000
    assert happened["valley"]["cells"] > 5000 and happened["valley"]["places"] > 2000
    assert happened["ground"]["places"] > 3000


def test_what_ends_in_the_other_process_is_told():
    with pytest.raises(AssertionError, match="KeyError: 'no scene of this name'"):
        patched_warp.run("thread_order.py", "no scene of this name")
