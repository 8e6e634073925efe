"""Translate C++ expressions to Python where both certainly mean the same, and refuse the others.

Refused is what differs or cannot be decided from the bundle alone: integer division, unsigned
arithmetic, pointers, macros, and all calls but those of clfsm's own predicates.
"""

from __future__ import annotations

import ast
import math
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from .code import too_deep
from .cpp import without_comments

__all__ = ["KINDS", "CppVariable", "translate_condition", "translate_value"]

KINDS = {
    "bool": ("bool", "False"),
    "int": ("int", "0"),
    "long": ("int", "0"),  # may be too long for a double to hold exactly
    "unsigned": ("int", "0"),
    "float": ("float", "0.0"),
    "single": ("float", "0.0"),  # rounded more coarsely in C++
    "string": ("str", '""'),
}
"""The kinds of values that are distinguished, with their Python types and zero values."""

_TOKEN = re.compile(
    r"""\s*(?:
    (?P<float>(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)(?P<single>[fF]?)(?![\w.])
    |(?P<int>0[xX][0-9a-fA-F]+|[1-9]\d*|0)(?P<suffix>[uUlL]*)(?![\w.'])
    |(?P<name>[A-Za-z_]\w*)
    |"(?P<string>[^"\\\n]*)"
    |(?P<sign>&&|\|\||[=!<>]=|--|[<>!+*/()-])
    )""",
    re.VERBOSE,
)
_TIMES = ("after", "after_ms", "timeout")
_QUESTIONS = ("is_suspended", "is_running")
_COMPARISONS: Sequence[Mapping[str, type[ast.cmpop]]] = (
    {"==": ast.Eq, "!=": ast.NotEq},
    {"<": ast.Lt, ">": ast.Gt, "<=": ast.LtE, ">=": ast.GtE},
)
_LARGEST_INT = 2**31 - 1
_DEEPEST = 25


class CppVariable(NamedTuple):
    """What a C++ variable is in Python: its name there, and one of `KINDS`."""

    name: str
    kind: str


def translate_condition(text: str, variables: Mapping[str, CppVariable]) -> str | None:
    """Return Python that has the truth value of `text`, or None if that is not certain.

    A C++ ``float`` becomes Python's, which is a ``double``: variables of that type are only
    compared, and only with what is exact in both.
    """
    try:
        condition = _Parser(text, variables).condition()
        return None if too_deep(condition) else ast.unparse(condition)
    except _RefusedError:
        return None


def translate_value(text: str, kind: str) -> str | None:
    """Return Python for a constant that a variable of `kind` begins with, or None."""
    try:
        value = _Parser(text, {}).whole()
    except _RefusedError:
        return None
    literal = value.node.operand if isinstance(value.node, ast.UnaryOp) else value.node
    if not isinstance(literal, ast.Constant):
        return None
    if value.kind == kind or (value.kind, kind) == ("int", "long"):
        return ast.unparse(value.node)
    if kind == "unsigned" and value.kind == "int" and literal is value.node:
        return ast.unparse(value.node)
    if kind == "float" or (kind == "single" and _exact(value)):
        if value.kind == "int":
            return f"{ast.unparse(value.node)}.0"
        return ast.unparse(value.node) if value.kind == "float" else None
    return None


class _RefusedError(Exception):
    """The text is not translated."""


class _Value(NamedTuple):
    node: ast.expr
    kind: str


