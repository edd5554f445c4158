"""``warpriver network``: the rivers of a terrain."""

from __future__ import annotations

import argparse
from typing import Any

from warpriver.cli.shared import OK, add_heights, command, quiet_warp, read_ground

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "network",
        _network,
        help="find the rivers of a terrain and write them as lines",
        description="Route water over a terrain, take what drains enough ground for a channel, and write the channels\n"
        "with their width, depth, discharge and elevation, which never rises downstream. Depressions are opened by\n"
        "carving first.",
        epilog="examples:\n"
        "  warpriver network dem.tif --min-area 2 -o rivers.gpkg --picture rivers.png\n"
        "  warpriver network dem.asc --crs EPSG:4326 --to-crs utm -o rivers.csv",
    )
    parser.add_argument("terrain", metavar="TERRAIN", help="heights: GeoTIFF, ESRI ASCII, npz ...")
    parser.add_argument("-o", "--out", required=True, metavar="FILE", help="lines to write; the ending says the format")
    parser.add_argument(
        "--min-area", type=float, default=1.0, metavar="KM2", help="least drainage area of a channel in km2 (default 1)"
    )
    parser.add_argument("--spacing", type=float, metavar="M", help="distance between points in m (default: the cell)")
    parser.add_argument("--smoothing", type=int, default=4, metavar="N", help="passes that smooth courses (default 4)")
    parser.add_argument("--picture", metavar="FILE", help="also draw the network over the shaded terrain, by order")
    parser.add_argument(
        "--fill",
        action="store_true",
        help="fill depressions instead of carving them open: finds more of the rivers of flat, leveed ground",
    )
    parser.add_argument("--crs", help="coordinate reference system of a file that does not say")
    parser.add_argument("--to-crs", help='reproject, e.g. EPSG:32619, or "utm" for the zone of the data')
    add_heights(parser)


def _network(options: argparse.Namespace) -> int:
    from warpriver import hydrology
    from warpriver.io.vector.networks import write_network

    quiet_warp()
    terrain = read_ground(options.terrain, options)
    print(terrain)
    network = hydrology.extract_network(
        terrain,
        min_drainage_area=1e6 * options.min_area,
        spacing=options.spacing,
        smoothing=options.smoothing,
        carve=not options.fill,
    )
    network = hydrology.drape(network, terrain)
    print(network)
    area = network.channel_drainage_area
    if area is not None:
        print(f"largest drainage area {area.max() / 1e6:.4g} km2, discharge {network.channel_discharge.max():.4g} m3/s")
    write_network(network, options.out)
    print(options.out)
    if options.picture is not None:
        from warpriver import viz

        order = hydrology.strahler_order(network.channel_from, network.channel_to)
        viz.draw_network(network, options.picture, terrain=terrain, color="order", order=order)
        print(options.picture)
    return OK
