"""Counts how many chunks of points each thread of a launch visits, and prints the most for each kernel.

On a GPU a thread takes a chunk of 32 points. A thread that walks along all of a long channel keeps the others waiting,
and a CPU does not show it. So here the arrays of the generated code are of a type that notes every access. What would
get round it does not compile, since the type hides the pointer that it holds. ``test_chunk_visits.py`` starts this.
"""

import ctypes
import json
import sys
import time

import numpy as np
import warp as wp
from patched_warp import Preamble
from plain import plain_params
from warp._src import codegen

from warpriver import PathMeander, RiverNetwork, Simulation, bench
from warpriver.engine import state as buffers

SOURCE = """
struct chunk_tally_t {
    uint64_t seen;  // by chunk: the last thread that touched it, uint32
    uint64_t chunk;  // points of a chunk
    uint64_t points, chunks;  // lengths of the arrays by point and by chunk
    uint64_t threads;  // that have begun so far
    uint64_t visited, most_visited;  // chunks: by this thread, and by any since the host has set it to 0
    uint64_t touched, most_touched;  // elements of all arrays, each as often as it was read or written
};

extern "C" { WP_API uint64_t chunk_tally = 0; }  // where it is

static inline void begin_thread()
{
    if (chunk_tally == 0)
        return;
    chunk_tally_t& tally = *(chunk_tally_t*)chunk_tally;
    tally.threads += 1;
    tally.visited = tally.touched = 0;
}

static inline void note_access(int64_t length, int64_t i)
{
    if (chunk_tally == 0)
        return;
    chunk_tally_t& tally = *(chunk_tally_t*)chunk_tally;
    tally.touched += 1;
    if (tally.touched > tally.most_touched)
        tally.most_touched = tally.touched;
    i = i < 0 ? i + length : i;
    // Offsets have one more.
    if (length == tally.points || length == tally.points + 1)
        i /= tally.chunk;
    else if (length != tally.chunks && length != tally.chunks + 1)
        return;
    uint32_t& seen = ((uint32_t*)tally.seen)[i];
    if (seen == (uint32_t)tally.threads)
        return;
    seen = (uint32_t)tally.threads;
    tally.visited += 1;
    if (tally.visited > tally.most_visited)
        tally.most_visited = tally.visited;
}

namespace wp {

template <typename T> struct noted_array_t : private array_t<T> {
    using array_t<T>::array_t;
    using array_t<T>::shape;
    using array_t<T>::strides;
    noted_array_t(const array_t<T>& array) : array_t<T>(array) { }
    operator bool() const { return this->data != nullptr; }
};

template <typename T> inline T& index(const noted_array_t<T>& array, int i)
{
    note_access(array.shape[0], i);
    return index((const array_t<T>&)array, i);
}

template <typename T, typename... Ints> inline T& index(const noted_array_t<T>& array, int i, Ints... more)
{
    return index((const array_t<T>&)array, i, more...);
}

// Rows of arrays of more dimensions than one: parts of an array by point have another length, and so no view.
template <typename T, typename... Ints> inline noted_array_t<T> view(noted_array_t<T>& array, int i, Ints... more)
{
    return view((array_t<T>&)array, i, more...);
}

template <typename T> inline noted_array_t<T> add(const noted_array_t<T>&, const noted_array_t<T>&) { return { }; }
template <typename T> inline void atomic_add(noted_array_t<T>*, noted_array_t<T>) { }

}  // namespace wp

#define array_t noted_array_t
"""
# Where the generated loop over a launch calls the kernel.
CALL = "{name}_cpu_kernel_forward<wp_linear_contiguous>(*dim, task_index, _wp_args);"
CHUNK = 32  # points of a thread on a GPU


class Tally(ctypes.Structure):
    """The struct of the same name in C++."""

    NAMES = "seen", "chunk", "points", "chunks", "threads", "visited", "most_visited", "touched", "most_touched"
    _fields_ = tuple((name, ctypes.c_uint64) for name in NAMES)


