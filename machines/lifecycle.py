"""Managed nodes of ROS 2, brought up one after the other."""

from __future__ import annotations

from llfsm.machines.calls import CallService, ServiceSlots
from llfsm.machines.combinators import Sequence
from llfsm.runtime import DefinitionError, Machine
from llfsm.whiteboard import Message
from llfsm.whiteboard.messages.types import UInt8

__all__ = ["LifecycleBringUp", "change_state_slots"]


class Transition(Message, type_name="lifecycle_msgs/msg/Transition"):
    """A transition of a managed node, by its number, or by its label if that is not empty."""

    id: UInt8 = 0
    label: str = ""


class ChangeStateRequest(Message, type_name="lifecycle_msgs/srv/ChangeState_Request"):
    """The transition that a node is to make."""

    number: int = 0
    transition: Transition = Transition()


class ChangeStateAnswer(Message, type_name="lifecycle_msgs/srv/ChangeState_Response"):
    """The answer: the node has made it, or not."""

    number: int = 0
    success: bool = False
    failure: str = ""


CONFIGURE, ACTIVATE = Transition(1, "configure"), Transition(3, "activate")


def change_state_slots(node: str) -> ServiceSlots:
    """Return the slots of a node's ``change_state`` service, as a bridge makes them."""
    return ServiceSlots.of(f"{node}/change_state", ChangeStateRequest, ChangeStateAnswer)


def LifecycleBringUp(  # noqa: N802  # makes classes
    *nodes: str, timeout_ms: float = 30_000, name: str = "LifecycleBringUp"
) -> type[Machine]:
    """Make a machine that configures and activates nodes: each one before the next.

    It is done when all are active, and fails with the first transition that its node refuses, that
    no node answers within `timeout_ms`, or that the bridge could not deliver.
    """
    if not nodes:
        raise DefinitionError(f"{name}: give the names of nodes")
    return Sequence(
        *(
            CallService(
                change_state_slots(node),
                ChangeStateRequest(transition=transition),
                timeout_ms,
                accept=lambda answer: bool(answer.success),
                name=transition.label.title(),
            )
            for node in nodes
            for transition in (CONFIGURE, ACTIVATE)
        ),
        name=name,
    )
