"""Connections: how many there are, and for how long, before they are the streams of pages.

Any user of this host can connect, and needs no token to be silent. Only a WebSocket may stay, which
needs the token.
"""

from __future__ import annotations

import asyncio
import errno
import logging
from typing import Any, Final

from starlette.types import ASGIApp
from uvicorn import Config
from uvicorn.protocols.http.h11_impl import H11Protocol

__all__ = ["configured", "log_exhaustion_once"]

_MOST: Final = 64  # of those that are no WebSockets; a browser makes six for a page
_LONGEST_S: Final = 10.0  # the life of one; a browser makes a new one when it needs one
_LOG_S: Final = 60.0
_EXHAUSTED: Final = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)

_log = logging.getLogger(__name__)


def configured(app: ASGIApp) -> Config:
    """Return the configuration of a server for the page."""
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
