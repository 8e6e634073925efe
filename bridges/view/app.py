"""The web application: the page's files, its stream of frames, and its requests."""

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

from .access import AccessMiddleware
from .broadcaster import Broadcaster
from .connections import log_exhaustion_once
from .diagram_data import SECTIONS, diagram_data
from .errors import RequestError
from .frames import FrameEncoder
from .page_requests import FrameShown, decode, perform
from .page_source import PageSource

__all__ = ["make_app"]

_ASSETS: Final = Path(__file__).with_name("assets")
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_UNSEEN = 2  # frames sent to a page before it confirms that it has shown one
_BEAT_S = 0.5  # between frames to an idle page, by which it notices a server that is gone


def make_app(source: PageSource, *, host: str, token: str, control: bool) -> AccessMiddleware:
    """Return the application that shows `source`, behind its access control."""
    files = {path.name: path.read_bytes() for path in _ASSETS.iterdir() if path.suffix in _TYPES}
    broadcaster: Broadcaster | None = None

    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        nonlocal broadcaster
        broadcaster = Broadcaster(source)  # here, because it belongs to the running loop
        log_exhaustion_once(asyncio.get_running_loop())
        yield
        source.close()

    async def asset(request: HttpRequest) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in files:  # no other file is ever read
            return _json({"problem": f"no such file: {name}"}, 404)
        return Response(files[name], media_type=_TYPES[Path(name).suffix])

    async def about(_: HttpRequest) -> Response:
        player = source.player
        span = None if player is None else (player.span_ns[1] - player.span_ns[0]) / 1e9
        return _json({"title": source.title, "control": control, "span": span})

    async def diagram(request: HttpRequest) -> Response:
        name = request.query_params.get("machine", "")
        sections = request.query_params.get("sections", "auto")
        latest = None if broadcaster is None else broadcaster.snapshot
        sample = (latest or source.snapshot()).samples.get(DEFINITIONS + name)
        try:
            if sample is None or not isinstance(sample.message, MachineDefinition):
                raise RequestError(f"{name}: its process has not published a definition")
            shown = SECTIONS.get(sections)
            drawn = await run_in_threadpool(diagram_data, sample.message, name, shown)
        except RequestError as error:
            return _json({"problem": str(error)})
        return _json(drawn)

    async def live(socket: WebSocket) -> None:
        assert broadcaster is not None
        await socket.accept()
        async with broadcaster:
            await _serve(socket, broadcaster, source, control)

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
    app.router.redirect_slashes = False
    return AccessMiddleware(app, host=host, token=token, is_open=_is_open)


def _is_open(path: str) -> bool:
    """Return whether a path is one of the page's own files, which are not secret."""
    return path == "/" or path.startswith("/assets/")


def _json(content: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(content), status, media_type="application/json")


async def _serve(
    socket: WebSocket, broadcaster: Broadcaster, source: PageSource, control: bool
) -> None:
    """Send a page every frame that it has time for, and carry out its requests, until it closes."""
    room = asyncio.BoundedSemaphore(_UNSEEN)

    async def send() -> None:
        encoder, serial, sent_s = FrameEncoder(source), 0, 0.0
        while True:
            await room.acquire()
            frame = None
            while frame is None:
                serial, snapshot = await broadcaster.next(serial)
                frame = encoder.encode(snapshot, beat=time.monotonic() - sent_s > _BEAT_S)
            sent_s = time.monotonic()
            await socket.send_text(frame.decode())

    async def receive() -> None:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            await _answer(socket, message.get("text") or "", room, source, control)

    tasks = {asyncio.create_task(send()), asyncio.create_task(receive())}
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        with suppress(WebSocketDisconnect):
            for task in done:
                task.result()
    finally:
        for task in tasks:
            task.cancel()


async def _answer(
    socket: WebSocket, text: str, room: asyncio.BoundedSemaphore, source: PageSource, control: bool
) -> None:
    number: int | None = None
    try:
        request = decode(text)
        if isinstance(request, FrameShown):
            with suppress(ValueError):  # it confirms more frames than it was sent
                room.release()
            return
        number = request.id
        answer = {"answer": number, "done": perform(request, source, control=control)}
    except RequestError as error:
        answer = {"answer": number, "problem": str(error)}
    await socket.send_text(msgspec.json.encode(answer).decode())
