"""Clients that are slow, silent or many keep nobody else from the page."""

from __future__ import annotations

import asyncio
import errno
import os
import resource
import select
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, NoReturn

import pytest

from llfsm.bridges.view.access import log_exhaustion_once
from waiting import PATIENCE_S, wait_for

from .conftest import Server

HEAD = b"GET /about HTTP/1.1\r\nHost: localhost\r\n"
ASSET = b"GET /assets/main.js HTTP/1.1\r\nHost: localhost\r\n\r\n"


@pytest.fixture
def server(board: str, start: Callable[..., Any]) -> Server:
    return start(Server, board)


@pytest.fixture
def dial(server: Server) -> Iterator[Callable[[], socket.socket]]:
    with ExitStack() as stack:
        yield lambda: stack.enter_context(
            socket.create_connection(("127.0.0.1", server.port), PATIENCE_S)
        )


def is_closed(client: socket.socket) -> bool:
    """Read what has arrived; return whether the server has closed the connection."""
    while select.select([client], [], [], 0)[0]:
        try:
            if not client.recv(1 << 16):
                return True
        except ConnectionResetError:
            return True
    return False


def is_served(server: Server) -> bool:
    return server.get("/about").status_code == 200


def test_a_slow_client_is_closed_and_a_page_is_not(
    server: Server, dial: Callable[[], socket.socket]
) -> None:
    silent, half, trickling, asking = dial(), dial(), dial(), dial()
    half.sendall(HEAD)
    trickling.sendall(HEAD + b"X: ")

    def keep_on() -> None:
        for client, text in ((trickling, b"x"), (asking, ASSET)):
            if not is_closed(client):
                client.sendall(text)

    with server.live() as page:
        for client in (silent, half, trickling, asking):
            wait_for(lambda client=client: is_closed(client), "it is closed", between=keep_on)
        page.recv(PATIENCE_S)  # which is older than they were
        page.ping().wait(PATIENCE_S)
    assert is_served(server)


def test_many_silent_clients_keep_nobody_out(
    server: Server, dial: Callable[[], socket.socket]
) -> None:
    with server.live() as page:
        silent = [dial() for _ in range(300)]
        assert is_served(server)
        wait_for(lambda: sum(not is_closed(each) for each in silent) <= 64, "the oldest are closed")
        assert is_served(server)
        page.recv(PATIENCE_S)
        page.ping().wait(PATIENCE_S)


def test_without_file_descriptors_it_goes_on_and_logs_little(
    board: str, start: Callable[..., Any], dial: Callable[[], socket.socket], server: Server
) -> None:
    descriptors = len([*Path(f"/proc/{server.popen.pid}/fd").iterdir()])
    resource.prlimit(server.popen.pid, resource.RLIMIT_NOFILE, (descriptors + 8, descriptors + 8))
    silent = [dial() for _ in range(60)]
    wait_for(lambda: len([*Path(f"/proc/{server.popen.pid}/fd").iterdir()]) >= descriptors + 8)
    for client in silent:
        client.close()
    wait_for(lambda: is_served(server), "the page is served again")
    status, printed = server.end()
    assert status == 0
    assert printed.count("cannot accept connections") == 1
    assert len(printed) < 2000


class Exhausted(socket.socket):
    """A socket of a process that can open no more files."""

    refusals = 0

    def accept(self) -> NoReturn:
        self.refusals += 1
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))


def test_an_end_before_connections_are_accepted_again_is_not_logged(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop tries again after a second, hundreds of times, whether the socket is open or not."""

    def go_on() -> None:
        loop.run_until_complete(asyncio.sleep(0))

    with closing(asyncio.new_event_loop()) as loop, Exhausted() as listening:
        log_exhaustion_once(loop)
        listening.bind(("127.0.0.1", 0))
        server = loop.run_until_complete(loop.create_server(asyncio.Protocol, sock=listening))
        with socket.create_connection(listening.getsockname()):
            wait_for(lambda: listening.refusals, between=go_on)
        server.close()
        later_s = loop.time() + 60
        monkeypatch.setattr(loop, "time", lambda: later_s)
        go_on()
    (record,) = caplog.records
    assert "cannot accept connections" in record.getMessage()


def test_what_clients_send_is_not_logged(server: Server, dial: Callable[[], socket.socket]) -> None:
    for _ in range(20):
        client = dial()
        client.sendall(b"\x00\xff garbage\r\n\r\n")
        wait_for(lambda client=client: is_closed(client), "it is refused")
    assert server.end() == (0, "")
