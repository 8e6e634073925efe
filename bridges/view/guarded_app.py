"""A web application behind its access control, from its routes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

from starlette.applications import Starlette
from starlette.routing import BaseRoute

from .access import AccessMiddleware
from .connections import log_exhaustion_once

__all__ = ["guarded_app"]


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
    """Return the application; `begin` and `end` are called in its loop, before and after it serves.

    The rest is as for :class:`.AccessMiddleware`.
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
