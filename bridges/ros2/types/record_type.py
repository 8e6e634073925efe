"""A definition together with its Message class, from which codecs are compiled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import msgspec

from llfsm.whiteboard import Message

from .definition import Definition, FieldType

__all__ = ["RecordField", "RecordType"]


@dataclass(frozen=True, eq=False)
class RecordField:
    """A field; ``record`` is the type of the messages in it, if any."""

    name: str  # in Python
    type: FieldType
    record: RecordType | None


@dataclass(frozen=True, eq=False)
class RecordType:
    """A message: its class and its fields."""

    name: str
    cls: type[Message]
    members: tuple[RecordField, ...]

    @classmethod
    def of(cls, name: str, message: type[Message], find: Callable[[str], Definition]) -> RecordType:
        """Combine a class with the definition of its fields; nested classes are the class's own.

        ``find`` returns the definition of a name.
        """
        held = msgspec.structs.fields(message)
        members = [
            RecordField(
                field.attribute,
                field.type,
                cls.of(field.type.base, _inmost(info.type), find) if field.type.nested else None,
            )
            for field, info in zip(find(name).fields, held, strict=True)
        ]
        return cls(name, message, tuple(members))


def _inmost(annotation: Any) -> Any:
    while arguments := get_args(annotation):  # of Annotated[tuple[X, ...], ...], X
        annotation = arguments[0]
    return annotation
