"""The types that the page offers to include: those that ship, those of ROS, those of a board.

Of a type of a board only the schema is known, which its slots carry; a class with the same schema
is written from it. A schema comes from another process, so it is data: its names are checked, and a
pattern in it is never run.
"""

from __future__ import annotations

import json
import keyword
from collections.abc import Iterator
from functools import cache
from typing import Any, Final

from llfsm.bridges.ros2.errors import RosTypeError
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.view.page_source import PageSource
from llfsm.whiteboard import Message
from llfsm.whiteboard.message_text import shipped_types
from llfsm.whiteboard.schema import Schema, limits
from llfsm.whiteboard.slot_names import is_own

_PLAIN = {"boolean": "bool", "integer": "int", "number": "float", "string": "str", "null": "None"}
_ZERO = {"boolean": "False", "integer": "0", "number": "0.0", "string": '""', "null": "None"}
_ORDER = ("typing", "msgspec", "llfsm.whiteboard")


def class_name(type_name: str) -> str:
    """Return the class name of a type: the last part of ``geometry_msgs/msg/Twist``."""
    return type_name.rpartition("/")[2]


def message_class_text(schema: Schema) -> str:
    """Write the imports and classes of a message type; raise `ValueError` if that is impossible.

    A field has a default where 0, or nothing, is one of its values.
    """
    classes = _Classes()
    try:
        classes.add(schema)
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError) as error:
        raise ValueError(f"this schema describes no messages: {error!r}") from error
    return "\n\n\n".join([classes.imports(), *classes.texts.values()]) + "\n"


class _Classes:
    def __init__(self) -> None:
        self.texts: dict[str, str] = {}  # those that others need come first
        self._schemas: dict[str, Schema] = {}
        self._used: set[tuple[str, str]] = {("llfsm.whiteboard", "Message")}

    def imports(self) -> str:
        names: dict[str, list[str]] = {}
        for module, name in sorted(self._used, key=lambda each: (_ORDER.index(each[0]), each[1])):
            names.setdefault(module, []).append(name)
        return "\n".join(
            f"from {module} import {', '.join(each)}" for module, each in names.items()
        )

    def add(self, schema: Schema) -> str:
        """Add a class; return its name."""
        title = schema["title"]
        name = _identifier(class_name(title))
        if self._schemas.setdefault(name, schema) != schema:
            raise ValueError(f"two types are called {name}")
        if name not in self.texts:
            fields = [
                (f"{_identifier(field)}: {self.annotation(part)}", _default(part))
                for field, part in schema["properties"].items()
            ]
            given = "" if title == name else f", type_name={_value(title)}"
            body = "".join(f"\n    {line}" for line in _lines(fields)) or "\n    pass"
            self.texts[name] = f"class {name}(Message{given}):{body}"
        return name

    def annotation(self, schema: Schema) -> str:
        """Write the type of a field, with its limits."""
        if "enum" in schema:
            return f"{self._use('typing', 'Literal')}[{', '.join(map(_value, schema['enum']))}]"
        if "anyOf" in schema:
            return " | ".join(map(self.annotation, schema["anyOf"]))
        made = self._bare(schema)
        if "pattern" in schema:
            raise ValueError("a pattern of another program is not run")
        within = limits(schema)
        if not within:
            return made
        given = ", ".join(f"{key}={_value(value)}" for key, value in within.items())
        self._use("typing", "Annotated")
        return f"Annotated[{made}, {self._use('msgspec', 'Meta')}({given})]"

    def _bare(self, schema: Schema) -> str:
        kind = schema["type"]
        if kind == "object":
            return self.add(schema)
        if kind == "array":
            if "prefixItems" in schema:
                each = ", ".join(map(self.annotation, schema["prefixItems"]))
                return f"tuple[{each or '()'}]"
            inner = self.annotation(schema["items"])
            return f"frozenset[{inner}]" if schema.get("uniqueItems") else f"tuple[{inner}, ...]"
        return "bytes" if schema.get("contentEncoding") else _PLAIN[kind]

    def _use(self, module: str, name: str) -> str:
        self._used.add((module, name))
        return name


def _lines(fields: list[tuple[str, str | None]]) -> Iterator[str]:
    """Give the lines of fields, declared so: a default only where all behind it have one."""
    first = max((i + 1 for i, (_, default) in enumerate(fields) if default is None), default=0)
    for i, (declaration, default) in enumerate(fields):
        yield declaration if i < first else f"{declaration} = {default}"


def _default(schema: Schema) -> str | None:
    if "enum" in schema:
        return _value(schema["enum"][0])
    if "anyOf" in schema:
        defaults = [_default(option) for option in schema["anyOf"]]
        return "None" if "None" in defaults else next(filter(None, defaults), None)
    if not _allows_zero(schema):
        return None
    kind = schema["type"]
    if kind == "object":
        has_all = None not in map(_default, schema["properties"].values())
        return f"{class_name(schema['title'])}()" if has_all else None
    if kind == "array":
        if "prefixItems" not in schema:
            return "frozenset()" if schema.get("uniqueItems") else "()"
        parts = [_default(part) for part in schema["prefixItems"]]
        inner = ", ".join(part for part in parts if part is not None)
        return None if None in parts else f"({inner}{',' if len(parts) == 1 else ''})"
    return 'b""' if schema.get("contentEncoding") else _ZERO[kind]


def _allows_zero(schema: Schema) -> bool:
    """Check that 0, or an empty text or array, is within the limits."""
    least = max(schema.get(key, 0) for key in ("minimum", "minLength", "minItems"))
    beside = schema.get("exclusiveMinimum", -1), schema.get("exclusiveMaximum", 1)
    return bool(least <= 0 <= schema.get("maximum", 0) and beside[0] < 0 < beside[1])


def _value(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def _identifier(name: str) -> str:
    """Return a name; raise `ValueError` if it cannot be one in Python."""
    if not name.isidentifier() or keyword.iskeyword(name):
        raise ValueError(f"{name!r} cannot be a name in Python")
    return name


_BASE: Final = {
    "llfsm.runtime": ("Actuator", "Sensor"),
    "llfsm.whiteboard": ("Message", "Slot"),
}


def offered(source: PageSource | None) -> dict[str, Any]:
    """List the types, each with the `text` that includes it, and the types of a board's slots.

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
