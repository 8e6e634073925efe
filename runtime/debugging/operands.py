"""What an expression of a machine's code has seen: the value of each of its parts.

Expressions are evaluated again from their text, on the machine's last snapshot. Nothing is called
that could have an effect: of functions, those that compute, those of the state's clock, and the
machine's own that are one expression. A part that needs another call stays as it is written.
"""

from __future__ import annotations

import ast
import builtins
import copy
import enum
import inspect
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from types import FunctionType, ModuleType
from typing import Any, Final

import msgspec

from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.ports import Sensor
from llfsm.runtime.engine.source_text import expression_of
from llfsm.runtime.engine.submachine import Submachine
from llfsm.runtime.value_text import ValueText

__all__ = ["Operands", "UnseenError", "parsed"]

_DEEPEST: Final = 5  # calls of the machine's own functions
_CALLED: Final = {abs, all, any, bool, float, int, len, max, min, round, sorted, str, sum}
_MOST: Final = 64  # an exponent, bits of a shift, and of what is raised: others may take for ever
_DATA: Final = (
    *(bool, int, float, complex, str, bytes, type(None)),
    *(tuple, list, dict, set, frozenset, range, enum.Enum, msgspec.Struct, Submachine, slice),
)
_OPERATORS: Final[Mapping[type[ast.AST], Callable[..., Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda value, found: value in found,
    ast.NotIn: lambda value, found: value not in found,
}
_CLOCK: Final = {"after_ms": 1e6, "after": 1e9, "timeout": 1e3}
"""The nanoseconds in a unit of the functions of the state's clock."""
_UNITS: Final = {"after_ms": "ms", "after": "s", "timeout": "us"}

_SCOPES: Final = (ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp, ast.Lambda)
_UNKNOWN: Final = object()

_texts: Final = ValueText(60)


@lru_cache(maxsize=1024)
def parsed(text: str) -> ast.expr:
    """Return the syntax tree of an expression."""
    return ast.parse(text.strip(), mode="eval").body


class UnseenError(Exception):
    """A part of an expression cannot be evaluated without an effect, or there is no such name."""


class Operands:
    """The values of names in an expression of `owner`, a machine or a message.

    `elapsed_ns` is how long a machine has been in its state `state`, None if that is not known.
    `function` is the guard whose expression it is; without one, names are those of the owner.
    """

    def __init__(
        self,
        owner: Any,
        elapsed_ns: int | None = None,
        function: object = None,
        *,
        state: str = "",
        depth: int = 0,
    ):
        self._owner = owner
        self._elapsed_ns = elapsed_ns
        self._state = state
        self._depth = depth
        self._names: dict[str, Any] = {}
        self._bound: dict[str, Any] = {}  # in the expression itself; a name without a value, too
        self._self: tuple[str, ...] = ("self",)
        self._is_owned = True  # whether a name may be an attribute of the owner
        if isinstance(function, FunctionType):
            code = function.__code__
            cells = zip(code.co_freevars, function.__closure__ or (), strict=False)
            self._names = {**vars(builtins), **function.__globals__}
            self._names.update((name, cell.cell_contents) for name, cell in cells)
            self._self = code.co_varnames[:1]
            self._is_owned = not all(map(str.isidentifier, self._self))  # of a bundle

    def value(self, node: ast.expr) -> Any:
        """Return the value of an expression; raise `UnseenError`, or what its operators raise."""
        match node:
            case ast.Constant(value):
                return value
            case ast.Name(name):
                return self._named(name)
            case ast.Attribute(inner, name):
                return self._attribute(self.value(inner), name)
            case ast.Subscript(inner, index):
                return _data(self.value(inner))[_data(self.value(index))]
            case ast.UnaryOp(op, operand):
                return _OPERATORS[type(op)](_data(self.value(operand)))
            case ast.BinOp(left, op, right) if type(op) in _OPERATORS:
                operands = _data(self.value(left)), _data(self.value(right))
                if not _is_small(op, *operands):
                    raise UnseenError(ast.unparse(node))
                return _OPERATORS[type(op)](*operands)
            case ast.BoolOp(op, values):
                for each in values:
                    value = _data(self.value(each))
                    if bool(value) is isinstance(op, ast.Or):
                        return value
                return value
            case ast.IfExp(test, body, orelse):
                return self.value(body if _data(self.value(test)) else orelse)
            case ast.Tuple(elts):
                return tuple(map(self.value, elts))
            case ast.List(elts):
                return [*map(self.value, elts)]
            case ast.Set(elts):
                return {_data(self.value(each)) for each in elts}
            case ast.Slice():
                ends = (node.lower, node.upper, node.step)
                return slice(*(each and _data(self.value(each)) for each in ends))
            case ast.JoinedStr(values):
                return "".join(map(str, map(self.value, values)))
            case ast.FormattedValue(inner, -1, None):
                return str(_data(self.value(inner)))
            case ast.NamedExpr(ast.Name(name), inner):
                self._bound[name] = self.value(inner)
                return self._bound[name]
            case ast.Compare(left, ops, comparators):
                value = self.value(left)
                for comparison, right in zip(ops, comparators, strict=True):
                    other = self.value(right)
                    if not isinstance(comparison, ast.Is | ast.IsNot):
                        value, other = _data(value), _data(other)
                    if not _OPERATORS[type(comparison)](value, other):
                        return False
                    value = other
                return True
            case ast.Call(function, arguments, []):
                return self._call(function, [self.value(each) for each in arguments])
        raise UnseenError(ast.unparse(node))

    def text(self, node: ast.expr) -> str:
        """Return an expression with values in place of all that is not constant."""
        return ast.unparse(_Substitution(self).visit(copy.deepcopy(node)))

    @contextmanager
    def binding(self, names: Iterable[str]) -> Iterator[None]:
        """Let names be those of an inner scope, whose values are not known."""
        outer = self._bound
        self._bound = {**outer, **dict.fromkeys(names, _UNKNOWN)}
        yield
        self._bound = outer

    def shown(self, node: ast.expr) -> str | None:
        """Return what stands in place of a part; None to look into it, or to leave it."""
        match node:
            case ast.Call(ast.Name(name) | ast.Attribute(attr=name), [limit], []) if name in _CLOCK:
                if self._elapsed_ns is None:
                    return None
                passed = self._elapsed_ns / _CLOCK[name]
                return f"{passed:.6g} {_UNITS[name]} > {self.value(limit)} {_UNITS[name]}"
            case ast.Name() | ast.Attribute() | ast.Subscript() | ast.Call() | ast.JoinedStr():
                value = self.value(node)
                return f"{value:.6g}" if isinstance(value, float) else _texts.text(_data(value))
        return None

    def _named(self, name: str) -> Any:
        if name in self._bound:
            if self._bound[name] is _UNKNOWN:
                raise UnseenError(f"{name!r} has no value here")
            return self._bound[name]
        if name in self._self and name not in self._names:
            return self._owner
        if self._is_owned:
            for attribute in (f"{self._state}.{name}", name):
                try:
                    return self._attribute(self._owner, attribute)
                except UnseenError:
                    continue
        if name in self._names:
            return self._names[name]
        if name in ("True", "False", "math") or getattr(builtins, name, None) in _CALLED:
            return {"math": math}.get(name, getattr(builtins, name, None))
        raise UnseenError(f"no name {name!r}")

    def _attribute(self, owner: Any, name: str) -> Any:
        """Return an attribute whose reading runs no code, but for what is known to be harmless."""
        if isinstance(owner, Submachine) or (
            owner is self._owner and name in ("name", "state_name")
        ):
            return getattr(owner, name)
        try:
            found = inspect.getattr_static(owner, name)
        except AttributeError:
            raise UnseenError(f"{type(owner).__name__} has no {name!r}") from None
        if isinstance(found, Sensor):
            return found.default
        if isinstance(found, property) and isinstance(owner, Machine) and found.fget is not None:
            return self._inline(found.fget)
        is_field = isinstance(owner, msgspec.Struct) and name in owner.__struct_fields__
        if is_field or (isinstance(owner, type) and issubclass(owner, enum.Enum)):
            return getattr(owner, name)
        if isinstance(owner, ModuleType | type) or not hasattr(type(found), "__get__"):
            return found
        if isinstance(found, FunctionType) and owner is self._owner:
            return found
        raise UnseenError(name)

    def _call(self, called: ast.expr, arguments: list[Any]) -> Any:
        name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
        if name in _CLOCK and len(arguments) == 1:
            if self._elapsed_ns is None:
                raise UnseenError("the state was not entered yet")
            return self._elapsed_ns > arguments[0] * _CLOCK[name]
        function = self.value(called)
        is_known = any(function is each for each in _CALLED)
        if is_known or getattr(function, "__module__", "") == "math":
            return function(*map(_data, arguments))
        if isinstance(function, FunctionType) and not arguments:
            return self._inline(function)
        raise UnseenError(f"{name} is not called")

    def _inline(self, function: Callable[..., Any]) -> Any:
        text = expression_of(function)
        if text is None or self._depth == _DEEPEST:
            raise UnseenError(f"{function.__name__} is more than an expression")
        depth = self._depth + 1
        inner = Operands(self._owner, self._elapsed_ns, function, state=self._state, depth=depth)
        return inner.value(parsed(text))


class _Substitution(ast.NodeTransformer):
    """Put values in place of names and calls."""

    def __init__(self, operands: Operands):
        self._operands = operands

    def visit(self, node: ast.AST) -> Any:
        """Return a node in place of another one."""
        if isinstance(node, ast.NamedExpr):
            with suppress(Exception):  # then the name has no value
                self._operands.value(node)
            node.value = self.visit(node.value)
            return node
        if isinstance(node, _SCOPES):
            with self._operands.binding(_bound_in(node)):
                return self.generic_visit(node)
        if isinstance(node, ast.expr):
            try:
                shown = self._operands.shown(node)
            except Exception:  # whatever code of operators raises: this part stays as it is
                return node
            if shown is not None:
                return ast.Name(shown)
            if isinstance(node, ast.JoinedStr):  # texts cannot be in place of its parts
                return node
        return self.generic_visit(node)


def _bound_in(scope: ast.AST) -> Iterator[str]:
    for node in ast.walk(scope):
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def _is_small(op: ast.operator, left: Any, right: Any) -> bool:
    """Return whether an operator's result takes little time and room, whatever the values are."""
    numbers = isinstance(left, int | float | complex) and isinstance(right, int | float | complex)
    match op:
        case ast.Mult() | ast.Mod():
            return numbers  # a text may become as long as you like
        case ast.Pow() if numbers:
            is_short = not isinstance(left, int) or left.bit_length() <= _MOST
            return is_short and abs(right) <= _MOST
        case ast.Pow() | ast.LShift():
            return isinstance(right, int) and right <= _MOST
    return True


def _data(value: Any) -> Any:
    """Return a value on which operators have no effect; raise `UnseenError` for others."""
    if isinstance(value, _DATA):
        return value
    raise UnseenError(f"{type(value).__name__} is not data")
