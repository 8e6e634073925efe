"""Parameters from YAML, read as rcl_yaml_param_parser reads them.

A file has a mapping for each node, by its full name or by namespaces that contain it, and in that,
below ``ros__parameters``, its parameters; ``*`` stands for one name and ``**`` for any number.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .errors import RosArgumentError
from .node_parameters import Value

__all__ = ["ANY_NODE", "fits", "read_parameters", "read_value"]

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
    """Return whether a node's full name fits a pattern."""
    parts = (
        {"**": r"(/[^/]+)*", "*": "/[^/]+"}.get(part, "/" + re.escape(part))
        for part in pattern.strip("/").split("/")
    )
    return re.fullmatch("".join(parts), node) is not None


def read_parameters(file: Path) -> list[tuple[str, str, Value]]:
    """Return the node pattern, name and value of each parameter in a file.

    Raise :class:`.RosArgumentError` with the file, and the line where there is one.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RosArgumentError(f"--params-file {file}: cannot be read: {error}") from error
    root = _compose(text, str(file))
    return [] if root is None else list(_nodes(root, (), str(file)))


def read_value(text: str, where: str) -> Value:
    """Return the value of a parameter in YAML; ``where`` names it in an error."""
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
    """Return whether a value has the tag ``!!str``, and not only looks like text to YAML."""
    return (node.ctag.handle, node.ctag.suffix) == ("!!", "str")


def _integer(text: str) -> int | float | str:
    """Return what strtoll reads with base 0: octal after a zero; beyond 64 bits it is a float."""
    digits = text.lstrip("+-")
    octal = len(digits) > 1 and digits[0] == "0" and digits[1] not in "xX"
    try:
        number = int(digits, 8 if octal else 0)
    except ValueError:  # 08
        return float(text)
    number = -number if text.startswith("-") else number
    return number if -(2**63) <= number < 2**63 else float(text)
