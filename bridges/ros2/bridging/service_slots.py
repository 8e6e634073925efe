"""A service's messages in slots: requests with a number, answers also with a failure.

A caller posts a request with a number above all earlier ones, and pulls until there is an answer
with that number. A slot holds one message, so independent callers need slots of their own.
"""

from __future__ import annotations

from types import new_class
from typing import Any

from msgspec.structs import astuple, fields

from llfsm.whiteboard import Message, Slot

from ..types import RosMessage, RosService
from .capacity import capacity_for

__all__ = ["ServiceSlots", "numbered", "service_slots"]


class ServiceSlots:
    """The two slots of a service, and its messages from ROS to them and back.

    Attributes:
        request: its messages have ``number`` and the fields of the service's request.
        answer: its messages have ``number``, the fields of the response, and ``failure``, which
            is the reason why there is no response, or empty.

    """

    def __init__(self, request: Slot[Any], answer: Slot[Any], of: RosService) -> None:
        self.request = request
        self.answer = answer
        self.of = of

    def asked(self, number: int, request: Message) -> Message:
        """Return a ROS request as a message of the slot."""
        return self.request.type(number, *astuple(request))  # type: ignore[no-any-return]

    def answered(self, number: int, response: Message) -> Message:
        """Return a ROS response as a message of the slot."""
        return self.answer.type(number, *astuple(response))  # type: ignore[no-any-return]

    def failed(self, number: int, why: str) -> Message:
        """Return the answer of a failure."""
        return self.answer.type(number=number, failure=why)  # type: ignore[no-any-return]

    def ros_request(self, asked: Message) -> Message:
        """Return the ROS request of a message in the slot."""
        return self.of.request.message(*astuple(asked)[1:])  # type: ignore[no-any-return]

    def ros_response(self, answered: Message) -> Message:
        """Return the ROS response of a message in the slot."""
        return self.of.response.message(*astuple(answered)[1:-1])  # type: ignore[no-any-return]


def service_slots(name: str, of: RosService, capacity: int | None = None) -> ServiceSlots:
    """Return the slots ``name/request`` and ``name/answer`` of a service type.

    A field of the service with the name of one of ours gets an underscore. Raise
    :class:`.SlotNameError`.
    """
    asked, answered = numbered(of.request), numbered(of.response, failure="")
    return ServiceSlots(
        Slot(f"{name}/request", asked, capacity or capacity_for(asked)),
        Slot(f"{name}/answer", answered, capacity or capacity_for(answered)),
        of,
    )


def numbered(of: RosMessage[Any], **last: Any) -> type[Message]:
    """Return a class with a number, the fields of a type, and ``last`` with their defaults.

    A field of the type with a name of ours gets an underscore.
    """
    annotations: dict[str, Any] = {"number": int}
    values: dict[str, Any] = {"number": 0}
    for field in fields(of.message):
        name = f"{field.name}_" if field.name in {"number", "failure", *last} else field.name
        annotations[name] = field.type
        values[name] = field.default
    namespace = {
        "__module__": __name__,
        "__doc__": f"{of.name} in a slot.",
        "__annotations__": annotations | {field: type(value) for field, value in last.items()},
        **values,
        **last,
    }
    name = of.name.rpartition("/")[2]
    return new_class(name, (Message,), {"type_name": of.name}, lambda n: n.update(namespace))
