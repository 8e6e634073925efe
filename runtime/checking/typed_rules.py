"""The rules that need types: each gives what it finds wrong with a machine that has been loaded.

They find what every run of the code would find, and nothing where a type is unknown.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from types import ModuleType, NoneType
from typing import Any, NamedTuple, TypeAlias

import msgspec

from llfsm.errors import did_you_mean

from ..engine.table import REQUIRED, Table
from .expression_types import (
    Types,
    fields_of,
    is_message,
    may_be,
    named,
    options_of,
)  # fmt: skip
from .subject import Code, Finding, Severity, Subject
from .uses import nodes_of, uses_of

__all__ = ["typed_findings"]


class _Piece(NamedTuple):
    """A piece of code with the types of its expressions."""

    code: Code
    types: Types
    table: Table

    def finding(self, node: ast.expr | ast.stmt, severity: Severity, text: str) -> Finding:
        return Finding(self.code.file, node.lineno, severity, text)


_Rule: TypeAlias = Callable[[_Piece, Any], Iterator[Finding]]


def typed_findings(subject: Subject, table: Table) -> list[Finding]:
    """Return what is wrong with the values in the code of a machine, in the order of lines."""
    found = {*_of_defaults(subject, table), *_of_sensors(subject, table)}
    for code in subject.all_code():
        piece = _Piece(code, Types(code, table), table)
        for node in nodes_of(code):
            for kind, rule in _RULES:
                if isinstance(node, kind):
                    found.update(rule(piece, node))
    for guard in subject.guards():
        found.update(_of_guard(_Piece(guard, Types(guard, table), table)))
    return sorted(found)


def _of_attribute(piece: _Piece, node: ast.Attribute) -> Iterator[Finding]:
    """Find fields that a message does not have, and names that a module does not have."""
    module = piece.types.value_of(node.value)
    if isinstance(module, ModuleType) and not hasattr(module, "__path__"):
        if not hasattr(module, node.attr):
            what = f"{module.__name__} has no {node.attr!r}{did_you_mean(node.attr, dir(module))}"
            yield piece.finding(node, "error", what)
        return
    options = [each for each in piece.types.of(node.value) if each is not NoneType]
    if not options or not all(map(is_message, options)):
        return
    if not any(hasattr(each, node.attr) for each in options):
        fields = list(dict.fromkeys(name for each in options for name in fields_of(each)))
        text = (
            f"{named(tuple(options))} has no field {node.attr!r}; it has: "
            f"{', '.join(fields) or 'none'}{did_you_mean(node.attr, fields)}"
        )
        yield piece.finding(node, "error", text)
    elif isinstance(node.ctx, ast.Store) and all(each.__struct_config__.frozen for each in options):
        text = f"a message cannot be changed: post a new {named(tuple(options))}"
        yield piece.finding(node, "error", text)


def _of_call(piece: _Piece, node: ast.Call) -> Iterator[Finding]:
    """Find messages that cannot be made, and calls of ports that fail."""
    match node.func:
        case ast.Attribute(ast.Name(name), port) if name == piece.code.machine:
            if port in piece.table.actuators:
                yield from _of_post(piece, node, port)
            elif port in piece.table.sensors:
                yield piece.finding(node, "error", f"sensor {port!r} is a value, not a function")
            return
    message = piece.types.value_of(node.func)
    if is_message(message):
        yield from _of_message(piece, node, message)


def _of_post(piece: _Piece, node: ast.Call, port: str) -> Iterator[Finding]:
    slot = piece.table.actuators[port].slot
    match node.args, node.keywords:
        case ([ast.Starred()], _) | (_, [ast.keyword(arg=None), *_]):
            return
        case [posted], []:
            given = piece.types.of(posted)
            if piece.types.value_of(posted) is slot.type:
                text = f"actuator {port!r} posts a message, not its class: {slot.type.__name__}()"
            elif given and not any(_is_kind_of(each, slot.type) for each in given):
                text = f"actuator {port!r} posts {slot.type.__name__}, not {named(given)}"
            else:
                return
        case _:
            text = f"actuator {port!r} takes one message: {slot.type.__name__}(...)"
    yield piece.finding(node, "error", text)


def _of_message(piece: _Piece, node: ast.Call, message: type[msgspec.Struct]) -> Iterator[Finding]:
    fields = fields_of(message)
    if not fields and message.__struct_fields__:
        return  # its annotations do not resolve yet
    name = message.__name__
    names = [each.name for each in fields.values()]
    starred = any(isinstance(each, ast.Starred) for each in node.args)
    more = starred or any(each.arg is None for each in node.keywords)
    if not starred and len(node.args) > len(names):
        yield piece.finding(node, "error", f"{name} has {len(names)} fields, not {len(node.args)}")
        return
    given = {} if starred else dict(zip(names, node.args, strict=False))
    for keyword in node.keywords:
        if keyword.arg is not None and keyword.arg not in fields:
            near = did_you_mean(keyword.arg, names)
            text = (
                f"{name} has no field {keyword.arg!r}; it has: {', '.join(names) or 'none'}{near}"
            )
            yield piece.finding(keyword.value, "error", text)
        elif keyword.arg is not None:
            given[keyword.arg] = keyword.value
    missing = [each for each in names if fields[each].required and each not in given]
    if missing and not more:
        yield piece.finding(node, "error", f"{name} needs a value for {', '.join(missing)}")
    for field, value in given.items():
        if not may_be(value, piece.types.of(value), fields[field].type):
            wanted, found = options_of(fields[field].type), piece.types.of(value)
            text = f"{name}: field {field!r} is {named(wanted)}, not {named(found)}"
            yield piece.finding(value, "error", text)


def _of_assignment(piece: _Piece, node: ast.Assign | ast.AnnAssign) -> Iterator[Finding]:
    """Find values of another type than the variable's."""
    if node.value is None:
        return
    for target in node.targets if isinstance(node, ast.Assign) else (node.target,):
        match target:
            case ast.Attribute(ast.Name(machine), name) if machine == piece.code.machine:
                variable = piece.table.variables.get(name)
                given = piece.types.of(node.value)
                if variable is not None and not may_be(node.value, given, variable.type):
                    text = _wrong_variable(name, variable.type, named(given))
                    yield piece.finding(node, "warning", text)


