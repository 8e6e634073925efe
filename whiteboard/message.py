"""What goes on a whiteboard: immutable, typed messages."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, TypeVar, dataclass_transform

import msgspec

from .errors import MessageTypeError
from .schema import describe

__all__ = ["M", "Message"]


@dataclass_transform(frozen_default=True, field_specifiers=(msgspec.field,))
class _MessageMeta(msgspec.StructMeta):
    """Make frozen, array-like Structs and check their fields; a metaclass, for type checkers."""

    def __new__(
        mcls,
        name: str,
        bases: tuple[type, ...],
        namespace: dict[str, Any],
        *,
        type_name: str | None = None,
        **config: Any,
    ) -> _MessageMeta:
        namespace["__type_name__"] = type_name = type_name or name
        if not type_name.isprintable() or len(type_name.encode()) > 255:
            raise MessageTypeError(f"{name}: {type_name!r} cannot name a type")
        # An array of values, not a map, makes a message cheaper to read and easy to write from
        # C; the names stand in the slot's schema, once. Unknown fields are forbidden so that a
        # larger message in place of a smaller one is not cut to size.
        config = {"frozen": True, "array_like": True, "forbid_unknown_fields": True, **config}
        cls = super().__new__(mcls, name, bases, namespace, **config)
        with suppress(NameError):  # an annotation names what comes later: the Slot asks again
            describe(cls)
        return cls


class Message(msgspec.Struct, metaclass=_MessageMeta):
    """Stand for one message on a whiteboard; subclass it and annotate the fields.

    A message never changes, so readers share it. Fields are ``bool``, ``int`` (64 bit, or a
    narrower ``Annotated`` range), ``float``, ``str``, ``bytes``, ``None``, ``Enum``, ``Literal``,
    other messages, and ``tuple``, ``frozenset`` or unions of these; anything else raises
    :class:`.MessageTypeError` naming the field. ``type_name`` is the name by which other
    processes know the type (default: the class's)::

        class Twist(Message, type_name="geometry_msgs/msg/Twist"):
            linear: Vector3 = Vector3()
            angular: Vector3 = Vector3()
    """


M = TypeVar("M", bound=Message)
