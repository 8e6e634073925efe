"""The parts of every node, as rclcpp has them: parameters, a time, type descriptions, a log.

A node's service ``~/get_type_description`` describes types to tools (REP 2011), its log is on
/rosout, which ROS's tools read.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from msgspec import convert

from llfsm.bridges.ros2.calls import through
from llfsm.bridges.ros2.errors import RosTypeError, TransportClosedError, UnknownTypeError
from llfsm.bridges.ros2.graph import logger_name
from llfsm.bridges.ros2.node_parameters import NodeParameters, Parameter
from llfsm.bridges.ros2.node_time import NodeTime, from_ns
from llfsm.bridges.ros2.parameter_server import PARAMETER_EVENTS, PARAMETER_QOS, ParameterServer
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos, overridden
from llfsm.bridges.ros2.threads import Put
from llfsm.bridges.ros2.transport import Node, ServiceRequest
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.whiteboard.schema import describe, from_plain

_FATAL = logging.CRITICAL
_LIFESPAN_NS = 10_000_000_000
_QOS = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1000, lifespan_ns=_LIFESPAN_NS)
"""As rcl_qos_profile_rosout_default."""


_SEVERITY = {logging.WARNING: "WARN", logging.CRITICAL: "FATAL"}  # others as in `logging`


class ConsoleFormat(logging.Formatter):
    """Lines as rcutils prints them: severity, time in seconds since 1970, the node's logger."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def format(self, record: logging.LogRecord) -> str:
        """Format a record as a line."""
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


class TypeDescriptionServer:
    """Describes every type in use by its hash, as rcl does, and any other by its name and hash.

    On request it sends their sources, too. Requests are handled through ``put``.
    """

    def __init__(self, node: Node, types: TypeLibrary, put: Put) -> None:
        self._types = types
        of = types.service("type_description_interfaces/srv/GetTypeDescription")
        self._response = of.response.message
        self._whole = types.message("type_description_interfaces/msg/TypeDescription").message
        self._source = types.message("type_description_interfaces/msg/TypeSource").message
        self._schema = describe(self._whole)
        node.server("~/get_type_description", of, through(put, self._answer))

    def _answer(self, request: ServiceRequest[Any, Any]) -> None:
        name, wanted = request.message.type_name, request.message.type_hash
        try:
            name = self._name_of(name, wanted)
            description, _ = self._types.describe(name)
        except RosTypeError as error:
            request.answer(self._response(failure_reason=str(error)))
            return
        sources = self._types.sources(name) if request.message.include_type_sources else []
        request.answer(
            self._response(
                successful=True,
                type_description=convert(from_plain(description, self._schema), self._whole),
                type_sources=tuple(
                    self._source(each.type_name, each.encoding, "\n".join(each.text.splitlines()))
                    for each in sources
                ),
            )
        )

    def _name_of(self, name: str, wanted: str) -> str:
        """Find the type that a request means; raise :class:`.RosTypeError` if there is none."""
        found = self._types.used_with_hash(wanted)
        if found is not None:
            return found
        _, type_hash = self._types.describe(name)
        if type_hash != wanted:
            raise UnknownTypeError(f"the hash of {name} is {type_hash} here")
        return name


_SIM_TIME = "use_sim_time"
_DESCRIBE = "start_type_description_service"


class Equipment(NamedTuple):
    """The parts that :func:`equip` adds to a node and that the node uses itself."""

    log: Rosout
    time: NodeTime


def equip(
    node: Node,
    types: TypeLibrary,
    parameters: NodeParameters,
    put: Put,
    set_ns: Callable[[int], None] | None = None,
) -> Equipment:
    """Give a node the parts of every node: parameters, a time, descriptions of its types, a log.

    Requests are handled through ``put``. A node whose work follows /clock has ``set_ns`` called
    with each of its times, and cannot leave it. Raise :class:`.ParameterOverrideError`.
    """
    bound = set_ns is not None
    time = NodeTime(node, types, parameters, set_ns or (lambda _: None))
    parameters.declare(
        {
            _SIM_TIME: Parameter(bound, read_only=bound, changed=time.simulate),
            _DESCRIBE: Parameter(
                True, "Start the ~/get_type_description service for this node.", read_only=True
            ),
        }
    )
    time.simulate(parameters.values()[_SIM_TIME])
    events = overridden(PARAMETER_QOS, parameters, PARAMETER_EVENTS, "publisher")
    ParameterServer(node, types, parameters, put, time.now_ns, events)
    if parameters.values()[_DESCRIBE]:
        TypeDescriptionServer(node, types, put)
    return Equipment(Rosout(node, types), time)
