"""What rclcpp gives every node: parameters, a time, type descriptions, a log."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from .call_queue import Put
from .node_parameters import NodeParameters, Parameter
from .node_time import NodeTime
from .parameter_server import PARAMETER_EVENTS, PARAMETER_QOS, ParameterServer
from .qos_overrides import overridden
from .rosout import Rosout
from .transport import Node
from .type_descriptions import TypeDescriptionServer
from .types import TypeLibrary

__all__ = ["Equipment", "equip"]

_SIM_TIME = "use_sim_time"
_DESCRIBE = "start_type_description_service"


class Equipment(NamedTuple):
    """What a node has from :func:`equip` and uses itself."""

    log: Rosout
    time: NodeTime


def equip(
    node: Node,
    types: TypeLibrary,
    parameters: NodeParameters,
    put: Put,
    set_ns: Callable[[int], None] | None = None,
) -> Equipment:
    """Serve a node's parameters, its own and those of every node, and descriptions of its types.

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