def _of_state_name(piece: _Piece, node: ast.Compare) -> Iterator[Finding]:
    """Find names that none of the machine's states has."""
    match node:
        case ast.Compare(
            ast.Attribute(ast.Name(machine), "state_name"),
            [ast.Eq() | ast.NotEq()],
            [ast.Constant(str(name))],
        ) if machine == piece.code.machine:
            states = [each.name for each in piece.table.states]
            if name not in states:
                text = f"no state {name!r}; the states are: {', '.join(states)}"
                yield piece.finding(node, "error", text + did_you_mean(name, states))


_RULES: list[tuple[type | tuple[type, ...], _Rule]] = [
    (ast.Attribute, _of_attribute),
    (ast.Call, _of_call),
    ((ast.Assign, ast.AnnAssign), _of_assignment),
    (ast.Compare, _of_state_name),
]


def _of_guard(piece: _Piece) -> Iterator[Finding]:
    """Find guards that return something other than True or False, for certain or at times."""
    if not uses_of(piece.code).returns:
        return  # another rule finds that
    for node in _returns(piece.code):
        given = piece.types.of(node.value) if node.value is not None else (NoneType,)
        others = tuple(each for each in given if each is not bool)
        if others:
            always = len(others) == len(given)
            what = "returns" if always else "can return"
            text = f"this guard {what} {named(others)}: return True or False"
            yield piece.finding(node, "error" if always else "warning", text)


def _returns(code: Code) -> Iterator[ast.Return]:
    todo: list[ast.AST] = [*code.body]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Return):
            yield node
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            todo += ast.iter_child_nodes(node)


def _of_defaults(subject: Subject, table: Table) -> Iterator[Finding]:
    """Find defaults of variables that are of another type than the variable."""
    for name, declared in subject.declared.items():
        if declared.kind == "variable" and name in table.variables:
            variable = table.variables[name]
            if variable.default is REQUIRED:
                continue
            given = (type(variable.default),)
            if not may_be(ast.Constant(variable.default), given, variable.type):
                text = _wrong_variable(name.rpartition(".")[2], variable.type, named(given))
                yield Finding(*declared.where, "warning", text)


def _of_sensors(subject: Subject, table: Table) -> Iterator[Finding]:
    """Find sensors whose fields are read though nothing looks whether there is a message yet."""
    if subject.opaque or any(uses_of(code).escapes for code in subject.all_code()):
        return  # code that is not here may look
    read: dict[str, tuple[Code, ast.Attribute]] = {}
    looked_at: set[str] = set()
    for code in subject.all_code():
        of_field = set()
        for node in nodes_of(code):  # an attribute comes before what it is an attribute of
            match node:
                case ast.Attribute(ast.Attribute(ast.Name(code.machine), name) as value):
                    of_field.add(value)
                    read.setdefault(name, (code, node))
                case ast.Attribute(ast.Name(code.machine), name) if node not in of_field:
                    looked_at.add(name)
    for name, (code, node) in read.items():
        if name not in looked_at and name in table.sensors and table.sensors[name].default is None:
            text = (
                f"sensor {name!r} is None before its first message, and no code of the machine "
                f"looks whether it is: test it, or give it a default"
            )
            yield Finding(code.file, node.lineno, "warning", text)


def _is_kind_of(given: Any, wanted: type) -> bool:
    return isinstance(given, type) and issubclass(given, wanted)


def _wrong_variable(name: str, annotation: Any, given: str) -> str:
    return f"variable {name!r} is {named(options_of(annotation))}, not {given}"
