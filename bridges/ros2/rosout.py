"""A node's log on /rosout, which ROS's tools read."""

from __future__ import annotations

import time

from .qos import DurabilityPolicy, Qos
from .stamps import from_ns
from .transport import Node
from .types import TypeLibrary

__all__ = ["Rosout"]

_QOS = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1000)


class Rosout:
    """Publishes log lines under the node's name."""

    def __init__(self, node: Node, types: TypeLibrary) -> None:
        line = types.message("rcl_interfaces/msg/Log")
        self._publisher = node.publisher("/rosout", line, _QOS)
        self._line = line.message
        self._logger = node.name.strip("/").replace("/", ".")  # as rcl names a node's logger

    def log(self, level: int, text: str) -> None:
        """Publish a line; levels are those of `logging` and of rcl_interfaces/msg/Log alike."""
        stamp = from_ns(time.time_ns())
        self._publisher.publish(
            self._line(stamp=stamp, level=int(level), name=self._logger, msg=text)
        )
