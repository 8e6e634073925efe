"""The rules for code that does nothing, or always the same: something else was meant."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from math import inf, nan
from types import MethodType

from .expression_types import Piece, is_message
from .subject import Finding
from .uses import nodes_of

__all__ = ["of_condition", "of_effectless", "of_hidden", "of_identity", "of_sign", "of_text"]


def of_effectless(piece: Piece, node: ast.Expr) -> Iterator[Finding]:
    """Find statements that only make a value."""
    match node.value:
        case ast.Compare(_, [ast.Eq()], _):
            text = "this compares, and does nothing else: write = to assign"
        case ast.Compare() | ast.BinOp() | ast.UnaryOp() | ast.Name() | ast.JoinedStr():
            text = "this makes a value that nothing uses"
        case ast.Attribute() if piece.types.of(node.value) not in ((), (MethodType,)):
            text = "this makes a value that nothing uses"
        case ast.Call(called) if is_message(piece.types.value_of(called)):
            text = "this makes a message that nothing posts: call an actuator with it"
            yield piece.finding(node, "warning", text)
            return
        case _:
            return
    tries = any(isinstance(each, ast.Try) for each in nodes_of(piece.code))
    if not tries and not any(isinstance(each, ast.Call) for each in ast.walk(node)):
        yield piece.finding(node, "warning", text)


def of_identity(piece: Piece, node: ast.Compare) -> Iterator[Finding]:
    """Find numbers and texts that are compared by `is`."""
    for op, value in zip(node.ops, node.comparators, strict=True):
        plain = isinstance(value, ast.Constant) and isinstance(
            value.value, int | float | str | bytes
        )
        if isinstance(op, ast.Is | ast.IsNot) and plain and not _is_truth(value):
            shown = "==" if isinstance(op, ast.Is) else "!="
            text = f"'is' asks for the same object, not for an equal one: write {shown}"
            yield piece.finding(node, "warning", text)


def _is_truth(value: ast.expr) -> bool:
    return isinstance(value, ast.Constant) and isinstance(value.value, bool)


def of_sign(piece: Piece, node: ast.Assign) -> Iterator[Finding]:
    """Find =+ and =- where += and -= were meant."""
    match node.value:
        case ast.UnaryOp(ast.UAdd() | ast.USub() as sign, ast.Constant() as number):
            if number.col_offset == node.value.col_offset + 2:  # a blank after the sign
                shown = "+" if isinstance(sign, ast.UAdd) else "-"
                text = f"this assigns {shown}{number.value!r}: was {shown}= meant?"
                yield piece.finding(node, "warning", text)


def of_hidden(piece: Piece, node: ast.Assign | ast.AnnAssign) -> Iterator[Finding]:
    """Find values that code keeps for itself, under a variable's name, and never reads."""
    match node:
        case ast.Assign([ast.Name(name)]) | ast.AnnAssign(ast.Name(name)):
            pass
        case _:
            return
    if name in piece.table.variables and not any(
        isinstance(each, ast.Global | ast.Nonlocal)
        or (isinstance(each, ast.Name) and each.id == name and isinstance(each.ctx, ast.Load))
        for each in nodes_of(piece.code)
    ):
        text = f"this does not set the variable: write {piece.code.machine}.{name}"
        yield piece.finding(node, "warning", text)


def of_text(piece: Piece, node: ast.Assign | ast.Call) -> Iterator[Finding]:
    """Find texts that would be filled in if they began with f."""
    values = [node.value] if isinstance(node, ast.Assign) else node.args
    for value in values:
        match value:
            case ast.Constant(str(text)) if f"{{{piece.code.machine}." in text and "}" in text:
                what = 'this text is not filled in: write f before it, as f"..."'
                yield piece.finding(value, "warning", what)


def of_condition(piece: Piece, node: ast.BoolOp | ast.Compare) -> Iterator[Finding]:
    """Find conditions on one value that nothing, or everything, satisfies."""
    if isinstance(node, ast.Compare):
        match node:
            case ast.Compare(one, [first, second], [_, other]):
                kinds, ends = {type(first), type(second)}, (_number(one), _number(other))
                if (kinds <= {ast.Lt, ast.LtE} and ends[0] > ends[1]) or (
                    kinds <= {ast.Gt, ast.GtE} and ends[0] < ends[1]
                ):
                    yield piece.finding(node, "warning", "this is never True: no value is between")
        return
    by_left: dict[str, list[tuple[ast.cmpop, ast.expr]]] = {}
    for value in node.values:
        match value:
            case ast.Compare(left, [op], [right]) if not _calls(value):
                by_left.setdefault(ast.unparse(left), []).append((op, right))
    for name, parts in by_left.items():
        if isinstance(node.op, ast.And):
            low = max((_number(v) for op, v in parts if isinstance(op, _OVER)), default=-inf)
            high = min((_number(v) for op, v in parts if isinstance(op, _UNDER)), default=inf)
            if low > high or len(_constants(parts, ast.Eq)) > 1:
                text = f"this is never True: no {name} satisfies all of it; was 'or' meant?"
                yield piece.finding(node, "warning", text)
        elif len(_constants(parts, ast.NotEq)) > 1:
            text = f"this is always True: {name} always differs from one; was 'and' meant?"
            yield piece.finding(node, "warning", text)


_OVER = (ast.Gt, ast.GtE)
_UNDER = (ast.Lt, ast.LtE)


def _constants(parts: list[tuple[ast.cmpop, ast.expr]], kind: type[ast.cmpop]) -> set[str]:
    return {
        repr(value.value)
        for op, value in parts
        if isinstance(op, kind) and isinstance(value, ast.Constant) and not _is_truth(value)
    }


def _number(node: ast.expr) -> float:
    """Return the number that is written there, or nan, which satisfies no comparison."""
    if _is_truth(node):
        return nan
    match node:
        case ast.UnaryOp(ast.USub(), operand):
            return -_number(operand)
        case ast.Constant(int(value) | float(value)):
            return value
    return nan


def _calls(node: ast.expr) -> bool:
    return any(isinstance(each, ast.Call) for each in ast.walk(node))
