"""The socket of a page: frames as fast as it shows them, and answers to its requests."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

import msgspec
from starlette.websockets import WebSocket, WebSocketDisconnect

from .errors import RequestError
from .page_requests import FrameShown

__all__ = ["serve_page"]

_UNSEEN = 2  # frames sent to a page before it confirms that it has shown one


async def serve_page(
    socket: WebSocket,
    next_frame: Callable[[], Awaitable[bytes]],
    decode: Callable[[str], Any],
    perform: Callable[[Any], Awaitable[str]],
) -> None:
    """Send a page every frame that it has time for, and carry out its requests, until it closes.

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
