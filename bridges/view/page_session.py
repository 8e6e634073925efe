"""The page of one source: its stream of frames, and its requests."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.websockets import WebSocket

from llfsm.whiteboard.messages.llfsm import DEFINITIONS, MachineDefinition

from .broadcaster import Broadcaster, frames
from .diagram_data import SECTIONS, diagram_data
from .errors import RequestError
from .event_log import log_page
from .frames import FrameEncoder
from .page_files import json_response
from .page_requests import decode, is_early, perform
from .page_socket import serve_page
from .page_source import PageSource, Snapshot

__all__ = ["SourcePage"]

_MOST_EVENTS = 10_000  # of the log at once
_LOOK_S, _LOOKS = 0.02, 25  # until another request is obeyed


class SourcePage:
    """Answers the requests of all windows that show one source.

    When the last window is closed, `left` is called.
    """

    def __init__(
        self, source: PageSource, *, control: bool, left: Callable[[], None] = lambda: None
    ) -> None:
        self.source = source
        self._control = control
        self._broadcaster = Broadcaster(source.snapshot, left=left)
        self._begun_ns = time.monotonic_ns() - time.time_ns()  # live events have the time of day

    def facts(self) -> dict[str, Any]:
        """Return what the page shows, and whether it controls that."""
        player = self.source.player
        span = None if player is None else (player.span_ns[1] - player.span_ns[0]) / 1e9
        return {"title": self.source.title, "control": self._control, "span": span}

    async def about(self, _: HttpRequest) -> Response:
        """Return the same to a window."""
        return json_response(self.facts())

    async def diagram(self, request: HttpRequest) -> Response:
        """Return the diagram of a machine."""
        name = request.query_params.get("machine", "")
        sections = request.query_params.get("sections", "auto")
        latest: Snapshot | None = self._broadcaster.snapshot
        sample = (latest or self.source.snapshot()).samples.get(DEFINITIONS + name)
        try:
            if sample is None or not isinstance(sample.message, MachineDefinition):
                raise RequestError(f"{name}: its process has not published a definition")
            shown = SECTIONS.get(sections)
            drawn = await run_in_threadpool(diagram_data, sample.message, name, shown)
        except RequestError as error:
            return json_response({"problem": str(error)})
        return json_response(drawn)

    async def log(self, request: HttpRequest) -> Response:
        """Return events, the latest first."""
        asked, source = request.query_params, self.source
        try:
            most = int(asked.get("most", "200"))
            until_s = float(asked["until"]) if "until" in asked else None
            if not 0 < most <= _MOST_EVENTS or (until_s is not None and not abs(until_s) < 1e10):
                raise ValueError(f"at most {_MOST_EVENTS} events, until a time in seconds")
        except ValueError as error:
            return json_response({"problem": f"invalid request: {error}"}, 400)
        latest = self._broadcaster.snapshot
        samples = {} if latest is None else latest.samples
        base_ns = self._begun_ns if source.player is None else source.player.span_ns[0]
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

    async def live(self, socket: WebSocket) -> None:
        """Send frames to a window, and carry out its requests, until it is closed."""

        async def answer(request: Any) -> str:
            for _ in range(_LOOKS):  # other pages, and commands, ask, too
                if not is_early(request, self.source):
                    break
                await asyncio.sleep(_LOOK_S)
            return perform(request, self.source, control=self._control)

        encoder = FrameEncoder(self.source)

        def encode(snapshot: Snapshot, beat: bool) -> bytes | None:
            return encoder.encode(snapshot, beat=beat)

        async with self._broadcaster:
            await socket.accept()
            await serve_page(socket, frames(self._broadcaster, encode), decode, answer)
