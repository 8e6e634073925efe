from __future__ import annotations

import itertools
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh

from forked import Forked
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport

HASHES = Path(__file__).parents[3] / "data" / "ros2" / "type_hashes.json"
_DOMAINS = itertools.count(101)


class Peer:
    """The node of peer.py, in a process of its own."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def do(self, *command: Any) -> list[Any]:
        """Have a command done; return the events that it reported before."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(command) + "\n")
        self.process.stdin.flush()
        return self.events_until("done")

    def events_until(self, kind: str) -> list[Any]:
        """Return events up to the first of a kind, itself left out."""
        events = []
        while (event := self.event())[0] != kind:
            events.append(event)
        return events

    def event(self) -> Any:
        """Return the next event."""
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())


@pytest.fixture
def domain() -> int:
    """Return a ROS domain that no other test uses."""
    return next(_DOMAINS)


@pytest.fixture
def transport(router: str, domain: int) -> Iterator[ZenohTransport]:
    with ZenohTransport(domain, router=[router], notify=lambda _: None) as transport:
        yield transport


@pytest.fixture
def start_peer(router: str, domain: int) -> Iterator[Callable[[], Peer]]:
    with ExitStack() as processes:

        def start() -> Peer:
            command = [sys.executable, str(Path(__file__).with_name("peer.py"))]
            process = processes.enter_context(
                Forked(
                    [*command, router.rpartition(":")[2], str(domain), str(HASHES)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                )
            )
            processes.callback(process.kill)
            deadline = threading.Timer(60, process.kill)  # else a test that fails would wait on
            deadline.start()
            processes.callback(deadline.cancel)
            return Peer(process)

        yield start


@pytest.fixture
def stranger(router: str) -> Iterator[zenoh.Session]:
    """Open a Zenoh session that knows nothing of ROS."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([router]))
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    yield session
    session.close()
