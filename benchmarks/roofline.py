"""What every kernel of a step has to read and write at least: the floor under its time on a given memory.

The table counts elements a point; the bytes follow from the types in the kernels' argument lists, for either
precision. Counted is what a kernel must move even if each element were fetched once only and caches held nothing from
one kernel to the next. On the CPU, where a slab of points goes through several kernels while it is in the cache, less
goes to memory than that; a grid's lists, whose entries lie scattered, move more.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import warp as wp

from warpriver.kernels.channels import Work

# What ``wp.struct`` makes of a class.
Struct = type(Work)
SCALARS = {"float64": wp.float64, "float32": wp.float32}


@dataclasses.dataclass(frozen=True)
class Moved:
    """Elements of one array that a kernel moves.

    Attributes:
        argument: Name in the kernel's argument list; "marks.place" is an array in a struct.
        read: Elements read for each ``per``.
        written: Elements written for each ``per``.
        per: What they are counted by: "point", "channel", "block" (of the search for collisions), "section" (a point,
            where width and depth vary along channels), "link" (a channel, where channels go on in each other or leave
            the map), "terrain" (a point, where there is ground), "controls" (a point, where controls reach), "event"
            (a cutoff, a contact, a whole launch or a group of a running sum: rare, counted as nothing), "ring" (a
            channel, where a network has rings), "chunk" (of 32 points, on a GPU alone), "field" (a point; twice with
            chunks, where a bucket has two fields).
    """

    argument: str
    read: float = 0.0
    written: float = 0.0
    per: str = "point"


@dataclasses.dataclass(frozen=True)
class Launch:
    """A kernel of a step, or memory that is set to 0 in between.

    Attributes:
        phase: Phase of the step, as in ``Stage.phase``.
        file: File of ``kernels/``.
        kernel: Name of the kernel.
        moved: One entry for every array among its arguments.
        only: "chunks" or "slabs" where it is launched only if the work is dealt out so.
    """

    phase: str
    file: str
    kernel: str
    moved: tuple[Moved, ...]
    only: str = ""


def _read(*names: str, per: str = "point") -> tuple[Moved, ...]:
    return tuple(Moved(name, read=1.0, per=per) for name in names)


def _written(*names: str, per: str = "point") -> tuple[Moved, ...]:
    return tuple(Moved(name, written=1.0, per=per) for name in names)


def _running_sum(phase: str, kind: str, per: str, only: str = "") -> tuple[Launch, Launch]:
    """A running sum where there are many values: of groups first, then of all."""
    total = (*_read("value", per=per), *_written("total_out", per="event"))
    final = (*_read("value", per=per), *_read("group_total", "upper_total", per="event"), *_written("sum_out", per=per))
    return Launch(phase, "scans", f"sum_{kind}", total, "chunks"), Launch(phase, "scans", f"scan_{kind}", final, only)


# What tells how channels go on in each other.
STEMS = ("upper", "lower", "top", "bottom", "length", "held")
# What the next run of points needs of its channel.
CHANNELS = (
    *_read("channels.start", "channels.form", "channels.spacing", "channels.step", per="channel"),
    *_read("channels.closed", per="ring"),
    *_read("channels.edge", *(f"channels.stems.{name}" for name in STEMS), per="link"),
)

# A bucket is set to 0, the last point in it exchanged (read and written), and with chunks the highest one raised; then
# each point's search looks one of both up, at least once.
BUCKETS_A_POINT = 4.0
# What the search for necks moves, by slabs or by chunks.
FOUND = (
    *CHANNELS,
    *_read("moved.xy", "near.point_next"), Moved("near.bucket_head", read=BUCKETS_A_POINT),
    *_read("moved.section", per="section"), *_written("cuts_out.point_neck"),
)  # fmt: skip
# Cells that a block looks at for its neighbours, where all channels are of one level, and the integers of a cell.
CELLS_A_BLOCK, CELL_FIELDS = 4.0, 4.0
# Points that a thread takes on a GPU.
CHUNK_POINTS = 32.0

STEP = (
    Launch("migrate", "schedule", "begin_substep", (
        *_read("substep", per="event"), *_written("channel_mobility_out", per="channel"),
        *_written("max_substeps_out", per="event"), Moved("status_io", 1.0, 1.0, per="event"),
    )),
    Launch("migrate", "schedule", "plan_steps", (
        *_read("channel_limits", "channel_mobility", "channel_max_speed", per="channel"),
        *_read("substep", "status", per="event"),
        *_written("channel_substeps_out", per="channel"), Moved("max_substeps_io", 1.0, 1.0, per="event"),
    )),
    Launch("migrate", "schedule", "schedule_channels", (
        *_read("channel_substeps", per="channel"), *_read("max_substeps", per="event"),
        *_written("channel_step_out", "channel_max_speed_out", per="channel"),
        Moved("substep_io", 1.0, 1.0, per="event"), Moved("status_io", 1.0, 1.0, per="event"),
    )),
    Launch("migrate", "migration", "compute_velocity", (
        *CHANNELS, *_read("channels.area", per="ring"), *_read("channels.fed", "channels.inlet", per="link"),
        *_read("points.xy"), *_read("points.section", per="section"), *_written("point_velocity_out"),
        *_written("memory_out.end", "memory_out.fade", "memory_out.terms", "memory_out.ends", per="link"),
    )),
    Launch("migrate", "migration", "move_points", (
        *CHANNELS, *_read("channels.area", per="ring"), *_read("channels.fed", per="link"),
        *_read("points.xy", "velocities.point"), *_read("points.section", per="section"),
        *_read("velocities.tail", per="link"),
        Moved("ground.height", read=4.0, per="terrain"),
        # Of the blocks of controls one a point; what they hold where a block has any.
        *_read("ground.steering.block_mobility", per="controls"), *_read("ground.steering.highest", per="event"),
        *(Moved(f"ground.steering.{name}", read=4.0, per="controls") for name in ("cell_control", "cell_factor")),
        # Four values of a table for each of two scales; as controls, they are told for runs that have them.
        Moved("ground.banks.cell_noise", read=8.0, per="controls"),
        *_written("moved_out.xy"), *_written("moved_out.section", per="section"),
        Moved("channel_max_speed_io", 1.0, 1.0, per="channel"),
    )),
    Launch("cut off", "cutoffs", "insert_points", (
        *CHANNELS, *_read("point_moved"), *_written("point_next_out"), Moved("bucket_head_io", 1.0, 1.0, per="field"),
        # The table by fours; chunks find it emptied by a memset.
        Moved("bucket_row_out", written=BUCKETS_A_POINT / 4.0, per="field"),
    )),
    Launch("cut off", "cutoffs", "find_necks", (
        *FOUND, Moved("chunk_mark_out", per="event"), *_written("cuts_out.share_cut", per="event"),
        *_written("cuts_out.channel_necks", per="channel"),
    ), "slabs"),
    Launch("cut off", "cutoffs", "find_necks_in_chunks", (
        *FOUND, *_written("chunk_mark_out", "cuts_out.share_cut", per="chunk"),
        Moved("cuts_out.channel_necks", per="event"),
    ), "chunks"),
    *_running_sum("cut off", "marks", "chunk", "chunks"),
    Launch("cut off", "cutoffs", "list_marks", (
        *_read("chunk_mark_sum", per="chunk"), *_written("mark_place_out", per="chunk"),
        *_written("mark_chunk_out", per="event"),
    ), "chunks"),
    Launch("cut off", "cutoffs", "select_cuts", (
        *CHANNELS, *_read("cuts_io.channel_necks", per="channel"), *_read("marks.sum", "marks.place", per="chunk"),
        *_read("marks.chunk", "cuts_io.point_neck", per="event"),
        *_written("cuts_io.point_cut", "cuts_io.share_cut", per="event"),
    )),
    *_running_sum("cut off", "pairs", "chunk"),
    Launch("cut off", "cutoffs", "record_cuts", (
        *_read("cuts.share_cut", per="chunk"),
        # Shares without cuts look no further.
        *_read(*(x.argument for x in CHANNELS), per="event"),
        *_read("cuts.channel_necks", "cuts.share_cut_sum", "cuts.point_neck", "cuts.point_cut", per="event"),
        *_written("loops_out.cut", "loops_out.span", "loops_out.xy", "loops_out.section", per="event"),
        *_written("moved_io.xy", per="event"), *_read("moved_io.section", per="event"),
        Moved("status_io", 1.0, 1.0, per="event"),
    )),
    Launch("cut off", "cutoffs", "save_loops", (
        *_read("channels.start", "cuts.share_cut", "cuts.share_cut_sum", per="event"),
        *_read("loops_io.cut", "loops_io.span", "moved_io.section", per="event"),
        *_written("loops_io.xy", "loops_io.section", "moved_io.xy", per="event"),
    )),
    Launch("resample", "resampling", "measure_arcs", (
        *CHANNELS, *_read("point_moved"), *_written("point_arc_out"),
        *_written("chunk_length_out", per="chunk"), Moved("status_io", per="event"),
    )),
    *_running_sum("resample", "lengths", "chunk", "chunks"),
    Launch("resample", "resampling", "count_samples", (
        *CHANNELS, *_read("point_moved", "arcs.point", per="channel"), *_read("arcs.chunk_offset", per="chunk"),
        *_written("channel_samples_out", "channel_spacing_out", per="channel"), Moved("status_io", per="event"),
    )),
    *_running_sum("resample", "counts", "channel"),
    Launch("resample", "resampling", "resample_points", (
        *CHANNELS, *(dataclasses.replace(x, argument=x.argument.replace("channels", "samples")) for x in CHANNELS),
        *_read("moved.xy", "arcs.point"), *_read("moved.section", per="section"),
        *_read("arcs.chunk_offset", per="chunk"),
        *_written("sampled_out.xy"), *_written("sampled_out.section", per="section"),
    )),
    Launch("resample", "resampling", "commit_step", (
        *_read("channel_start_next", "channel_spacing_next", per="channel"),
        Moved("status_io", 1.0, 1.0, per="event"),
        *_written("channel_start_out", "channel_spacing_out", per="channel"),
        Moved("substep_io", 1.0, 1.0, per="event"),
    )),
    Launch("collide", "collisions", "insert_blocks", (
        *CHANNELS, *_read("point_xy", per="block"), *_written("point_next_out", "point_owner_out", per="block"),
        # One cell a point, about, is set to 0; then a block changes the four fields of one.
        Moved("bucket_io", read=0.0, written=CELL_FIELDS), *_written("status_out", per="event"),
    )),
    Launch("collide", "collisions", "find_contacts", (
        *CHANNELS, *_read("channel_nodes", per="channel"),
        *_read("points.xy", per="block"), *_read("points.section", per="event"),
        *_read("index.point_next", "index.point_owner", per="block"), *_read("index.channel_river", per="channel"),
        Moved("index.bucket", read=CELLS_A_BLOCK * CELL_FIELDS, per="block"),
        # Where contacts are listed is for the host, when there are any.
        Moved("contacts_io.pair", per="event"), Moved("contacts_io.share_sum", per="event"),
        Moved("contacts_io.share_count", written=1.0, per="chunk"), Moved("status_io", 1.0, 1.0, per="event"),
    )),
    Launch("collide", "collisions", "count_contacts", (
        *_read("share_contacts", per="event"), Moved("status_io", 1.0, 1.0, per="event"),
    ), "slabs"),
)  # fmt: skip


def _members(label: str, kind: Struct) -> dict[str, Any]:
    """Types of the members of a struct, and of those of structs in it."""
    members = {f"{label}.{name}": member.type for name, member in kind.vars.items()}
    for name, member in list(members.items()):
        if isinstance(member, Struct):
            members |= _members(name, member)
    return members


def argument_sizes(launch: Launch, dtype: str) -> dict[str, int]:
    """Bytes of an element of every array among a kernel's arguments, in their order, those in structs among them."""
    kernel = getattr(importlib.import_module(f"warpriver.kernels.{launch.file}").build(SCALARS[dtype]), launch.kernel)
    arguments = {}
    for a in kernel.adj.args:
        arguments[a.label] = a.type
        # How the work is dealt out is the same for all kernels: a few numbers a launch.
        if a.label != "work" and isinstance(a.type, Struct):
            arguments |= _members(a.label, a.type)
    # Of the types of arguments only that of an array has elements.
    arrays = {label: kind for label, kind in arguments.items() if hasattr(kind, "dtype")}
    return {label: wp.types.type_size_in_bytes(kind.dtype) for label, kind in arrays.items()}


