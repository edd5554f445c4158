"""The figures of compiled kernels: the reader of cubins, and the occupancy that follows from what it reads."""

import struct

import pytest
import warp as wp
from cubin import KernelFigures, read_kernels
from cuda_kernels import MULTIPROCESSORS, compile_cubin, kernel_row, occupancy, plain_name, print_short, print_summary

SYMBOL = "build__locals__move_points_0123abcd_cuda_kernel_forward"
CALLED = "$called_function"


def sized(attribute, *words):
    return struct.pack(f"<BBH{len(words)}I", 4, attribute, 4 * len(words), *words)


def made_cubin(arch=90, interface=8, registers=80, shared=3072, stack=96, annotations=(), own=True):
    """A cubin with one kernel that calls one function, written from the ELF specification."""
    info = b"".join(
        [
            sized(0x2F, 1, registers) if own else b"",
            sized(0x11, 1, 40),
            sized(0x11, 2, 8),
            sized(0x12, 1, stack),
        ]
    )
    # A value of half a word, one of a byte, then a list: records of the three formats in a row.
    kernel_info = struct.pack("<BBH", 3, 0x1B, 255) + struct.pack("<BBBx", 2, 0x4C, 1) + sized(0x55, *annotations)
    symbol_names = b"\0" + SYMBOL.encode() + b"\0" + CALLED.encode() + b"\0"
    symbols = struct.pack("<IBBHQQ", 0, 0, 0, 0, 0, 0)
    symbols += struct.pack("<IBBHQQ", 1, 0x12, 0, 5, 0, 640)
    symbols += struct.pack("<IBBHQQ", 2 + len(SYMBOL), 0x02, 0, 5, 0, 64)
    parts = [("", 0, b"", 0, 0), (".strtab", 3, symbol_names, 0, 0), (".symtab", 2, symbols, 1, 0)]
    parts += [(".nv.info", 0x70000000, info, 2, 0), (f".nv.info.{SYMBOL}", 0x70000000, kernel_info, 2, 0)]
    parts += [(f".text.{SYMBOL}", 1, bytes(640), 2, 0)]
    parts += [(f".nv.shared.{SYMBOL}", 8, b"", 0, shared)] if shared else []
    names = b"".join(name.encode() + b"\0" for name, *_ in parts) + b".shstrtab\0"
    parts.append((".shstrtab", 3, names, 0, 0))
    body, headers, name_at = b"", b"", 0
    for name, kind, data, link, size in parts:
        headers += struct.pack("<IIQQQQIIQQ", name_at, kind, 0, 0, 64 + len(body), size or len(data), link, 0, 1, 0)
        name_at += len(name) + 1
        body += data
    flags = 0x06000002 | arch << 8 if interface >= 8 else arch
    start = b"\x7fELF\x02\x01\x01" + bytes([65, interface]) + bytes(7)
    start += struct.pack(
        "<HHIQQQIHHHHHH", 2, 190, 1, 0, 0, 64 + len(body), flags, 64, 56, 0, 64, len(parts), len(parts) - 1
    )
    return start + body + headers


@pytest.mark.parametrize("interface", [7, 8])
@pytest.mark.parametrize(("arch", "shared"), [(80, 3072), (90, 2048), (100, 2048)])
def test_figures_of_a_made_file(arch, interface, shared):
    """From sm_90 on, 1,024 bytes of shared memory are the system's."""
    (found,) = read_kernels(made_cubin(arch, interface, annotations=(1, 0x40, 1, 0x90, 7, 0xA0)))
    assert found == KernelFigures(SYMBOL, arch, registers=80, local=96, spills=2, shared=shared, code=640)


def test_figures_of_a_kernel_without_memory_of_its_own():
    (found,) = read_kernels(made_cubin(shared=0, stack=0))
    assert (found.shared, found.spills) == (0, 0)
    assert found.local == 40  # the frame of the kernel, where the stack is not told


@pytest.mark.parametrize("kept", [0, 10, 60, 200, 900])
def test_a_file_cut_short_is_told(kept):
    with pytest.raises(ValueError, match="ELF file"):
        read_kernels(made_cubin()[:kept])


def test_other_files_are_told():
    with pytest.raises(ValueError, match="and not PTX"):
        read_kernels(b".version 9.0\n.target sm_90\n")
    intel = bytearray(made_cubin())
    intel[18:20] = struct.pack("<H", 62)
    with pytest.raises(ValueError, match="machine 62"):
        read_kernels(bytes(intel))
    with pytest.raises(ValueError, match="registers of build__locals__move_points"):
        read_kernels(made_cubin(own=False))


