"""The ROS graph as data: nodes, publishers, subscriptions, servers and clients, and their names.

The rules for names are those of ROS 2 (rmw's validation of names, and "Topic and Service names" of
its design articles): parts of letters, digits and underscores, joined by ``/``; none begins with a
digit.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

from llfsm.bridges.ros2.errors import RosNameError
from llfsm.bridges.ros2.qos import Qos

NO_REMAPPING: Mapping[str, str] = MappingProxyType({})

_NODE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_FULL = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_TOPIC, _SERVICE = "rostopic://", "rosservice://"
_LONGEST_NODE = 255
_LONGEST_NAME = 247  # 255 less the prefix that DDS puts before a name ("rq/" and so on)


class Names:
    """Expands the names that one node uses to full names, and remaps them."""

    def __init__(
        self, node: str, namespace: str = "/", remap: Mapping[str, str] = NO_REMAPPING
    ) -> None:
        """Name a node.

        ``remap`` maps names of topics and services, as the node uses them, to other names; one that
        begins with ``rostopic://`` or ``rosservice://`` only those. Raise :class:`.RosNameError`
        for an invalid name.
        """
        if not _NODE.fullmatch(node) or len(node) > _LONGEST_NODE:
            raise RosNameError(
                f"{node!r} is not a node name: letters, digits and underscores, no digit "
                f"first, at most {_LONGEST_NODE}"
            )
        self.node = node
        self.namespace = namespace if namespace.startswith("/") else f"/{namespace}"
        if self.namespace != "/":
            _check_full(self.namespace, namespace, "namespace")
        self.full_node = f"{self.namespace.rstrip('/')}/{node}"
        self.remap = remap
        self._remap = {
            (scheme, self._expand(name.removeprefix(scheme))): self._expand(to)
            for name, to in remap.items()
            for scheme in (_TOPIC, _SERVICE)
            if name.startswith(scheme) or "://" not in name
        }

    def full_service(self, name: str) -> str:
        """Expand and remap a service's name; as :meth:`full`."""
        return self._full(name, _SERVICE)

    def full(self, name: str) -> str:
        """Expand and remap a topic's name.

        ``/x`` is full already, ``x`` is in the node's namespace, ``~/x`` is the node's own. Raise
        :class:`.RosNameError` for an invalid name.
        """
        return self._full(name, _TOPIC)

    def _full(self, name: str, scheme: str) -> str:
        full = self._expand(name)
        return self._remap.get((scheme, full), full)

    def _expand(self, name: str) -> str:
        if name.startswith("/"):
            full = name
        elif name == "~" or name.startswith("~/"):
            full = self.full_node + name[1:]
        else:
            full = f"{self.namespace.rstrip('/')}/{name}"
        _check_full(full, name, "name of a topic or service")
        return full


def _check_full(full: str, given: str, what: str) -> None:
    if not _FULL.fullmatch(full):
        raise RosNameError(
            f"{given!r} is not a {what}: parts of letters, digits and underscores, joined by '/', "
            "none with a digit first"
        )
    if len(full) > _LONGEST_NAME:
        raise RosNameError(f"{given!r} is too long: {len(full)} of {_LONGEST_NAME} characters")


def logger_name(node: str) -> str:
    """Name a node's logger as rcl does, from the node's full name."""
    return node.strip("/").replace("/", ".")


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
        """Make the graph of these nodes and endpoints.

        Like `ros2 node list`, it leaves out nodes whose name begins with an underscore, such as
        those of the ros2 command, but not their endpoints.
        """
        return cls(
            tuple(sorted(node for node in nodes if not node.rpartition("/")[2].startswith("_"))),
            tuple(sorted(endpoints, key=lambda end: (end.name, end.role.name, end.node))),
        )

    def topics(self) -> dict[str, tuple[str, ...]]:
        """List each topic's types; more than one means that nodes disagree."""
        return self._types({Role.PUBLISHER, Role.SUBSCRIPTION})

    def services(self) -> dict[str, tuple[str, ...]]:
        """List the types of each service that has a server."""
        return self._types({Role.SERVER})

    def ends(self, name: str, role: Role) -> tuple[Endpoint, ...]:
        """List the endpoints of a topic or service in one role."""
        return tuple(e for e in self.endpoints if e.name == name and e.role is role)

    def _types(self, roles: set[Role]) -> dict[str, tuple[str, ...]]:
        types: dict[str, dict[str, None]] = {}
        for end in self.endpoints:
            if end.role in roles:
                types.setdefault(end.name, {})[end.type_name] = None
        return {name: tuple(of_name) for name, of_name in sorted(types.items())}


def type_conflict(ours: Endpoint, theirs: Endpoint) -> str | None:
    """Explain why the types of two endpoints of one name differ; None if they are equal."""
    if ours.type_name != theirs.type_name:
        return f"{_who(theirs)} has type {theirs.type_name}, ours is {ours.type_name}"
    if None not in (ours.type_hash, theirs.type_hash) and ours.type_hash != theirs.type_hash:
        return (
            f"{_who(theirs)} has another definition of {ours.type_name}: "
            f"{theirs.type_hash}, ours is {ours.type_hash}"
        )
    return None


def qos_conflict(ours: Endpoint, theirs: Endpoint) -> str | None:
    """Explain why a publisher offers less than a subscription requests; None if it does not.

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
