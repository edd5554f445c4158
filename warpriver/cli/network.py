"""``warpriver network``: the rivers of a terrain."""

from __future__ import annotations

import argparse
from typing import Any

from warpriver.cli.output import say
from warpriver.cli.parser import area, number, whole_number
from warpriver.cli.shared import (
    OK,
    add_heights,
    add_systems,
    check_out,
    check_picture,
    command,
    quiet_warp,
    read_ground,
)

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "network",
        _network,
        help="find the rivers of a terrain and write them as lines",
        description="Route water over a terrain, keep the channels that drain enough ground, and write them with\n"
        "their width, depth, bankfull discharge and elevation, which never rises downstream. Depressions are opened\n"
        "by carving first.",
        epilog="examples:\n"
        "  warpriver network dem.tif --min-area 2 -o rivers.gpkg --picture rivers.png\n"
        "  warpriver network dem.asc --crs EPSG:4326 --to-crs utm -o rivers.csv",
    )
    parser.add_argument("terrain", metavar="TERRAIN", help="heights: GeoTIFF, ESRI ASCII, npz ...")
    parser.add_argument(
        "-o", "--out", required=True, metavar="FILE", help="lines to write; the ending names the format: .gpkg .csv ..."
    )
    parser.add_argument("--picture", metavar="FILE", help="also draw the network over the shaded terrain, by order")
    rivers = parser.add_argument_group("rivers")
    rivers.add_argument(
        "--min-area",
        type=area,
        default=area("1"),
        metavar="AREA",
        help="minimum drainage area of a channel: 1 or 1km2, 5e5m2, 50cells (default 1km2)",
    )
    rivers.add_argument(
        "--spacing",
        type=number(above=0.0, unit="m"),
        metavar="M",
        help="distance between the points of a channel in m (default: a cell)",
    )
    rivers.add_argument(
        "--smoothing-passes",
        type=whole_number(),
        default=4,
        metavar="N",
        help="passes that smooth the courses, which run from cell to cell (default 4)",
    )
    rivers.add_argument(
        "--fill",
        action="store_true",
        help="fill depressions instead of carving them open: finds more of the rivers of flat, leveed ground",
    )
    rivers.add_argument(
        "--shape-junctions",
        action="store_true",
        help="bend the last reaches of tributaries so that they arrive at the angles that fit their flows",
    )
    ground = parser.add_argument_group("terrain")
    add_systems(ground, "a file")
    add_heights(ground)


def _network(options: argparse.Namespace) -> int:
    from warpriver import hydrology
    from warpriver.io.vector.networks import line_formats, write_network

    out = check_out(options.out, "-o", line_formats())
    picture = None if options.picture is None else check_picture(options.picture, "--picture")
    quiet_warp()
    terrain = read_ground(options.terrain, options)
    network = hydrology.extract_network(
        terrain,
        min_drainage_area=options.min_area.square_meters(terrain.cell_size),
        spacing=options.spacing,
        smoothing=options.smoothing_passes,
        carve=not options.fill,
    )
    if options.shape_junctions:
        from warpriver.meander.junctions import shape_junctions

        network = shape_junctions(network)
    network = hydrology.drape(network, terrain)
    write_network(network, out)
    told = [repr(terrain), repr(network)]
    area = network.channel_drainage_area
    if area is not None:
        flow = network.channel_discharge.max()
        told.append(f"largest drainage area {area.max() / 1e6:.4g} km2, bankfull discharge {flow:.4g} m3/s")
    told.append(f"{out}")
    try:
        if picture is not None:
            from warpriver import viz

            order = hydrology.strahler_order(network.channel_from, network.channel_to)
            viz.draw_network(network, picture, terrain=terrain, color="order", order=order)
            told.append(f"{picture}")
    finally:
        for line in told:
            say(line)
    return OK
