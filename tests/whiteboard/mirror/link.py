"""A link between two hosts that is slow, loses packets and can be cut: a relay of TCP."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections import deque
from contextlib import suppress

__all__ = ["Link"]

_RESEND_S = 0.2  # by which all that follows a lost packet is late, as TCP sends it again
_CHUNK = 1400  # bytes: about a packet


class Link:
    """Relays each connection to `port` of this machine, until it is closed.

    Args:
        port: where the host at the other end listens.
        delay_s: one way.
        loss: of packets, 0 to 1.

    """

    def __init__(self, port: int, *, delay_s: float = 0.0, loss: float = 0.0) -> None:
        self._port = port
        self._delay_s = delay_s
        self._loss = loss
        self._random = random.Random(port)
        self._passes = threading.Event()
        self._passes.set()
        self._closed = False
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._sockets = [self._server]
        self._start(self._accept)

    def cut(self) -> None:
        """Let nothing pass, without an error at either end."""
        self._passes.clear()

    def join(self) -> None:
        """Let all pass again, also what was sent meanwhile."""
        self._passes.set()

    def close(self) -> None:
        """End all connections."""
        self._closed = True
        self._passes.set()
        for each in self._sockets:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _start(self, run: object, *arguments: object) -> None:
        threading.Thread(target=run, args=arguments, daemon=True).start()  # type: ignore[arg-type]

    def _accept(self) -> None:
        with suppress(OSError):
            while not self._closed:
                near, _ = self._server.accept()
                self._sockets.append(near)
                try:
                    far = socket.create_connection(("127.0.0.1", self._port))
                except OSError:  # nobody listens: who has connected finds out
                    near.close()
                    continue
                self._sockets.append(far)
                for source, to in ((near, far), (far, near)):
                    self._relay(source, to)

    def _relay(self, source: socket.socket, to: socket.socket) -> None:
        """Pass on what comes from one end, in order, each packet late by its delay."""
        waiting: deque[tuple[float, bytes]] = deque()
        changed = threading.Condition()

        def read() -> None:
            due_s, data = 0.0, b"-"
            while data:
                data = b""
                with suppress(OSError):
                    data = source.recv(_CHUNK)
                lost = self._random.random() < self._loss
                due_s = max(due_s, time.monotonic() + self._delay_s + lost * _RESEND_S)
                with changed:
                    waiting.append((due_s, data))
                    changed.notify()

        def write() -> None:
            data = b"-"
            while data:
                with changed:
                    changed.wait_for(lambda: waiting)
                    due_s, data = waiting.popleft()
                time.sleep(max(0.0, due_s - time.monotonic()))
                self._passes.wait()
                with suppress(OSError):
                    to.sendall(data) if data else to.shutdown(socket.SHUT_RDWR)

        self._start(read)
        self._start(write)
