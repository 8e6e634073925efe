"""Finds what may be None and is used as if it never were, while nothing checks for that.

That is the value of a sensor without a default, and a field that may be None. One look anywhere in
the machine is enough: in which states it has been looked at is not known here.
"""

from __future__ import annotations

import ast
import builtins
from collections.abc import Iterator
from typing import Final, Literal, NamedTuple, TypeAlias

from ..engine.table import Table
from .expression_types import Types, named
from .subject import Code, Finding, Subject
from .uses import nodes_of, uses_of

__all__ = ["of_optional"]

_Path: TypeAlias = tuple[str, ...]
"""A sensor's name, then those of fields."""
_Use: TypeAlias = Literal["needs a value", "tests", "hands on", "names"]

_ORDERS: Final = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
_NEED_A_VALUE: Final = {
    getattr(builtins, name)
    for name in ("abs", "enumerate", "float", "int", "len", "list", "max", "min", "round",
                 "sorted", "sum", "tuple")
}  # fmt: skip


class _Seen(NamedTuple):
    code: Code
    node: ast.expr
    types: Types


def of_optional(subject: Subject, table: Table) -> Iterator[Finding]:
    """Find sensors and fields that may be None where a value is needed."""
    if subject.opaque or any(uses_of(code).escapes for code in subject.all_code()):
        return  # code that is not here may look
    needed: dict[_Path, _Seen] = {}
    looked_at: set[_Path] = set()
    handed_on: set[_Path] = set()
    for code in subject.all_code():
        paths = _Paths(code, table)
        for node, path, use in paths.uses():
            if use == "needs a value":
                needed.setdefault(path, _Seen(code, node, paths.types))
            elif use != "names":
                looked_at.add(path)
                if use == "hands on":
                    handed_on.add(path)
    for path, seen in needed.items():
        above = {path[:length] for length in range(1, len(path))}
        if path in looked_at or not above.isdisjoint(handed_on):
            continue
        text = _of_sensor(path, table) if len(path) == 1 else _of_field(path, seen, looked_at)
        if text:
            yield Finding(seen.code.file, seen.node.lineno, "warning", text)


def _of_sensor(path: _Path, table: Table) -> str:
    if table.sensors[path[0]].default is not None:
        return ""
    return (
        f"sensor {path[0]!r} is None before its first message, and no code of the machine "
        f"checks for that: test it, or give it a default"
    )


def _of_field(path: _Path, seen: _Seen, looked_at: set[_Path]) -> str:
    *within, field = path
    if any(len(each) == len(path) and [*each[:-1]] == within for each in looked_at):
        return ""  # another field may decide it
    options = seen.types.of(seen.node)
    if type(None) not in options or len(options) == 1:
        return ""
    return (
        f"field {field!r} may be None, as it is {named(options)}, and no code of the machine "
        f"checks for that: test it"
    )


class _Paths:
    """The places where code names a sensor, or a field of its message."""

    def __init__(self, code: Code, table: Table):
        self.types = Types(code, table)
        self._code = code
        self._table = table
        self._parents = {
            child: node for node in nodes_of(code) for child in ast.iter_child_nodes(node)
        }

    def uses(self) -> Iterator[tuple[ast.expr, _Path, _Use]]:
        for node in nodes_of(self._code):
            if isinstance(node, ast.Attribute | ast.Name | ast.NamedExpr) and not isinstance(
                getattr(node, "ctx", None), ast.Store | ast.Del
            ):
                path = self._path(node)
                if path:
                    yield node, path, self._use(node, self._parents.get(node))

    def _path(self, node: ast.expr | None, deep: int = 8) -> _Path:
        match node:
            case ast.Attribute(ast.Name(self._code.machine), name):
                return (name,) if name in self._table.sensors else ()
            case ast.Attribute(value, name):
                within = self._path(value, deep)
                return (*within, name) if within else ()
            case ast.NamedExpr(_, value):
                return self._path(value, deep)
            case ast.Name(name) if deep:
                return self._path(self.types.assigned(name), deep - 1)
        return ()

    def _use(self, node: ast.expr, parent: ast.AST | None) -> _Use:
        match parent:
            case ast.Attribute():
                return "needs a value"
            case ast.Subscript(value) | ast.For(_, value) | ast.comprehension(_, value) if (
                value is node
            ):
                return "needs a value"
            case ast.UnaryOp(op):
                return "tests" if isinstance(op, ast.Not) else "needs a value"
            case ast.BinOp(left, op) if left is node or not isinstance(op, ast.Mod):
                return "needs a value"  # but % may write None into a text
            case ast.AugAssign(_, op, value) if value is node and not isinstance(op, ast.Mod):
                return "needs a value"
            case ast.Compare():
                return self._compared(node, parent)
            case ast.Call(called, [value, *_]) if value is node:
                function = self.types.value_of(called)
                known = isinstance(function, type | type(len)) and function in _NEED_A_VALUE
                return "needs a value" if known else "hands on"
            case ast.If() | ast.While() | ast.IfExp() | ast.BoolOp() | ast.Assert():
                return "tests"
            case ast.NamedExpr() | ast.Expr():
                return "names"
            case ast.Assign([ast.Name(name)]) if self._path(self.types.assigned(name)):
                return "names"
        return "hands on"

    def _compared(self, node: ast.expr, parent: ast.Compare) -> _Use:
        operands = [parent.left, *parent.comparators]
        place = operands.index(node)
        beside = [*parent.ops[max(place - 1, 0) : place + 1]]
        if any(isinstance(op, _ORDERS) for op in beside):
            return "needs a value"
        if place and isinstance(parent.ops[place - 1], ast.In | ast.NotIn):
            return "needs a value"
        others = operands[:place] + operands[place + 1 :]
        none = all(isinstance(each, ast.Constant) and each.value is None for each in others)
        return "tests" if none else "hands on"
