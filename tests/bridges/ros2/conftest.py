from __future__ import annotations

import importlib.util
import itertools
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from fake_rclpy import modules
from free_ports import free_endpoint, free_port
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.rclpy_transport.api import import_rclpy
from llfsm.bridges.ros2.transport import Notice, Transport
from llfsm.bridges.ros2.types import TypeLibrary
from memory_transport import MemoryTransport, MemoryWorld
from ros_domains import own_domains
from waiting import PATIENCE_S, wait_for


class Seen(list[Any]):
    """A list that can be waited for; use it as a callback or as what gets notices."""

    def __init__(self) -> None:
        super().__init__()
        self._changed = threading.Condition()

    def __call__(self, thing: Any) -> None:
        with self._changed:
            self.append(thing)
            self._changed.notify_all()

    def wait(self, ready: Callable[[Seen], object]) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: ready(self), PATIENCE_S), list(self)

    def repeat(self, do: Callable[[], object]) -> None:
        """Do something until it is seen: what is published may be too early for a subscription."""
        for _ in range(100):
            do()
            with self._changed:
                if self._changed.wait_for(lambda: len(self), PATIENCE_S / 100):
                    return
        raise AssertionError("nothing was seen")


class World:
    """A place where transports of one kind meet, empty at the beginning of a test."""

    reports_failure = True
    """Whether a caller learns at once that its request has failed."""
    counts = True
    """Whether messages come with a number."""
    reports_depth = True
    """Whether the graph tells how many messages an endpoint keeps."""

    def __init__(
        self, handles: ExitStack, opener: Callable[..., Transport], domains: range
    ) -> None:
        self._handles = handles
        self._opener = opener
        self._domains = domains
        self._transports: list[Transport] = []
        self._rclpy_nodes: list[Any] = []

    def open(
        self, notify: Callable[[Notice], None] | None = None, *, elsewhere: int = 0
    ) -> Transport:
        """Open one more transport; ``elsewhere``: in another domain."""
        domain = self._domains[elsewhere]
        self._transports.append(self._opener(domain, notify=Seen() if notify is None else notify))
        return self._handles.enter_context(self._transports[-1])

    def meet(self, name: str, subscriptions: int) -> None:
        """Wait until a topic's publishers have met so many subscriptions; others may know before.

        What they publish until then is lost. In DDS, the graph is earlier.
        """
        for transport in self._transports:
            if transport.domain == self._domains[0] and not transport.closed:
                assert transport.wait_graph(
                    lambda graph: len(graph.ends(name, Role.SUBSCRIPTION)) >= subscriptions,
                    PATIENCE_S,
                ), transport.graph()
        for publisher in (each for node in self._rclpy_nodes for each in node.publishers):
            if publisher.topic_name == name:
                counts = publisher.get_subscription_count
                wait_for(lambda counts=counts: counts() >= subscriptions)

    def note_nodes(self, of_rclpy: Any, patch: pytest.MonkeyPatch) -> None:
        """Note the nodes of rclpy that transports make: only their publishers count meetings."""
        make = of_rclpy.__init__

        def making(node: Any, *arguments: Any, **options: Any) -> None:
            make(node, *arguments, **options)
            self._rclpy_nodes.append(node)

        patch.setattr(of_rclpy, "__init__", making)


_DOMAINS = itertools.cycle(own_domains()[::2])
"""A pair for each test: what one leaves cannot reach another."""


@pytest.fixture(params=["memory", "zenoh", "rclpy", "fake rclpy"])
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    number = next(_DOMAINS)
    domains = range(number, number + 2)
    with ExitStack() as handles:
        if request.param == "memory":
            shared = MemoryWorld()
            yield World(
                handles, lambda domain, **kw: MemoryTransport(shared, domain, **kw), domains
            )
        elif request.param == "zenoh":
            from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport

            router = [request.getfixturevalue("router")]
            yield World(handles, lambda d, **kw: ZenohTransport(d, router=router, **kw), domains)
        else:
            middleware = ""
            if request.param == "fake rclpy":
                request.getfixturevalue("fake_rclpy")
            elif importlib.util.find_spec("rclpy") is None:
                pytest.skip("rclpy cannot be imported: no ROS 2 environment is sourced")
            else:
                middleware = request.getfixturevalue("middleware")
            from llfsm.bridges.ros2.rclpy_transport.transport import RclpyTransport

            rcl = World(handles, RclpyTransport, domains)
            rcl.reports_failure = False
            rcl.reports_depth = middleware != "rmw_fastrtps_cpp"
            rcl.counts = middleware != "rmw_cyclonedds_cpp"
            with pytest.MonkeyPatch.context() as patch:
                rcl.note_nodes(import_rclpy().new_node, patch)
                yield rcl


@pytest.fixture(scope="module")
def middleware(request: pytest.FixtureRequest) -> Iterator[str]:
    """Return what carries rclpy's messages; if that is Zenoh, have it meet at our router."""
    import rclpy

    name: str = rclpy.get_rmw_implementation_identifier()
    with pytest.MonkeyPatch.context() as environment:
        if name == "rmw_zenoh_cpp":
            router = request.getfixturevalue("router")
            environment.setenv("ZENOH_CONFIG_OVERRIDE", f'connect/endpoints=["{router}"]')
        yield name


@pytest.fixture
def fake_rclpy(monkeypatch: pytest.MonkeyPatch, types: TypeLibrary) -> None:
    """Have the stand-in imported instead of rclpy."""
    for name, module in modules(types).items():
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("turtle_sensor_poster", "turtle_sensor_poster.srv"):  # a workspace may have it
        monkeypatch.setitem(sys.modules, name, None)


@pytest.fixture(name="free_port")
def _free_port() -> int:
    """Return a TCP port on which nobody listens."""
    return free_port()


@pytest.fixture(scope="session")
def router() -> Iterator[str]:
    """Run a router in this process; return its endpoint."""
    from llfsm.bridges.ros2.opening import open_router

    endpoint = free_endpoint()
    session = open_router([endpoint])
    yield endpoint
    session.close()


@pytest.fixture(scope="session")
def types() -> TypeLibrary:
    """Return the types that everybody has, also where ROS is sourced."""
    with pytest.MonkeyPatch.context() as environment:
        environment.delenv("AMENT_PREFIX_PATH", raising=False)
        return TypeLibrary()


@pytest.fixture
def seen() -> Callable[[], Seen]:
    return Seen
