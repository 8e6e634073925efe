"""The web application of one source: the page's files, its stream of frames, and its requests."""

from __future__ import annotations

from starlette.routing import Route, WebSocketRoute

from .access import AccessMiddleware
from .guarded_app import guarded_app
from .page_files import ASSETS, PageFiles, is_open
from .page_session import SourcePage
from .page_source import PageSource

__all__ = ["make_app"]


def make_app(source: PageSource, *, host: str, token: str, control: bool) -> AccessMiddleware:
    """Return the application that shows `source`, behind its access control."""
    files, page = PageFiles(ASSETS), SourcePage(source, control=control)
    routes = [
        Route("/", files.respond),
        Route("/assets/{name}", files.respond),
        Route("/about", page.about),
        Route("/diagram", page.diagram),
        Route("/log", page.log),
        WebSocketRoute("/live", page.live),
    ]
    return guarded_app(routes, end=source.close, host=host, token=token, is_open=is_open)
