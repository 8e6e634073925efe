"""The web application of a fleet: a page with all hosts, and a page for each that is looked at.

Nothing is read of a host but its summary, except while its own page is open: slots of other hosts
cross the network only where somebody reads them.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import msgspec
from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from llfsm.bridges.view.access import (
    ASSETS,
    AccessMiddleware,
    PageFiles,
    guarded_app,
    is_open,
    json_response,
)
from llfsm.bridges.view.app import Broadcaster, SourcePage, frames
from llfsm.bridges.view.errors import RequestError
from llfsm.bridges.view.frames import TimedEncoder
from llfsm.bridges.view.live_source import LiveSource, ReopenedBoard
from llfsm.bridges.view.page_requests import decode, serve_page
from llfsm.runtime.presence.hosts import FleetTable, HostRow
from llfsm.whiteboard.board_files import DIRECTORY
from llfsm.whiteboard.mirror.naming import require_host_name


class FleetSnapshot(NamedTuple):
    """The hosts at one moment."""

    now_ns: int
    hosts: Sequence[HostRow]
    trouble: str
    """Why there is nothing to show, in a sentence with the remedy; else empty."""


class FleetSource:
    """Read the hosts of the fleet from the board of a name, while snapshots are taken of it."""

    def __init__(self, name: str, directory: str | os.PathLike[str] = DIRECTORY) -> None:
        self.title = f"{name}, fleet"
        self._opened = ReopenedBoard(name, directory)
        self._table: FleetTable | None = None
        self._hosts: Sequence[HostRow] = ()

    def snapshot(self) -> FleetSnapshot:
        """Return the hosts; never raise because of what a board holds."""
        now_ns, trouble = time.monotonic_ns(), ""
        try:
            before, board = self._opened.board, self._opened.look(now_ns)
            if board is None:
                self._table, trouble = None, self._opened.trouble
            else:
                if board is not before or self._table is None:
                    self._table = FleetTable(board)
                self._table.look()
                self._hosts, trouble = self._table.rows(), self._table.problem()
        except Exception as error:  # also what a damaged file makes of the libraries that read it
            trouble = f"the whiteboard cannot be read: {error}; trying again"
            self.close()
        return FleetSnapshot(now_ns, self._hosts, trouble)

    def close(self) -> None:
        """Read no more of the hosts."""
        self._table, self._hosts = None, ()
        self._opened.close()  # what is bound to it is forgotten with it


class FleetEncoder(TimedEncoder):
    """Encode what a page does not know yet of the hosts.

    A frame is a JSON object. Members that are missing have not changed:

        now      seconds on the clock of all stamps; 0 is the page's first frame
        trouble  why there is nothing to show
        hosts    by name, see `_host`; null: removed
    """

    def __init__(self) -> None:
        super().__init__()
        self._trouble: str | None = None
        self._known: dict[str, HostRow] = {}

    def encode(self, snapshot: FleetSnapshot, beat: bool) -> bytes | None:
        """Return the frame for a snapshot; None if nothing has changed and no `beat` is due."""
        if self._base_ns is None:
            self._base_ns = snapshot.now_ns
        frame: dict[str, Any] = {}
        if snapshot.trouble != self._trouble:
            frame["trouble"] = self._trouble = snapshot.trouble
        rows = {row.name: row for row in snapshot.hosts}
        new: dict[str, Any] = dict.fromkeys(self._known.keys() - rows.keys())
        new |= {n: self._host(row) for n, row in rows.items() if self._known.get(n) != row}
        self._known = rows
        if new:
            frame["hosts"] = new
        return self._framed(snapshot.now_ns, frame, beat=beat)

    def _host(self, row: HostRow) -> dict[str, Any]:
        contact_ns = row.contact_ns
        return {
            "own": row.is_own,
            "there": row.is_there,
            "contact": None if contact_ns is None else self._seconds(contact_ns),
            "lead": None if row.lead_s is None else round(row.lead_s, 4),
            "trouble": row.trouble,
            "summary": None if row.summary is None else msgspec.structs.asdict(row.summary),
        }


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
    """Make the application that shows the hosts of the board `name`, behind its access control.

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
        Route(f"{_HOSTS}{{host}}/", files.respond),
        Route(f"{_HOSTS}{{host}}/about", hosts.about),
        Route(f"{_HOSTS}{{host}}/diagram", hosts.diagram),
        Route(f"{_HOSTS}{{host}}/log", hosts.log),
        WebSocketRoute(f"{_HOSTS}{{host}}/live", hosts.live),
    ]
    opens = partial(is_open, pages=_HOSTS)
    return guarded_app(routes, end=end, host=host, token=token, is_open=opens)


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
        """Send the facts of a host's page, and the address of the page with all hosts."""
        host = request.path_params["host"]
        try:
            require_host_name(host)
        except ValueError as error:
            return json_response({"title": host, "problem": str(error)})
        return json_response({**self._page(host).facts(), "title": host, "back": "/"})

    async def diagram(self, request: HttpRequest) -> Response:
        """Send the diagram of a machine, if the page of its host is open."""
        page = self._open.get(request.path_params["host"])
        return _not_open() if page is None else await page.diagram(request)

    async def log(self, request: HttpRequest) -> Response:
        """Send events of the log, if the page of the host is open."""
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
