"""Quality of service."""

from __future__ import annotations

from enum import IntEnum
from types import SimpleNamespace


class ReliabilityPolicy(IntEnum):
    SYSTEM_DEFAULT, RELIABLE, BEST_EFFORT = range(3)


class DurabilityPolicy(IntEnum):
    SYSTEM_DEFAULT, TRANSIENT_LOCAL, VOLATILE = range(3)


class HistoryPolicy(IntEnum):
    SYSTEM_DEFAULT, KEEP_LAST, KEEP_ALL = range(3)


class LivelinessPolicy(IntEnum):
    SYSTEM_DEFAULT, AUTOMATIC, MANUAL_BY_NODE, MANUAL_BY_TOPIC = range(4)


class Duration:
    def __init__(self, *, nanoseconds=0):
        self.nanoseconds = nanoseconds


class QoSProfile(SimpleNamespace):
    deadline = lifespan = liveliness_lease_duration = Duration()
    liveliness = LivelinessPolicy.AUTOMATIC


def reaches(publisher, subscription):
    offered, asked = publisher.qos, subscription.qos
    return offered.reliability <= asked.reliability and offered.durability <= asked.durability


def profile():
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=1000,
    )