class _Parser:
    """A parser by recursive descent; each method is a level of C++'s precedence."""

    def __init__(self, text: str, variables: Mapping[str, CppVariable]):
        self.tokens = _tokens(without_comments(text))
        self.variables = variables
        self.at = 0
        self.depth = 0

    def condition(self) -> ast.expr:
        return _truth(self.whole())

    def whole(self) -> _Value:
        value = self.either()
        if self.at < len(self.tokens):
            raise _RefusedError
        return value

    def either(self) -> _Value:
        return self.joined("||", ast.Or(), self.both)

    def both(self) -> _Value:
        return self.joined("&&", ast.And(), lambda: self.compared(0))

    def joined(self, sign: str, operator: ast.boolop, operand: Callable[[], _Value]) -> _Value:
        value = operand()
        if self.peek() != sign:
            return value
        values = [_truth(value)]
        while self.take(sign):
            values.append(_truth(operand()))
        return _Value(ast.BoolOp(operator, values), "bool")

    def compared(self, level: int) -> _Value:
        if level == len(_COMPARISONS):
            return self.sum()
        value = self.compared(level + 1)
        while sign := self.take(*_COMPARISONS[level]):
            other = self.compared(level + 1)
            _check_comparable(value, other)
            operator = _COMPARISONS[level][sign]()
            value = _Value(ast.Compare(value.node, [operator], [other.node]), "bool")
        return value

    def sum(self) -> _Value:
        value = self.product()
        while sign := self.take("+", "-"):
            operator = ast.Add() if sign == "+" else ast.Sub()
            value = _arithmetic(value, operator, self.product())
        return value

    def product(self) -> _Value:
        value = self.unary()
        while sign := self.take("*", "/"):
            other = self.unary()
            if sign == "*":
                value = _arithmetic(value, ast.Mult(), other)
                continue
            divisor = other.node.value if isinstance(other.node, ast.Constant) else 0
            if "float" not in (value.kind, other.kind) or not divisor:
                raise _RefusedError  # C++ cuts whole quotients, and divides by zero
            value = _arithmetic(value, ast.Div(), other)
        return value

    def unary(self) -> _Value:
        self.depth += 1
        if self.depth > _DEEPEST:
            raise _RefusedError
        if self.take("!"):
            value = _Value(ast.UnaryOp(ast.Not(), _truth(self.unary())), "bool")
        elif self.take("-"):
            value = self.unary()
            if value.kind in ("unsigned", "string"):
                raise _RefusedError
            kind = "int" if value.kind == "bool" else value.kind
            value = _Value(ast.UnaryOp(ast.USub(), value.node), kind)
        else:
            value = self.primary()
        self.depth -= 1
        return value

    def primary(self) -> _Value:
        if self.take("("):
            value = self.either()
            self.expect(")")
            return value
        if self.at == len(self.tokens):
            raise _RefusedError
        token = self.tokens[self.at]
        self.at += 1
        if isinstance(token, _Value):
            return token
        if token in ("true", "false"):
            return _Value(ast.Constant(token == "true"), "bool")
        if self.peek() == "(":
            return self.call(token)
        if token not in self.variables:
            raise _RefusedError
        name, kind = self.variables[token]
        return _Value(ast.Name(name), kind)

    def call(self, name: str) -> _Value:
        self.expect("(")
        argument = self.either()
        self.expect(")")
        known = _QUESTIONS if argument.kind == "string" else _TIMES
        if name not in known or name in self.variables:
            raise _RefusedError
        return _Value(ast.Call(ast.Name(name), [argument.node], []), "bool")

    def peek(self) -> str | None:
        token = self.tokens[self.at] if self.at < len(self.tokens) else None
        return token if isinstance(token, str) else None

    def take(self, *signs: str) -> str | None:
        token = self.peek()
        if token not in signs:
            return None
        self.at += 1
        return token

    def expect(self, sign: str) -> None:
        if not self.take(sign):
            raise _RefusedError


def _tokens(text: str) -> list[_Value | str]:
    """Return literals as values, names and signs as texts."""
    tokens: list[_Value | str] = []
    text = text.rstrip()
    at = 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise _RefusedError
        at = match.end()
        if match["float"]:
            value = _Value(ast.Constant(float(match["float"])), "float")
            if float(match["float"]) == math.inf or (match["single"] and not _exact(value)):
                raise _RefusedError
            tokens.append(value)
        elif match["int"]:
            tokens.append(_whole_number(int(match["int"], 0), match["suffix"].lower()))
        elif match["string"] is not None:
            tokens.append(_Value(ast.Constant(match["string"]), "string"))
        else:
            tokens.append(match["name"] or match["sign"])
    return tokens


def _whole_number(number: int, suffix: str) -> _Value:
    kinds = {"": "int", "u": "unsigned", "l": "long", "ll": "long"}
    if number > _LARGEST_INT or suffix not in kinds:
        raise _RefusedError
    return _Value(ast.Constant(number), kinds[suffix])


def _truth(value: _Value) -> ast.expr:
    """Return the node that is True or False as C++ takes `value`."""
    if value.kind == "bool":
        return value.node
    if value.kind == "string":
        raise _RefusedError
    if isinstance(value.node, ast.Constant):
        return ast.Constant(bool(value.node.value))
    return ast.Compare(value.node, [ast.NotEq()], [ast.Constant(0)])


def _check_comparable(one: _Value, other: _Value) -> None:
    kinds = {one.kind, other.kind}
    for value, beside in ((one, other), (other, one)):
        if (
            value.kind == "string"
            or (value.kind == "unsigned" and not (_never_negative(beside) or "float" in kinds))
            or (value.kind == "long" and kinds & {"float", "single"})
            or (value.kind == "single" and beside.kind != "single" and not _exact(beside))
        ):
            raise _RefusedError


def _never_negative(value: _Value) -> bool:
    is_literal = value.kind == "int" and isinstance(value.node, ast.Constant)
    return is_literal or value.kind in ("bool", "unsigned")


def _exact(value: _Value) -> bool:
    """Return whether `value` is a constant, or a bool, that a C++ ``float`` holds exactly."""
    node = value.node.operand if isinstance(value.node, ast.UnaryOp) else value.node
    if not isinstance(node, ast.Constant) or not isinstance(node.value, int | float):
        return value.kind == "bool"
    try:
        rounded: float = struct.unpack("f", struct.pack("f", node.value))[0]
    except OverflowError:
        return False
    return rounded == node.value


def _arithmetic(one: _Value, operator: ast.operator, other: _Value) -> _Value:
    kinds = {one.kind, other.kind}
    if kinds & {"unsigned", "single", "string"} or kinds == {"long", "float"}:
        raise _RefusedError
    kind = next((kind for kind in ("float", "long") if kind in kinds), "int")
    return _Value(ast.BinOp(one.node, operator, other.node), kind)
