"""What stands between the studio and every other page that a browser has open.

A server on the loopback address alone does not keep a hostile page out: a browser sends its requests there, too, and by
DNS rebinding under another name. So each request needs the secret of the link, under a name that is ours, and what
changes something needs to come from a page of ours.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

__all__ = ["COOKIE", "Guard", "new_token"]

Message = MutableMapping[str, Any]
App = Callable[[Message, Callable[[], Awaitable[Message]], Callable[[Message], Awaitable[None]]], Awaitable[None]]

COOKIE = "warpriver_studio"
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
SAFE = ("GET", "HEAD")
# Scripts, styles and pictures of our own, and nothing in line; the page cannot be put into another one.
HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


def new_token() -> str:
    """Return a secret that nobody guesses."""
    return secrets.token_urlsafe(24)


class Guard:
    """Middleware that lets through what has the token, from our own pages, under our own names."""

    def __init__(self, app: App, token: str, hosts: tuple[str, ...] = LOOPBACK):
        """Wrap an application.

        Args:
            app: ASGI application.
            token: The secret.
            hosts: Names under which the server may be asked for, without ports; "*" stands for any.
        """
        self._app, self._token, self._hosts = app, token.encode(), hosts

    async def __call__(self, scope: Message, receive: Any, send: Any) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.lower(): value for name, value in scope["headers"]}
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await self._refuse(scope, receive, send, *refusal)
            return
        first = scope["type"] == "http" and b"token=" in scope["query_string"]

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                listed = [*message.get("headers", [])]
                listed += [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                if first:
                    listed.append(
                        (b"set-cookie", f"{COOKIE}={self._token.decode()}; HttpOnly; SameSite=Strict; Path=/".encode())
                    )
                message["headers"] = listed
            await send(message)

        await self._app(scope, receive, with_headers)

    def _refusal(self, scope: Message, headers: dict[bytes, bytes]) -> tuple[int, str] | None:
        """Return status and reason of what is not let through."""
        host = headers.get(b"host", b"").decode("latin-1")
        name = _name(host)
        if "*" not in self._hosts and name not in self._hosts:
            return 421, "this server does not go by that name"
        origin = headers.get(b"origin")
        needs_origin = scope["type"] == "websocket" or scope.get("method") not in SAFE
        if origin is not None and urlsplit(origin.decode("latin-1")).netloc.lower() != host.lower():
            return 403, "the request comes from another page"
        if origin is None and needs_origin:
            return 403, "the request does not say which page it comes from"
        if not self._knows(scope, headers):
            return 401, "open the link that warpriver studio printed: it holds the token"
        return None

    def _knows(self, scope: Message, headers: dict[bytes, bytes]) -> bool:
        """Tell whether a request has the token, in its address or in the cookie."""
        given = [value.encode() for value in parse_qs(scope["query_string"].decode("latin-1")).get("token", [])]
        cookie: SimpleCookie = SimpleCookie()
        try:
            cookie.load(headers.get(b"cookie", b"").decode("latin-1"))
        except CookieError:
            cookie = SimpleCookie()
        if COOKIE in cookie:
            given.append(cookie[COOKIE].value.encode("latin-1", "replace"))
        # All are compared, in constant time.
        return any([hmac.compare_digest(each, self._token) for each in given])

    async def _refuse(self, scope: Message, receive: Any, send: Any, status: int, reason: str) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": reason})
            return
        body = f"{reason}\n".encode()
        listed = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
        listed += [(name.encode(), value.encode()) for name, value in HEADERS.items()]
        await send({"type": "http.response.start", "status": status, "headers": listed})
        await send({"type": "http.response.body", "body": body})


def _name(host: str) -> str:
    """Host without its port, in lower case."""
    if host.startswith("["):
        return host.partition("]")[0].lower() + "]"
    return host.partition(":")[0].lower()
