"""Message classes from definitions.

| ROS | Python |
|---|---|
| bool, string, wstring | ``bool``, ``str`` |
| byte, char, all int and uint types | ``int`` in the type's range |
| float32, float64 | ``float``; a float32 is rounded when it is encoded |
| several byte, char or uint8 | ``bytes`` |
| several of anything else | ``tuple`` |

Bounds and sizes become limits of the annotation, which a whiteboard checks in ``add``.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Mapping
from types import new_class
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from llfsm.bridges.ros2.types._primitives import PRIMITIVES
from llfsm.bridges.ros2.types.definition import Definition, Field, FieldType, Shape
from llfsm.whiteboard import Message
from llfsm.whiteboard.schema import describe

_Nested = Callable[[str], type[Message]]


def make_class(definition: Definition, nested: _Nested) -> type[Message]:
    """Make the Message class of a definition; ``nested`` returns the class of a type within it."""
    annotations: dict[str, Any] = {c.name: ClassVar[type(c.value)] for c in definition.constants}
    values: dict[str, Any] = {c.name: c.value for c in definition.constants}
    for field in definition.fields:
        annotations[field.attribute] = _annotation(field.type, nested)
        values[field.attribute] = _default(field, nested)
    doc = f"{definition.name}, made from its definition."
    return new_message(definition.name, annotations, {"__doc__": doc, **values})


def new_message(
    type_name: str, annotations: Mapping[str, Any], values: Mapping[str, Any]
) -> type[Message]:
    """Make a Message class of its fields' types and defaults."""
    namespace = {"__module__": __name__, "__annotations__": annotations, **values}
    name = type_name.rpartition("/")[2]
    return new_class(name, (Message,), {"type_name": type_name}, lambda n: n.update(namespace))


def shipped_class(made: type[Message], name: str) -> type[Message] | None:
    """Find the class of that ROS name in ``llfsm.whiteboard.messages``, if it equals ``made``."""
    package, _, last = name.split("/")
    module = f"llfsm.whiteboard.messages.{package}"
    if importlib.util.find_spec(module) is None:
        return None
    found = getattr(importlib.import_module(module), last, None)
    if not (isinstance(found, type) and issubclass(found, Message)):
        return None
    return found if describe(found) == describe(made) else None


def _annotation(kind: FieldType, nested: _Nested) -> Any:
    if kind.is_bytes:
        return _limited(bytes, kind)
    single: Any = nested(kind.base) if kind.nested else PRIMITIVES[kind.base].python
    if kind.bound:
        single = Annotated[single, Meta(max_length=kind.bound)]
    return single if kind.shape is Shape.SINGLE else _limited(tuple[single, ...], kind)


def _limited(annotation: Any, kind: FieldType) -> Any:
    match kind.shape:
        case Shape.ARRAY:
            return Annotated[annotation, Meta(min_length=kind.size, max_length=kind.size)]
        case Shape.BOUNDED:
            return Annotated[annotation, Meta(max_length=kind.size)]
        case _:
            return annotation


def _default(field: Field, nested: _Nested) -> Any:
    if field.default is not None:
        return field.default
    kind = field.type
    count = kind.size if kind.shape is Shape.ARRAY else 0
    if kind.is_bytes:
        return bytes(count)
    if kind.shape is Shape.SINGLE or count:
        single = nested(kind.base)() if kind.nested else PRIMITIVES[kind.base].zero
        return single if kind.shape is Shape.SINGLE else (single,) * count
    return ()
