"""Access control: checks on every request before the application sees it.

Any web site that this user has open can send requests to an address of this host. Therefore:

* A request's Host must be a name of this host, or an IP address; any other name that resolves to
  this host (DNS rebinding) is refused.
* The Origin of a WebSocket, and of any other request that has one, must be that host.
* Everything but the page's own files requires the token, as a whiteboard's file is private to its
  user, and any user of this host can connect to an address of it.

The headers of every response forbid the page to load or run anything from elsewhere.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
from collections.abc import Callable
from http import HTTPStatus
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["AccessMiddleware"]

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

    `host` is the name or address that the server listens on; `is_open` returns whether a path needs
    no token. Styles that a script of the page adds need the nonce `styles`, if that is not empty.
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
