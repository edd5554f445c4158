"""What every kernel asks of a GPU: registers, spills, shared memory, code, and the occupancy that they allow.

The compiler for CUDA is in Warp's wheel, so that no GPU is needed. Cubins are kept in Warp's kernel cache under a hash
of the source: what the tests have compiled is not compiled again.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import json
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import warp as wp
from cubin import KernelFigures, read_kernels
from machine import machine

FOLDER = Path(__file__).resolve().parents[1] / "kernels"
RESULTS = Path(__file__).parent / "results"
SCALARS = {"float64": wp.float64, "float32": wp.float32}
ARCHS = (80, 90, 100)
WARP_THREADS = 32
# Registers of a multiprocessor on every architecture below; a warp gets them in units, from one of four partitions.
REGISTERS, PARTITIONS, REGISTER_UNIT = 65_536, 4, 256
# Shared memory that the system takes in each block, and the unit it is given in.
RESERVED_SHARED, SHARED_UNIT = 1024, 128
LOW_OCCUPANCY = 0.25
BLOCK_DIMS = (256, 128, 64, 32)


@dataclass(frozen=True)
class Multiprocessor:
    """Limits of a multiprocessor (CUDA C++ Programming Guide, "Compute Capabilities"); shared memory in bytes."""

    warps: int
    blocks: int
    shared: int


MULTIPROCESSORS = {
    80: Multiprocessor(64, 32, 164 * 1024),
    86: Multiprocessor(48, 16, 100 * 1024),
    89: Multiprocessor(48, 24, 100 * 1024),
    90: Multiprocessor(64, 32, 228 * 1024),
    100: Multiprocessor(64, 32, 228 * 1024),
}


def occupancy(registers: int, shared: int, block_dim: int, multiprocessor: Multiprocessor) -> float:
    """Share of a multiprocessor's warps that can be resident: what hides the latency of memory.

    Args:
        registers: Registers a thread.
        shared: Shared memory, bytes a block, without the system's own.
        block_dim: Threads a block.
        multiprocessor: Its limits.
    """
    block_warps = -(-block_dim // WARP_THREADS)
    warp_registers = -(-registers * WARP_THREADS // REGISTER_UNIT) * REGISTER_UNIT
    register_warps = REGISTERS // PARTITIONS // max(warp_registers, 1) * PARTITIONS
    block_shared = -(-(shared + RESERVED_SHARED) // SHARED_UNIT) * SHARED_UNIT
    blocks = min(
        multiprocessor.blocks,
        multiprocessor.warps // block_warps,
        register_warps // block_warps,
        multiprocessor.shared // block_shared,
    )
    return blocks * block_warps / multiprocessor.warps


@functools.cache
def kernel_files() -> list[str]:
    """Stems of the files that hold kernels; the others hold functions that these share."""
    stems = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem != "__init__")
    return [stem for stem in stems if built_kernels(stem, wp.float64)]


def targets_of(stem: str) -> tuple[tuple[str, int], tuple[str, int]]:
    """Precisions and architectures that the tests compile a file for.

    The usual precision for the middle architecture; the other precision for the oldest and the newest in turn, since a
    kernel that fails on one of them alone has not been seen, and each target takes a second or more.
    """
    return ("float64", 90), ("float32", (80, 100)[kernel_files().index(stem) % 2])


def built_kernels(stem: str, scalar: type) -> list[wp.Kernel]:
    """Kernels of a file in one precision."""
    file = importlib.import_module(f"warpriver.kernels.{stem}")
    namespace = vars(file.build(scalar)) if hasattr(file, "build") else {}
    return [value for value in namespace.values() if isinstance(value, wp.Kernel)]


def kernel_module(stem: str, scalar: type) -> wp.Module:
    """Warp module of a file in one precision."""
    (module,) = {kernel.module for kernel in built_kernels(stem, scalar)}
    return module


def compile_cubin(module: wp.Module, arch: int) -> bytes:
    """Machine code of a module for one architecture, from Warp's kernel cache where it is there.

    Raises:
        RuntimeError: A kernel does not compile for CUDA.
    """
    (path,) = wp.compile_aot_module(module, arch=arch, use_ptx=False)
    return path.read_bytes()


def plain_name(symbol: str) -> str:
    """Name of a kernel in its file: ``build__locals__move_points_0123abcd_cuda_kernel_forward`` is ``move_points``."""
    found = re.fullmatch(r"(?:\w*__locals__)?(\w+?)(?:_[0-9a-f]{8})?_cuda_kernel_(?:forward|backward)", symbol)
    if not found:
        raise ValueError(f"{symbol} is no name that Warp gives to a kernel")
    return found[1]


def kernel_row(stem: str, dtype: str, figures: KernelFigures, block_dim: int) -> dict:
    """A kernel's figures and what follows from them."""
    limits = MULTIPROCESSORS[figures.arch]
    reached = {dim: occupancy(figures.registers, figures.shared, dim, limits) for dim in (block_dim, *BLOCK_DIMS)}
    best = max(reached, key=lambda dim: (reached[dim], dim == block_dim, dim))
    flags = ["spills"] * (figures.spills > 0) + ["low occupancy"] * (reached[block_dim] < LOW_OCCUPANCY)
    return (
        {"file": stem, "dtype": dtype}
        | asdict(figures)
        | {
            "name": plain_name(figures.name),
            "block_dim": block_dim,
            "occupancy": reached[block_dim],
            "best_block_dim": best,
            "best_occupancy": reached[best],
            "flags": flags,
        }
    )


