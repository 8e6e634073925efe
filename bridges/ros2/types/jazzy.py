"""The definitions of rosbags: the messages of a desktop installation of ROS 2 Jazzy.

They have no defaults and no services. Where that matters, ours has a definition of its own.
"""

from __future__ import annotations

from functools import cache
from typing import Any, cast

from llfsm.bridges.ros2.types.definition import (
    EMPTY_MEMBER,
    Constant,
    Definition,
    Field,
    FieldType,
    Shape,
)

_SHAPES = {3: Shape.ARRAY, 4: Shape.SEQUENCE}  # as rosbags numbers them


def find(name: str) -> Definition | None:
    """Return the definition of a message; None if rosbags does not have it or is not installed."""
    entry = _store().get(name)
    if entry is None:
        return None
    constants, fields = entry
    return Definition(
        name,
        tuple(Field(n, _type(kind)) for n, kind in fields if n != EMPTY_MEMBER),
        tuple(Constant(n, value, kind) for n, kind, value in constants),
    )


def names() -> list[str]:
    """Return the names of all these messages."""
    return list(_store())


@cache
def _store() -> dict[str, tuple[Any, Any]]:
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        return {}
    return cast("dict[str, tuple[Any, Any]]", get_typestore(Stores.ROS2_JAZZY).fielddefs)


def _type(entry: tuple[int, Any]) -> FieldType:
    kind, inner = entry
    if kind == 1:
        return FieldType(inner[0], bound=inner[1])
    if kind == 2:
        return FieldType(inner)
    item, size = inner
    shape = Shape.BOUNDED if kind == 4 and size else _SHAPES[kind]
    single = _type(item)
    return FieldType(single.base, shape, size, single.bound)
