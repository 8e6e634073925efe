"""A node's health on /diagnostics, once a second, as diagnostic_updater publishes it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from enum import IntEnum
from typing import NamedTuple

from llfsm.bridges.ros2.errors import TransportClosedError
from llfsm.bridges.ros2.node_time import from_ns
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import Node
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.whiteboard.messages.std_msgs import Header

_PERIOD_S = 1.0


class HealthLevel(IntEnum):
    """How well something is, numbered as in diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Health(NamedTuple):
    """The health of one part of a node."""

    name: str
    level: HealthLevel
    message: str
    values: dict[str, str]


class Diagnostics:
    """Publishes what ``report`` returns, on the timer's thread, until the node is closed."""

    def __init__(
        self,
        node: Node,
        types: TypeLibrary,
        report: Callable[[], Iterable[Health]],
        timer: TimerThread,
        now_ns: Callable[[], int],
    ) -> None:
        """``now_ns`` returns the node's time, for stamps."""
        array = types.message("diagnostic_msgs/msg/DiagnosticArray")
        self._array = array.message
        self._status = types.message("diagnostic_msgs/msg/DiagnosticStatus").message
        self._value = types.message("diagnostic_msgs/msg/KeyValue").message
        self._publisher = node.publisher("/diagnostics", array, Qos(depth=1))
        self._prefix = node.name.lstrip("/")
        self._report = report
        self._timer = timer
        self._now_ns = now_ns
        self._later()

    def _later(self) -> None:
        self._timer.call_later(_PERIOD_S, self._publish)

    def _publish(self) -> None:
        if self._publisher.closed:
            return
        self._later()  # first: a report that fails is logged, and the next is published
        statuses = tuple(
            self._status(
                level=int(each.level),
                name=f"{self._prefix}: {each.name}",
                message=each.message,
                values=tuple(self._value(*pair) for pair in each.values.items()),
            )
            for each in self._report()
        )
        with suppress(TransportClosedError):
            self._publisher.publish(self._array(Header(stamp=from_ns(self._now_ns())), statuses))
