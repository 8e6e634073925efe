"""Quality of service: what publishers offer and subscriptions request.

The names and numbers are those of ROS 2 (rmw/types.h), the rule that decides whether an offer is
enough is DDS's. Durations are nanoseconds; 0 is none, as ROS 2's infinite one. The parameters
``qos_overrides.<topic>.<publisher|subscription>.<policy>`` of a node are rclcpp's.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

from llfsm.bridges.ros2.errors import ParameterOverrideError
from llfsm.bridges.ros2.node_parameters import NodeParameters, Parameter


class ReliabilityPolicy(IntEnum):
    """Reliable, or messages may be lost on the way."""

    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(IntEnum):
    """Late subscriptions get messages that were published before, or they do not."""

    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class HistoryPolicy(IntEnum):
    """The newest messages are kept, or all."""

    KEEP_LAST = 1
    KEEP_ALL = 2


class LivelinessPolicy(IntEnum):
    """The process, the node or the publisher itself asserts that a publisher is alive.

    ROS 2 has deprecated assertion by the node. It is known here for the sake of older peers' ends.
    """

    AUTOMATIC = 1
    MANUAL_BY_NODE = 2
    MANUAL_BY_TOPIC = 3


_ALIVE = {
    LivelinessPolicy.AUTOMATIC: "automatic",
    LivelinessPolicy.MANUAL_BY_NODE: "by node",
    LivelinessPolicy.MANUAL_BY_TOPIC: "by topic",
}


class Qos(NamedTuple):
    """A profile; as it stands, ROS 2's default for topics."""

    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
    history: HistoryPolicy = HistoryPolicy.KEEP_LAST
    depth: int = 10
    """Messages kept, from 1; without meaning if all are kept."""
    deadline_ns: int = 0
    """The longest time between two messages."""
    lifespan_ns: int = 0
    """The time for which a message is valid after its publication; offered only."""
    liveliness: LivelinessPolicy = LivelinessPolicy.AUTOMATIC
    lease_ns: int = 0
    """The longest time between two signs of life."""

    def refused(self, offered: Qos) -> list[tuple[str, str]]:
        """List the policies of an offer that are refused, by rmw's name, with the reason.

        The rule is DDS's: an offer must be at least as strong as the request.
        """
        found = []
        if self.reliability < offered.reliability:
            found.append(("RELIABILITY", "asks for reliable, best effort is offered"))
        if self.durability < offered.durability:
            found.append(("DURABILITY", "asks for transient local, volatile is offered"))
        if _longer(offered.deadline_ns, self.deadline_ns):
            wanted = f"asks for a deadline of {_text(self.deadline_ns)}, not offered"
            found.append(("DEADLINE", wanted))
        if self.liveliness > offered.liveliness:
            wanted = f"asks for liveliness {_ALIVE[self.liveliness]}"
            found.append(("LIVELINESS", f"{wanted}, {_ALIVE[offered.liveliness]} is offered"))
        if _longer(offered.lease_ns, self.lease_ns):
            wanted = f"asks for a lease of {_text(self.lease_ns)}, not offered"
            found.append(("LIVELINESS", wanted))
        return [(f"{policy}_QOS_POLICY", reason) for policy, reason in found]


def _longer(offered_ns: int, requested_ns: int) -> bool:
    return requested_ns > 0 and not 0 < offered_ns <= requested_ns


def _text(ns: int) -> str:
    return f"{ns / 1e9:g} s"


TOPIC = Qos()
"""The default profile of a topic (rmw_qos_profile_default)."""

SERVICE = Qos()
"""The profile of both ends of a service (rmw_qos_profile_services_default)."""


_KINDS: dict[str, type[IntEnum]] = {
    "durability": DurabilityPolicy,
    "history": HistoryPolicy,
    "reliability": ReliabilityPolicy,
    "liveliness": LivelinessPolicy,
}
_DEPRECATED = LivelinessPolicy.MANUAL_BY_NODE  # which rclcpp does not take, either
_TIMES = {
    "deadline": "deadline_ns",
    "lifespan": "lifespan_ns",
    "liveliness_lease_duration": "lease_ns",
}
_USUAL = ("depth", "durability", "history", "reliability")


def overridden(
    qos: Qos, parameters: NodeParameters, topic: str, end: str, *, every: bool = False
) -> Qos:
    """Declare the policies of a node's end of a topic; return the profile with overrides.

    ``end`` is ``publisher`` or ``subscription``, ``topic`` a full name. The usual four policies are
    declared, or ``every`` one that the end has; times are in nanoseconds, 0 is none. The parameters
    are read-only: only overrides at the start change them. Raise :class:`.ParameterOverrideError`.
    """
    prefix = f"qos_overrides.{topic}.{end}."
    names = [*_USUAL, "liveliness", *_TIMES] if every else [*_USUAL]
    if every and end == "subscription":
        names.remove("lifespan")
    parameters.declare(
        {
            prefix + name: Parameter(
                _plain(qos, name), f"qos policy {{{name}}} for {end} {{{topic}}}", read_only=True
            )
            for name in names
        }
    )
    values = parameters.values()
    changes = dict(_changed(name, values[prefix + name], prefix) for name in names)
    return qos._replace(**changes)


def _plain(qos: Qos, name: str) -> int | str:
    value: Any = getattr(qos, _TIMES.get(name, name))
    return value.name.lower() if name in _KINDS else int(value)


def _changed(name: str, value: Any, prefix: str) -> tuple[str, Any]:
    """Turn a parameter into the field of a profile and its value."""
    if name in _KINDS:
        known = {one.name.lower(): one for one in _KINDS[name] if one is not _DEPRECATED}
        if value not in known:
            raise ParameterOverrideError(f"{prefix}{name}={value}: not one of {', '.join(known)}")
        return name, known[value]
    if name == "depth" and not 1 <= value < 2**31:
        raise ParameterOverrideError(f"{prefix}depth={value}: a depth is 1 or more")
    if value < 0:
        raise ParameterOverrideError(f"{prefix}{name}={value}: a time is 0 ns or more")
    return _TIMES.get(name, name), value
