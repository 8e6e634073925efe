"""Read a TOML file into typed structs; errors name the file and the line."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from llfsm.errors import did_you_mean, nearby_file

from ..engine.errors import ConfigurationError

__all__ = ["line_of", "read_text", "read_toml"]

T = TypeVar("T")
Path_ = tuple[str | int, ...]

_WHERE = re.compile(r" - at (?:key in )?`(\$.*)`$")
_STEP = re.compile(r"\[(\d+|\.\.\.)\]|\.?([^.\[\]]+)")


def read_toml(file: Path, kind: type[T], check: Callable[[T], None] = lambda _: None) -> T:
    """Return the content of `file` as a `kind`, a msgspec Struct.

    `check` may raise `ConfigurationError` with a `where` path, as ("machine", 1, "name"), for
    faults that the types cannot express. Raise `ConfigurationError` with file and line for every
    fault.
    """
    text = read_text(file)
    try:
        value = msgspec.convert(tomllib.loads(text), kind)
        check(value)
    except tomllib.TOMLDecodeError as error:
        what, _, place = str(error).partition(" (at ")
        found = re.match(r"line (\d+)", place)
        line = int(found[1]) if found else text.rstrip("\n").count("\n") + 1
        raise ConfigurationError(what, file=file, line=line) from error
    except RecursionError as error:
        raise ConfigurationError("is nested too deeply", file=file) from error
    except msgspec.ValidationError as error:
        found = _WHERE.search(str(error))
        where = _steps(found[1]) if found else ()
        what = _WHERE.sub("", str(error))
        key = _unknown_key(what)
        if key is not None:
            keys = set(_keys(kind))
            near = "; another table has it" if key in keys else did_you_mean(key, keys)
            what = f"there is no key {key!r} here{near}"
        else:
            what += _remedy(what, where, kind)
        raise _located(what, file, text, where, key) from error
    except ConfigurationError as error:
        raise _located(error.what, file, text, error.where) from error
    except ValueError as error:  # a number of thousands of digits
        raise ConfigurationError(str(error), file=file) from error
    return value


def read_text(file: Path) -> str:
    """Return the text of a file; raise `ConfigurationError` if it cannot be read as UTF-8."""
    try:
        return file.read_text(encoding="utf-8")
    except OSError as error:
        why = f"{error.strerror}{nearby_file(file)}"
        raise ConfigurationError(f"cannot be read: {why}", file=file) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"is not UTF-8 text: {error.reason}", file=file) from error


def line_of(text: str, where: Path_) -> int | None:
    """Return the line, from 1, where the value at `where` in a TOML text begins.

    If there is no such value, it is the line of the innermost table or array on the path, or None.
    The parser finds it: the shortest document of leading lines that has the value ends with its
    last line, and the value begins after the longest document without it.
    """
    lines = text.split("\n")

    def document(end: int) -> dict[str, Any] | None:
        try:
            return tomllib.loads("\n".join(lines[:end]))
        except ValueError:  # in the middle of a value
            return None

    for length in range(len(where), 0, -1):
        if not _has(document(len(lines)), where[:length]):
            continue
        without, within = 0, len(lines)  # so many lines lack the value; have it
        while within - without > 1:
            middle = end = (without + within) // 2
            while end < within and (found := document(end)) is None:
                end += 1
            if end == within or _has(found, where[:length]):
                within = middle
            else:
                without = end
        rest = enumerate(lines[without:], without + 1)
        return next(n for n, line in rest if line.strip() and line.strip()[0] != "#")
    return None


def _has(value: Any, where: Path_) -> bool:
    for step in where:
        if isinstance(step, int):
            if not (isinstance(value, list) and step < len(value)):
                return False
        elif not (isinstance(value, dict) and step in value):
            return False
        value = value[step]
    return True


def _located(
    what: str, file: Path, text: str, where: Path_, key: str | None = None
) -> ConfigurationError:
    line = line_of(text, where if key is None else (*where, key))
    place = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in where)
    return ConfigurationError(
        f"{place.lstrip('.')}: {what}" if place else what, where, file=file, line=line
    )


def _remedy(what: str, where: Path_, kind: Any) -> str:
    """Return what to write, in a `kind`, instead of a value that msgspec refuses."""
    if wrong := re.match(r"Invalid enum value (.*)", what):
        known = _choices(kind, where)
        near = did_you_mean(wrong[1].strip("'"), known)
        return f"; not one of {', '.join(map(repr, known))}{near}" if known else ""
    if missing := re.search(r"missing required field `(.*)`", what):
        return f"; add {missing[1]} = ..."
    found = re.match(r"Expected `(.*)`.*, got `(.*)`", what)
    if found is None:
        return ""
    wanted, got = found[1].split(" | "), found[2]
    if "array" in wanted:
        name = where[-1] if where else ""
        return f"; write [[{name}]], not [{name}]" if got == "object" else "; write [...]"
    if "object" in wanted:
        return "; write a table, as {key = value}"
    if "str" in wanted:
        return "; write it in quotes"
    return "; write it without quotes" if got == "str" else ""


def _unknown_key(what: str) -> str | None:
    found = re.search(r"unknown field `(.*)`", what)
    return found[1] if found else None


def _choices(kind: Any, where: Path_) -> list[str]:
    """Return the texts that a value of `kind` can be, wherever its key stands."""
    types = [field.type for field in _fields(kind) if field.encode_name == (where or ("",))[-1]]
    types += [each for found in types for each in getattr(found, "types", ())]
    literals = (each for each in types if isinstance(each, msgspec.inspect.LiteralType))
    return [value for each in literals for value in each.values if isinstance(value, str)]


def _keys(kind: Any) -> set[str]:
    """Return the keys that tables of `kind` can have, on whatever level."""
    return {field.encode_name for field in _fields(kind)}


def _fields(kind: Any) -> list[msgspec.inspect.Field]:
    """Return the fields of all tables in a `kind`, on whatever level."""
    fields: list[msgspec.inspect.Field] = []
    todo, seen = [msgspec.inspect.type_info(kind)], set[int]()
    while todo:
        found: Any = todo.pop()
        if isinstance(found, msgspec.inspect.StructType):
            if id(found.cls) not in seen:
                seen.add(id(found.cls))
                fields += found.fields
                todo += [field.type for field in found.fields]
        else:
            parts = (getattr(found, name, ()) for name in ("types", "item_types"))
            todo += [part for several in parts for part in several]
            for name in ("item_type", "value_type"):
                if hasattr(found, name):
                    todo.append(getattr(found, name))
    return fields


def _steps(path: str) -> Path_:
    """Return the steps of msgspec's path ``$.machine[1].name``; `...` ends them."""
    steps: list[str | int] = []
    for index, name in _STEP.findall(path[1:]):
        if index == "...":
            break
        steps.append(int(index) if index else name)
    return tuple(steps)
