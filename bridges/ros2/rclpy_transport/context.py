"""rclpy's context, the executor's thread, and the graph.

All that rclpy does happens on one thread, which spins its executor; other threads queue tasks for
it. rclpy reports no changes of the graph, so it is asked: once a second for incompatible endpoints,
and 50 times a second while somebody waits.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from functools import partial
from typing import Any, TypeVar

from llfsm.bridges.ros2.defaults import ROS_ARGUMENTS
from llfsm.bridges.ros2.errors import TransportUnavailableError
from llfsm.bridges.ros2.graph import Endpoint, Graph, Names, Role
from llfsm.bridges.ros2.qos import TOPIC, Qos
from llfsm.bridges.ros2.rclpy_transport import api
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import NoticeKind, Notifier

E = TypeVar("E", bound=IntEnum)

_LOOK = 1.0  # seconds between checks for incompatible endpoints: rclpy reports no changes

_INFINITE_NS = 2**63 - 1

_PAUSE = 0.01  # seconds after an error, so that a lasting one costs little


class RclpyContext:
    """A context of its own, whose nodes' callbacks run on one thread.

    It installs no signal handlers. Another part of the process may shut it down through rclpy.
    """

    def __init__(self, domain: int, enclave: str, notifier: Notifier) -> None:
        """Open it; raise :class:`.TransportUnavailableError` if the middleware cannot be."""
        self.rclpy = api.import_rclpy()
        self.notifier = notifier
        self.timer = TimerThread("ros2 answers")
        self.ours: dict[Endpoint, None] = {}
        self._nodes: list[Any] = []
        self._hidden: Any = None
        self._reading = threading.Lock()  # no node goes while it reads the graph
        self._over = threading.Event()
        self._ending = threading.Lock()
        self.context = self.rclpy.new_context()
        try:
            self._open(domain, enclave)
        except self.rclpy.failure as error:
            self.timer.close()
            self.context.try_shutdown()
            raise TransportUnavailableError(f"rclpy cannot be opened: {error}") from error
        self._thread = threading.Thread(target=self._spin, name="ros2 executor", daemon=True)
        self._thread.start()
        atexit.register(self.close)
        self._look_later()

    def _open(self, domain: int, enclave: str) -> None:
        self.rclpy.init(
            args=[ROS_ARGUMENTS, "--enclave", enclave] if enclave else [],
            context=self.context,
            domain_id=domain,
            signal_handler_options=self.rclpy.no_signal_handlers,
        )
        self.context.on_shutdown(self._on_shutdown)
        self.executor = self.rclpy.new_executor(context=self.context)

    def new_node(self, names: Names) -> Any:
        """Create a node without any endpoints, and spin it.

        Raise :class:`.TransportUnavailableError` if the middleware cannot.
        """
        node = self._new_node(names)
        with self._reading:
            self._nodes.append(node)
            hidden, self._hidden = self._hidden, None
        if hidden is not None:
            self._destroy(hidden)
        return node

    def _new_node(self, names: Names) -> Any:
        rclpy = self.rclpy
        quiet = rclpy.parameter("start_type_description_service", value=False)
        try:
            node = rclpy.new_node(
                names.node,
                namespace=names.namespace,
                context=self.context,
                use_global_arguments=False,
                enable_rosout=False,
                start_parameter_services=False,
                parameter_overrides=[quiet],
            )
        except rclpy.failure as error:
            raise TransportUnavailableError(
                f"rclpy cannot make the node {names.full_node}: {error}"
            ) from error
        for publisher in list(node.publishers):  # rclpy's own of /parameter_events
            node.destroy_publisher(publisher)
        self.executor.add_node(node)
        return node

    def remove_node(self, node: Any) -> None:
        """Take a node off the graph."""
        with self._reading:
            self._nodes.remove(node)
        self._destroy(node)

    def _destroy(self, node: Any) -> None:
        self.executor.remove_node(node)
        node.destroy_node()

    @contextmanager
    def _reader(self) -> Iterator[Any]:
        """Hold a node that reads the graph: one of ours, or a hidden one until there is one."""
        with self._reading:
            if not self._nodes and self._hidden is None:
                self._hidden = self._new_node(Names(f"_llfsm_{os.getpid()}"))
            yield self._nodes[0] if self._nodes else self._hidden

    def run(self, do: Callable[..., object], *arguments: object) -> None:
        """Run an action on the executor's thread, unless that is ending."""
        with self._ending:  # so that the executor exists until the task is queued
            if not self._over.is_set():
                self.executor.create_task(do, *arguments)

    def close(self) -> None:
        """Let the executor's thread shut everything down, and wait for it unless this is it."""
        atexit.unregister(self.close)
        with self._ending:
            self._over.set()
            # A spin without work continues, whatever wakes it.
            self.executor.create_task(lambda: None)
        if threading.current_thread() is not self._thread:
            self._thread.join()
        self.timer.close()

    def qos(self, qos: Qos) -> object:
        """Make a profile of rclpy; the numbers are the same."""
        of, duration = self.rclpy.qos, self.rclpy.duration
        limits = {
            "deadline": qos.deadline_ns,
            "lifespan": qos.lifespan_ns,
            "liveliness_lease_duration": qos.lease_ns,
        }
        profile: object = of.QoSProfile(
            reliability=of.ReliabilityPolicy(int(qos.reliability)),
            durability=of.DurabilityPolicy(int(qos.durability)),
            history=of.HistoryPolicy(int(qos.history)),
            depth=qos.depth,
            liveliness=of.LivelinessPolicy(int(qos.liveliness)),
            **{name: duration(nanoseconds=ns) for name, ns in limits.items() if ns},
        )
        return profile

    def graph(self) -> Graph:
        """Read the graph from rclpy."""
        with self._reader() as reader:
            names = reader.get_node_names_and_namespaces()
            return Graph.of(
                (_full(name, namespace) for name, namespace in names),
                (*self._topic_ends(reader), *self._service_ends(reader, names)),
            )

    def wait(self, ready: Callable[[], bool], timeout: float) -> bool | None:
        """Wait ``timeout`` seconds for ``ready()``; None: it was closed meanwhile."""
        period = 0.02
        for _ in range(int(timeout / period) + 1):
            if self._over.is_set():
                return None
            if ready():
                return True
            self._over.wait(min(period, timeout))
        return False

    def _topic_ends(self, reader: Any) -> Iterator[Endpoint]:
        for topic, _ in reader.get_topic_names_and_types():
            yield from self._ends_of(reader, topic)

    def _ends_of(self, reader: Any, topic: str) -> Iterator[Endpoint]:
        for role, infos in (
            (Role.PUBLISHER, reader.get_publishers_info_by_topic(topic)),
            (Role.SUBSCRIPTION, reader.get_subscriptions_info_by_topic(topic)),
        ):
            for info in infos:
                yield _endpoint(role, topic, info)

    def _service_ends(self, reader: Any, names: list[tuple[str, str]]) -> Iterator[Endpoint]:
        for role, ask in (
            (Role.SERVER, reader.get_service_names_and_types_by_node),
            (Role.CLIENT, reader.get_client_names_and_types_by_node),
        ):
            for name, namespace in names:
                try:
                    found = ask(name, namespace)
                except self.rclpy.unknown_node:
                    continue  # it has gone since
                for service, types in found:
                    for of in types:
                        yield Endpoint(role, _full(name, namespace), service, of, None, None)

    def _spin(self) -> None:
        with suppress(self.rclpy.shut_down):  # which is reported already
            while not self._over.is_set():
                self._spin_once()
        self._over.wait()
        with self._ending:
            if self._hidden is not None:
                self._destroy(self._hidden)
            self.executor.shutdown(0.0)
        self.context.try_shutdown()

    def _spin_once(self) -> None:
        try:
            self.executor.spin_once()
        except self.rclpy.shut_down:
            raise
        except Exception as error:  # as of a truncated message that rclpy cannot take
            self.notifier.bad_message("", error)
            self._release()
            self._over.wait(_PAUSE)

    def _release(self) -> None:
        """Let the executor serve the entity that it failed to take from, and its node, again."""
        for node in self.executor.get_nodes():
            for entity in (*node.subscriptions, *node.clients, *node.services):
                if entity._executor_event:
                    entity._executor_event = False
                    entity.callback_group.ending_execution(entity)

    def _look_later(self) -> None:
        self.timer.call_later(_LOOK, self._look)

    def _look(self) -> None:
        """Report endpoints that are incompatible with ours."""
        if self._over.is_set() or not self.context.ok():
            return
        for ours in list(self.ours):
            with self._reader() as reader:
                others = list(self._ends_of(reader, ours.name))
            for theirs in others:
                self.notifier.compare(ours, theirs)
        self._look_later()

    def _on_shutdown(self) -> None:
        if not self._over.is_set():  # rclpy holds a lock of the context meanwhile
            down = partial(self.notifier.notify, NoticeKind.DOWN, "rclpy was shut down")
            self.timer.call_soon(down)


def _full(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _endpoint(role: Role, topic: str, info: Any) -> Endpoint:
    profile = info.qos_profile
    hash_text = str(info.topic_type_hash)
    return Endpoint(
        role,
        _full(info.node_name, info.node_namespace),
        topic,
        info.topic_type,
        hash_text if hash_text.startswith("RIHS") else None,  # not every middleware reports it
        Qos(
            _known(profile.reliability, TOPIC.reliability),
            _known(profile.durability, TOPIC.durability),
            _known(profile.history, TOPIC.history),  # those of other nodes are often unknown
            profile.depth or TOPIC.depth,
            _finite(profile.deadline),
            _finite(profile.lifespan),
            _known(profile.liveliness, TOPIC.liveliness),
            _finite(profile.liveliness_lease_duration),
        ),
    )


def _finite(duration: Any) -> int:
    ns: int = duration.nanoseconds
    return ns if ns < _INFINITE_NS else 0


def _known(number: int, default: E) -> E:
    kind = type(default)
    return kind(number) if number in list(kind) else default
