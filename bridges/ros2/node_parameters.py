"""A node's parameters: what they are, what they may be, and why a value is refused.

Each parameter is declared with a value and keeps its type, as in rclcpp without dynamic typing. The
reasons are in rclcpp's words, which people search for.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, NamedTuple

__all__ = ["NodeParameters", "Parameter", "ParameterType", "Value", "type_of"]

Value = bool | int | float | str | bytes | tuple[bool | int | float | str, ...] | None
"""A parameter's value; several of a kind are a tuple, several bytes are bytes; None: not set."""


class ParameterType(IntEnum):
    """The types of values, numbered as in rcl_interfaces/msg/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    def __str__(self) -> str:
        return "not set" if self is ParameterType.NOT_SET else self.name.lower()


_SINGLE = {
    type(None): ParameterType.NOT_SET,
    bool: ParameterType.BOOL,
    int: ParameterType.INTEGER,
    float: ParameterType.DOUBLE,
    str: ParameterType.STRING,
    bytes: ParameterType.BYTE_ARRAY,
}
_SEVERAL = {
    bool: ParameterType.BOOL_ARRAY,
    int: ParameterType.INTEGER_ARRAY,
    float: ParameterType.DOUBLE_ARRAY,
    str: ParameterType.STRING_ARRAY,
}


def type_of(value: Value) -> ParameterType:
    """Return a value's type; an empty tuple counts as bytes, as in rclpy."""
    if isinstance(value, tuple):
        return _SEVERAL[type(value[0])] if value else ParameterType.BYTE_ARRAY
    return _SINGLE[type(value)]


class Parameter(NamedTuple):
    """A parameter's declaration."""

    default: bool | int | float | str
    description: str = ""
    range: tuple[int, int] | None = None
    """The least and the greatest integer it may be."""


class NodeParameters:
    """The values of the parameters that a node has declared."""

    def __init__(self, declared: Mapping[str, Parameter]) -> None:
        self.declared = MappingProxyType(dict(declared))
        self._values: dict[str, Any] = {name: one.default for name, one in declared.items()}

    def values(self) -> dict[str, Any]:
        """Return a copy of all values by name."""
        return dict(self._values)

    def refusal(self, name: str, value: Value) -> str | None:
        """Return why a parameter refuses a value, or None if it accepts it."""
        declared = self.declared.get(name)
        if declared is None:
            return f"parameter '{name}' cannot be set because it was not declared"
        wanted, given = type_of(declared.default), type_of(value)
        if given is not wanted:
            return (
                f"Wrong parameter type, parameter {{{name}}} is of type {{{wanted}}}, "
                f"setting it to {{{given}}} is not allowed."
            )
        if declared.range is not None and isinstance(value, int):
            least, greatest = declared.range
            if not least <= value <= greatest:
                return f"Parameter {{{name}}} doesn't comply with integer range."
        return None

    def assign(self, name: str, value: Value) -> None:
        """Assign a value that :meth:`refusal` accepts."""
        self._values[name] = value
