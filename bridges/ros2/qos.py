"""Quality of service: what a topic's two ends ask of each other.

The names and numbers are those of ROS 2 (rmw/types.h). Deadline, lifespan and liveliness are left
at their defaults: nothing here offers or asks for them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

__all__ = ["SERVICE", "TOPIC", "DurabilityPolicy", "HistoryPolicy", "Qos", "ReliabilityPolicy"]


class ReliabilityPolicy(IntEnum):
    """Whether a message may be lost on its way."""

    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(IntEnum):
    """Whether a subscription that comes late gets what was published before."""

    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class HistoryPolicy(IntEnum):
    """Whether the newest messages are kept, or all."""

    KEEP_LAST = 1
    KEEP_ALL = 2


class Qos(NamedTuple):
    """A profile; as it stands, ROS 2's default for topics."""

    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
    history: HistoryPolicy = HistoryPolicy.KEEP_LAST
    depth: int = 10
    """Messages kept, from 1; it says nothing if all are kept."""

    def refusal(self, offered: Qos) -> str | None:
        """Return why a subscription with this profile gets nothing from one that offers another.

        The rule is DDS's: an offer must be at least as strong as what is asked for. None if it is.
        """
        refused = []
        if self.reliability < offered.reliability:
            refused.append("asks for reliable, best effort is offered")
        if self.durability < offered.durability:
            refused.append("asks for transient local, volatile is offered")
        return "; ".join(refused) or None


TOPIC = Qos()
"""The profile of a topic unless somebody says otherwise (rmw_qos_profile_default)."""

SERVICE = Qos()
"""The profile of both ends of a service (rmw_qos_profile_services_default)."""
