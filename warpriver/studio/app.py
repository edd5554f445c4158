"""The studio's application: the page, the socket, uploads and downloads."""

from __future__ import annotations

import asyncio
import contextlib
import re
import shutil
import tempfile
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from warpriver.errors import InputError, MissingExtraError
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.scenes import Scene
from warpriver.simulation import Simulation
from warpriver.studio.folder import RUN, begin_folder
from warpriver.studio.guard import LOOPBACK, Guard, new_token
from warpriver.studio.live import LiveSession, Watcher
from warpriver.studio.opening import RECIPE, basin, open_apart
from warpriver.studio.processes import run_apart, warm_up
from warpriver.terrain import Terrain
from warpriver.validate import shown

__all__ = ["make_app"]

STATIC = Path(__file__).parent / "static"
# Bytes of a file that a page may send, and seconds and bytes of memory that reading it may take.
UPLOAD_BYTES, OPENING_SECONDS, OPENING_MEMORY = 256 * 2**20, 180.0, 6 * 2**30
# Seconds between two looks whether the page still waits for it.
LOOK = 0.25
# Bytes of a message of a page, and of what a generator is asked for.
MESSAGE_BYTES, RECIPE_BYTES = 2**20, 2**14
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,80}\.[A-Za-z0-9]{1,8}")


@public
def make_app(
    start: Scene | RiverNetwork | Simulation | None = None,
    *,
    token: str | None = None,
    terrain: Terrain | None = None,
    folder: Path | str | None = None,
    hosts: tuple[str, ...] = LOOPBACK,
) -> Any:
    """Make the studio as an ASGI application, for ``uvicorn`` and its like.

    Every request needs the token, as ``?token=`` in the first address, which sets a cookie. It is refused under a name
    that is not one of ``hosts``, and so is what comes from a page of another origin.

    Args:
        start: What a session begins with: a scene at its beginning, a network, or a simulation; by default a basin with
            its rivers.
        token: The secret of the link; by default a new one, ``app.token``.
        terrain: Ground under a network.
        folder: Where the session is kept, a new folder or one of an earlier session, which goes on; by default one
            that is removed in the end.
        hosts: Names under which the server may be asked for; ``("*",)`` stands for any.

    Returns:
        The application. Its attribute ``token`` is the secret, ``folder`` the session's folder.

    Raises:
        ImportError: ``warpriver[studio]`` is not installed.
        ValueError: A terrain is given beside what has its own, or the token is empty.
    """
    try:
        from starlette.applications import Starlette
        from starlette.requests import Request
        from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
        from starlette.routing import Mount, Route, WebSocketRoute
        from starlette.staticfiles import StaticFiles
        from starlette.websockets import WebSocket, WebSocketDisconnect
    except ImportError as error:
        raise MissingExtraError('the studio needs starlette: pip install "warpriver[studio]"') from error

    if token is not None and len(token) < 4:
        raise InputError(f"token is {shown(token)}; give 4 characters or more, or leave it out for a new one")
    secret = token or new_token()
    removed = folder is None
    place = Path(folder) if folder is not None else Path(tempfile.mkdtemp(prefix="warpriver-studio-"))
    if not (place / RUN).exists():
        begin_folder(place, _simulation_of(start, terrain))
    elif start is not None:
        raise InputError(f"{place} holds a session already; leave start out to go on with it, or give a new folder")
    session = LiveSession(place)

    @contextlib.asynccontextmanager
    async def lifespan(_: Any) -> AsyncIterator[None]:
        warm_up()
        yield
        await session.stop()
        if removed:
            shutil.rmtree(place, ignore_errors=True)

    async def page(_: Request) -> Response:
        return FileResponse(STATIC / "index.html")

    async def upload(request: Request) -> Response:
        name = request.path_params["name"]
        if not NAME.fullmatch(name):
            return PlainTextResponse("the name of the file has characters that it cannot have here", 400)
        if int(request.headers.get("content-length", 0) or 0) > UPLOAD_BYTES:
            return PlainTextResponse(f"the file is larger than {UPLOAD_BYTES // 2**20} MiB", 413)
        with tempfile.TemporaryDirectory(dir=place, prefix="upload-") as box:
            size = 0
            with (Path(box) / name).open("wb") as file:
                async for chunk in request.stream():
                    size += len(chunk)
                    if size > UPLOAD_BYTES:
                        return PlainTextResponse(f"the file is larger than {UPLOAD_BYTES // 2**20} MiB", 413)
                    file.write(chunk)
            return await opened(Path(box) / name, request)

    async def opened(file: Path, request: Request) -> Response:
        """Begin anew with what a file holds, unless the page gives it up meanwhile."""
        made, given_up = file.parent / "session", threading.Event()
        call = (open_apart, (str(file), str(made), OPENING_MEMORY), OPENING_SECONDS, given_up)
        task = asyncio.create_task(asyncio.to_thread(run_apart, *call))
        while not (await asyncio.wait({task}, timeout=LOOK))[0]:
            if await request.is_disconnected():
                given_up.set()
        error = task.result()
        if error is not None:
            return PlainTextResponse(error.replace(f"{file.parent}/", ""), 422)
        await session.replace(made)
        return JSONResponse({"opened": file.name})

    async def generate(request: Request) -> Response:
        body = b""
        async for chunk in request.stream():
            body += chunk
            if len(body) > RECIPE_BYTES:
                return PlainTextResponse("that is no recipe", 413)
        with tempfile.TemporaryDirectory(dir=place, prefix="new-") as box:
            file = Path(box) / f"new{RECIPE}"
            file.write_bytes(body)
            return await opened(file, request)

    async def download(request: Request) -> Response:
        name = request.path_params["name"]
        file = place / "exports" / name
        if not NAME.fullmatch(name) or not file.is_file():
            return PlainTextResponse("there is no such export", 404)
        return FileResponse(file, filename=name)

    async def live(socket: WebSocket) -> None:
        await socket.accept()
        watcher = session.join()
        if watcher is None:
            await socket.close(1013, "too many pages watch this session")
            return
        sender = asyncio.create_task(_send_all(socket, watcher))
        try:
            while True:
                message = await socket.receive()
                if message["type"] == "websocket.disconnect":
                    break
                text = message.get("text")
                if text is None or len(text) > MESSAGE_BYTES:
                    await socket.close(1009 if text else 1003)
                    break
                session.take(watcher, text)
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            session.leave(watcher)
            sender.cancel()

    routes = [
        Route("/", page),
        Route("/open/{name}", upload, methods=["PUT"]),
        Route("/new", generate, methods=["POST"]),
        Route("/exports/{name}", download),
        WebSocketRoute("/live", live),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    app: Any = Guard(Starlette(routes=routes, lifespan=lifespan), secret, hosts)
    app.token, app.folder, app.session = secret, place, session
    return app


async def _send_all(socket: Any, watcher: Watcher) -> None:
    """Send a page what there is for it, until it is gone."""
    while True:
        message = await watcher.next()
        try:
            if message is None:
                await socket.close(1013, "the page is too far behind")
                return
            if isinstance(message, str):
                await socket.send_text(message)
            else:
                await socket.send_bytes(message)
        except RuntimeError:
            return


def _simulation_of(start: object, terrain: Terrain | None) -> Simulation:
    """Return the simulation that a session begins with."""
    if isinstance(start, RiverNetwork):
        return Simulation(start, terrain=terrain)
    if terrain is not None:
        raise InputError("terrain is given beside what has its own ground; leave it out")
    if isinstance(start, Simulation):
        return start
    if isinstance(start, Scene):
        return start.simulation()
    return basin()
