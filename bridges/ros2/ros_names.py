"""Names of nodes, topics and services: validation and expansion to full names.

The rules are those of ROS 2 (rmw's validation of names, and "Topic and Service names" of its design
articles): parts of letters, digits and underscores, joined by ``/``; none begins with a digit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

from .errors import RosNameError

__all__ = ["NO_REMAPPING", "Names"]

NO_REMAPPING: Mapping[str, str] = MappingProxyType({})

_NODE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_FULL = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_TOPIC, _SERVICE = "rostopic://", "rosservice://"
_LONGEST_NODE = 255
_LONGEST_NAME = 247  # 255 less the prefix that DDS puts before a name ("rq/" and so on)


class Names:
    """Expands the names that one node uses."""

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
        """Return a service's full name, remapped; as :meth:`full`."""
        return self._full(name, _SERVICE)

    def full(self, name: str) -> str:
        """Return a topic's full name, remapped.

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