@wp.func_native("""
double held[96];
#pragma unroll
for (int k = 0; k < 96; ++k) held[k] = source.data[96 * i + k];
__threadfence();
double sum = 0.0;
#pragma unroll
for (int k = 0; k < 96; ++k) sum += held[k] * held[(7 * k) % 96];
return sum;
""")
def sum_held(source: wp.array[wp.float64], i: int) -> wp.float64: ...


def compiled_figures(function, arch=90, **options):
    kernel = wp.kernel(function, module="unique", enable_backward=False, **options)
    (found,) = read_kernels(compile_cubin(kernel.module, arch))
    return found


@pytest.mark.parametrize("arch", [80, 90])
def test_spills_of_a_real_kernel_are_seen(arch):
    """96 float64 that live at once need 192 registers: they fit in 255, and not in 64."""

    def hold_values(source: wp.array[wp.float64], sum_out: wp.array[wp.float64]):
        i = wp.tid()
        sum_out[i] = sum_held(source, i)

    free = compiled_figures(hold_values, arch)
    tight = compiled_figures(hold_values, arch, cuda_max_registers=64)
    assert 192 < free.registers <= 255 and free.spills == free.local == 0
    # At least 192 - 64 registers of 4 bytes lie outside, each stored once and loaded once, two at a time at best.
    assert tight.registers <= 64 and tight.local >= 4 * (192 - 64) and tight.spills >= 192 - 64


def test_an_array_indexed_at_run_time_is_no_spill():
    """64 floats in local memory, which no register can hold since registers have no index."""
    vec64 = wp.types.vector(64, float)

    def permute_values(order: wp.array[int], value_out: wp.array[float]):
        held = vec64()
        for k in range(order.shape[0]):
            held[order[k]] = float(k)
        for k in range(order.shape[0]):
            value_out[k] = held[k]

    found = compiled_figures(permute_values)
    assert found.local >= 4 * 64 and found.spills == 0


# Worked out by hand after the rules of NVIDIA's occupancy calculator: registers, shared bytes, threads a block, and
# the warps that are resident.
BY_HAND = {
    80: [(32, 0, 256, 64), (40, 0, 256, 48), (64, 0, 256, 32), (128, 0, 256, 16), (129, 0, 256, 8), (255, 0, 256, 8)]
    + [(168, 0, 128, 12), (168, 0, 256, 8), (32, 48 * 1024, 256, 24), (16, 0, 32, 32), (32, 0, 1024, 64)],
    90: [(32, 0, 256, 64), (33, 0, 256, 48), (162, 1024, 64, 12), (32, 48 * 1024, 256, 32), (16, 0, 32, 32)],
    89: [(32, 0, 256, 48), (64, 0, 256, 32), (16, 0, 32, 24), (32, 48 * 1024, 256, 16)],
}


@pytest.mark.parametrize("arch", BY_HAND)
def test_occupancy_against_figures_by_hand(arch):
    limits = MULTIPROCESSORS[arch]
    for registers, shared, block_dim, warps in BY_HAND[arch]:
        assert occupancy(registers, shared, block_dim, limits) == warps / limits.warps, (registers, shared, block_dim)


@pytest.mark.parametrize(
    ("symbol", "name"),
    [
        (SYMBOL, "move_points"),
        ("permute_values_0123abcd_cuda_kernel_forward", "permute_values"),
        ("outer__locals__inner__locals__find_it_89abcdef_cuda_kernel_backward", "find_it"),
        ("move_points_cuda_kernel_forward", "move_points"),
    ],
)
def test_plain_names(symbol, name):
    assert plain_name(symbol) == name


def test_rows_are_flagged(capsys):
    light = KernelFigures(SYMBOL, 90, registers=40, local=64, spills=0, shared=1024, code=640)
    heavy = KernelFigures(SYMBOL, 100, registers=168, local=64, spills=9, shared=1024, code=640)
    rows = [kernel_row("migration", "float64", figures, 256) for figures in (light, heavy)]
    assert [row["flags"] for row in rows] == [[], ["spills", "low occupancy"]]
    assert [row["best_block_dim"] for row in rows] == [256, 128]
    assert rows[1]["occupancy"] == 8 / 64 and rows[1]["best_occupancy"] == 12 / 64
    print_short(rows)
    print_summary(rows)
    printed = capsys.readouterr().out
    (line,) = (line for line in printed.splitlines() if line.startswith("migration.move_points"))
    assert line.split() == ["migration.move_points", "40l", "168sol"]
    assert "spills: migration.move_points" in printed
