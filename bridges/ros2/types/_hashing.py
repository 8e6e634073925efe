"""RIHS01: the hash by which ROS 2 compares types (REP 2011).

It is the SHA-256 of a type's description as JSON: the names and types of its fields, and of all
types that it refers to. Two nodes whose hashes differ have different definitions, even if their
types have one name. Defaults and constants do not count, as they are not on the wire.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from typing import Any

from llfsm.bridges.ros2.types._primitives import PRIMITIVES
from llfsm.bridges.ros2.types.definition import EMPTY_MEMBER, Definition, Field, FieldType

_NESTED = 1  # the type id of a message
_EMPTY = Field(EMPTY_MEMBER, FieldType("uint8"))


def rihs01(definition: Definition, find: Callable[[str], Definition]) -> str:
    """Hash a definition and all it refers to, which ``find`` returns by name: ``RIHS01_...``."""
    # The separators, the order of keys and the escapes are part of the standard: those of json.
    whole = json.dumps(describe(definition, find))
    return "RIHS01_" + hashlib.sha256(whole.encode()).hexdigest()


def describe(definition: Definition, find: Callable[[str], Definition]) -> dict[str, Any]:
    """Describe a type as it is hashed: type_description_interfaces/msg/TypeDescription as data."""
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
    row = PRIMITIVES[kind.base]
    return row.bounded_id if kind.bound else row.type_id
