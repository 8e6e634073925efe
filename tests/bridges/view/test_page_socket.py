"""The socket of a page, without a server."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any, cast

from starlette.websockets import WebSocket, WebSocketDisconnect

from llfsm.bridges.view.page_requests import serve_page


class GoneSocket:
    """A page that has gone."""

    async def receive(self) -> dict[str, Any]:
        return {"type": "websocket.disconnect"}

    async def send_text(self, text: str) -> None:
        raise WebSocketDisconnect


def test_a_page_that_goes_before_its_frame_is_sent_is_no_error() -> None:
    wrong: list[object] = []

    async def next_frame() -> bytes:
        with suppress(asyncio.CancelledError):  # as `wait_for` may do, until Python 3.12
            await asyncio.Event().wait()
        return b"{}"

    async def perform(request: object) -> str:
        return ""

    async def serve() -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, what: wrong.append(what))
        await serve_page(cast(WebSocket, GoneSocket()), next_frame, str, perform)
        while len(asyncio.all_tasks()) > 1:
            await asyncio.sleep(0)

    asyncio.run(serve())
    assert wrong == []
