"""Quality of service: what publishers offer and subscriptions request.

The names and numbers are those of ROS 2 (rmw/types.h). Deadline, lifespan and liveliness keep
their defaults: nothing here offers or requests them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

__all__ = ["SERVICE", "TOPIC", "DurabilityPolicy", "HistoryPolicy", "Qos", "ReliabilityPolicy"]


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


class Qos(NamedTuple):
    """A profile; as it stands, ROS 2's default for topics."""

    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
    history: HistoryPolicy = HistoryPolicy.KEEP_LAST
    depth: int = 10
    """Messages kept, from 1; without meaning if all are kept."""

    def refusal(self, offered: Qos) -> str | None:
        """Return why a subscription with this profile refuses an offered one, or None.

        The rule is DDS's: an offer must be at least as strong as the request.
        """
        refused = []
        if self.reliability < offered.reliability:
            refused.append("asks for reliable, best effort is offered")
        if self.durability < offered.durability:
            refused.append("asks for transient local, volatile is offered")
        return "; ".join(refused) or None


TOPIC = Qos()
"""The default profile of a topic (rmw_qos_profile_default)."""

SERVICE = Qos()
"""The profile of both ends of a service (rmw_qos_profile_services_default)."""
