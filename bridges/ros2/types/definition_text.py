"""Definitions as text: one that is known without its file, and several in one text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from .definition import Definition, Field, Shape, Value

__all__ = ["TypeSource", "bundled", "definition_text", "unbundled"]

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
