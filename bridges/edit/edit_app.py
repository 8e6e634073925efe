"""The web application of the editor: a page for each machine, and an overview of an arrangement.

To draw the overview is to load all machines, whose code may fail or hang: each is loaded in a
process of its own, and only when the page asks for it.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from llfsm.bridges.edit.edit_session import EditSession, decode_request
from llfsm.bridges.edit.machine_page import unfolded_data
from llfsm.bridges.edit.message_types import offered
from llfsm.bridges.view.access import (
    ASSETS,
    AccessMiddleware,
    PageFiles,
    guarded_app,
    is_open,
    json_response,
)
from llfsm.bridges.view.frames import plain_diagram
from llfsm.bridges.view.page_requests import serve_page
from llfsm.bridges.view.page_source import PageSource
from llfsm.runtime.converting.class_process import read_links
from llfsm.runtime.drawing import MachineLinks, overview
from llfsm.runtime.editing import Document
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.plans import PlannedMachine

_PROCESSES = 4  # at once, each of which loads a machine


class OpenedMachine(NamedTuple):
    """A machine of an arrangement file: a document, or the reason why it cannot be opened."""

    planned: PlannedMachine
    document: Document | None
    problem: str = ""


class OpenedPlan(NamedTuple):
    """An arrangement file with its machines, by the names that they get."""

    path: Path
    machines: Mapping[str, OpenedMachine]


def overview_data(plan: OpenedPlan) -> dict[str, Any]:
    """Draw the overview as plain data, with a problem for each machine that cannot be loaded."""
    with ThreadPoolExecutor(_PROCESSES) as pool:
        found = dict(zip(plan.machines, pool.map(_links, plan.machines.values()), strict=True))
    links = {
        name: each if isinstance(each, MachineLinks) else _NONE for name, each in found.items()
    }
    problems = {name: each for name, each in found.items() if isinstance(each, str)}
    return {"diagram": plain_diagram(overview(plan.path.name, links)), "problems": problems}


def _links(machine: OpenedMachine) -> MachineLinks | str:
    if machine.document is None:
        return machine.problem
    try:
        return read_links(machine.document.found_by, machine.planned)
    except BundleError as error:
        return str(error)


_NONE = MachineLinks()


_OWN_ASSETS: Final = Path(__file__).with_name("assets")
_CODEMIRROR: Final = Path(__file__).with_name("codemirror")
_MACHINES: Final = "/machine/"


def make_edit_app(
    opened: Document | OpenedPlan,
    *,
    host: str,
    token: str,
    source: PageSource | None = None,
    control: bool = False,
) -> AccessMiddleware:
    """Make the application that edits a document, or each of a plan's, behind its access control.

    The machines of the same names are watched on the board of `source`, and with `control` also
    reloaded there.
    """
    files = PageFiles(ASSETS, _OWN_ASSETS, _CODEMIRROR)
    styles = secrets.token_urlsafe(16)  # CodeMirror has its styles in its script
    shared = {"styles": styles, "tabs": [], "control": control}
    if isinstance(opened, OpenedPlan):
        documents = {name: each.document or each.problem for name, each in opened.machines.items()}
        pages = _MachinePages(documents, source, shared | {"tabs": _tabs(opened)})
        routes = pages.routes(files, f"{_MACHINES}{{machine:path}}") + _overview(opened, files)
    else:
        pages = _MachinePages({"": opened}, source, shared)
        routes = pages.routes(files, "")
    routes.append(Route("/assets/{name}", files.respond))
    return guarded_app(
        routes,
        begin=pages.begin,
        end=pages.end,
        host=host,
        token=token,
        is_open=partial(is_open, pages=_MACHINES),
        styles=styles,
    )


class _MachinePages:
    """The pages of machines by their names; `shared` are facts that each window is sent.

    In place of a document may be the reason why there is none.
    """

    def __init__(
        self,
        documents: Mapping[str, Document | str],
        source: PageSource | None,
        shared: dict[str, Any],
    ):
        self._documents = documents
        self._source = source
        self._shared = shared
        self._sessions: dict[str, EditSession] = {}

    def routes(self, files: PageFiles, at: str) -> list[BaseRoute]:
        """Return the routes of a machine's page, whose name is in the address if that has one."""
        return [
            Route(f"{at}/", files.respond),
            Route(f"{at}/about", self._about),
            Route(f"{at}/offered", self._offered),
            Route(f"{at}/unfolded", self._unfolded),
            WebSocketRoute(f"{at}/live", self._live),
        ]

    def begin(self) -> None:
        """Make the sessions, which belong to the running loop."""
        for name, each in self._documents.items():
            if isinstance(each, Document):
                self._sessions[name] = EditSession(
                    each, self._source, name, control=self._shared["control"]
                )

    def end(self) -> None:
        """Read no more of the board."""
        if self._source is not None:
            self._source.close()

    async def _about(self, request: HttpRequest) -> Response:
        name = request.path_params.get("machine", "")
        document = self._documents.get(name, f"the arrangement has no machine {name!r}")
        if isinstance(document, str):
            return json_response(self._shared | {"title": name, "problem": document})
        title, path = name or document.folder.name, str(document.path)
        return json_response(self._shared | {"title": title, "path": path})

    async def _offered(self, _: HttpRequest) -> Response:
        """Send the types that machines can include, which are searched at this moment."""
        return json_response(await run_in_threadpool(offered, self._source))

    async def _unfolded(self, request: HttpRequest) -> Response:
        """Send the drawing with what states run inside of them, or why there is none."""
        document = self._documents.get(request.path_params.get("machine", ""), "no such machine")
        if isinstance(document, str):
            return json_response({"problem": document})
        return json_response(await run_in_threadpool(unfolded_data, document))

    async def _live(self, socket: WebSocket) -> None:
        session = self._sessions.get(socket.path_params.get("machine", ""))
        if session is None:
            await socket.close()
            return
        await socket.accept()
        window = await session.open()
        try:
            await serve_page(socket, window.frame, decode_request, session.perform)
        finally:
            await session.close()


def _overview(plan: OpenedPlan, files: PageFiles) -> list[BaseRoute]:
    """Return the routes of the overview's page."""

    async def page(_: HttpRequest) -> Response:
        return files.response("overview.html")

    async def about(_: HttpRequest) -> Response:
        path, tabs = str(plan.path), _tabs(plan)
        machines = [
            {"name": name, "definition": each.planned.definition, "problem": each.problem}
            for name, each in plan.machines.items()
        ]
        title = plan.path.name
        return json_response({"title": title, "path": path, "tabs": tabs, "machines": machines})

    async def links(_: HttpRequest) -> Response:
        return json_response(await run_in_threadpool(overview_data, plan))

    return [Route("/", page), Route("/about", about), Route("/overview", links)]


def _tabs(plan: OpenedPlan) -> list[dict[str, str]]:
    tabs = [{"title": "Overview", "address": "/", "problem": ""}]
    for name, each in plan.machines.items():
        address = f"{_MACHINES}{quote(name, safe='')}/"
        tabs.append({"title": name, "address": address, "problem": each.problem})
    return tabs
