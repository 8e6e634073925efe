"""Quality of service: what publishers offer and subscriptions request.

The names and numbers are those of ROS 2 (rmw/types.h). Durations are nanoseconds; 0 is none, as
ROS 2's infinite one.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

__all__ = [
    "SERVICE",
    "TOPIC",
    "DurabilityPolicy",
    "HistoryPolicy",
    "LivelinessPolicy",
    "Qos",
    "ReliabilityPolicy",
]


class ReliabilityPolicy(IntEnum):
    """Whether messages may be lost on the way."""

    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(IntEnum):
    """Whether a late subscription gets messages that were published before."""

    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class HistoryPolicy(IntEnum):
    """Whether the newest messages are kept, or all."""

    KEEP_LAST = 1
    KEEP_ALL = 2


class LivelinessPolicy(IntEnum):
    """Who asserts that a publisher is alive: its process, its node, or the publisher itself.

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
    """How long a message is valid after its publication; offered only."""
    liveliness: LivelinessPolicy = LivelinessPolicy.AUTOMATIC
    lease_ns: int = 0
    """The longest time between two signs of life."""

    def refusal(self, offered: Qos) -> str | None:
        """Return why a subscription with this profile refuses an offered one, or None.

        The rule is DDS's: an offer must be at least as strong as the request.
        """
        return "; ".join(reason for _, reason in self.refused(offered)) or None

    def refused(self, offered: Qos) -> list[tuple[str, str]]:
        """Return rmw's name of each policy of an offer that is refused, and the reason."""
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
