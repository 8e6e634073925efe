"""A node's log on /rosout, which ROS's tools read."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import suppress

from llfsm.bridges.ros2.errors import TransportClosedError
from llfsm.bridges.ros2.node_time import from_ns
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos
from llfsm.bridges.ros2.transport import Node
from llfsm.bridges.ros2.types import TypeLibrary

_FATAL = logging.CRITICAL
_LIFESPAN_NS = 10_000_000_000
_QOS = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1000, lifespan_ns=_LIFESPAN_NS)
"""As rcl_qos_profile_rosout_default."""


_SEVERITY = {logging.WARNING: "WARN", logging.CRITICAL: "FATAL"}  # others as in `logging`


def logger_name(node: str) -> str:
    """Return the name of a node's logger, as rcl makes it of the node's full name."""
    return node.strip("/").replace("/", ".")


class ConsoleFormat(logging.Formatter):
    """Lines as rcutils prints them: severity, time in seconds since 1970, the node's logger."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def format(self, record: logging.LogRecord) -> str:
        """Return a record's line."""
        severity = _SEVERITY.get(record.levelno, record.levelname)
        return f"[{severity}] [{record.created:.9f}] [{self._name}]: {record.getMessage()}"


class Rosout(logging.Handler):
    """Publishes log records under the node's name, with the file, function and line they are from.

    What it logs itself while it publishes, as a fault of the transport, is not published.
    """

    def __init__(self, node: Node, types: TypeLibrary) -> None:
        super().__init__()
        line = types.message("rcl_interfaces/msg/Log")
        self._publisher = node.publisher("/rosout", line, _QOS)
        self._line = line.message
        self._publishing = _Publishing()
        self._logger = logger_name(node.name)

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a record; levels are those of `logging` and of rcl_interfaces/msg/Log alike."""
        if self._publishing.entered:
            return
        self._publishing.entered = True
        try:
            text, function = record.getMessage(), record.funcName or ""
            self.log(record.levelno, text, record.pathname, function, record.lineno)
        except Exception:  # as everywhere in `logging`: a line that is lost stops no robot
            self.handleError(record)
        finally:
            self._publishing.entered = False

    def log(self, level: int, text: str, file: str, function: str, line: int) -> None:
        """Publish a line of this origin, if its level is enabled; not after the node's end."""
        if level < self.level:
            return
        stamp, level = from_ns(time.time_ns()), min(int(level), _FATAL)
        with suppress(TransportClosedError):
            self._publisher.publish(
                self._line(stamp, level, self._logger, text, file, function, line)
            )


class _Publishing(threading.local):
    entered = False
