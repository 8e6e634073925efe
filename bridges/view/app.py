"""The web application that shows one source: its page, a stream of frames, its requests and log.

One `Broadcaster` takes snapshots for all windows, up to thirty a second and only while one is open.
At most a fifth of the time goes into them: a page must not slow the machines of its host. Each
window makes its own frames of the newest snapshot when it has room for one, so a slow window misses
snapshots, delays no other, and nothing is queued for it.
"""

from __future__ import annotations

import asyncio
import logging
import time
from bisect import bisect_right
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from functools import partial
from heapq import merge
from itertools import islice
from operator import attrgetter
from typing import Any, Final, Generic, NamedTuple, TypeVar

from starlette.concurrency import run_in_threadpool
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
from llfsm.bridges.view.errors import RequestError
from llfsm.bridges.view.frames import SECTIONS, FrameEncoder, diagram_data
from llfsm.bridges.view.page_requests import decode, is_early, perform, serve_page
from llfsm.bridges.view.page_source import Change, Note, PageSource, Snapshot
from llfsm.runtime.debugging.leases import PAGE_LEASE_S
from llfsm.whiteboard import Sample
from llfsm.whiteboard.messages.llfsm import DEFINITIONS, MachineDefinition

_LOOKED_AT: Final = 50  # events for each one that is asked for: a page must not wait for long


class LogPage(NamedTuple):
    """The newest events; `complete` if there are no older ones."""

    events: list[Note]
    complete: bool


def log_page(
    history: Mapping[str, Sequence[Change]],
    notes: Sequence[Note],
    samples: Mapping[str, Sample[Any]],
    *,
    words: str = "",
    until_ns: int | None = None,
    most: int = 200,
) -> LogPage:
    """Search the log for up to `most` events that have all the words, the newest first.

    `until_ns` is the latest time, on the clock of the stamps; None for no end. The labels of
    transitions are in the definitions among the samples.
    """
    wanted = words.lower().split()
    ways = [_changes(name, each, samples, until_ns) for name, each in history.items()]
    end = len(notes) if until_ns is None else bisect_right(notes, until_ns, key=_stamp_ns)
    # Without an end, these may grow, or lose their oldest, only after this function has returned.
    newest = merge(*ways, (notes[i] for i in range(end - 1, -1, -1)), key=_stamp_ns, reverse=True)
    looked_at = islice(newest, _LOOKED_AT * most)
    found = list(islice((each for each in looked_at if _has(each, wanted)), most))
    return LogPage(found, next(newest, None) is None)


_stamp_ns = attrgetter("stamp_ns")


def _has(event: Note, wanted: Sequence[str]) -> bool:
    text = f"{event.machine} {event.kind} {event.text}".lower()
    return all(word in text for word in wanted)


def _changes(
    machine: str,
    changes: Sequence[Change],
    samples: Mapping[str, Sample[Any]],
    until_ns: int | None,
) -> Iterator[Note]:
    """Give a machine's changes as events, the latest first."""
    sample = samples.get(DEFINITIONS + machine)
    definition = None if sample is None else sample.message
    labels = {}
    if isinstance(definition, MachineDefinition):
        for state in definition.states:
            for number, each in enumerate(state.transitions):
                labels[state.name, number] = each.label
    end = len(changes) if until_ns is None else bisect_right(changes, until_ns, key=_stamp_ns)
    for i in range(end - 1, -1, -1):
        change, before = changes[i], changes[i - 1] if i else None
        if not change.failed:  # there is a note of it, which says why
            kind, text = _described(change, before, labels)
            yield Note(change.stamp_ns, machine, kind, text)


def _described(
    change: Change, before: Change | None, labels: Mapping[tuple[str, int], str]
) -> tuple[str, str]:
    """Return the kind and the text of a change."""
    if not change.state:
        return "ended", "ended"
    if change.suspended:
        return "suspended", f"suspended in {change.state}"
    if before is not None and before.suspended:
        return "resumed", f"resumed in {change.state}"
    if not change.source:
        return "state", f"in {change.state}"
    label = labels.get((change.source, change.transition), "")
    text = f"{change.source} → {change.state}  {label}".rstrip()
    return "transition", f"… {text}" if change.skipped else text


T = TypeVar("T")

_log = logging.getLogger(__name__)

_PERIOD_S = 1 / 30
_SHARE = 5  # at most one part in so many of the time goes into snapshots and frames
_BEAT_S = 0.5  # between frames to an idle page, by which it notices a server that is gone


