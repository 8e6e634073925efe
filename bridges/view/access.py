"""Access control: checks on every request before the application sees it.

Any web site that this user has open can send requests to an address of this host. Therefore:

* A request's Host must be the address of the server; any other name that resolves to this host (DNS
  rebinding) is refused. With a token, any name is accepted.
* The Origin of a WebSocket, and of any other request that has one, must be that host.
* With a token, everything but the page's own files requires it.

The headers of every response forbid the page to load or run anything from elsewhere.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from http import HTTPStatus
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["AccessMiddleware", "is_loopback"]

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


def is_loopback(host: str) -> bool:
    """Return whether only processes of this host can reach the address."""
    import ipaddress

    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class AccessMiddleware:
    """Refuse requests that must not be served; pass on the others.

    `is_open` returns whether a path needs no token.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        host: str,
        port: int,
        token: str | None,
        is_open: Callable[[str], bool],
    ) -> None:
        names = {host, "localhost", "127.0.0.1", "[::1]"}
        self._app = app
        self._hosts = {f"{name}:{port}" for name in names} | (names if port == 80 else set())
        self._token = token
        self._is_open = is_open

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
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
        if self._token is None and host.lower() not in self._hosts:
            return HTTPStatus.FORBIDDEN, f"this server is not {host!r}"
        if origin is None:
            if scope["type"] == "websocket":
                return HTTPStatus.FORBIDDEN, "a WebSocket needs an Origin"
        elif origin.lower() != f"http://{host.lower()}":
            return HTTPStatus.FORBIDDEN, f"pages of {origin!r} have no access"
        if self._token is not None and not self._is_open(scope["path"]):
            given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
            if not secrets.compare_digest(given.encode(), self._token.encode()):
                return (
                    HTTPStatus.UNAUTHORIZED,
                    "open the address that `llfsm view` printed: it contains the token",
                )
        return None
