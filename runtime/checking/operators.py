"""The rules for operators: what is compared, reckoned with or taken apart to no purpose."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator, Sequence
from enum import Enum, EnumMeta
from itertools import pairwise, product
from types import MethodType, NoneType
from typing import Any, get_args, get_origin

import msgspec

from llfsm.whiteboard import Message

from .expression_types import PLAIN, Options, Piece, fields_of, is_message, named
from .subject import Finding
from .uses import nodes_of

__all__ = ["of_comparison", "of_division", "of_items", "of_operator"]


def of_comparison(piece: Piece, node: ast.Compare) -> Iterator[Finding]:
    """Find values that are compared for equality though their types are never equal."""
    for op, (left, right) in zip(node.ops, pairwise([node.left, *node.comparators]), strict=True):
        if not isinstance(op, ast.Eq | ast.NotEq):
            continue
        one, other = piece.types.of(left), piece.types.of(right)
        kinds = {*map(_kind, one)}, {*map(_kind, other)}
        if one and other and kinds[0].isdisjoint(kinds[1]) and None not in kinds[0] | kinds[1]:
            always = isinstance(op, ast.NotEq)
            near = _member(one, right) or _member(other, left)
            text = f"{named(one)} never equals {named(other)}, so this is always {always}{near}"
            yield piece.finding(node, "warning", text)


def _kind(option: Any) -> Any:
    """Return what types have in common of which values may be equal; None if that is unknown."""
    if option in (bool, int, float):
        return "number"
    if option in (str, bytes):
        return option
    if is_message(option):
        return "message" if option.__eq__ is msgspec.Struct.__eq__ else None
    if isinstance(option, type) and issubclass(option, Enum):
        mixed = issubclass(option, int | float | str | bytes) or option.__eq__ is not Enum.__eq__
        return None if mixed else option
    return None


def _member(options: Options, value: ast.expr) -> str:
    """Return which member of an enum was meant by its value, if one was."""
    for option in options:
        if isinstance(value, ast.Constant) and isinstance(option, EnumMeta):
            members: list[Enum] = list(option)
            for member in members:
                if member.value == value.value:
                    return f"; did you mean {option.__name__}.{member.name}?"
    return ""


def of_operator(piece: Piece, node: ast.BinOp | ast.Compare) -> Iterator[Finding]:
    """Find messages that are ordered or reckoned with."""
    if isinstance(node, ast.BinOp):
        operands, special = [node.left, node.right], _ARITHMETIC
    elif any(isinstance(each, _ORDERS) for each in node.ops):
        operands, special = [node.left, *node.comparators], _ORDERING
    else:
        return
    types = [[e for e in piece.types.of(each) if e is not NoneType] for each in operands]
    for found in types:
        wrong = found and all(map(is_message, found))
        others = {each for other in types if other is not found for each in other}
        if wrong and others and others <= PLAIN and not _defines(found, special):
            fields = list(dict.fromkeys(name for each in found for name in fields_of(each)))
            text = f"{named(tuple(found))} is not a number; its fields are: {', '.join(fields)}"
            yield piece.finding(node, "error", text)
            return
    for (left, right), op in zip(pairwise(types), _operators(node), strict=True):
        kinds = [{get_origin(each) or each for each in one} for one in (left, right)]
        if not (kinds[0] and kinds[1]) or isinstance(op, ast.Is | ast.IsNot | ast.In | ast.NotIn):
            continue
        if MethodType in kinds[0] | kinds[1]:
            method = operands[0] if MethodType in kinds[0] else operands[-1]
            text = f"{ast.unparse(method)} is a method: call it, as {ast.unparse(method)}()"
            yield piece.finding(node, "error", text)
        elif not any(_go_together(op, one, other) for one, other in product(*kinds)):
            text = f"{named(tuple(left))} and {named(tuple(right))} do not go together here"
            yield piece.finding(node, "error", text)


def _operators(node: ast.BinOp | ast.Compare) -> Sequence[ast.operator | ast.cmpop]:
    return [node.op] if isinstance(node, ast.BinOp) else node.ops


def _go_together(op: ast.operator | ast.cmpop, one: Any, other: Any) -> bool:
    """Return whether an operator takes values of two built-in types; True where that is unknown."""
    if isinstance(op, ast.Eq | ast.NotEq) or not {one, other} <= _BUILT_IN:
        return True
    numbers = [each in _NUMBERS for each in (one, other)]
    if all(numbers):
        return True
    if isinstance(op, ast.Mod):
        return one in (str, bytes)  # which it fills in
    if isinstance(op, ast.Mult):
        return any(numbers) and {one, other}.isdisjoint({float, dict, set, frozenset})
    if any(numbers):
        return False
    sets = {one, other} <= {set, frozenset}
    if isinstance(op, ast.Add):
        return one is other and one in _SEQUENCES
    if isinstance(op, _ORDERS):
        return sets or (one is other and one in _SEQUENCES)
    return sets or (one is other is dict and isinstance(op, ast.BitOr))


_NUMBERS = {bool, int, float}
_SEQUENCES = {bytes, list, str, tuple}
_BUILT_IN = _NUMBERS | _SEQUENCES | {dict, frozenset, set}
_ORDERS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
_ORDERING = ["__lt__", "__le__", "__gt__", "__ge__"]
_ARITHMETIC = ["__add__", "__radd__", "__sub__", "__rsub__", "__mul__", "__rmul__", "__mod__",
               "__truediv__", "__rtruediv__", "__pow__", "__matmul__", "__or__"]  # fmt: skip


def _defines(messages: Sequence[Any], special: Sequence[str]) -> bool:
    """Return whether a class, or a parent of its own, defines one of these methods."""
    bases = {base for each in messages for base in each.__mro__} - {*Message.__mro__}
    return any(name in vars(base) for base in bases for name in special)


def of_division(piece: Piece, node: ast.BinOp | ast.AugAssign | ast.Call) -> Iterator[Finding]:
    """Find divisions by a zero that is written there."""
    match node:
        case ast.BinOp(left, op, right) | ast.AugAssign(left, op, right):
            divides = isinstance(op, ast.Div | ast.FloorDiv) or (
                isinstance(op, ast.Mod) and {*piece.types.of(left)} & {int, float}  # else a text
            )
        case ast.Call(ast.Name("divmod"), [_, right]):
            divides = True
        case _:
            return
    match right:
        case ast.UnaryOp(ast.USub() | ast.UAdd(), operand):
            right = operand
    zero = isinstance(right, ast.Constant) and type(right.value) in (int, float) and not right.value
    if divides and zero and not any(isinstance(each, ast.Try) for each in nodes_of(piece.code)):
        yield piece.finding(node, "error", "this divides by 0")


def of_items(piece: Piece, node: ast.AST) -> Iterator[Finding]:
    """Find items, lengths and loops of what has none, and those that a tuple does not have."""
    match node:
        case ast.Subscript(value, index, ctx):
            yield from _without(piece, value, _ITEMS[type(ctx)])
            number = _length(piece, value)
            match index:
                case ast.Constant(int(place)) if number is not None and place >= number:
                    text = f"{ast.unparse(value)} has {number} items, the last is [{number - 1}]"
                    yield piece.finding(value, "error", text)
        case ast.Call(called, [value], []) if not isinstance(value, ast.Starred):
            function = piece.types.value_of(called)
            if function is len:
                yield from _without(piece, value, ("length", "__len__"))
            elif isinstance(function, type | type(len)) and function in _OF_ITEMS:
                yield from _without(piece, value, _EACH)
            elif function in _OF_NUMBERS and {*piece.types.of(value)} & {str, list, tuple}:
                text = f"{ast.unparse(called)} needs a number, not {named(piece.types.of(value))}"
                yield piece.finding(node, "error", text)
        case ast.For(_, value) | ast.comprehension(_, value):
            yield from _without(piece, value, _EACH)
        case ast.Assign([ast.Tuple(names)], value) if not isinstance(value, ast.Tuple):
            yield from _without(piece, value, _EACH)
            number, starred = _length(piece, value), any(isinstance(n, ast.Starred) for n in names)
            if number is not None and number != len(names) and not starred:
                text = f"{ast.unparse(value)} has {number} items, not {len(names)}"
                yield piece.finding(node, "error", text)
        case ast.Compare(_, ops, values):
            for op, value in zip(ops, values, strict=True):
                if isinstance(op, ast.In | ast.NotIn):
                    yield from _without(piece, value, (*_EACH, "__contains__"))


def _length(piece: Piece, value: ast.expr) -> int | None:
    """Return how many items a tuple has, if its type says so."""
    options = [each for each in piece.types.of(value) if each is not NoneType]
    items = get_args(options[0]) if len(options) == 1 and get_origin(options[0]) is tuple else ()
    return len(items) if items and ... not in items else None


_OF_ITEMS = {all, any, dict, enumerate, frozenset, list, max, min, set, sorted, sum, tuple}
_OF_NUMBERS = [
    *(abs, round, math.acos, math.asin, math.atan, math.ceil, math.cos, math.degrees, math.exp),
    *(math.fabs, math.floor, math.isfinite, math.isnan, math.log, math.radians, math.sin),
    *(math.sqrt, math.tan),
]
_EACH = ("items", "__iter__", "__getitem__")
_ITEMS = {
    ast.Load: ("items", "__getitem__"),
    ast.Store: ("items that can be changed", "__setitem__"),
    ast.Del: ("items that can be deleted", "__delitem__"),
}


def _without(piece: Piece, value: ast.expr, wanted: Sequence[str]) -> Iterator[Finding]:
    options = tuple(each for each in piece.types.of(value) if each is not NoneType)
    what, *methods = wanted
    kinds = [get_origin(each) or each for each in options]
    if kinds and not any(hasattr(each, name) for each in kinds for name in methods):
        messages = [each for each in kinds if is_message(each)]
        fields = dict.fromkeys(name for each in messages for name in fields_of(each))
        more = f"; its fields are: {', '.join(fields)}" if fields else ""
        text = f"{ast.unparse(value)} is {named(options)}, which has no {what}{more}"
        yield piece.finding(value, "error", text)
