"""The web application: the page's files, its stream of frames, and its requests."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from llfsm.whiteboard.messages.llfsm import DEFINITIONS, MachineDefinition

from .access import AccessMiddleware
from .broadcaster import Broadcaster
from .connections import log_exhaustion_once
from .diagram_data import SECTIONS, diagram_data
from .errors import RequestError
from .event_log import log_page
from .frames import FrameEncoder
from .page_files import ASSETS, PageFiles, is_open, json_response
from .page_requests import decode, perform
from .page_socket import serve_page
from .page_source import PageSource

__all__ = ["make_app"]

_BEAT_S = 0.5  # between frames to an idle page, by which it notices a server that is gone
_MOST_EVENTS = 10_000  # of the log at once


def make_app(source: PageSource, *, host: str, token: str, control: bool) -> AccessMiddleware:
    """Return the application that shows `source`, behind its access control."""
    files = PageFiles(ASSETS)
    broadcaster: Broadcaster | None = None
    begun_ns = time.monotonic_ns() - time.time_ns()  # live events have the time of day

    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        nonlocal broadcaster
        broadcaster = Broadcaster(source)  # here, because it belongs to the running loop
        log_exhaustion_once(asyncio.get_running_loop())
        yield
        source.close()

    async def about(_: HttpRequest) -> Response:
        player = source.player
        span = None if player is None else (player.span_ns[1] - player.span_ns[0]) / 1e9
        return json_response({"title": source.title, "control": control, "span": span})

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
            return json_response({"problem": str(error)})
        return json_response(drawn)

    async def log(request: HttpRequest) -> Response:
        asked = request.query_params
        try:
            most = int(asked.get("most", "200"))
            until_s = float(asked["until"]) if "until" in asked else None
            if not 0 < most <= _MOST_EVENTS or (until_s is not None and not abs(until_s) < 1e10):
                raise ValueError(f"at most {_MOST_EVENTS} events, until a time in seconds")
        except ValueError as error:
            return json_response({"problem": f"invalid request: {error}"}, 400)
        latest = None if broadcaster is None else broadcaster.snapshot
        samples = {} if latest is None else latest.samples
        base_ns = begun_ns if source.player is None else source.player.span_ns[0]
        page = log_page(
            source.history(),
            source.notes(),
            samples,
            words=asked.get("words", ""),
            until_ns=None if until_s is None else base_ns + round(until_s * 1e9),
            most=most,
        )
        events = [((e.stamp_ns - base_ns) / 1e9, *e[1:]) for e in page.events]
        return json_response({"events": events, "complete": page.complete})

    async def live(socket: WebSocket) -> None:
        assert broadcaster is not None
        await socket.accept()

        async def answer(request: Any) -> str:
            return perform(request, source, control=control)

        async with broadcaster:
            await serve_page(socket, _frames(broadcaster, source), decode, answer)

    app = Starlette(
        routes=[
            Route("/", files.respond),
            Route("/assets/{name}", files.respond),
            Route("/about", about),
            Route("/diagram", diagram),
            Route("/log", log),
            WebSocketRoute("/live", live),
        ],
        lifespan=life,
    )
    app.router.redirect_slashes = False
    return AccessMiddleware(app, host=host, token=token, is_open=is_open)


def _frames(broadcaster: Broadcaster, source: PageSource) -> Callable[[], Awaitable[bytes]]:
    """Return what waits for the next frame of one page."""
    encoder, serial, sent_s = FrameEncoder(source), 0, 0.0

    async def next_frame() -> bytes:
        nonlocal serial, sent_s
        frame = None
        while frame is None:
            serial, snapshot = await broadcaster.next(serial)
            frame = encoder.encode(snapshot, beat=time.monotonic() - sent_s > _BEAT_S)
        sent_s = time.monotonic()
        return frame

    return next_frame
