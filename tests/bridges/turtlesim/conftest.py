from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from free_ports import free_endpoint
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.transport import (
    Client,
    Node,
    Notice,
    Publisher,
    SerializedMessage,
    Transport,
)
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.turtlesim.ros import RosTurtlesim
from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.bridges.turtlesim.turtle import Level
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from memory_transport import MemoryTransport, MemoryWorld
from waiting import PATIENCE_S, wait_for

DATA = Path(__file__).parents[2] / "data" / "turtlesim"
_ALL = Qos(depth=10_000)


@pytest.fixture
def recorded() -> Callable[[str], Any]:
    """Load a file that was recorded from turtlesim 1.8.2."""
    return lambda name: json.loads((DATA / name).read_text())


@pytest.fixture
def log() -> list[tuple[Level, str]]:
    return []


@pytest.fixture
def simulator(log: list[tuple[Level, str]]) -> Simulator:
    """A simulator as it starts, its log emptied after the spawning of turtle1."""
    simulator = Simulator(log=lambda level, text: log.append((level, text)))
    log.clear()
    return simulator


class Ros:
    """Our node on a graph, and another that talks to it from a transport of its own.

    Time passes only by `step`. What waits here works off our queue meanwhile.
    """

    def __init__(
        self,
        ours: Transport,
        theirs: Transport,
        log: list[tuple[Level, str]],
        reported: list[Notice],
    ) -> None:
        self.turtlesim = RosTurtlesim(ours, lambda level, text: log.append((level, text)))
        log.clear()
        self.reported = reported
        self.types = TypeLibrary()
        self.transport = theirs
        self.node: Node = theirs.node("other")
        self._ours = ours
        self._clients: dict[str, Client[Any, Any]] = {}
        self._publishers: dict[str, Publisher[Any]] = {}

    def step(self, times: int = 1) -> None:
        for _ in range(times):
            self.turtlesim.step()

    def until(self, ready: Callable[[], object]) -> None:
        wait_for(ready, between=self.turtlesim.queue.run_pending)

    def hear(self, topic: str, type_name: str, qos: Qos = _ALL) -> list[Any]:
        """Return a list of the messages of a topic from now on; it grows as they come."""
        got: list[Any] = []

        def receive(arrival: SerializedMessage[Any]) -> None:
            got.append(arrival.decode())

        subscription = self.node.subscription(topic, self.types.message(type_name), receive, qos)
        for transport in (self.transport, self._ours):
            assert transport.wait_graph(
                lambda graph: (
                    any(end.node == "/turtlesim" for end in graph.ends(topic, Role.PUBLISHER))
                    and any(end.node == "/other" for end in graph.ends(topic, Role.SUBSCRIPTION))
                ),
                PATIENCE_S,
            )
        assert subscription.name == topic
        return got

    def ask(self, service: str, type_name: str, **fields: Any) -> Future[Any]:
        """Call a service, and wait until that is in our queue."""
        of = self.types.service(type_name)
        client = self._clients.get(service)
        if client is None:
            client = self._clients[service] = self.node.client(service, of)
        assert self.transport.wait_graph(lambda _: client.ready, PATIENCE_S)
        before = len(self.turtlesim.queue)
        future = client.call(of.request.message(**fields), timeout=PATIENCE_S)
        self.arrives(before)
        return future

    def call(self, service: str, type_name: str, **fields: Any) -> Any:
        """Call a service and return the answer."""
        future = self.ask(service, type_name, **fields)
        self.until(future.done)
        return future.result()

    def command(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> None:
        """Command turtle1, and wait until that is in our queue."""
        topic = "/turtle1/cmd_vel"
        if topic not in self._publishers:
            twist = self.types.message("geometry_msgs/msg/Twist")
            self._publishers[topic] = self.node.publisher(topic, twist)
            assert self.transport.wait_graph(
                lambda graph: bool(graph.ends(topic, Role.SUBSCRIPTION)), PATIENCE_S
            )
        before = len(self.turtlesim.queue)
        self._publishers[topic].publish(Twist(Vector3(x=x, y=y), Vector3(z=z)))
        self.arrives(before)

    def arrives(self, before: int) -> None:
        """Wait until our queue has one thing more than before."""
        wait_for(lambda: len(self.turtlesim.queue) > before)


@pytest.fixture
def ros(request: pytest.FixtureRequest, log: list[tuple[Level, str]]) -> Iterator[Ros]:
    """Our node and another, in memory; with the parameter "zenoh" over a router of their own."""
    reported: list[Notice] = []
    if getattr(request, "param", "memory") == "memory":
        world = MemoryWorld()

        def open_transport() -> Transport:
            return MemoryTransport(world, notify=reported.append)
    else:
        from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport

        at = request.getfixturevalue("router")

        def open_transport() -> Transport:
            return ZenohTransport(91, router=[at], notify=reported.append)

    with open_transport() as ours, open_transport() as theirs:
        yield Ros(ours, theirs, log, reported)


@pytest.fixture
def router() -> Iterator[str]:
    """Run a router in this process; return its endpoint."""
    from llfsm.bridges.ros2.opening import open_router

    endpoint = free_endpoint()
    session = open_router([endpoint])
    yield endpoint
    session.close()
