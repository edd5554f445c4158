"""The studio's server."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path

from warpriver.errors import InputError, MissingExtraError, MissingFileError
from warpriver.studio.app import MESSAGE_BYTES, make_app
from warpriver.studio.folder import RUN
from warpriver.studio.guard import LOOPBACK

__all__ = ["serve"]


def serve(
    source: Path | None,
    *,
    folder: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    browser: bool = True,
    started: Callable[[str], None] = print,
) -> None:
    """Serve the studio until it is interrupted.

    Args:
        source: File or run that the session begins with; None for the built-in basin.
        folder: Where the session is kept; one that holds a session goes on with it.
        host: Address to listen on.
        port: Port, 0 for a free one.
        browser: Open the page in the browser.
        started: Is told the link.

    Raises:
        ImportError: ``warpriver[studio]`` is not installed.
        ValueError: The file cannot be opened, or the address is taken.
    """
    try:
        import uvicorn
    except ImportError as error:
        raise MissingExtraError('the studio needs uvicorn: pip install "warpriver[studio]"') from error
    from warpriver.studio.opening import opened

    if source is not None and not source.exists():
        raise MissingFileError(f"no file {source}")
    listening = _listen(host, port)
    with contextlib.closing(listening):
        begun = folder is not None and (folder / RUN).exists()
        if begun and source is not None:
            raise InputError(
                f"{folder} holds a session already; leave INPUT out to go on with it, or give a new folder"
            )
        hosts = LOOPBACK if host in ("127.0.0.1", "localhost", "::1") else ("*",)
        start = None if source is None else opened(source)
        app = make_app(start, folder=folder, hosts=hosts)
        name = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        link = f"http://{name}:{listening.getsockname()[1]}/?token={app.token}"
        config = uvicorn.Config(
            app, log_level="warning", access_log=False, ws="websockets-sansio", ws_max_size=MESSAGE_BYTES,
            ws_per_message_deflate=False, loop="asyncio", timeout_graceful_shutdown=3, server_header=False,
        )  # fmt: skip
        server = uvicorn.Server(config)
        started(link)
        if browser:
            webbrowser.open(link)
        with contextlib.suppress(KeyboardInterrupt, asyncio.CancelledError):
            server.run(sockets=[listening])


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
        listening.listen(256)
    except (OSError, OverflowError) as error:
        listening.close()
        raise InputError(f"cannot listen on {host}, port {port}: {error}") from error
    return listening
