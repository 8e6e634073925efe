"""RIHS01: the hash by which ROS 2 compares types (REP 2011)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from typing import Any

from llfsm.bridges.ros2.types.definition import (
    EMPTY_MEMBER,
    PRIMITIVES,
    Definition,
    Field,
    FieldType,
)

_NESTED = 1
_BOUNDED_TEXT = {"string": 21, "wstring": 22}
_EMPTY = Field(EMPTY_MEMBER, FieldType("uint8"))


def rihs01(definition: Definition, find: Callable[[str], Definition]) -> str:
    """Return ``RIHS01_`` and the SHA-256 of a definition and all it refers to.

    ``find`` returns the definition of a name. Defaults and constants do not count.
    """
    # The separators, the order of keys and the escapes are part of the standard: those of json.
    whole = json.dumps(describe(definition, find))
    return "RIHS01_" + hashlib.sha256(whole.encode()).hexdigest()


def describe(definition: Definition, find: Callable[[str], Definition]) -> dict[str, Any]:
    """Return what is hashed: a type_description_interfaces/msg/TypeDescription without defaults."""
    described: dict[str, dict[str, Any]] = {}
    waiting = [definition]
    while waiting:
        one = waiting.pop()
        if one.name not in described:
            described[one.name] = _description(one)
            waiting += [find(field.type.base) for field in one.fields if field.type.nested]
    return {
        "type_description": described.pop(definition.name),
        "referenced_type_descriptions": [described[name] for name in sorted(described)],
    }


def _description(definition: Definition) -> dict[str, Any]:
    return {
        "type_name": definition.name,
        "fields": [
            {
                "name": field.name,
                "type": {
                    "type_id": field.type.shape.value + _type_id(field.type),
                    "capacity": field.type.size,
                    "string_capacity": field.type.bound,
                    "nested_type_name": field.type.base if field.type.nested else "",
                },
            }
            for field in definition.fields or (_EMPTY,)
        ],
    }


def _type_id(kind: FieldType) -> int:
    if kind.nested:
        return _NESTED
    return _BOUNDED_TEXT[kind.base] if kind.bound else PRIMITIVES[kind.base].type_id
