"""On a GPU no thread walks along a whole channel: what it visits does not grow with the channel's length.

The launches of a step are counted on the CPU, in the layout of a GPU, in a process in which every access to an array is
noted: see ``chunk_visits.py``.
"""

import patched_warp

POINTS = 250_000  # in one channel: 7,812 chunks
# Chunks that a thread may visit: its own, what lies upstream and downstream, what lies near, and binary searches.
MOST_CHUNKS = 64
# Elements of any arrays that it may read and write: fewer than there are chunks, so that a walk along a list of them
# is seen whatever array the list is in.
MOST_ELEMENTS = 4096
# What is cut off a ring depends on what is left of it, and its route on its head: one thread goes through the chunks
# that hold necks or ends of shortcuts, and through no others. So many there are for each loop that is cut off, at most.
RING_CHUNKS = 4


def assert_counts(walked):
    """Thread 40 of a made-up kernel reads 40 points, 1, 32 and 64 apart, and writes the numbers of the last 40 chunks.

    With 64 points between, 40 of the even chunks 0 .. 78 are read, and 60 .. 99 written: ten are the same.
    """
    assert [row["chunks"] for row in walked] == [2 + 40, 40 + 40, 40 + 40 - 10]
    assert all((row["elements"], row["threads"], row["all"]) == (81, 41, 41) for row in walked)


def test_no_thread_walks_along_a_channel():
    """One channel of 250,000 points, a line and a ring, loses hundreds of loops in two steps by either solver."""
    counted = patched_warp.run("chunk_visits.py", str(POINTS))
    assert_counts(counted["walked"])
    assert list(counted["scenes"]) == ["plain", "plain, a ring", "paths", "paths, a ring"]
    long = []
    for scene, found in counted["scenes"].items():
        kernels = found["kernels"]
        assert found["points"] > 0.9 * POINTS and found["cutoffs"] > 50, scene
        assert max(row["threads"] for row in kernels.values()) > POINTS // 32, f"{scene}: points are not in chunks"
        assert max(row["chunks"] for row in kernels.values()) > 2, f"{scene}: nothing was counted"
        ring = scene.endswith("a ring")
        most = RING_CHUNKS * found["cutoffs"] if ring else MOST_CHUNKS
        elements = 8 * 32 * most if ring else MOST_ELEMENTS
        long += [
            f"{scene}, {name}: {row['chunks']} chunks, {row['elements']} elements"
            for name, row in kernels.items()
            if row["chunks"] > most or row["elements"] > elements
        ]
    assert not long, "\n".join(["one thread visits", *long])
