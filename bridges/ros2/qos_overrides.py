"""A node's parameters ``qos_overrides.<topic>.<publisher|subscription>.<policy>``, as rclcpp's."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from .errors import ParameterOverrideError
from .node_parameters import NodeParameters, Parameter
from .qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, Qos, ReliabilityPolicy

__all__ = ["overridden"]

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
    """Declare the policies of a node's end of a topic, and return the profile with overrides.

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
    """Return the field of a profile for a parameter, and its value."""
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
