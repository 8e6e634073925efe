"""One host's network alone: what Zenoh reports of another one's replies."""

from __future__ import annotations

import queue
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest

from free_ports import free_endpoint
from llfsm.whiteboard.errors import NetworkError
from llfsm.whiteboard.mirror.groups import group_of
from llfsm.whiteboard.mirror.keys import Keys
from llfsm.whiteboard.mirror.network import Network
from llfsm.whiteboard.mirror.peers import Query, Source
from llfsm.whiteboard.mirror.settings import Settings
from waiting import PATIENCE_S, wait_for

OTHER, GROUP = 2, group_of("number")
PARTS = [b"one part", b"another part"]


class Asker:
    """A host that only asks; the rest of a receiver is not called."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.ends: queue.Queue[bool] = queue.Queue()
        self.linked = False

    def receive_link(self, to_router: bool) -> None:
        assert not to_router
        self.linked = True

    def receive_reply(self, data: bytes, *_: str) -> None:
        self.parts.append(data)

    def end_reply(self, query: Query, *, complete: bool) -> None:
        self.ends.put(complete)


Ask = Callable[[Callable[[Any], None]], bool]


@pytest.fixture
def asker() -> Asker:
    return Asker()


@pytest.fixture
def reply_s() -> float:
    return PATIENCE_S


@pytest.fixture
def ask(asker: Asker, reply_s: float) -> Iterator[Ask]:
    """Return a function that asks a host which answers as it is told."""
    import zenoh

    endpoint = free_endpoint()
    settings = Settings(listen=(endpoint,), connect=())
    asking = Network("board", 1, settings, reply_s=reply_s)
    asking.join(asker)  # type: ignore[arg-type]
    config = zenoh.Config()
    for key, value in {
        "mode": '"client"',
        "connect/endpoints": f'["{endpoint}"]',
        "scouting/multicast/enabled": "false",
        "transport/shared_memory/enabled": "false",  # whose file would stay
    }.items():
        config.insert_json5(key, value)
    with zenoh.open(config) as session:

        def ask(answer: Callable[[Any], None]) -> bool:
            session.declare_queryable(Keys("board", OTHER, "-").answered(GROUP), answer)
            query = Query(Source("", OTHER, GROUP), 1, b"")

            while not asker.parts:  # the other one may not be known yet
                asking.send_query(query)
                complete = asker.ends.get(timeout=PATIENCE_S)
            return complete

        wait_for(lambda: asker.linked)
        yield ask
    asking.close()


def test_a_reply_is_complete_with_all_its_parts(asker: Asker, ask: Ask) -> None:
    def answer(query: Any) -> None:
        with query:
            for part in PARTS:
                query.reply(query.key_expr, part)

    assert ask(answer)
    assert asker.parts == PARTS


@pytest.mark.parametrize("reply_s", [1.0])
def test_a_reply_of_which_a_part_does_not_arrive_in_time_is_not_complete(
    asker: Asker, ask: Ask
) -> None:
    """As when the rest is large, and was dropped: the host has to be asked again."""
    unanswered = []

    def answer(query: Any) -> None:
        query.reply(query.key_expr, PARTS[0])
        unanswered.append(query)  # which stays open

    assert not ask(answer)
    assert asker.parts == PARTS[:1]


def test_a_process_does_not_wait_for_ever() -> None:
    with pytest.raises(NetworkError, match="cannot open tcp/127"):
        Network("nobody", 1, Settings(connect=(free_endpoint(),)), "client", connect_s=0)


def test_a_network_reports_the_ports_that_it_got() -> None:
    given = "tcp/127.0.0.3:0", free_endpoint("127.0.0.4"), "tcp/127.0.0.2:0?prio=1-7"
    with closing(Network("board", 1, Settings(listen=given))) as network:
        first, second, third = network.listens
        assert re.fullmatch(r"tcp/127\.0\.0\.3:[1-9]\d*", first)
        assert second == given[1]
        assert re.fullmatch(r"tcp/127\.0\.0\.2:[1-9]\d*\?prio=1-7", third)
        for endpoint in (first, third):
            address, _, port = endpoint.removeprefix("tcp/").partition("?")[0].partition(":")
            socket.create_connection((address, int(port))).close()
