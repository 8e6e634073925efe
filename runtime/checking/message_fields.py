"""The fields of the messages that a bundle's code reads, for completion; nothing of it is run.

Types are found in what the bundle includes: classes in it, those of modules in its include folders,
of which the text is read, those of this product, which are imported, and those of ROS.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any, TypeAlias, get_type_hints

from llfsm.runtime.bundles import PYTHON, Bundle, Fragment
from llfsm.whiteboard import Message, Slot

MessageFields: TypeAlias = dict[str, "MessageFields"]
"""Names of fields, each with the fields of its own value; none if that is no message."""

RosClass: TypeAlias = Callable[[str], "type[Message] | None"]
_OURS = ("llfsm.whiteboard.", "llfsm.machines.")
_DEEPEST = 8  # a class may have fields of its own type
_MOST = 5000  # fields of all names, beyond which there are no more
_LONGEST = 1 << 20  # bytes of a module


def message_fields(bundle: Bundle, ros_class: RosClass = lambda _: None) -> MessageFields:
    """Return the fields of what each name holds that the code can use; those without are left out.

    A state's variables hide the machine's of the same name, also in other states. `ros_class` finds
    the class of a type's ROS name.
    """
    if bundle.language != PYTHON:
        return {}
    included = _included(bundle, ros_class)
    declared = [bundle.variables, *(state.variables for state in bundle.states)]
    found = {}
    for statement in (each for text in declared for each in _statements(text)):
        name, kind = _declared(statement)
        if name and kind is not None:
            found[name] = included.fields(kind)
    return {name: fields for name, fields in found.items() if fields}


def class_fields(bundle: Bundle, ros_class: RosClass = lambda _: None) -> dict[str, list[str]]:
    """Return the names of the fields of each message class that the bundle includes."""
    if bundle.language != PYTHON:
        return {}
    included = _included(bundle, ros_class)
    found = {name: [*included.fields(ast.Name(name))] for name in included.names}
    return {name: fields for name, fields in found.items() if fields}


def _included(bundle: Bundle, ros_class: RosClass) -> _Module:
    return _Module(_statements(bundle.includes), _folders(bundle), ros_class)


def _folders(bundle: Bundle) -> tuple[Path, ...]:
    if bundle.folder is None:
        return ()
    return tuple(bundle.folder / os.path.expandvars(each) for each in bundle.include_paths)


def _statements(text: Fragment | str | None) -> list[ast.stmt]:
    """Return the statements of a text; none of one that cannot be parsed, as check says."""
    try:
        return [] if text is None else ast.parse(text if isinstance(text, str) else text.text).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []


def _declared(statement: ast.stmt) -> tuple[str, ast.expr | None]:
    """Return the name that a variable's declaration gives, and what has the fields of its value."""
    match statement:
        case ast.AnnAssign(ast.Name(name), annotation):
            return name, annotation
        case ast.Assign([ast.Name(name)], ast.Call(ast.Name("Sensor"), [slot, *_])):
            return name, slot
        case ast.Assign([ast.Name(name)], ast.Call(ast.Name() as kind)):
            return name, kind
    return "", None


class _Module:
    """The names of a module by its text, with what it imports."""

    def __init__(
        self,
        statements: list[ast.stmt],
        folders: tuple[Path, ...],
        ros_class: RosClass,
        numbers: Iterator[int] | None = None,
    ):
        self._folders = folders
        self._ros_class = ros_class
        self._numbers = count() if numbers is None else numbers  # of the fields, in all modules
        self._known: dict[str, Any] = {}
        for statement in statements:
            match statement:
                case ast.ClassDef(name):
                    self._known[name] = statement
                case ast.Assign([ast.Name(name)], value):
                    self._known[name] = value
                case ast.ImportFrom(str(module), names, 0):
                    for each in names:
                        self._known[each.asname or each.name] = (module, each.name)

    @property
    def names(self) -> list[str]:
        """The names that the module defines or imports."""
        return list(self._known)

    def fields(self, kind: ast.expr | Any, depth: int = 0) -> MessageFields:
        """Return the fields of a message's class, or of a slot's messages."""
        if depth > _DEEPEST:
            return {}
        match kind:
            case ast.Call(ast.Name("Slot"), [_, message, *_]):
                return self.fields(message, depth)
            case ast.Attribute(
                ast.Call(ast.Attribute(ast.Call(), "message"), [ast.Constant(str(name))]), "message"
            ):  # TypeLibrary().message("std_msgs/msg/String").message
                return _fields_of(self._ros_class(name))
            case ast.BinOp(left, ast.BitOr(), ast.Constant(None)):
                return self.fields(left, depth)
            case ast.Constant(str(name)) | ast.Name(name) if name in self._known:
                return self.fields(self._known[name], depth + 1)
            case ast.ClassDef(bases=bases, body=body):
                found: MessageFields = {}
                for base in bases:
                    found |= self.fields(base, depth + 1)
                for name, annotation in _annotated(body):
                    if next(self._numbers) > _MOST:
                        break
                    found[name] = self.fields(annotation, depth + 1)
                return found
            case (str(module), str(name)):
                return self._imported(module, name, depth + 1)
        return {}

    def _imported(self, module: str, name: str, depth: int) -> MessageFields:
        if f"{module}.".startswith(_OURS):
            try:
                return _fields_of(getattr(import_module(module), name, None))
            except ImportError:
                return {}
        for folder in self._folders:
            path = folder / f"{module.replace('.', '/')}.py"
            try:
                if path.is_file() and path.stat().st_size <= _LONGEST:
                    text = path.read_text("utf-8-sig")
                    there = _Module(
                        _statements(text), self._folders, self._ros_class, self._numbers
                    )
                    return there.fields(ast.Name(name), depth)
            except (OSError, ValueError):
                continue
        return {}


def _annotated(body: list[ast.stmt]) -> Iterator[tuple[str, ast.expr]]:
    for statement in body:
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            yield statement.target.id, statement.annotation


def _fields_of(kind: Any) -> MessageFields:
    if isinstance(kind, Slot):
        kind = kind.type
    if not (isinstance(kind, type) and issubclass(kind, Message)):
        return {}
    hints: Mapping[str, Any] = get_type_hints(kind)
    return {name: _fields_of(hints[name]) for name in kind.__struct_fields__}
