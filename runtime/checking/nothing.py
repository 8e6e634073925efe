"""The rules for None: what is used where it is None, or before it is known that it is not."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from types import NoneType

from .expression_types import Piece, is_message
from .subject import Finding

__all__ = ["of_none", "of_none_inside"]


def of_none(piece: Piece, node: ast.BoolOp) -> Iterator[Finding]:
    """Find attributes of what is None there, as in `x is None and x.y`, or is tested only later."""
    met = isinstance(node.op, ast.And)
    none: dict[str, str] = {}
    for place, value in enumerate(node.values):
        unknown = none.keys() - {ast.unparse(each) for each in _looked_at_again(value)}
        for name, at in _used(value):
            if name in unknown:
                text = f"{name} is None here; was {none[name]} meant?"
                yield piece.finding(at, "error", text)
        tested = _tested(piece, value)
        if tested is None:
            continue
        name, is_none, other = tested
        if is_none is met:
            none[name] = other
        else:
            used = {each: at for part in node.values[:place] for each, at in _used(part)}
            before = {
                ast.unparse(e) for part in node.values[:place] for e in _looked_at_again(part)
            }
            if name in used and name not in before:
                text = f"{name} is used here before it is tested: put the test first"
                yield piece.finding(used[name], "warning", text)


def of_none_inside(piece: Piece, node: ast.If) -> Iterator[Finding]:
    """Find attributes of what an `if` has just found to be None."""
    tested = _tested(piece, node.test)
    if tested is None:
        return
    name, is_none, other = tested
    body = node.body if is_none else node.orelse
    again = {ast.unparse(e) for part in body for e in _looked_at_again(part)}
    if name in again | {ast.unparse(e) for part in body for e in _given(part)}:
        return
    if not name.isidentifier() and not _is_sensor(piece, name):
        return  # what the code calls may change it
    for part in body:
        for used, at in _used(part):
            if used == name:
                text = f"{name} is None here; was {other} meant?"
                yield piece.finding(at, "error", text)
                return


def _tested(piece: Piece, value: ast.expr) -> tuple[str, bool, str] | None:
    """Return what a test is about, if it is True for None alone or for others, and the opposite."""
    match value:
        case ast.Compare(left, [ast.Is()], [ast.Constant(None)]) if not _has_call(left):
            return ast.unparse(left), True, "'is not None'"
        case ast.Compare(left, [ast.IsNot()], [ast.Constant(None)]) if not _has_call(left):
            return ast.unparse(left), False, "'is None'"
        case ast.UnaryOp(ast.Not(), left) if _is_message_or_none(piece, left):
            return ast.unparse(left), True, f"{ast.unparse(left)!r}"
        case ast.Attribute() | ast.Name() if _is_message_or_none(piece, value):
            return ast.unparse(value), False, f"'not {ast.unparse(value)}'"
    return None


def _is_message_or_none(piece: Piece, node: ast.expr) -> bool:
    """Return whether only None is false of what an expression may be."""
    options = piece.types.of(node)
    messages = [each for each in options if each is not NoneType]
    plain = all(
        is_message(e) and not hasattr(e, "__bool__") and not hasattr(e, "__len__") for e in messages
    )
    return NoneType in options and bool(messages) and plain and not _has_call(node)


def _is_sensor(piece: Piece, name: str) -> bool:
    machine, _, sensor = name.partition(".")
    return machine == piece.code.machine and sensor.partition(".")[0] in piece.table.sensors


def _used(part: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Find what has its attributes read in some code, and where."""
    for each in ast.walk(part):
        if isinstance(each, ast.Attribute):
            yield ast.unparse(each.value), each


def _looked_at_again(value: ast.AST) -> Iterator[ast.expr]:
    """Find what is compared or gets another value inside, as in `x is None or (x and x.y)`."""
    for each in ast.walk(value):
        match each:
            case ast.Compare(left, _, _):
                yield left
            case ast.BoolOp(_, values):
                yield from values
            case ast.IfExp(test, _, _) | ast.If(test) | ast.While(test):
                yield test
            case ast.UnaryOp(ast.Not(), operand):
                yield operand
            case ast.NamedExpr(target, _):
                yield target


def _given(part: ast.AST) -> Iterator[ast.expr]:
    """Find what gets another value."""
    for each in ast.walk(part):
        if isinstance(each, ast.Name | ast.Attribute) and isinstance(each.ctx, ast.Store):
            yield each


def _has_call(node: ast.expr) -> bool:
    return any(isinstance(each, ast.Call) for each in ast.walk(node))
