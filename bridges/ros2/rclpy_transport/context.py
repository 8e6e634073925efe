"""rclpy's context, the executor's thread, and the graph."""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from enum import IntEnum
from functools import partial
from typing import TypeVar

from ..errors import TransportUnavailableError
from ..graph import Endpoint, Graph, Role
from ..notices import Notifier
from ..qos import DurabilityPolicy, HistoryPolicy, Qos, ReliabilityPolicy
from ..ros_names import Names
from ..timer_thread import TimerThread
from ..transport import NoticeKind
from . import api

__all__ = ["RclpyContext"]

E = TypeVar("E", bound=IntEnum)

_LOOK = 1.0  # seconds between checks for incompatible endpoints: rclpy reports no changes

_PAUSE = 0.01  # seconds after an error, so that a lasting one costs little


class RclpyContext:
    """A context of its own, whose nodes' callbacks run on one thread.

    It installs no signal handlers. Another part of the process may shut it down through rclpy.
    """

    def __init__(self, domain: int, notifier: Notifier) -> None:
        """Open it; raise :class:`.TransportUnavailableError` if the middleware cannot be."""
        self.rclpy = api.import_rclpy()
        self.notifier = notifier
        self.timer = TimerThread("ros2 answers")
        self.ours: dict[Endpoint, None] = {}
        self._over = threading.Event()
        self._ending = threading.Lock()
        self.context = self.rclpy.new_context()
        try:
            self._open(domain)
        except self.rclpy.failure as error:
            self.timer.close()
            self.context.try_shutdown()
            raise TransportUnavailableError(f"rclpy cannot be opened: {error}") from error
        self._thread = threading.Thread(target=self._spin, name="ros2 executor", daemon=True)
        self._thread.start()
        atexit.register(self.close)
        self._look_later()

    def _open(self, domain: int) -> None:
        self.rclpy.init(
            args=[],
            context=self.context,
            domain_id=domain,
            signal_handler_options=self.rclpy.no_signal_handlers,
        )
        self.context.on_shutdown(self._on_shutdown)
        self.executor = self.rclpy.new_executor(context=self.context)
        # A hidden node, which reads the graph.
        self._asking = self.new_node(Names(f"_llfsm_{os.getpid()}"))

    def new_node(self, names: Names) -> api.NodeApi:
        """Create a node with only the endpoints of every rclpy node, and spin it."""
        rclpy = self.rclpy
        node = rclpy.new_node(
            names.node,
            namespace=names.namespace,
            context=self.context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[rclpy.parameter("start_type_description_service", value=False)],
        )
        self.executor.add_node(node)
        return node

    def remove_node(self, node: api.NodeApi) -> None:
        """Take a node off the graph."""
        self.executor.remove_node(node)
        node.destroy_node()

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
        """Return a profile of rclpy; the numbers are the same."""
        of = self.rclpy.qos
        profile: object = of.QoSProfile(
            reliability=of.ReliabilityPolicy(int(qos.reliability)),
            durability=of.DurabilityPolicy(int(qos.durability)),
            history=of.HistoryPolicy(int(qos.history)),
            depth=qos.depth,
        )
        return profile

    def graph(self) -> Graph:
        """Return the graph from rclpy."""
        names = self._asking.get_node_names_and_namespaces()
        return Graph.of(
            (_full(name, namespace) for name, namespace in names),
            (*self._topic_ends(), *self._service_ends(names)),
        )

    def wait(self, ready: Callable[[], bool], timeout: float) -> bool | None:
        """Wait until ``ready()`` is true; return None if it is closed meanwhile."""
        period = 0.02
        for _ in range(int(timeout / period) + 1):
            if self._over.is_set():
                return None
            if ready():
                return True
            self._over.wait(min(period, timeout))
        return False

    def _topic_ends(self) -> Iterator[Endpoint]:
        for topic, _ in self._asking.get_topic_names_and_types():
            yield from self._ends_of(topic)

    def _ends_of(self, topic: str) -> Iterator[Endpoint]:
        for role, infos in (
            (Role.PUBLISHER, self._asking.get_publishers_info_by_topic(topic)),
            (Role.SUBSCRIPTION, self._asking.get_subscriptions_info_by_topic(topic)),
        ):
            for info in infos:
                yield _endpoint(role, topic, info)

    def _service_ends(self, names: list[tuple[str, str]]) -> Iterator[Endpoint]:
        for role, ask in (
            (Role.SERVER, self._asking.get_service_names_and_types_by_node),
            (Role.CLIENT, self._asking.get_client_names_and_types_by_node),
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
            self.remove_node(self._asking)
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
            for theirs in self._ends_of(ours.name):
                self.notifier.compare(ours, theirs)
        self._look_later()

    def _on_shutdown(self) -> None:
        if not self._over.is_set():  # rclpy holds a lock of the context meanwhile
            down = partial(self.notifier.notify, NoticeKind.DOWN, "rclpy was shut down")
            self.timer.call_soon(down)


def _full(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _endpoint(role: Role, topic: str, info: api.EndpointInfo) -> Endpoint:
    profile = info.qos_profile
    hash_text = str(info.topic_type_hash)
    return Endpoint(
        role,
        _full(info.node_name, info.node_namespace),
        topic,
        info.topic_type,
        hash_text if hash_text.startswith("RIHS") else None,  # not every middleware reports it
        Qos(
            _known(ReliabilityPolicy, profile.reliability, ReliabilityPolicy.RELIABLE),
            _known(DurabilityPolicy, profile.durability, DurabilityPolicy.VOLATILE),
            # Those of other nodes are often unknown.
            _known(HistoryPolicy, profile.history, HistoryPolicy.KEEP_LAST),
            profile.depth or Qos().depth,
        ),
    )


def _known(kind: type[E], number: int, default: E) -> E:
    return kind(number) if number in list(kind) else default