def measure(stems: Iterable[str], targets: Iterable[tuple[str, int]], block_dim: int | None = None) -> list[dict]:
    """One row for each kernel on each target.

    Args:
        stems: Kernel files.
        targets: Pairs of precision and architecture.
        block_dim: Threads a block; by default as many as Warp launches the file's kernels with.
    """
    rows, targets = [], list(targets)
    for stem in stems:
        for dtype, arch in targets:
            module = kernel_module(stem, SCALARS[dtype])
            dim = block_dim or int(module.options["block_dim"])
            rows += [kernel_row(stem, dtype, f, dim) for f in read_kernels(compile_cubin(module, arch))]
    return rows


def print_rows(rows: list[dict]) -> None:
    """The whole table."""
    heads = f"{'regs':>4} {'local':>5} {'spills':>6} {'shared':>6} {'code':>6} {'occupancy':>9}  better at"
    print(f"{'kernel':<32} {'dtype':<7} {'sm':>3} {heads}")
    for row in rows:
        cells = [f"{row['file'] + '.' + row['name']:<32} {row['dtype']:<7} {row['arch']:>3} {row['registers']:>4}"]
        cells += [f"{row['local']:>5} {row['spills']:>6} {row['shared']:>6} {row['code']:>6} {row['occupancy']:>9.1%} "]
        better = row["best_occupancy"] > row["occupancy"]
        cells += [f"{row['best_block_dim']} ({row['best_occupancy']:.1%})" if better else ""] + row["flags"]
        print(*cells)


def print_short(rows: list[dict]) -> None:
    """A line for each kernel: its registers on each architecture, and marks."""
    columns = list(dict.fromkeys((row["dtype"], row["arch"]) for row in rows))
    table: dict[str, dict] = {}
    for row in rows:
        mark = "s" * ("spills" in row["flags"]) + "o" * ("low occupancy" in row["flags"]) + "l" * (row["local"] > 0)
        table.setdefault(f"{row['file']}.{row['name']}", {})[row["dtype"], row["arch"]] = f"{row['registers']}{mark}"
    print(f"{'registers a thread':<32}" + "".join(f" {'f' + dtype[5:]:>4} sm_{arch:<3}" for dtype, arch in columns))
    for name, cells in table.items():
        print(f"{name:<32}" + "".join(f" {cells.get(column, ''):>11}" for column in columns))
    print("s: spills registers; o: under 25 % occupancy; l: arrays in local memory (or what is spilled)")


def print_summary(rows: list[dict]) -> None:
    """How many kernels there are, and which are flagged."""
    kernels, most = {(r["file"], r["name"]) for r in rows}, max(r["registers"] for r in rows)
    print(f"{len(kernels)} kernels, {len(rows)} figures; {most} registers at most")
    for flag in ("spills", "low occupancy"):
        found = sorted({f"{r['file']}.{r['name']}" for r in rows if flag in r["flags"]})
        print(f"{flag}: {', '.join(found) or 'none'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--arch", type=int, nargs="+", choices=MULTIPROCESSORS, default=ARCHS, help="architectures (default 80 90 100)"
    )
    parser.add_argument("--dtype", nargs="+", choices=SCALARS, default=list(SCALARS), help="precisions (default both)")
    parser.add_argument("--file", nargs="+", choices=kernel_files(), default=kernel_files(), help="default all")
    parser.add_argument("--block-dim", type=int, help="threads a block (default: as Warp launches, 256)")
    parser.add_argument(
        "--short", action="store_true", help="a line a kernel, for what the tests have compiled; nothing is written"
    )
    parser.add_argument("-o", "--out", help="JSON to write (default results/cuda-kernels.json)")
    options = parser.parse_args()
    if options.block_dim is not None and not 1 <= options.block_dim <= 1024:
        parser.error(f"--block-dim is {options.block_dim}; a block has 1 to 1024 threads")
    wp.config.log_level = wp.LOG_WARNING
    targets = [(dtype, arch) for dtype in options.dtype for arch in options.arch]
    if options.short:
        tested = {stem: [t for t in targets_of(stem) if t in targets] for stem in options.file}
        if not any(tested.values()):
            parser.error("--short: the tests compile none of these; leave out --dtype and --arch, or --short")
        rows = [row for stem, some in tested.items() for row in measure([stem], some, options.block_dim)]
    else:
        rows = measure(options.file, targets, options.block_dim)
    (print_short if options.short else print_rows)(rows)
    print_summary(rows)
    if options.short:
        return
    target = Path(options.out) if options.out else RESULTS / "cuda-kernels.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    head = json.dumps({"benchmark": "cuda_kernels", "machine": machine("cpu")}, indent=2).removesuffix("\n}")
    lines = ",\n".join(f"    {json.dumps(row)}" for row in rows)  # a row a line, so that a change can be read
    target.write_text(f'{head},\n  "kernels": [\n{lines}\n  ]\n}}\n')
    print(f"written to {target}")


if __name__ == "__main__":
    main()
