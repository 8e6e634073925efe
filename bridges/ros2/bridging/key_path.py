"""Where a message has a key.

``keyed_by = "transforms.child_frame_id"`` is a path of fields to a text or a whole number. If a
field on the way is a sequence, each of its items is a message for the slot of its key; otherwise
the whole message is.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from msgspec import inspect as mi

from llfsm.whiteboard import Message

from ..errors import KeyPathError

__all__ = ["KeyPath"]


class KeyPath:
    """Where the keys of a message are; ``part`` is the class of the messages of the slots."""

    def __init__(self, path: str, message: type[Message]) -> None:
        """Raise :class:`.KeyPathError`."""
        self.part: Any = message
        self._to_parts: list[str] | None = None
        """The fields on the way to a sequence, if there is one."""
        self._to_key: list[str] = []
        node: mi.Type = mi.type_info(message)
        for name in path.split("."):
            if not isinstance(node, mi.StructType):
                raise KeyPathError(f"{path!r}: there is no field {name!r} in a value")
            fields = {field.name.removesuffix("_"): field for field in node.fields}
            if name not in fields:
                known = ", ".join(fields)
                raise KeyPathError(f"{path!r}: no field {name!r}; there are: {known}")
            self._to_key.append(fields[name].name)
            node = fields[name].type
            item = getattr(node, "item_type", None)
            if self._to_parts is None and isinstance(item, mi.StructType):
                self._to_parts, self._to_key, self.part, node = self._to_key, [], item.cls, item
        if not isinstance(node, mi.StrType | mi.IntType):
            raise KeyPathError(f"{path!r}: a key is a text or a whole number")

    def split(self, message: Any) -> Iterator[tuple[str, Message]]:
        """Yield the keys in a message and the message of each."""
        parts = (message,) if self._to_parts is None else _at(message, self._to_parts)
        for part in parts:
            yield str(_at(part, self._to_key)).removeprefix("/"), part


def _at(value: Any, path: list[str]) -> Any:
    for name in path:
        value = getattr(value, name)
    return value
