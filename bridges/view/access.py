"""The server of a page: access control in front of the application, short connections, files.

Any web site that this user has open can send requests to an address of this host, and any user of
this host can connect. Therefore every request is checked before the application sees it:

* A request's Host must be a name of this host, or an IP address; any other name that resolves to
  this host (DNS rebinding) is refused.
* The Origin of a WebSocket, and of any other request that has one, must be that host.
* Everything but the page's own files requires the token, as a whiteboard's file is private to its
  user.

To connect and be silent needs no token, so connections are few and live for seconds. Only a
WebSocket may stay, which needs the token. The headers of every response forbid the page to load or
run anything from elsewhere. The files of a page are read once; no other file is ever served.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import logging
import re
import secrets
import socket
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

import msgspec
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn import Config
from uvicorn.protocols.http.h11_impl import H11Protocol

_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class AccessMiddleware:
    """Refuse requests that must not be served; pass on the others.

    `host` is the name or address that the server listens on; `is_open` is asked if a path needs no
    token. Styles that a script of the page adds need the nonce `styles`, if that is not empty.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        host: str,
        token: str,
        is_open: Callable[[str], bool],
        styles: str = "",
    ) -> None:
        own = socket.gethostname().lower()
        self._app = app
        self._names = {host.lower(), "localhost", own, f"{own}.local"}
        self._token = token
        policy = _HEADERS["Content-Security-Policy"]
        if styles:
            policy = policy.replace("style-src 'self'", f"style-src 'self' 'nonce-{styles}'")
        self._headers = _HEADERS | {"Content-Security-Policy": policy}
        self._is_open = is_open

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(self._headers)
            await send(message)

        refused = self._refusal(scope)
        if refused is None:
            await self._app(scope, receive, guarded)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": refused[1]})
        else:
            status, why = refused
            await JSONResponse({"problem": why}, status)(scope, receive, guarded)

    def _refusal(self, scope: Scope) -> tuple[HTTPStatus, str] | None:
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if not self._is_ours(host):
            return HTTPStatus.FORBIDDEN, f"this server is not {host!r}"
        if origin is None:
            if scope["type"] == "websocket":
                return HTTPStatus.FORBIDDEN, "a WebSocket needs an Origin"
        elif origin.lower() != f"http://{host.lower()}":
            return HTTPStatus.FORBIDDEN, f"pages of {origin!r} have no access"
        if not self._is_open(scope["path"]):
            given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
            if not secrets.compare_digest(given.encode(), self._token.encode()):
                return (
                    HTTPStatus.UNAUTHORIZED,
                    "open the address that was printed: it contains the token",
                )
        return None

    def _is_ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
            return name in self._names or bool(ipaddress.ip_address(name))
        except ValueError:
            return False


_MOST: Final = 64  # of those that are no WebSockets; a browser makes six for a page
_LONGEST_S: Final = 10.0  # the life of one; a browser makes a new one when it needs one
_LOG_S: Final = 60.0
_EXHAUSTED: Final = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)

_log = logging.getLogger(__name__)


def configured(app: ASGIApp) -> Config:
    """Configure a server for a page's application."""
    return Config(
        app,
        log_config=None,
        log_level="error",  # any client can cause warnings
        access_log=False,
        http=_ShortConnection,
        backlog=64,  # connections that are accepted at once
        ws="websockets-sansio",
        ws_max_size=1 << 20,
        ws_per_message_deflate=False,  # costs more time than the bytes it saves
        timeout_graceful_shutdown=1,
        server_header=False,
    )


# With this the loop accepts connections again after a second; it fails if the page has ended since.
_RETRY = "_start_serving"


class _ShortConnection(H11Protocol):
    """HTTP that ends after a few seconds, whatever the client does; the oldest gives way."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin."""
        super().connection_made(transport)
        self._made_s = self.loop.time()
        self.loop.call_later(_LONGEST_S, self._end)
        short = [each for each in self.connections if isinstance(each, _ShortConnection)]
        if len(short) > _MOST:
            min(short, key=lambda each: each._made_s)._end()

    def _end(self) -> None:
        if self in self.connections:  # else it is over, or has become a WebSocket
            self.connections.discard(self)
            self.transport.abort()


def log_exhaustion_once(loop: asyncio.AbstractEventLoop) -> None:
    """Log once a minute that no connection can be accepted, for example without file descriptors.

    By default the loop logs hundreds of tracebacks each second.
    """
    due_s = 0.0

    def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        nonlocal due_s
        error = context.get("exception")
        if isinstance(error, ValueError) and _RETRY in context["message"]:
            return
        if not isinstance(error, OSError) or error.errno not in _EXHAUSTED:
            loop.default_exception_handler(context)
        elif loop.time() >= due_s:
            due_s = loop.time() + _LOG_S
            _log.error("the page cannot accept connections: %s; trying again", error.strerror)

    loop.set_exception_handler(handle)


def guarded_app(
    routes: Sequence[BaseRoute],
    *,
    end: Callable[[], None],
    host: str,
    token: str,
    is_open: Callable[[str], bool],
    begin: Callable[[], None] = lambda: None,
    styles: str = "",
) -> AccessMiddleware:
    """Make an application of its routes, behind its access control.

    `begin` and `end` are called in its loop, before and after it serves. The rest is as for
    :class:`.AccessMiddleware`.
    """

    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        begin()
        log_exhaustion_once(asyncio.get_running_loop())
        yield
        end()

    app = Starlette(routes=routes, lifespan=life)
    app.router.redirect_slashes = False
    return AccessMiddleware(app, host=host, token=token, is_open=is_open, styles=styles)


ASSETS: Final = Path(__file__).with_name("assets")
"""The files of the page that shows a whiteboard, some of which others have, too."""
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}


_PART: Final = re.compile(rb"<!--(\w+\.html)-->")


class PageFiles:
    """The files of some folders, by their names; of two with one name, that of the later folder.

    In a page, a comment such as ``<!--head.html-->`` stands for what all pages have of it.
    """

    def __init__(self, *folders: Path):
        self._files = {
            path.name: path.read_bytes()
            for folder in folders
            for path in folder.iterdir()
            if path.suffix in _TYPES
        }
        for name, data in self._files.items():
            if name.endswith(".html"):
                self._files[name] = _PART.sub(lambda part: self._files[part[1].decode()], data)

    async def respond(self, request: Request) -> Response:
        """Return the file that a request names, by default the page itself."""
        return self.response(request.path_params.get("name", "index.html"))

    def response(self, name: str) -> Response:
        """Return the file of this name."""
        if name not in self._files:
            return json_response({"problem": f"no such file: {name}"}, 404)
        return Response(self._files[name], media_type=_TYPES[Path(name).suffix])


def is_open(path: str, pages: str = "") -> bool:
    """Check that a path is not secret: a file of a page, or a page itself.

    One page is at "/"; with `pages`, another is at every path that begins so and ends in "/".
    """
    is_page = bool(pages) and path.startswith(pages) and path.endswith("/")
    return is_page or path == "/" or path.startswith("/assets/")


def json_response(content: Any, status: int = 200) -> Response:
    """Make a response of any value, as JSON."""
    return Response(msgspec.json.encode(content), status, media_type="application/json")
