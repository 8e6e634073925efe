"""What the page offers to include: message types that ship, those of ROS, and those of a board."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, Final

from llfsm.bridges.ros2.errors import RosTypeError
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.view.page_source import PageSource
from llfsm.whiteboard import Message
from llfsm.whiteboard.message_text import shipped_types
from llfsm.whiteboard.own_slots import is_own

from .message_class_text import class_name, message_class_text

__all__ = ["offered", "ros_class"]

_BASE: Final = {
    "llfsm.runtime": ("Actuator", "Sensor"),
    "llfsm.whiteboard": ("Message", "Slot"),
}


def offered(source: PageSource | None) -> dict[str, Any]:
    """Return the types, each with the `text` that includes it, and the types of a board's slots.

    A type's class has a `name` that another one's may have, too; in `text`, NAME stands for it.
    """
    types, slots = list(_known()), {}
    names = {each["type"] for each in types}
    for info in source.snapshot().slots.values() if source is not None else ():
        if info.problem or is_own(info.name):
            continue
        slots[info.name] = info.type_name
        if info.type_name not in names:
            try:
                text = message_class_text(info.schema)
            except ValueError:  # it has no text
                continue
            names.add(info.type_name)
            types.append({"name": class_name(info.type_name), "type": info.type_name, "text": text})
    return {"types": types, "slots": slots}


@cache
def _library() -> TypeLibrary:
    return TypeLibrary()


def ros_class(name: str) -> type[Message] | None:
    """Return the class of a message type of ROS; None if it is not known."""
    try:
        return _library().message(name).message
    except RosTypeError:
        return None


@cache
def _known() -> tuple[dict[str, str], ...]:
    return tuple(_found())


def _found() -> Iterator[dict[str, str]]:
    for module, names in _BASE.items():
        for name in names:
            yield {"name": name, "type": "", "text": f"from {module} import {name}\n"}
    here: dict[str, tuple[str, str]] = {
        each.__type_name__: (each.__module__, each.__name__)  # type: ignore[attr-defined]
        for each in shipped_types()
    }
    for type_name in sorted({*here, *_library().message_names()}):
        module, name = here.get(type_name, ("", class_name(type_name)))
        yield {"name": name, "type": type_name, "text": _including(type_name, module, name)}


def _including(type_name: str, module: str, name: str) -> str:
    if module:
        return f"from {module} import {name} as NAME\n"
    return (
        "from llfsm.bridges.ros2.types import TypeLibrary\n\n\n"
        f'NAME = TypeLibrary().message("{type_name}").message\n'
    )
