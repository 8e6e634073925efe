"""The rules for operators: what is compared or reckoned with though that makes no sense."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from enum import Enum, EnumMeta
from itertools import pairwise
from types import NoneType
from typing import Any

import msgspec

from llfsm.whiteboard import Message

from .expression_types import PLAIN, Options, Piece, fields_of, is_message, named
from .subject import Finding

__all__ = ["of_comparison", "of_operator"]


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
            text = f"{named(tuple(found))} is no number; its fields are: {', '.join(fields)}"
            yield piece.finding(node, "error", text)


_ORDERS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
_ORDERING = ["__lt__", "__le__", "__gt__", "__ge__"]
_ARITHMETIC = ["__add__", "__radd__", "__sub__", "__rsub__", "__mul__", "__rmul__", "__mod__",
               "__truediv__", "__rtruediv__", "__pow__", "__matmul__", "__or__"]  # fmt: skip


def _defines(messages: Sequence[Any], special: Sequence[str]) -> bool:
    """Return whether a class, or a parent of its own, defines one of these methods."""
    bases = {base for each in messages for base in each.__mro__} - {*Message.__mro__}
    return any(name in vars(base) for base in bases for name in special)