class Broadcaster(Generic[T]):
    """Call `take` for a snapshot each `period_s` seconds, while any window is open; then `left`."""

    def __init__(
        self,
        take: Callable[[], T],
        *,
        period_s: float = _PERIOD_S,
        left: Callable[[], None] = lambda: None,
    ) -> None:
        self.snapshot: T | None = None
        self._take = take
        self._period_s = period_s
        self._left = left
        self._pages = 0
        self._serial = 0
        self._taken = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Broadcaster[T]:
        """Add a window; the first one starts the snapshots."""
        self._pages += 1
        if self._task is None:
            self._task = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._pages -= 1
        if not self._pages and self._task is not None:
            self._task.cancel()
            self._task = None
            self._left()

    async def next(self, after: int) -> tuple[int, T]:
        """Wait for a snapshot newer than number `after`; return the newest and its number."""
        while self._serial <= after or self.snapshot is None:
            await self._taken.wait()
        return self._serial, self.snapshot

    async def _run(self) -> None:
        while True:
            # All the server's work is on this thread: its CPU time since the last snapshot is the
            # cost of the snapshot and of the frames made from it.
            began, cpu = time.monotonic(), time.thread_time()
            try:
                self.snapshot = self._take()
            except Exception:
                _log.exception("a snapshot has failed; the pages keep the last one")
            self._serial += 1
            self._taken.set()
            self._taken = asyncio.Event()
            await asyncio.sleep(self._period_s / 2)
            busy = time.thread_time() - cpu
            due = began + max(self._period_s, _SHARE * busy)
            await asyncio.sleep(max(0.0, due - time.monotonic()))


def frames(
    broadcaster: Broadcaster[T], encode: Callable[[T, bool], bytes | None]
) -> Callable[[], Awaitable[bytes]]:
    """Return a function that waits for the next frame of one window.

    `encode` takes a snapshot, and if a beat is due. Without one, it returns None if nothing has
    changed.
    """
    serial, sent_s = 0, 0.0

    async def next_frame() -> bytes:
        nonlocal serial, sent_s
        frame = None
        while frame is None:
            serial, snapshot = await broadcaster.next(serial)
            frame = encode(snapshot, time.monotonic() - sent_s > _BEAT_S)
        sent_s = time.monotonic()
        return frame

    return next_frame


_MOST_EVENTS = 10_000  # of the log at once
_LOOK_S, _LOOKS = 0.02, 25  # until another request is obeyed


class SourcePage:
    """Answer the requests of all windows that show one source; once all are closed, call `left`."""

    def __init__(
        self, source: PageSource, *, control: bool, left: Callable[[], None] = lambda: None
    ) -> None:
        self.source = source
        self._control = control
        self._broadcaster = Broadcaster(source.snapshot, left=left)
        self._begun_ns = time.monotonic_ns() - time.time_ns()  # live events have the time of day

    def facts(self) -> dict[str, Any]:
        """Describe what the page shows; with control, pauses by it last `lease_s` seconds."""
        player = self.source.player
        span = None if player is None else (player.span_ns[1] - player.span_ns[0]) / 1e9
        return {
            "title": self.source.title,
            "control": self._control,
            "lease_s": PAGE_LEASE_S,
            "span": span,
        }

    async def about(self, _: HttpRequest) -> Response:
        """Send the facts to a window."""
        return json_response(self.facts())

    async def diagram(self, request: HttpRequest) -> Response:
        """Send the diagram of a machine, or why there is none."""
        name = request.query_params.get("machine", "")
        sections = request.query_params.get("sections", "auto")
        latest: Snapshot | None = self._broadcaster.snapshot
        sample = (latest or self.source.snapshot()).samples.get(DEFINITIONS + name)
        try:
            if sample is None or not isinstance(sample.message, MachineDefinition):
                raise RequestError(f"{name}: its process has not published a definition")
            unfold, shown = "unfold" in request.query_params, SECTIONS.get(sections)
            draw = partial(diagram_data, sample.message, name, shown, unfold=unfold)
            drawn = await run_in_threadpool(draw)
        except RequestError as error:
            return json_response({"problem": str(error)})
        return json_response(drawn)

    async def log(self, request: HttpRequest) -> Response:
        """Send events of the log, the latest first."""
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

        encode = FrameEncoder(self.source).encode
        async with self._broadcaster:
            await socket.accept()
            await serve_page(socket, frames(self._broadcaster, encode), decode, answer)


def make_app(source: PageSource, *, host: str, token: str, control: bool) -> AccessMiddleware:
    """Make the application that shows `source`, behind its access control.

    `host` is the name or address to listen on. Without `control` the page only shows.
    """
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
