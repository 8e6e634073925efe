"""The services for a node's parameters, those of rcl_interfaces, and /parameter_events.

As in rclcpp, a request for several parameters returns nothing if one of them is unknown.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from llfsm.bridges.ros2.calls import answering, through
from llfsm.bridges.ros2.node_parameters import NodeParameters, ParameterType, Value, type_of
from llfsm.bridges.ros2.node_time import from_ns
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.threads import Put
from llfsm.bridges.ros2.transport import Node
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.whiteboard import Message

PARAMETER_EVENTS = "/parameter_events"

PARAMETER_QOS = Qos(depth=1000)
"""Of the services and of the events (rmw_qos_profile_parameters, _parameter_events)."""

_NOTHING = (
    "parameter list cannot be empty, this might be due to "
    "pre_set_parameters_callback modifying the original parameters list."
)
_SEPARATOR = "."
_FIELDS = {kind: f"{kind.name.lower()}_value" for kind in ParameterType if kind}


class ParameterServer:
    """Serves a node's parameters to others; requests are handled through ``put``, on one thread."""

    def __init__(
        self,
        node: Node,
        types: TypeLibrary,
        parameters: NodeParameters,
        put: Put,
        now_ns: Callable[[], int] = time.time_ns,
        events_qos: Qos = PARAMETER_QOS,
    ) -> None:
        """``now_ns`` returns the node's time, for stamps."""
        self._node = node.name
        self._now_ns = now_ns
        self._parameters = parameters

        def of(name: str) -> type[Message]:
            return types.message(f"rcl_interfaces/msg/{name}").message

        self._parameter, self._value = of("Parameter"), of("ParameterValue")
        self._descriptor, self._outcome = of("ParameterDescriptor"), of("SetParametersResult")
        self._integers, self._floats = of("IntegerRange"), of("FloatingPointRange")
        self._found = of("ListParametersResult")
        event = types.message("rcl_interfaces/msg/ParameterEvent")
        self._event = event.message
        self._publish = node.publisher(PARAMETER_EVENTS, event, events_qos).publish
        for name, type_name, respond in (
            ("get_parameters", "GetParameters", self._get),
            ("get_parameter_types", "GetParameterTypes", self._types),
            ("describe_parameters", "DescribeParameters", self._describe),
            ("list_parameters", "ListParameters", self._list),
            ("set_parameters", "SetParameters", self._set),
            ("set_parameters_atomically", "SetParametersAtomically", self._set_atomically),
        ):
            service = types.service(f"rcl_interfaces/srv/{type_name}")
            handler = through(put, answering(service, respond))
            node.server(f"~/{name}", service, handler, PARAMETER_QOS)
        self._publish_event(new_parameters=parameters.values().items())

    def _get(self, request: Any) -> dict[str, Any]:
        values = self._parameters.values()
        known = self._all_known(request.names)
        return {"values": tuple(self._to_message(values[name]) for name in known)}

    def _types(self, request: Any) -> dict[str, Any]:
        values = self._parameters.values()
        return {"types": bytes(type_of(values[name]) for name in self._all_known(request.names))}

    def _describe(self, request: Any) -> dict[str, Any]:
        known = self._all_known(request.names)
        return {"descriptors": tuple(self._description(name) for name in known)}

    def _list(self, request: Any) -> dict[str, Any]:
        names = tuple(
            name
            for name in self._parameters.declared
            if _listed(name, request.prefixes, request.depth)
        )
        prefixes = dict.fromkeys(
            name.rpartition(_SEPARATOR)[0] for name in names if _SEPARATOR in name
        )
        return {"result": self._found(names=names, prefixes=tuple(prefixes))}

    def _set(self, request: Any) -> dict[str, Any]:
        return {"results": tuple(self._set_all([one]) for one in request.parameters)}

    def _set_atomically(self, request: Any) -> dict[str, Any]:
        if not all(one.name in self._parameters.declared for one in request.parameters):
            reason = "One or more parameters were not declared before setting"
            return {"result": self._outcome(successful=False, reason=reason)}
        return {"result": self._set_all(request.parameters)}

    def _set_all(self, wanted: Sequence[Any]) -> Message:
        """Set all of these parameters or none; return the outcome."""
        if not wanted:
            return self._outcome(successful=False, reason=_NOTHING)
        values = [(one.name, _from_message(one.value)) for one in wanted]
        if reason := self._parameters.refusal(*values):
            return self._outcome(successful=False, reason=reason)
        for name, value in values:
            self._parameters.assign(name, value)
        self._publish_event(changed_parameters=values)
        return self._outcome(successful=True)

    def _publish_event(self, **changes: Iterable[tuple[str, Value]]) -> None:
        lists = {
            field: tuple(
                self._parameter(name=name, value=self._to_message(value)) for name, value in values
            )
            for field, values in changes.items()
        }
        self._publish(self._event(stamp=from_ns(self._now_ns()), node=self._node, **lists))

    def _all_known(self, names: tuple[str, ...]) -> tuple[str, ...]:
        return names if all(name in self._parameters.declared for name in names) else ()

    def _to_message(self, value: Value) -> Message:
        kind = type_of(value)
        field = {_FIELDS[kind]: value} if kind else {}
        return self._value(type=int(kind), **field)

    def _description(self, name: str) -> Message:
        declared = self._parameters.declared[name]
        ranges: dict[str, tuple[Message, ...]] = {}
        if declared.range is not None:
            least, greatest = declared.range
            if isinstance(declared.default, float):
                floats = self._floats(from_value=least, to_value=greatest)
                ranges["floating_point_range"] = (floats,)
            else:
                integers = self._integers(from_value=least, to_value=greatest, step=1)
                ranges["integer_range"] = (integers,)
        return self._descriptor(
            name=name,
            type=int(type_of(declared.default)),
            description=declared.description,
            read_only=declared.read_only,
            **ranges,
        )


def _from_message(value: Any) -> Value:
    field = _FIELDS.get(value.type)
    held: Value = None if field is None else getattr(value, field)
    return held


def _listed(name: str, prefixes: tuple[str, ...], depth: int) -> bool:
    """Check if a listing to that depth (0: any) names a parameter.

    The depth is counted from the prefix, or from the root where no prefix is given.
    """
    if not prefixes:
        return not depth or name.count(_SEPARATOR) < depth
    for prefix in prefixes:
        rest = name.removeprefix(prefix + _SEPARATOR)
        if name == prefix or (rest != name and (not depth or rest.count(_SEPARATOR) < depth)):
            return True
    return False
