"""The web application of one source: the page's files, its stream of frames, and its requests."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from starlette.applications import Starlette
from starlette.routing import Route, WebSocketRoute

from .access import AccessMiddleware
from .connections import log_exhaustion_once
from .page_files import ASSETS, PageFiles, is_open
from .page_session import SourcePage
from .page_source import PageSource

__all__ = ["make_app"]


def make_app(source: PageSource, *, host: str, token: str, control: bool) -> AccessMiddleware:
    """Return the application that shows `source`, behind its access control."""
    files, page = PageFiles(ASSETS), SourcePage(source, control=control)

    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        log_exhaustion_once(asyncio.get_running_loop())
        yield
        source.close()

    app = Starlette(
        routes=[
            Route("/", files.respond),
            Route("/assets/{name}", files.respond),
            Route("/about", page.about),
            Route("/diagram", page.diagram),
            Route("/log", page.log),
            WebSocketRoute("/live", page.live),
        ],
        lifespan=life,
    )
    app.router.redirect_slashes = False
    return AccessMiddleware(app, host=host, token=token, is_open=is_open)