def bytes_per_point(
    launch: Launch,
    dtype: str = "float64",
    *,
    channel_points: float = 1000.0,
    block_points: float = 8.0,
    chunk_points: float = np.inf,
    varying: bool = False,
    terrain: bool = False,
    controls: bool = False,
    rings: bool = False,
    links: bool = False,
) -> tuple[float, float]:
    """Bytes that a kernel reads and writes a point at least; none where it is not launched.

    Args:
        launch: The kernel.
        dtype: "float64" or "float32".
        channel_points: Points of a channel.
        block_points: Points of a block of the search for collisions: 8 widths.
        chunk_points: Points that a thread takes on a GPU; infinite on the CPU, which has no chunks.
        varying: Whether width and depth vary along channels.
        terrain: Whether there is ground.
        controls: Whether controls reach all points.
        rings: Whether the network has rings.
        links: Whether channels go on in each other, or leave the map.
    """
    if launch.only == ("slabs" if np.isfinite(chunk_points) else "chunks"):
        return 0.0, 0.0
    weight = {
        "point": 1.0, "channel": 1.0 / channel_points, "block": 1.0 / block_points, "chunk": 1.0 / chunk_points,
        "section": float(varying), "terrain": float(terrain), "controls": float(controls), "event": 0.0,
        "ring": float(rings) / channel_points, "link": float(links) / channel_points,
        "field": 1.0 + np.isfinite(chunk_points),
    }  # fmt: skip
    size = argument_sizes(launch, dtype)
    read, written = (
        sum(getattr(m, which) * size[m.argument] * weight[m.per] for m in launch.moved) for which in ("read", "written")
    )
    return read, written


