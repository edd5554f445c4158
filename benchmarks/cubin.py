"""What a kernel asks of a GPU, read from a cubin: an ELF file with NVIDIA's sections, of which few are needed here.

The compiler leaves the figures as attributes in ``.nv.info`` sections. A record is a format byte, an attribute byte
and two bytes that are the value or, in the format ``SIZED``, the length of what follows. CUDA 12 wrote the registers
into the header of ``.text.KERNEL``, too; CUDA 13 no longer does, so that the attribute is read. It also lists the
instructions that spill registers or fill them again, which tells them from arrays that lie in local memory anyway.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

CUDA_MACHINE, SYMBOL_TABLE = 190, 2
SIZED, FRAME_SIZE, MIN_STACK_SIZE, REGISTER_COUNT, ANNOTATIONS = 0x04, 0x11, 0x12, 0x2F, 0x55
# The kind of annotation that marks a spill.
SPILL = 1
# CUDA 13 raised the version of the binary interface and moved the architecture to the second byte of the flags.
NEW_INTERFACE = 8
# From sm_90 on, the shared memory of a kernel that has any begins with what the system reserves in every block.
RESERVED_SHARED, FIRST_WITH_RESERVE = 1024, 90


@dataclass(frozen=True)
class KernelFigures:
    """Resources of one kernel on one architecture.

    Attributes:
        name: Symbol of the kernel.
        arch: Architecture, as 90 for sm_90.
        registers: 32-bit registers a thread.
        local: Bytes a thread of local memory, which lies in DRAM behind the caches: what was spilled, arrays that are
            indexed at run time, and the frames of called functions.
        spills: Instructions that store or load a spilled register.
        shared: Static shared memory of its own, bytes a block.
        code: Bytes of machine code.
    """

    name: str
    arch: int
    registers: int
    local: int
    spills: int
    shared: int
    code: int


class Section(NamedTuple):
    """Header of a section; fields that are not needed are left out."""

    name: str
    kind: int
    size: int
    link: int
    data: bytes


def text_at(table: bytes, offset: int) -> str:
    """String of a string table."""
    return table[offset : table.index(b"\0", offset)].decode()


def read_sections(binary: bytes) -> list[Section]:
    """Sections of a 64-bit little-endian ELF file.

    Args:
        binary: The whole file.

    Raises:
        ValueError: It is no such file, or is cut short.
    """
    if binary[:6] != b"\x7fELF\x02\x01":
        raise ValueError("no 64-bit little-endian ELF file: is it a cubin, and not PTX?")
    no_bits = 8
    try:
        machine = struct.unpack_from("<H", binary, 18)[0]
        start = struct.unpack_from("<Q", binary, 40)[0]
        width, count, names_at = struct.unpack_from("<HHH", binary, 58)
        headers = [struct.unpack_from("<IIQQQQII", binary, start + k * width) for k in range(count)]
    except struct.error as error:
        raise ValueError("the ELF file is cut short; compile it again") from error
    if machine != CUDA_MACHINE:
        raise ValueError(f"the ELF file is for machine {machine}, not for CUDA ({CUDA_MACHINE})")
    bodies = [b"" if h[1] == no_bits else binary[h[4] : h[4] + h[5]] for h in headers]
    if any(len(body) < h[5] for h, body in zip(headers, bodies, strict=True) if h[1] not in (0, no_bits)):
        raise ValueError("the ELF file is cut short; compile it again")
    names = bodies[names_at]
    return [Section(text_at(names, h[0]), h[1], h[5], h[6], b) for h, b in zip(headers, bodies, strict=True)]


def read_symbols(sections: list[Section]) -> list[str]:
    """Names of the symbols, by their index."""
    (table,) = (section for section in sections if section.kind == SYMBOL_TABLE)
    strings = sections[table.link].data
    return [text_at(strings, offset) for offset, *_ in struct.iter_unpack("<I20x", table.data)]


def read_attributes(info: bytes) -> Iterator[tuple[int, bytes]]:
    """Attributes and values of a ``.nv.info`` section."""
    offset = 0
    while offset < len(info):
        form, attribute, value = struct.unpack_from("<BBH", info, offset)
        offset += 4
        if form == SIZED:
            yield attribute, info[offset : offset + value]
            offset += value
        else:
            yield attribute, struct.pack("<H", value)


def architecture(binary: bytes) -> int:
    """Architecture that a cubin runs on, as 90 for sm_90."""
    (flags,) = struct.unpack_from("<I", binary, 48)
    return (flags >> 8) & 0xFF if binary[8] >= NEW_INTERFACE else flags & 0xFF


def resource_tables(info: bytes, symbols: list[str]) -> dict[int, dict[str, int]]:
    """Figures of the file's own ``.nv.info``: for each attribute that is needed, the value by symbol."""
    tables: dict[int, dict[str, int]] = {FRAME_SIZE: {}, MIN_STACK_SIZE: {}, REGISTER_COUNT: {}}
    for attribute, value in read_attributes(info):
        if attribute in tables:
            symbol, figure = struct.unpack("<II", value)
            tables[attribute][symbols[symbol]] = figure
    return tables


def count_spills(info: bytes) -> int:
    """Spilling instructions that a kernel's ``.nv.info`` lists, as pairs of kind and place."""
    lists = [value for attribute, value in read_attributes(info) if attribute == ANNOTATIONS]
    return sum(kind == SPILL for value in lists for kind, _ in struct.iter_unpack("<II", value))


def read_kernels(binary: bytes) -> list[KernelFigures]:
    """Figures of the kernels of a cubin, by name.

    Args:
        binary: The whole file.

    Raises:
        ValueError: It is no cubin, is cut short, or does not tell the registers of a kernel.
    """
    sections = read_sections(binary)
    arch = architecture(binary)
    by_name = {section.name: section for section in sections}
    if ".nv.info" not in by_name:
        raise ValueError("the file has no section .nv.info: is it a linked cubin?")
    tables = resource_tables(by_name[".nv.info"].data, read_symbols(sections))
    figures = []
    # A kernel has an information section of its own; a function that it calls has code alone.
    for name in sorted(s.name.removeprefix(".nv.info.") for s in sections if s.name.startswith(".nv.info.")):
        if name not in tables[REGISTER_COUNT]:
            raise ValueError(f"the cubin does not tell the registers of {name}")
        shared = by_name[f".nv.shared.{name}"].size if f".nv.shared.{name}" in by_name else 0
        figures.append(
            KernelFigures(
                name=name,
                arch=arch,
                registers=tables[REGISTER_COUNT][name],
                # The least stack counts what the kernel calls, too; recursion would leave it out.
                local=max(tables[table].get(name, 0) for table in (MIN_STACK_SIZE, FRAME_SIZE)),
                spills=count_spills(by_name[f".nv.info.{name}"].data),
                shared=max(0, shared - RESERVED_SHARED) if arch >= FIRST_WITH_RESERVE else shared,
                code=by_name[f".text.{name}"].size,
            )
        )
    return figures
