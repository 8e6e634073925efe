"""A node's parameters: their declarations and values, and why a value is refused; values from YAML.

Each parameter is declared with a value and keeps its type, as in rclcpp without dynamic typing. The
reasons are in rclcpp's words, which people search for. Several parameters are set together or not
at all, so all of them are judged before the first is assigned. Values from outside are kept until
their parameter is declared: a node that declares late starts with them, too.

YAML is read as rcl_yaml_param_parser reads it, which is not YAML 1.2: ``on`` is true, ``010`` is
octal, ``nan`` a number. So scalars are taken as text and their types decided here. A file has a
mapping for each node, by its full name or by namespaces that contain it, and in that, below
``ros__parameters``, its parameters; ``*`` stands for one name and ``**`` for any number.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from llfsm.bridges.ros2.errors import ParameterOverrideError, RosArgumentError

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
    """Determine the type of a value; an empty tuple counts as bytes, as in rclpy."""
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
        """Copy all values, by name."""
        return dict(self._values)

    def refusal(self, *wanted: tuple[str, Value]) -> str | None:
        """Explain why these values, by name, cannot be set together; None if they can.

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


ANY_NODE = "/**"

_PARAMETERS = "ros__parameters"
_TRUE = {"Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"}
_FALSE = {"N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"}
_INTEGER = re.compile(r"\s*[+-]?(0[xX][0-9a-fA-F]+|[0-9]+)")
_FLOAT = re.compile(r"\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_PART = r"(?:\*\*?|[A-Za-z_][A-Za-z0-9_]*)"
_PATTERN = re.compile(rf"/?{_PART}(?:/{_PART})*")
_SPECIAL = re.compile(r"([+-]?)(?:\.(?:nan|NaN|NAN|inf|Inf|INF)|(?i:nan|inf|infinity))")


def fits(pattern: str, node: str) -> bool:
    """Check if a node's full name fits a pattern."""
    parts = (
        {"**": r"(/[^/]+)*", "*": "/[^/]+"}.get(part, "/" + re.escape(part))
        for part in pattern.strip("/").split("/")
    )
    return re.fullmatch("".join(parts), node) is not None


def read_parameters(file: Path) -> list[tuple[str, str, Value]]:
    """Read the node pattern, name and value of each parameter in a file.

    Raise :class:`.RosArgumentError` with the file, and the line where there is one.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RosArgumentError(f"--params-file {file}: cannot be read: {error}") from error
    root = _compose(text, str(file))
    return [] if root is None else list(_nodes(root, (), str(file)))


def read_value(text: str, where: str) -> Value:
    """Parse a parameter's value in YAML; ``where`` names it in a :class:`.RosArgumentError`."""
    root = _compose(text, where)
    return "" if root is None else _value(root, where)


def _compose(text: str, where: str) -> Any:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        return YAML(typ="safe", pure=True).compose(text)
    except YAMLError as error:
        raise RosArgumentError(f"{where}: not YAML: {' '.join(str(error).split())}") from error


def _nodes(mapping: Any, above: tuple[str, ...], where: str) -> Iterator[tuple[str, str, Value]]:
    for name, value, place in _entries(mapping, where):
        if name == _PARAMETERS:
            if not above:
                raise RosArgumentError(f"{place}: {_PARAMETERS} belongs below a node's name")
            for parameter, held in _parameters(value, "", where):
                yield "/" + "/".join(above), parameter, held
        elif not _PATTERN.fullmatch(name):
            raise RosArgumentError(
                f"{place}: {name!r} is not a node's name, whose parts may be * or **"
            )
        else:
            yield from _nodes(value, (*above, *filter(None, name.split("/"))), where)


def _parameters(mapping: Any, prefix: str, where: str) -> Iterator[tuple[str, Value]]:
    for name, value, place in _entries(mapping, where):
        if value.id == "mapping":
            yield from _parameters(value, f"{prefix}{name}.", where)
        else:
            yield prefix + name, _value(value, place)


def _entries(mapping: Any, where: str) -> Iterator[tuple[str, Any, str]]:
    if mapping.id != "mapping":
        raise RosArgumentError(f"{_place(mapping, where)}: expected names with values below them")
    for key, value in mapping.value:
        yield str(key.value), value, _place(key, where)


def _place(node: Any, where: str) -> str:
    return f"{where}:{node.start_mark.line + 1}"


def _value(node: Any, where: str) -> Value:
    if node.id == "sequence":
        values = tuple(_scalar(each, where) for each in node.value)
        if len({type(value) for value in values}) > 1:
            raise RosArgumentError(f"{where}: a sequence has values of one type")
        return values
    return _scalar(node, where)


def _scalar(node: Any, where: str) -> bool | int | float | str:
    if node.id != "scalar":
        raise RosArgumentError(f"{where}: expected a value, or a sequence of values")
    text: str = node.value
    if node.style in ("'", '"') or _is_tagged_text(node):
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if found := _INTEGER.fullmatch(text):
        return _integer(found[0].strip())
    if _SPECIAL.fullmatch(text):
        return float(text.replace(".", ""))
    if _FLOAT.fullmatch(text):
        return float(text)
    if not text:
        raise RosArgumentError(f"{where}: a value is missing")
    return text


def _is_tagged_text(node: Any) -> bool:
    """Check if a value has the tag ``!!str``, and does not only look like text to YAML."""
    return (node.ctag.handle, node.ctag.suffix) == ("!!", "str")


def _integer(text: str) -> int | float | str:
    """Read a number as strtoll with base 0: octal after a zero; beyond 64 bits it is a float."""
    digits = text.lstrip("+-")
    octal = len(digits) > 1 and digits[0] == "0" and digits[1] not in "xX"
    try:
        number = int(digits, 8 if octal else 0)
    except ValueError:  # 08
        return float(text)
    number = -number if text.startswith("-") else number
    return number if -(2**63) <= number < 2**63 else float(text)