class Counter:
    """Counts for every launch what its threads visit, and keeps the most for each kernel."""

    def __init__(self):
        template = codegen.cpu_module_template_forward
        if template.count(CALL) != 1:
            raise RuntimeError(f"Warp {wp.__version__} loops over the threads of a launch in another way: look at CALL")
        codegen.cpu_module_template_forward = template.replace(CALL, f"begin_thread();\n        {CALL}")
        self.table = {}
        self.tally = Tally(chunk=CHUNK)
        self._seen = np.zeros(0, np.uint32)
        self._launch = wp.launch
        self._preamble = Preamble(SOURCE, "chunk_tally")

    def count(self, call, lengths):
        """Call something and count its launches; ``lengths()`` gives those of the arrays by point and by chunk."""
        self._preamble.set(ctypes.addressof(self.tally))
        wp.launch = lambda kernel, dim, *args, **kwargs: self._count(lengths(), kernel, dim, *args, **kwargs)
        before = self.tally.threads
        try:
            call()
        finally:
            wp.launch = self._launch
            self._preamble.set(0)
        if self.tally.threads - before != sum(row["all"] for row in self.table.values()):
            raise RuntimeError("kernels were launched by other means than wp.launch, and not counted")

    def _count(self, lengths, kernel, dim, *args, **kwargs):
        tally = self.tally
        tally.points, tally.chunks = lengths
        if len(self._seen) < tally.chunks + 1:
            self._seen = np.zeros(tally.chunks + 1, np.uint32)
            tally.seen = self._seen.ctypes.data
        tally.most_visited = tally.most_touched = 0
        before = tally.threads
        self._launch(kernel, dim, *args, **kwargs)
        name = f"{kernel.module.name.split('.')[-1]}.{kernel.key.split('__')[-1]}"
        row = self.table.setdefault(name, {"chunks": 0, "elements": 0, "threads": 0, "all": 0})
        row["chunks"] = max(row["chunks"], tally.most_visited)
        row["elements"] = max(row["elements"], tally.most_touched)
        row["threads"] = max(row["threads"], tally.threads - before)
        row["all"] += tally.threads - before


# ---- what shows that it counts


@wp.kernel(enable_backward=False)
def walk(point: wp.array[float], chunk_sum: wp.array[int], step: int, sum_out: wp.array[float]):
    """Thread i reads i points that are so far apart, then writes i chunks' numbers."""
    i = wp.tid()
    total = wp.float32(0.0)
    for k in range(i):
        total += point[k * step]
    for k in range(i):
        wp.atomic_add(chunk_sum, -1 - k, 1)
    sum_out[i] = total


def walked(counter):
    """What is counted of threads that visit known chunks, of 100 of them."""
    point, chunk_sum = wp.zeros(100 * CHUNK, dtype=float), wp.zeros(100, dtype=int)
    found = []
    for step in (1, CHUNK, 2 * CHUNK):
        counter.table.clear()
        launch = [walk, 41, [point, chunk_sum, step], [wp.zeros(41, dtype=float)]]
        counter.count(lambda launch=launch: wp.launch(*launch), lambda: (100 * CHUNK, 100))
        found += counter.table.values()
    counter.table.clear()
    return found


# ---- scenes


def river(points):
    """A river in full bend, with necks that have not been cut yet where those are cut that are a third wider."""
    (line,) = bench.cut_lines([points], river_points=5_000, years=200.0)
    return line


def ring(line):
    """The same bent round a circle, its last point beside its first."""
    along = line[-1] - line[0]
    length = np.hypot(*along)
    along /= length
    x, y = (line - line[0]) @ along, (line - line[0]) @ np.array([-along[1], along[0]])
    length += bench.SPACING
    angle, radius = 2.0 * np.pi * x / length, length / (2.0 * np.pi) + y
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def scenes(points):
    """Simulations of one channel of that many points, by name."""
    line = river(points)
    plain, paths = plain_params(cutoff_distance=1.3), PathMeander(spacing=bench.SPACING)
    for name, params in (("plain", plain), ("paths", paths)):
        for closed in (False, True):
            xy = ring(line) if closed else line
            network = RiverNetwork.from_polylines([xy], bench.WIDTH, closed=closed)
            yield f"{name}, a ring" if closed else name, Simulation(network, params, capture=False, threads=1)


def steps_of(sim, counter):
    """What the threads of each kernel visit at most in two steps, and what happens in them."""
    begin = time.perf_counter()
    counter.table.clear()

    def lengths():
        if len(sim.network.point_xy) != sim.stepper.state.point_capacity:
            raise RuntimeError("arrays by point are of several lengths, of which one is counted")
        return sim.stepper.state.point_capacity, sim.stepper.state.chunk_count

    counter.count(lambda: [sim.step() for _ in range(2)], lengths)
    return {
        "kernels": counter.table.copy(),
        "points": sim.network.point_count,
        "cutoffs": len(sim.history.cutoffs),
        "seconds": time.perf_counter() - begin,
    }


def main(points):
    """Print for every scene what the threads of each kernel visit at most in two steps."""
    counter = Counter()
    told = {"walked": walked(counter), "scenes": {}}
    river(points)  # not yet in chunks, which would take longer
    buffers.CPU_CHUNK = CHUNK
    for name, sim in scenes(points):
        told["scenes"][name] = steps_of(sim, counter)
    print(json.dumps(told))


if __name__ == "__main__":
    with wp.ScopedDevice("cpu"):
        main(int(sys.argv[1]))
