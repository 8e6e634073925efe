"""The web application of a fleet: a page with all hosts, and a page for each that is looked at.

Nothing is read of a host but its summary, except while its own page is open.
"""

from __future__ import annotations

import os
from typing import Any, Final

from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from llfsm.whiteboard.board_files import DIRECTORY
from llfsm.whiteboard.mirror.naming import require_host_name

from . import page_files
from .access import AccessMiddleware
from .broadcaster import Broadcaster, frames
from .errors import RequestError
from .fleet_source import FleetEncoder, FleetSource
from .guarded_app import guarded_app
from .live_source import LiveSource
from .page_files import ASSETS, PageFiles, json_response
from .page_requests import decode
from .page_session import SourcePage
from .page_socket import serve_page

__all__ = ["make_fleet_app"]

_HOSTS: Final = "/host/"
_PERIOD_S = 0.25  # hosts publish their summaries once a second


def make_fleet_app(
    name: str,
    directory: str | os.PathLike[str] = DIRECTORY,
    *,
    host: str,
    token: str,
    control: bool,
) -> AccessMiddleware:
    """Return the application that shows the hosts of the board `name`, behind its access control.

    With `control`, the hosts' own pages control their machines.
    """
    files, source = PageFiles(ASSETS), FleetSource(name, directory)
    hosts = _HostPages(name, directory, control=control)
    broadcaster = Broadcaster(source.snapshot, period_s=_PERIOD_S, left=source.close)

    def end() -> None:
        source.close()
        hosts.close()

    async def page(_: HttpRequest) -> Response:
        return files.response("fleet.html")

    async def host_page(_: HttpRequest) -> Response:
        return files.response("index.html")

    async def about(_: HttpRequest) -> Response:
        return json_response({"title": source.title})

    async def live(socket: WebSocket) -> None:
        async with broadcaster:
            await socket.accept()
            encode = FleetEncoder().encode
            await serve_page(socket, frames(broadcaster, encode), decode, _refuse)

    routes = [
        Route("/", page),
        Route("/assets/{name}", files.respond),
        Route("/about", about),
        WebSocketRoute("/live", live),
        Route(f"{_HOSTS}{{host}}/", host_page),
        Route(f"{_HOSTS}{{host}}/about", hosts.about),
        Route(f"{_HOSTS}{{host}}/diagram", hosts.diagram),
        Route(f"{_HOSTS}{{host}}/log", hosts.log),
        WebSocketRoute(f"{_HOSTS}{{host}}/live", hosts.live),
    ]
    return guarded_app(routes, end=end, host=host, token=token, is_open=_is_open)


def _is_open(path: str) -> bool:
    """Return whether a path is that of a page, the same for all hosts, or one of its files."""
    return page_files.is_open(path) or (path.startswith(_HOSTS) and path.endswith("/"))


async def _refuse(_: Any) -> str:
    raise RequestError("this page only shows; open the page of a host")


class _HostPages:
    """The pages of the hosts that are looked at, by name."""

    def __init__(self, name: str, directory: str | os.PathLike[str], *, control: bool) -> None:
        self._name = name
        self._directory = directory
        self._control = control
        self._open: dict[str, SourcePage] = {}

    def close(self) -> None:
        """Read no more of any host."""
        for page in self._open.values():
            page.source.close()

    async def about(self, request: HttpRequest) -> Response:
        """Return what the page shows, and the address of the one that leads to it."""
        host = request.path_params["host"]
        try:
            require_host_name(host)
        except ValueError as error:
            return json_response({"title": host, "problem": str(error)})
        return json_response({**self._page(host).facts(), "title": host, "back": "/"})

    async def diagram(self, request: HttpRequest) -> Response:
        """Return the diagram of a machine."""
        page = self._open.get(request.path_params["host"])
        return _not_open() if page is None else await page.diagram(request)

    async def log(self, request: HttpRequest) -> Response:
        """Return events, the latest first."""
        page = self._open.get(request.path_params["host"])
        return _not_open() if page is None else await page.log(request)

    async def live(self, socket: WebSocket) -> None:
        """Send frames to a window, and carry out its requests, until it is closed."""
        host = socket.path_params["host"]
        try:
            require_host_name(host)
        except ValueError:
            await socket.close()
            return
        page = self._open[host] = self._page(host)
        await page.live(socket)

    def _page(self, host: str) -> SourcePage:
        """Return the page of a host, which reads nothing before the first window is open."""
        if host in self._open:
            return self._open[host]
        source = LiveSource(self._name, self._directory, host=host)

        def left() -> None:
            del self._open[host]
            source.close()

        return SourcePage(source, control=self._control, left=left)


def _not_open() -> Response:
    return json_response({"problem": "the page of this host is not open"})
