"""The configuration that machines need themselves: a topic for each slot that they use."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from llfsm.bridges.ros2.bridging.bridge_config import (
    BridgeConfig,
    Direction,
    PositionConfig,
    RelayConfig,
)
from llfsm.bridges.ros2.bridging.bridge_plan import BridgePlan, make_plan
from llfsm.bridges.ros2.errors import RosNameError, RosTypeError
from llfsm.bridges.ros2.graph import Names
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.runtime import Machine
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.turtle_sensor_poster import REQUEST
from llfsm.whiteboard.messages.turtlesim import Pose

_NODE = "llfsm_machines"
_DRIVE = "/cmd_vel"


def machine_config(
    machines: Iterable[tuple[type[Machine], Mapping[str, str]]], node: str = _NODE
) -> BridgeConfig:
    """Make the configuration that connects machines with the topics of their slots' names.

    With each class come the slots that replace others, by name. What a machine reads comes from
    ROS, what one posts goes there, if the slot's type is a message type of ROS and its name can be
    a topic's. Other slots connect machines with each other. If a machine requests the position of
    the turtle that it drives by ``TURTLE/cmd_vel``, that is answered from ``TURTLE/pose``.
    """
    read, posted = used_slots(machines)
    driven = next((name for name in posted if name.endswith(_DRIVE)), None)
    position = None
    if driven is not None and REQUEST.name in posted:
        pose = Slot(driven.removesuffix(_DRIVE) + "/pose", Pose)
        position = PositionConfig(pose=pose.name)
        read.setdefault(pose.name, pose)
    types = TypeLibrary()
    relays = tuple(
        RelayConfig(slot=name, type=slot.type_name, direction=_direction(name, read, posted))
        for name, slot in (read | posted).items()
        if _in_ros(name, slot, types)
    )
    return BridgeConfig(node=node, relay=relays, turtle_position=position)


def plan_for(*machines: type[Machine], node: str = _NODE) -> BridgePlan:
    """Make the plan that connects machines with the topics of their slots' names.

    Raise :class:`.ConfigurationError` for a wrong ``node``.
    """
    plan, faults = make_plan(machine_config([(cls, {}) for cls in machines], node), Path(), [])
    if faults:
        raise faults[0]
    return plan


def used_slots(
    machines: Iterable[tuple[type[Machine], Mapping[str, str]]],
) -> tuple[dict[str, Slot[Any]], dict[str, Slot[Any]]]:
    """List the slots that machines read, and those that they post to, by name.

    With each class come the slots that replace others, by name.
    """
    read: dict[str, Slot[Any]] = {}
    posted: dict[str, Slot[Any]] = {}
    for cls, replaced in machines:
        for ports, found in ((cls.table.sensors, read), (cls.table.actuators, posted)):
            for port in ports.values():
                name = replaced.get(port.slot.name, port.slot.name)
                found.setdefault(name, Slot(name, port.slot.type, port.slot.capacity))
    return read, posted


def _direction(name: str, read: Mapping[str, object], posted: Mapping[str, object]) -> Direction:
    if name in posted:
        return "both" if name in read else "to_ros"
    return "from_ros"


def _in_ros(name: str, slot: Slot[Any], types: TypeLibrary) -> bool:
    try:
        types.of(slot.type)
        Names(_NODE).full(name)
    except (RosTypeError, RosNameError):
        return False
    return True
