"""The socket of a window: frames as fast as it shows them, and answers to its requests.

Backpressure: a window confirms each frame that it has shown, and no more than two are under way.
A request controls a machine, posts a message, or moves in a recording.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, get_args

import msgspec
from starlette.websockets import WebSocket, WebSocketDisconnect

from llfsm.bridges.view.errors import RequestError
from llfsm.bridges.view.page_source import PageSource
from llfsm.runtime.debugging.leases import PAGE_LEASE_S
from llfsm.runtime.engine.errors import FsmError
from llfsm.runtime.engine.events import Status
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import WhiteboardError
from llfsm.whiteboard.message_text import parse_message
from llfsm.whiteboard.messages.llfsm import Action, Debugging, MachineRequest
from llfsm.whiteboard.shared import Whiteboard


class NumberedRequest(msgspec.Struct):
    """A request of a page, whose answer has its number."""

    id: int


class MachineCommand(NumberedRequest, tag="ask"):
    """Suspend, resume, restart, reload or stop a machine, or debug the machines of its process."""

    machine: str
    action: Action
    argument: str = ""


class PostMessage(NumberedRequest, tag="post"):
    """Add a message to a slot; fields left out are zero."""

    slot: str
    message: msgspec.Raw


class Seek(NumberedRequest, tag="seek"):
    """Go to a moment of a recording: seconds from its beginning."""

    at: float


class Play(NumberedRequest, tag="play"):
    """Play a recording at so many times real time; 0 pauses."""

    speed: float


class FrameShown(msgspec.Struct, tag="seen"):
    """The page has shown a frame and can take another one."""


PageRequest = MachineCommand | PostMessage | Seek | Play | FrameShown

_decoder: msgspec.json.Decoder[Any] = msgspec.json.Decoder(PageRequest)


def decode(text: str, decoder: msgspec.json.Decoder[Any] = _decoder) -> Any:
    """Decode a request of a page, by default a `PageRequest`; raise `RequestError`."""
    try:
        return decoder.decode(text)
    except (ValueError, RecursionError) as error:  # msgspec's is a ValueError
        raise RequestError(f"invalid request: {error}") from error


def is_early(request: PageRequest, source: PageSource) -> bool:
    """Check if a request would replace an earlier one that its machine has not obeyed yet."""
    board = source.board()
    if board is None or not isinstance(request, MachineCommand):
        return False
    with suppress(WhiteboardError, FsmError):  # what is wrong is found when it is performed
        return Directory(board).find(request.machine).is_asked
    return False


def perform(
    request: MachineCommand | PostMessage | Seek | Play, source: PageSource, *, control: bool
) -> str:
    """Carry out a request and return a text that confirms it; raise `RequestError`.

    Without `control`, only moves in a recording are carried out.
    """
    if isinstance(request, Seek | Play):
        return _move(request, source)
    board = source.board()
    if not control:
        raise RequestError("this page only shows; start it with --control")
    if board is None:
        raise RequestError("no live whiteboard to control")
    try:
        if isinstance(request, PostMessage):
            assert isinstance(board, Whiteboard)
            slot = board.find(request.slot)
            count = board.add_message(slot, parse_message(slot, bytes(request.message)))
            return f"message {count} of {request.slot}"
        machine = Directory(board).find(request.machine)
        if request.action == "renew":
            machine.renew(PAGE_LEASE_S)
            return f"{request.machine}: renewed"
        if request.action in get_args(Debugging):
            machine.send(MachineRequest(request.action, request.argument, PAGE_LEASE_S))
            return f"{request.machine}: {request.action}"
        if machine.request(request.action) is Status.ERROR:
            raise RequestError(f"{request.machine} is about to restart; try again after that")
    except (WhiteboardError, FsmError) as error:
        raise RequestError(str(error)) from error
    failure = f"; it had failed: {machine.status.error}" if machine.status.failed else ""
    return f"{request.machine}: asked to {request.action}{failure}"


def _move(request: Seek | Play, source: PageSource) -> str:
    player = source.player
    if player is None:
        raise RequestError("a live whiteboard has no time slider")
    if isinstance(request, Play):
        if not 0 <= request.speed <= 1000:
            raise RequestError(f"a speed of {request.speed} is not in 0 to 1000")
        player.play(request.speed)
        return f"speed {request.speed:g}"
    first_ns, last_ns = player.span_ns
    after_s = min(max(request.at, 0.0), (last_ns - first_ns) / 1e9)
    player.seek(min(first_ns + round(after_s * 1e9), last_ns))
    return f"at {request.at:.3f} s"


_UNSEEN = 2  # frames sent to a page before it confirms that it has shown one


async def serve_page(
    socket: WebSocket,
    next_frame: Callable[[], Awaitable[bytes]],
    decode: Callable[[str], Any],
    perform: Callable[[Any], Awaitable[str]],
) -> None:
    """Send a window every frame that it has time for, and carry out its requests, until it closes.

    `decode` and `perform` raise `RequestError`, whose text is the answer.
    """
    room = asyncio.BoundedSemaphore(_UNSEEN)

    async def send() -> None:
        while True:
            await room.acquire()
            await socket.send_text((await next_frame()).decode())

    async def receive() -> None:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            number: int | None = None
            try:
                request = decode(message.get("text") or "")
                if isinstance(request, FrameShown):
                    with suppress(ValueError):  # it confirms more frames than it was sent
                        room.release()
                    continue
                number = request.id
                answer = {"answer": number, "done": await perform(request)}
            except RequestError as error:
                answer = {"answer": number, "problem": str(error)}
            await socket.send_text(msgspec.json.encode(answer).decode())

    tasks = {asyncio.create_task(send()), asyncio.create_task(receive())}
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        with suppress(WebSocketDisconnect):
            for task in done:
                task.result()
    finally:
        for task in tasks:
            task.cancel()
            task.add_done_callback(_take)


def _take(task: asyncio.Task[None]) -> None:
    """Take how a task has ended, of which asyncio would print a traceback: both see the page go."""
    if not task.cancelled():
        task.exception()
