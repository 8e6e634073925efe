"""The text of an expression with values beside its parts, as ``why`` shows it.

``self.scan.nearest < LIMIT`` becomes ``scan.nearest=0.32 < LIMIT=0.5``. Only the text is made here:
the values are those of an `Evaluator`. A part that has none stays as it is written, and so does one
that was not reached, if it cannot be evaluated. What is long or makes a text is replaced by its
value. Numbers have six digits, unless two that are compared would look alike.
"""

from __future__ import annotations

import ast
import enum
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import Any, Final

from llfsm.runtime.expressions.evaluation import UNKNOWN, Evaluator
from llfsm.runtime.expressions.reads import CLOCK, COMPREHENSIONS, inner_names
from llfsm.runtime.value_text import ValueText

_UNITS: Final = {"after_ms": "ms", "after": "s", "timeout": "us"}
_SCOPES: Final = (*COMPREHENSIONS, ast.Lambda)
_SHOWN: Final = (
    *(ast.Name, ast.Attribute, ast.Subscript, ast.Call, ast.JoinedStr),
    *(ast.ListComp, ast.SetComp, ast.DictComp),
)
_NAMED: Final = (ast.Name, ast.Attribute, ast.Subscript, ast.Call)
_LONGEST: Final = 40  # characters of a part that stands beside its value

_texts: Final = ValueText(60)


def annotated(evaluator: Evaluator, text: str) -> str:
    """Write an expression with the values of all that is not constant."""
    tree = ast.parse(text.strip(), mode="eval").body  # one of its own, which is changed
    return ast.unparse(_Substitution(evaluator).visit(tree))


def elapsed_text(elapsed_ns: int, limit: float, function: str = "after_ms") -> str:
    """Write how long a machine has been in its state against a limit, in a function's unit."""
    passed, unit = elapsed_ns / CLOCK[function], _UNITS[function]
    is_near = f"{passed:.6g}" == f"{limit:.6g}"  # more digits show which is greater
    return f"{passed:.{12 if is_near else 6}g} {unit} > {limit:.12g} {unit}"


class _Substitution(ast.NodeTransformer):
    """Put values beside names and calls."""

    def __init__(self, evaluator: Evaluator):
        self._evaluator = evaluator
        self._is_exact = False  # whether numbers are shown with all of their digits
        self._is_reached = True  # whether the part was evaluated, as far as that is known
        self._form = "{}={}"  # of a part and its value

    def visit(self, node: ast.AST) -> Any:
        """Put values beside the parts of a node."""
        match node:
            case ast.NamedExpr():
                with suppress(Exception):  # then the name has no value
                    self._evaluator.value(node)
                node.value = self.visit(node.value)
                return node
            case ast.BoolOp(op, values):
                node.values = [*self._in_turn(values, isinstance(op, ast.Or))]
                return node
            case ast.IfExp(test, body, orelse):
                value = self._truth(test)
                node.test = self.visit(test)
                with self._reaching(value is not False):
                    node.body = self.visit(body)
                with self._reaching(value is not True):
                    node.orelse = self.visit(orelse)
                return node
            case ast.Compare(left, _, comparators):
                node.left, *node.comparators = self._compared([left, *comparators])
                return node
            case ast.expr() if isinstance(node, _SHOWN):
                return self._shown(node)
            case ast.BinOp(left, ast.Pow(), right):
                node.left, node.right = self._formed(left, "({}={})"), self.visit(right)
                return node
        return self._inside(node)

    def _in_turn(self, values: Sequence[ast.expr], decisive: bool) -> Iterator[ast.expr]:
        is_reached = True
        for each in values:
            value = self._truth(each)
            with self._reaching(is_reached):
                yield self.visit(each)
            is_reached = is_reached and value is not decisive

    def _compared(self, operands: Sequence[ast.expr]) -> list[ast.expr]:
        """Replace operands so that those that differ look different."""
        before, values = self._is_exact, [*map(self._value, operands)]
        self._is_exact = before or any(_look_alike(*pair) for pair in pairwise(values))
        shown = [self.visit(each) for each in operands]
        self._is_exact = before
        return shown

    def _shown(self, node: ast.expr) -> ast.AST:
        try:
            text = self._text(node)
        except Exception:  # whatever code of operators raises: this part has no value
            is_part = isinstance(node, ast.Attribute | ast.Subscript) and not self._is_reached
            # Texts cannot be in place of parts of a text.
            if is_part or isinstance(node, ast.JoinedStr):
                return node
            return self._inside_of_part(node)
        if isinstance(node, _NAMED) and self._evaluator.clock_of(node) is None:
            source = ast.unparse(self._evaluator.without_owner(node))
            if source.endswith(text):  # a member of an enumeration
                return ast.Name(source)
            if len(source) <= _LONGEST and self._form:
                return ast.Name(self._form.format(source, text))
        if text.startswith("-"):
            return ast.UnaryOp(ast.USub(), ast.Name(text[1:]))  # it may be raised to a power
        return ast.Name(text)

    def _text(self, node: ast.expr) -> str:
        clock = self._evaluator.clock_of(node)
        if clock is not None and self._evaluator.elapsed_ns is not None:
            name, limit = clock
            return elapsed_text(self._evaluator.elapsed_ns, self._evaluator.data(limit), name)
        value = self._evaluator.data(node)
        if isinstance(value, enum.Enum) and not isinstance(value, enum.Flag):
            return f"{type(value).__name__}.{value.name}"
        is_short = isinstance(value, float) and not self._is_exact
        return f"{value:.6g}" if is_short else _texts.text(value)

    def _inside(self, node: ast.AST) -> ast.AST:
        outer = self._evaluator
        if isinstance(node, _SCOPES):
            self._evaluator = outer.hiding(inner_names(node))
        found = self.generic_visit(node)
        self._evaluator = outer
        return found

    def _inside_of_part(self, node: ast.expr) -> ast.AST:
        """Put values into a part that has none; in a call, a name beside one would be a keyword."""
        match node:
            case ast.Attribute(value) | ast.Subscript(value):
                node.value = self._formed(value, "({}={})")
                if isinstance(node, ast.Subscript):
                    node.slice = self.visit(node.slice)
                return node
            case ast.Call(function, arguments):
                node.func = self._formed(function, "({}={})")
                node.args = [self._formed(each, "") for each in arguments]
                for keyword in node.keywords:
                    keyword.value = self._formed(keyword.value, "")
                return node
        return self._inside(node)

    def _formed(self, node: ast.expr, form: str) -> Any:
        before, self._form = self._form, form
        found = self.visit(node)
        self._form = before
        return found

    def _truth(self, node: ast.expr) -> bool | None:
        value = self._value(node)
        return None if value is UNKNOWN else bool(value)

    def _value(self, node: ast.expr) -> Any:
        with suppress(Exception):
            return self._evaluator.data(node)
        return UNKNOWN

    @contextmanager
    def _reaching(self, is_reached: bool) -> Iterator[None]:
        outer = self._is_reached
        self._is_reached = outer and is_reached
        yield
        self._is_reached = outer


def _look_alike(one: Any, other: Any) -> bool:
    """Check if two numbers that differ have the same first digits."""
    are_numbers = isinstance(one, int | float) and isinstance(other, int | float)
    return are_numbers and one != other and f"{one:.6g}" == f"{other:.6g}"