def phase_bytes(dtype: str = "float64", launches: Iterable[Launch] = STEP, **shape: float) -> dict[str, float]:
    """Bytes a point, read and written, of each phase; the keywords are those of :func:`bytes_per_point`."""
    found: dict[str, float] = {}
    for launch in launches:
        found[launch.phase] = found.get(launch.phase, 0.0) + sum(bytes_per_point(launch, dtype, **shape))
    return found


def main() -> None:
    """Print the table as ``README.md`` shows it."""
    print("| phase | kernel | read | written | float32 | in chunks |\n| --- | --- | ---: | ---: | ---: | ---: |")

    def figures(launches: Iterable[Launch]) -> list[float]:
        """Bytes read and written, all in float32, and all where threads take chunks of points."""
        kinds = ({}, {"dtype": "float32"}, {"chunk_points": CHUNK_POINTS})
        plain, small, chunked = (np.sum([bytes_per_point(x, **kind) for x in launches], axis=0) for kind in kinds)
        return [*plain, small.sum(), chunked.sum()]

    for launch in STEP:
        cells = " | ".join(f"{figure:.1f}" for figure in figures([launch]))
        print(f"| {launch.phase} | `{launch.kernel}` | {cells} |")
    for name, wanted in (("all but collisions", ("migrate", "cut off", "resample")), ("all", None)):
        chosen = [x for x in STEP if wanted is None or x.phase in wanted]
        print(f"| **{name}** | | " + " | ".join(f"**{figure:.0f}**" for figure in figures(chosen)) + " |")


if __name__ == "__main__":
    main()
