"""A ROS definition as data: the types of fields, their defaults, constants.

Services and actions are definitions, too, as in ROS's own type descriptions: their fields are their
parts (see :mod:`.interfaces`).

Definitions as text: one that is known without its file, and several in one text.
"""

from __future__ import annotations

import keyword
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

Value = bool | int | float | str | bytes | tuple["Value", ...]

# The field that stands for all of a message without fields: in its hash, and as a byte on the wire.
EMPTY_MEMBER = "structure_needs_at_least_one_member"


class Primitive(NamedTuple):
    """A type that is built into ROS."""

    code: str  # of the struct module; empty for texts
    size: int  # bytes, and so the alignment; of a text, of the length before it
    type_id: int  # in ROS's descriptions of types, as hashed


PRIMITIVES = {
    "bool": Primitive("B", 1, 15),  # read as a byte: struct takes any byte for a bool
    "byte": Primitive("B", 1, 16),
    "char": Primitive("B", 1, 3),  # in ROS 2 a char is a uint8, in hashes, too
    "int8": Primitive("b", 1, 2),
    "uint8": Primitive("B", 1, 3),
    "int16": Primitive("h", 2, 4),
    "uint16": Primitive("H", 2, 5),
    "int32": Primitive("i", 4, 6),
    "uint32": Primitive("I", 4, 7),
    "int64": Primitive("q", 8, 8),
    "uint64": Primitive("Q", 8, 9),
    "float32": Primitive("f", 4, 10),
    "float64": Primitive("d", 8, 11),
    "string": Primitive("", 4, 17),
    "wstring": Primitive("", 4, 18),
}

# The least and the greatest value of each type of whole numbers.
INTEGERS = {
    name: (0, 2**bits - 1) if code.isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    for name, (code, size, _) in PRIMITIVES.items()
    if (bits := 8 * size) and code in tuple("bBhHiIqQ") and name != "bool"
}


class Shape(Enum):
    """How many values a field has; the number is what ROS adds to the type id in the hash."""

    SINGLE = 0
    ARRAY = 48  # exactly so many
    BOUNDED = 96  # at most so many
    SEQUENCE = 144


@dataclass(frozen=True)
class FieldType:
    """The type of a field: a primitive's name or ``package/msg/Name``, and how many there are.

    ``size`` is the number of values of an array or the bound of a sequence, ``bound`` that of a
    text in characters; 0 is none.
    """

    base: str
    shape: Shape = Shape.SINGLE
    size: int = 0
    bound: int = 0

    @property
    def nested(self) -> bool:
        """Whether the values are messages."""
        return "/" in self.base

    @property
    def is_text(self) -> bool:
        """Whether the values are texts."""
        return self.base in ("string", "wstring")

    @property
    def is_bytes(self) -> bool:
        """Whether the field is ``bytes`` in Python: several unsigned values of eight bits."""
        return self.shape is not Shape.SINGLE and self.base in ("byte", "char", "uint8")


@dataclass(frozen=True)
class Field:
    """A field; ``default`` is None if the definition names none."""

    name: str
    type: FieldType
    default: Value | None = None

    @property
    def attribute(self) -> str:
        """Its name in Python: an underscore is added to a keyword, as no ROS name ends in one."""
        return f"{self.name}_" if keyword.iskeyword(self.name) else self.name


@dataclass(frozen=True)
class Constant:
    """A constant of a message, and the primitive type that it has there."""

    name: str
    value: Value
    type: str


@dataclass(frozen=True)
class Definition:
    """A message, service or action (its ``kind``), under its full name."""

    name: str
    fields: tuple[Field, ...] = ()
    constants: tuple[Constant, ...] = ()
    kind: str = "message"


_RULE = "=" * 80


class TypeSource(NamedTuple):
    """What defines a type, as type_description_interfaces/msg/TypeSource."""

    type_name: str
    encoding: str
    """``msg``, ``srv`` or ``action``; ``implicit``: a part of a service or an action."""
    text: str


def definition_text(definition: Definition) -> str:
    """Return text that is read as this message: its constants and fields, without comments."""
    return "".join(
        [
            *(f"{one.type} {one.name}={_literal(one.value)}\n" for one in definition.constants),
            *(_field(field) for field in definition.fields),
        ]
    )


def _field(field: Field) -> str:
    kind = field.type
    bound = f"<={kind.bound}" if kind.bound else ""
    match kind.shape:
        case Shape.SINGLE:
            several = ""
        case Shape.ARRAY:
            several = f"[{kind.size}]"
        case Shape.BOUNDED:
            several = f"[<={kind.size}]"
        case Shape.SEQUENCE:
            several = "[]"
    base = kind.base.replace("/msg/", "/")
    default = "" if field.default is None else f" {_literal(field.default)}"
    return f"{base}{bound}{several} {field.name}{default}\n"


def _literal(value: Value) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return '"' + value.replace('"', r"\"") + '"'
        case bytes() | tuple():
            return f"[{', '.join(map(_literal, value))}]"
        case _:
            return repr(value)


def bundled(sources: Sequence[TypeSource]) -> str:
    """Return the texts of a type and of all that it refers to as one, as MCAP's ``ros2msg``."""
    first, *others = sources
    parts = [first.text]
    for each in others:
        parts += [_RULE, f"MSG: {each.type_name.replace('/msg/', '/')}", each.text]
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


def unbundled(name: str, text: str) -> dict[str, str]:
    """Return the text of each type in a bundle, by full name; ``name`` is the first one's."""
    first, *others = text.replace("\r\n", "\n").split(f"{_RULE}\nMSG: ")
    found = {name: first}
    for other in others:
        title, _, body = other.partition("\n")
        package, _, base = title.strip().rpartition("/")
        found[f"{package.removesuffix('/msg')}/msg/{base}"] = body
    return found
