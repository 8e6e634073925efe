"""Time stamps of ROS messages."""

from __future__ import annotations

from llfsm.whiteboard.messages.builtin_interfaces import Time

__all__ = ["from_ns", "to_ns"]

_SECOND = 1_000_000_000


def from_ns(ns: int) -> Time:
    """Return a time of so many nanoseconds since the epoch."""
    return Time(*divmod(ns, _SECOND))


def to_ns(time: Time) -> int:
    """Return the nanoseconds since the epoch."""
    return time.sec * _SECOND + time.nanosec
