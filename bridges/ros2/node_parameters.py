"""A node's parameters: what they are, what they may be, and why a value is refused.

Each parameter is declared with a value and keeps its type, as in rclcpp without dynamic typing. The
reasons are in rclcpp's words, which people search for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, NamedTuple

from .errors import ParameterOverrideError

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
    range: tuple[float, float] | None = None
    """The least and the greatest number it may be."""
    read_only: bool = False
    changed: Callable[[Any], None] | None = None
    """Called with each value that it is set to, also at the start by an override."""


class NodeParameters:
    """The values of the parameters that a node has declared, sorted by name as by rclcpp."""

    def __init__(self, declared: Mapping[str, Parameter] = MappingProxyType({})) -> None:
        self._declared: dict[str, Parameter] = {}
        self._values: dict[str, Any] = {}
        self._overrides: Mapping[str, Value] = {}
        self.declare(declared)

    @property
    def declared(self) -> Mapping[str, Parameter]:
        """The declarations by name."""
        return MappingProxyType(self._declared)

    def declare(self, declared: Mapping[str, Parameter]) -> None:
        """Declare more parameters; raise as :meth:`override`."""
        self._declared = dict(sorted((self._declared | dict(declared)).items()))
        for name, one in declared.items():
            self._values[name] = one.default
            self._override(name)

    def override(self, values: Mapping[str, Value]) -> None:
        """Start with these values instead of the defaults, also of what is declared later.

        Names that are never declared are ignored, as by rclcpp. Raise
        :class:`.ParameterOverrideError` for a value of another type or outside the range.
        """
        self._overrides = values
        for name in self._declared:
            self._override(name)

    def _override(self, name: str) -> None:
        if name in self._overrides:
            value = self._overrides[name]
            if reason := self._misfit(name, value):
                raise ParameterOverrideError(f"parameter {name!r}: {reason}")
            self.assign(name, value)

    def values(self) -> dict[str, Any]:
        """Return a copy of all values by name."""
        return dict(self._values)

    def refusal(self, *wanted: tuple[str, Value]) -> str | None:
        """Return why these values, by name, cannot be set together, or None if they can.

        Of several reasons it is the one that rclcpp finds first.
        """
        for check in (self._fixed, self._missing, self._misfit):
            for name, value in wanted:
                if reason := check(name, value):
                    return reason
        return None

    def _fixed(self, name: str, _: Value) -> str | None:
        declared = self._declared.get(name)
        if declared is None:
            return f"parameter '{name}' cannot be set because it was not declared"
        if declared.read_only:
            return f"parameter '{name}' cannot be set because it is read-only"
        return None

    def _missing(self, _: str, value: Value) -> str | None:
        return "cannot undeclare a statically typed parameter" if value is None else None

    def _misfit(self, name: str, value: Value) -> str | None:
        declared = self._declared[name]
        wanted, given = type_of(declared.default), type_of(value)
        if given is not wanted:
            return (
                f"Wrong parameter type, parameter {{{name}}} is of type {{{wanted}}}, "
                f"setting it to {{{given}}} is not allowed."
            )
        if declared.range is not None and isinstance(value, int | float):
            least, greatest = declared.range
            if not least <= value <= greatest:
                kind = "integer" if wanted is ParameterType.INTEGER else "floating point"
                return f"Parameter {{{name}}} doesn't comply with {kind} range."
        return None

    def assign(self, name: str, value: Value) -> None:
        """Assign a value that :meth:`refusal` accepts."""
        self._values[name] = value
        if changed := self._declared[name].changed:
            changed(value)
