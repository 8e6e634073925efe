"""The ROS graph as data: nodes, publishers, subscriptions, servers and clients."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import NamedTuple

from .qos import Qos

__all__ = ["Endpoint", "Graph", "Role", "qos_conflict", "type_conflict"]


class Role(Enum):
    """The role of an endpoint; the value is its name in messages."""

    PUBLISHER = "publisher"
    SUBSCRIPTION = "subscription"
    SERVER = "service server"
    CLIENT = "service client"

    @property
    def partner(self) -> Role:
        """The role at the other end."""
        return _PARTNERS[self]


_PARTNERS = {
    Role.PUBLISHER: Role.SUBSCRIPTION,
    Role.SUBSCRIPTION: Role.PUBLISHER,
    Role.SERVER: Role.CLIENT,
    Role.CLIENT: Role.SERVER,
}


class Endpoint(NamedTuple):
    """One end of a topic or of a service."""

    role: Role
    node: str
    """The node's full name, namespace included: ``/ns/name``."""
    name: str
    """The full name of the topic or service."""
    type_name: str
    """As ``geometry_msgs/msg/Twist``."""
    type_hash: str | None
    """As ``RIHS01_...``; None where the middleware does not report it."""
    qos: Qos | None
    """None where the middleware does not report it."""


class Graph(NamedTuple):
    """The graph as it was known at one moment, sorted by name."""

    nodes: tuple[str, ...] = ()
    """Full names of the nodes that are not hidden; twice if two nodes have the same name."""
    endpoints: tuple[Endpoint, ...] = ()

    @classmethod
    def of(cls, nodes: Iterable[str], endpoints: Iterable[Endpoint]) -> Graph:
        """Return the graph of these nodes and endpoints.

        Like `ros2 node list`, it leaves out nodes whose name begins with an underscore, such as
        those of the ros2 command, but not their endpoints.
        """
        return cls(
            tuple(sorted(node for node in nodes if not node.rpartition("/")[2].startswith("_"))),
            tuple(sorted(endpoints, key=lambda end: (end.name, end.role.name, end.node))),
        )

    def topics(self) -> dict[str, tuple[str, ...]]:
        """Return each topic's types; more than one means that nodes disagree."""
        return self._types({Role.PUBLISHER, Role.SUBSCRIPTION})

    def services(self) -> dict[str, tuple[str, ...]]:
        """Return the types of each service that has a server."""
        return self._types({Role.SERVER})

    def ends(self, name: str, role: Role) -> tuple[Endpoint, ...]:
        """Return the endpoints of a topic or service in one role."""
        return tuple(e for e in self.endpoints if e.name == name and e.role is role)

    def _types(self, roles: set[Role]) -> dict[str, tuple[str, ...]]:
        types: dict[str, dict[str, None]] = {}
        for end in self.endpoints:
            if end.role in roles:
                types.setdefault(end.name, {})[end.type_name] = None
        return {name: tuple(of_name) for name, of_name in sorted(types.items())}


def type_conflict(ours: Endpoint, theirs: Endpoint) -> str | None:
    """Return why two endpoints of one name are incompatible, or None if they are not."""
    if ours.type_name != theirs.type_name:
        return f"{_who(theirs)} has type {theirs.type_name}, ours is {ours.type_name}"
    if None not in (ours.type_hash, theirs.type_hash) and ours.type_hash != theirs.type_hash:
        return (
            f"{_who(theirs)} has another definition of {ours.type_name}: "
            f"{theirs.type_hash}, ours is {ours.type_hash}"
        )
    return None


def qos_conflict(ours: Endpoint, theirs: Endpoint) -> str | None:
    """Return why a publisher offers less than a subscription requests, or None.

    The words are those that rclcpp logs, which people search for; then who they are.
    """
    asking, offering = (ours, theirs) if ours.role is Role.SUBSCRIPTION else (theirs, ours)
    if (asking.role, offering.role) != (Role.SUBSCRIPTION, Role.PUBLISHER):
        return None
    if asking.qos is None or offering.qos is None:
        return None
    refused = asking.qos.refused(offering.qos)
    if not refused:
        return None
    other = "publisher" if ours is asking else "subscription"
    does = "offering" if ours is asking else "requesting"
    reasons = "; ".join(reason for _, reason in refused)
    return (
        f"New {other} discovered on topic '{ours.name}', {does} incompatible QoS. "
        f"No messages will be sent to it. Last incompatible policy: {refused[-1][0]} "
        f"(the subscription of {asking.node} {reasons} by {offering.node})"
    )


def _who(end: Endpoint) -> str:
    return f"the {end.role.value} of {end.node}"
