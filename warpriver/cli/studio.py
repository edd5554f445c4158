"""``warpriver studio``: shape living rivers in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from warpriver.cli.output import say
from warpriver.cli.shared import OK, command, quiet_warp

__all__ = ["add"]

LOCAL = "127.0.0.1"


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "studio",
        _studio,
        help="shape living rivers in the browser",
        description="Open a page on this machine in which rivers migrate while you drag their bends, draw and\n"
        "erase channels, raise and lower the ground, and paint where they are drawn to. INPUT is a scene\n"
        "(.toml), a terrain, river lines, or a stored run at its beginning; without it a basin with its rivers\n"
        "is made.\n"
        "\n"
        "The page needs the link that is printed: it holds a secret. Only this machine reaches the server, unless\n"
        "--host opens it to others. Ctrl-C ends it.",
        epilog="examples:\n"
        "  warpriver studio\n"
        "  warpriver studio dem.tif\n"
        "  warpriver studio demos/scenes/basin.toml --folder out/session\n"
        "  warpriver studio --port 8123 --no-browser",
    )
    parser.add_argument("input", nargs="?", metavar="INPUT", help="scene, terrain, river lines or stored run")
    parser.add_argument("--port", type=_port, default=0, metavar="N", help="port (default: a free one)")
    parser.add_argument(
        "--host", default=LOCAL, metavar="ADDRESS",
        help=f"address to listen on (default {LOCAL}: this machine only); others need the link",
    )  # fmt: skip
    parser.add_argument("--no-browser", action="store_true", help="print the link only")
    parser.add_argument(
        "--folder", metavar="DIR", help="keep the session there, a new folder or one of an earlier session, which goes "
        "on (default: nothing is kept)",
    )  # fmt: skip


def _port(text: str) -> int:
    try:
        port = int(text)
    except ValueError:
        port = -1
    if not 0 <= port <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no port; give 0 to 65535")
    return port


def _studio(options: argparse.Namespace) -> int:
    quiet_warp()
    from warpriver.studio.serving import serve

    def tell(link: str) -> None:
        if options.host != LOCAL:
            say(f"warning: {options.host} lets other machines in; whoever has the link can work in this session")
        say(f"warpriver studio: {link}")
        say("Ctrl-C ends it")

    folder = None if options.folder is None else Path(options.folder)
    source = None if options.input is None else Path(options.input)
    serve(source, folder=folder, host=options.host, port=options.port, browser=not options.no_browser, started=tell)
    return OK
