"""A node's time: the host's or, where ``use_sim_time`` is set, that of /clock, as rclcpp's.

ROS messages have times of seconds and nanoseconds; here a time is a number of nanoseconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from llfsm.bridges.ros2.node_parameters import NodeParameters
from llfsm.bridges.ros2.qos import Qos, ReliabilityPolicy, overridden
from llfsm.bridges.ros2.transport import Node, SerializedMessage, TopicSubscription
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.whiteboard.messages.builtin_interfaces import Time

_SECOND = 1_000_000_000


def from_ns(ns: int) -> Time:
    """Make a message of nanoseconds since 1970."""
    return Time(*divmod(ns, _SECOND))


def to_ns(time: Time) -> int:
    """Turn a message into nanoseconds since 1970."""
    return time.sec * _SECOND + time.nanosec


CLOCK = "/clock"
CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
CLOCK_QOS = Qos(ReliabilityPolicy.BEST_EFFORT, depth=1)
"""Of both ends (rclcpp's ClockQoS)."""


@dataclass(eq=False)
class NodeTime:
    """The clock of a node, in nanoseconds since 1970 or since a simulation began.

    A simulated time is the newest one of /clock, 0 before the first, and ``set_ns`` is called with
    each.
    """

    node: Node
    types: TypeLibrary
    parameters: NodeParameters
    set_ns: Callable[[int], None] = lambda _: None

    def __post_init__(self) -> None:
        self._clock: TopicSubscription | None = None
        self._simulated_ns = 0

    def simulate(self, simulated: bool) -> None:
        """Follow /clock from now on, or the host's time."""
        if simulated and self._clock is None:
            of = self.types.message(CLOCK_TYPE)
            qos = overridden(CLOCK_QOS, self.parameters, CLOCK, "subscription")
            self._clock = self.node.subscription(CLOCK, of, self._tick, qos)
        elif not simulated and self._clock is not None:
            self._clock.close()
            self._clock = None

    @property
    def simulated(self) -> bool:
        """True if the time is that of /clock."""
        return self._clock is not None

    def now_ns(self) -> int:
        """Return the node's time in nanoseconds."""
        return time.time_ns() if self._clock is None else self._simulated_ns

    def _tick(self, arrival: SerializedMessage[Any]) -> None:
        self._simulated_ns = to_ns(arrival.decode().clock)
        self.set_ns(self._simulated_ns)
