"""The page's files, its stream of frames, and its requests, as one application."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Final

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from llfsm.whiteboard.messages.llfsm import DEFINITIONS, MachineDefinition

from .errors import RequestError
from .feed import Feed
from .guard import Guard
from .hub import Hub
from .picture import SECTIONS, picture
from .requests import Seen, decode, perform
from .source import Source

__all__ = ["make_app"]

_ASSETS: Final = Path(__file__).with_name("assets")
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_UNSEEN = 2  # frames that a page may be sent before it says that it has shown one
_BEAT_S = 0.5  # an idle page is told the time so often, and so notices a server that is gone


def make_app(source: Source, *, host: str, port: int, token: str | None, control: bool) -> Guard:
    """Return the application that shows `source` to whoever may see it."""
    files = {path.name: path.read_bytes() for path in _ASSETS.iterdir() if path.suffix in _TYPES}
    hub: Hub | None = None

    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        nonlocal hub
        hub = Hub(source)  # here, as it belongs to the loop that runs
        yield
        source.close()

    async def asset(request: HttpRequest) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in files:  # whatever it is: no other file is ever read
            return _json({"problem": f"there is no {name}"}, 404)
        return Response(files[name], media_type=_TYPES[Path(name).suffix])

    async def about(_: HttpRequest) -> Response:
        player = source.player
        span = None if player is None else (player.span_ns[1] - player.span_ns[0]) / 1e9
        return _json({"title": source.title, "control": control, "span": span})

    async def diagram(request: HttpRequest) -> Response:
        name = request.query_params.get("machine", "")
        sections = request.query_params.get("sections", "auto")
        look = source.look() if hub is None or hub.look is None else hub.look
        sample = look.samples.get(DEFINITIONS + name)
        try:
            if sample is None or not isinstance(sample.message, MachineDefinition):
                raise RequestError(f"{name}: its process has not told what it consists of")
            shown = SECTIONS.get(sections)
            drawn = await run_in_threadpool(picture, sample.message, name, shown)
        except RequestError as error:
            return _json({"problem": str(error)})
        return _json(drawn)

    async def live(socket: WebSocket) -> None:
        assert hub is not None
        await socket.accept()
        async with hub:
            await _serve(socket, hub, source, control)

    app = Starlette(
        routes=[
            Route("/", asset),
            Route("/assets/{name}", asset),
            Route("/about", about),
            Route("/diagram", diagram),
            WebSocketRoute("/live", live),
        ],
        lifespan=life,
    )
    return Guard(app, host=host, port=port, token=token, is_open=_is_open)


def _is_open(path: str) -> bool:
    """Tell whether a path is one of the page's own files, which are no secret."""
    return path == "/" or path.startswith("/assets/")


def _json(content: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(content), status, media_type="application/json")


async def _serve(socket: WebSocket, hub: Hub, source: Source, control: bool) -> None:
    """Tell a page of every look that it has time for, and do what it asks, until it goes."""
    room = asyncio.BoundedSemaphore(_UNSEEN)

    async def tell() -> None:
        feed, serial, told_s = Feed(source), 0, 0.0
        while True:
            await room.acquire()
            frame = None
            while frame is None:
                serial, look = await hub.next(serial)
                frame = feed.frame(look, beat=time.monotonic() - told_s > _BEAT_S)
            told_s = time.monotonic()
            await socket.send_text(frame.decode())

    async def listen() -> None:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            await _answer(socket, message.get("text") or "", room, source, control)

    tasks = {asyncio.create_task(tell()), asyncio.create_task(listen())}
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        with suppress(WebSocketDisconnect):
            for task in done:
                task.result()
    finally:
        for task in tasks:
            task.cancel()


async def _answer(
    socket: WebSocket, text: str, room: asyncio.BoundedSemaphore, source: Source, control: bool
) -> None:
    number: int | None = None
    try:
        request = decode(text)
        if isinstance(request, Seen):
            with suppress(ValueError):  # it has said so more often than it was sent one
                room.release()
            return
        number = request.id
        answer = {"answer": number, "done": perform(request, source, control=control)}
    except RequestError as error:
        answer = {"answer": number, "problem": str(error)}
    await socket.send_text(msgspec.json.encode(answer).decode())
