"""A page's server on a real socket, and clients that send it damaged handshakes and frames."""

from __future__ import annotations

import atexit
import os
import socket
import threading
from collections.abc import Iterable
from contextlib import suppress
from random import Random
from typing import Any

import msgspec
import uvicorn
from mutation import damaged, damaged_text
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.utils import ClientDisconnected
from websockets.sync.client import connect

from llfsm.bridges.view.access import configured
from llfsm.bridges.view.app import make_app
from llfsm.bridges.view.live_source import LiveSource
from llfsm.whiteboard import Message, Slot, Whiteboard

__all__ = ["PageServer"]

_TOKEN = "secret"
_HANDSHAKE = """GET /live?token={token} HTTP/1.1
Host: 127.0.0.1:{port}
Origin: http://127.0.0.1:{port}
Upgrade: websocket
Connection: Upgrade
Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==
Sec-WebSocket-Version: 13

"""
_LIMIT_S = 30.0


class PageServer:
    """A server in this process, and a page of its own that has to be served all the time."""

    def __init__(self, messages: dict[Slot[Any], Message]) -> None:
        self.board = Whiteboard(f"fuzz-{os.getpid()}")
        atexit.register(self.board.remove)
        for slot, message in messages.items():
            self.board.add_message(slot, message)
        source = LiveSource(self.board.name)
        app = make_app(source, host="127.0.0.1", token=_TOKEN, control=True)
        self._failures: list[Exception] = []

        async def checked(scope: Scope, receive: Receive, send: Send) -> None:
            try:
                await app(scope, receive, send)
            except ClientDisconnected:
                raise
            except Exception as error:  # a fault of the application, which would be logged
                self._failures.append(error)
                raise

        listener = socket.create_server(("127.0.0.1", 0))
        self._port = listener.getsockname()[1]
        server = uvicorn.Server(configured(checked))
        threading.Thread(target=server.run, args=([listener],), daemon=True).start()
        address = f"ws://127.0.0.1:{self._port}"
        self._page = connect(
            f"{address}/live?token={_TOKEN}", origin=f"http{address[2:]}", proxy=None
        )
        self._number = 0

    def attack(self, choose: Random, requests: Iterable[dict[str, Any]]) -> None:
        """Send a handshake and frames, damaged or not, and see that the page is still served."""
        hello = _HANDSHAKE.format(token=_TOKEN, port=self._port)
        if choose.random() < 0.2:
            hello = damaged_text(choose, hello)
        data = hello.replace("\n", "\r\n").encode(errors="surrogatepass")
        for request in choose.choices([*requests], k=choose.randrange(5)):
            payload = msgspec.json.encode(request)
            if choose.random() < 0.5:
                payload = damaged(choose, payload)
            data += _frame(choose, payload)
        if choose.random() < 0.2:
            data = damaged(choose, data)
        with (
            suppress(ConnectionError),
            socket.create_connection(("127.0.0.1", self._port), _LIMIT_S) as client,
        ):
            client.sendall(data)
            client.shutdown(socket.SHUT_WR)
            while client.recv(1 << 16):
                pass
        self.post()

    def post(self) -> None:
        """Post as the page does, and get the answer; raise what the application has raised."""
        self._number += 1
        self._page.send(msgspec.json.encode({"type": "seen"}).decode())
        post = {"type": "post", "id": self._number, "slot": "text", "message": {"data": "own"}}
        self._page.send(msgspec.json.encode(post).decode())
        while (answer := msgspec.json.decode(self._page.recv(_LIMIT_S))).get(
            "answer"
        ) != self._number:
            pass
        assert "problem" not in answer, answer
        if self._failures:
            raise self._failures.pop()


def _frame(choose: Random, payload: bytes) -> bytes:
    """Return a frame of WebSocket, mostly a text in one piece, as clients send it."""
    is_plain = choose.random() < 0.7
    first = 0x81 if is_plain else choose.getrandbits(8)
    length = len(payload) if choose.random() < 0.9 else choose.choice((0, 1, 200, 2**20, 2**63))
    masked = 0x80 if is_plain or choose.random() < 0.5 else 0
    if length < 126 and choose.random() < 0.9:
        head = bytes((first, masked | length))
    elif length < 2**16 and choose.random() < 0.9:
        head = bytes((first, masked | 126)) + length.to_bytes(2, "big")
    else:
        head = bytes((first, masked | 127)) + length.to_bytes(8, "big")
    mask = choose.randbytes(4)
    if not masked:
        return head + payload
    return head + mask + bytes(byte ^ mask[at % 4] for at, byte in enumerate(payload))
