"""``warpriver bench``: what a step costs on this machine."""

from __future__ import annotations

import argparse
from typing import Any

from warpriver import __version__
from warpriver.cli.output import say
from warpriver.cli.parser import whole_number
from warpriver.cli.shared import OK, check_out, command, quiet_warp

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "bench",
        _bench,
        help="what a step costs on this machine",
        description="Let synthetic rivers in full bend, 50 m wide with a point every 50 m, go on, and measure\n"
        "their steps: time a step and a point, by phase, and beside a plain copy of memory in the same run.\n"
        "Memory: about 150 bytes a point, and 1 GB for the copy. The whole suite, with peers, is benchmarks/.",
        epilog="examples:\n"
        "  warpriver bench\n"
        "  warpriver bench --points 1000000 --channels 1000 --threads 1\n"
        "  warpriver bench --device cuda --points 10000000 --channels 10000 --json gpu.json",
    )
    scene = parser.add_argument_group("scene")
    scene.add_argument(
        "--points", type=whole_number(3), default=100_000, metavar="N", help="points, about (default 100000)"
    )
    scene.add_argument(
        "--channels",
        type=whole_number(1),
        default=100,
        metavar="N",
        help="channels that share the points evenly (default 100)",
    )
    scene.add_argument("--on-slopes", action="store_true", help="put a terrain under them, whose slope is felt")
    scene.add_argument("--no-cutoffs", action="store_true", help="cut no necks off")
    scene.add_argument("--no-collisions", action="store_true", help="do not look for channels that touch")
    where = parser.add_argument_group("machine")
    where.add_argument("--device", default="cpu", help='"cpu", "cuda", "cuda:1" ... (default cpu)')
    where.add_argument("--dtype", default="float64", choices=("float64", "float32"), help="precision (default float64)")
    where.add_argument(
        "--threads", type=whole_number(1), metavar="N", help="threads on the CPU (default: one for each core)"
    )
    parser.add_argument("--json", metavar="FILE", help="also write the figures into a file")


def _bench(options: argparse.Namespace) -> int:
    import json

    quiet_warp()
    from warpriver import bench
    from warpriver.files import beside

    target = None if options.json is None else check_out(options.json, "--json", (".json",))
    found = bench.measure(
        options.points,
        options.channels,
        device=options.device,
        dtype=options.dtype,
        threads=options.threads,
        terrain=options.on_slopes,
        cutoffs=not options.no_cutoffs,
        collisions=not options.no_collisions,
    )
    hands = f"{found['threads']} thread{'s' * (found['threads'] != 1)}"
    parts = ["migration"] + [name for name in ("cutoffs", "collisions", "terrain") if found[name]]
    say(f"{found['device']}, {hands}, {found['dtype']}: {', '.join(parts)}")
    say(f"  scene    {found['points']} points in {found['channels']} channels")
    say(
        f"  step     {found['ms_per_step']:.4g} ms, {found['ns_per_point']:.4g} ns a point; "
        f"{found['cutoffs_per_step']:.3g} cutoffs, {found['bytes_per_point']:.0f} bytes a point on the device"
    )
    total = sum(found["phases_ms"].values())
    shares = [f"{name} {cost / total:.0%}" for name, cost in found["phases_ms"].items()]
    say(f"  phases   {', '.join(shares)}")
    say(
        f"  memory   a copy moves {1e-9 * found['copy_bytes_per_second']:.3g} GB/s (read + written): "
        f"a step takes as long as {found['copies_of_points']:.3g} copies of its points"
    )
    if target is not None:
        with beside(target) as temporary:
            temporary.write_text(json.dumps({"benchmark": "bench", "warpriver": __version__, **found}, indent=2) + "\n")
        say(f"  figures  {target}")
    return OK
