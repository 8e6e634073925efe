"""The text of an expression with values in the places of its parts.

What an expression of a machine's code has seen: its value, and the values of its parts.

Expressions are evaluated again from their text, on what the machine had when it evaluated them, or
has now. Nothing is called that could have an effect: of functions, those that compute, those of the
state's clock, and others that are one expression, which is evaluated likewise.
"""

from __future__ import annotations

import ast
import builtins
import copy
import enum
import math
import sys
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from itertools import pairwise
from types import FunctionType, MethodType, ModuleType
from typing import Any, Final, Self

from llfsm.runtime.debugging.safe_operations import (
    FUNCTIONS,
    Elements,
    MissingError,
    UnseenError,
    applied,
    called,
    data,
    item,
    member,
)
from llfsm.runtime.engine.machine import Machine, Submachine
from llfsm.runtime.engine.ports import Sensor
from llfsm.runtime.engine.source_text import expression_of
from llfsm.runtime.value_text import ValueText

_DEEPEST: Final = 5  # calls of functions that are one expression
_LONGEST: Final = 1000  # elements of all comprehensions: machines wait for the answer
CLOCK: Final = {"after_ms": 1e6, "after": 1e9, "timeout": 1e3}
"""The nanoseconds in a unit of the functions of the state's clock."""
_OF_PYTHON: Final = {each.__name__: each for each in FUNCTIONS} | {"math": math}
_UNKNOWN: Final = object()
_WIDEST: Final = 6  # characters of a format


@lru_cache(maxsize=1024)
def parsed(text: str) -> ast.expr:
    """Return the syntax tree of an expression."""
    return ast.parse(text.strip(), mode="eval").body


class Operands:
    """The values of names in an expression of `owner`, a machine or a message.

    `elapsed_ns` is how long a machine has been in its state `state`, None if that is not known.
    `function` is the guard whose expression it is; without one, names are those of the owner, and
    of the module of its class. `attributes` are what the owner had then, where it has others now.
    """

    def __init__(
        self,
        owner: Any,
        elapsed_ns: int | None = None,
        function: object = None,
        *,
        state: str = "",
        attributes: Mapping[str, Any] | None = None,
    ):
        self._owner = owner
        self.elapsed_ns = elapsed_ns
        self._state = state
        self._attributes = attributes or {}
        self._depth = 0
        self._left = [_LONGEST]  # how many elements may still be looked at
        self._locals: ChainMap[str, Any] = ChainMap({"self": owner})
        self._is_owned = True  # whether a name may be an attribute of the owner
        module = sys.modules.get(type(owner).__module__)
        self._globals: Mapping[str, Any] = {} if module is None else vars(module)
        if isinstance(function, FunctionType):
            self._enter(function, (owner,))

    def _enter(self, function: FunctionType, arguments: Sequence[Any]) -> None:
        """Let names be those of a function that is called with these arguments."""
        code, defaults = function.__code__, function.__defaults__ or ()
        names = code.co_varnames[: code.co_argcount]
        missing = len(names) - len(arguments)
        if not 0 <= missing <= len(defaults) or code.co_kwonlyargcount:
            raise UnseenError(f"{function.__name__} is called otherwise")
        given = [*arguments, *defaults[len(defaults) - missing :]]
        cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
        enclosing = {name: cell.cell_contents for name, cell in cells}
        self._locals = ChainMap(enclosing | dict(zip(names, given, strict=True)))
        self._globals = function.__globals__
        self._is_owned = not all(map(str.isidentifier, names[:1]))  # of a bundle

    def within(self, names: Mapping[str, Any]) -> Self:
        """Return the operands of an inner scope with these names."""
        inner = copy.copy(self)
        inner._locals = self._locals.new_child(dict(names))
        return inner

    def hiding(self, names: Iterable[str]) -> Self:
        """Return the operands of an inner scope whose own names have no value."""
        return self.within(dict.fromkeys(names, _UNKNOWN))

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
                return item(self.data(inner), self.data(index))
            case ast.UnaryOp(op, operand):
                return applied(op, self.data(operand))
            case ast.BinOp(left, op, right) if not isinstance(op, ast.MatMult):
                return applied(op, self.data(left), self.data(right))
            case ast.BoolOp(op, values):
                for each in values:
                    value = self.data(each)
                    if bool(value) is isinstance(op, ast.Or):
                        return value
                return value
            case ast.IfExp(test, body, orelse):
                return self.value(body if self.data(test) else orelse)
            case ast.Compare():
                return self._compared(node)
            case ast.NamedExpr(ast.Name(name), inner):
                value = self._locals.maps[-1][name] = self.value(inner)
                return value
            case ast.Call():
                return self._call(node)
        return self._displayed(node)

    def data(self, node: ast.expr) -> Any:
        """Return a value on which operators have no effect; raise what `value` raises."""
        return data(self.value(node))

    def _compared(self, node: ast.Compare) -> bool:
        value = self.value(node.left)
        for comparison, right in zip(node.ops, node.comparators, strict=True):
            other = self.value(right)
            if not isinstance(comparison, ast.Is | ast.IsNot):
                value, other = data(value), data(other)
            if not applied(comparison, value, other):
                return False
            value = other
        return True

    # What makes a new value

    def _displayed(self, node: ast.expr) -> Any:
        match node:
            case ast.Tuple(elts):
                return tuple(self._elements(elts))
            case ast.List(elts):
                return [*self._elements(elts)]
            case ast.Set(elts):
                return {*map(data, self._elements(elts))}
            case ast.Dict(keys, values):
                pairs = zip(filter(None, keys), values, strict=True)  # a ** has no key
                return {self.data(key): self.value(each) for key, each in pairs}
            case ast.Slice():
                ends = (node.lower, node.upper, node.step)
                return slice(*(each and self.data(each) for each in ends))
            case ast.JoinedStr(values):
                return "".join(map(str, map(self.value, values)))
            case ast.FormattedValue(inner, conversion, form):
                return self._formatted(self.data(inner), conversion, form)
            case ast.ListComp(element, generators):
                return [*self._comprehended(element, generators)]
            case ast.SetComp(element, generators):
                return {*self._comprehended(element, generators)}
            case ast.GeneratorExp(element, generators):
                return Elements(self._comprehended(element, generators))
            case ast.DictComp(key, element, generators):
                pair = ast.Tuple([key, element], ast.Load())
                return dict(self._comprehended(pair, generators))
        raise UnseenError(ast.unparse(node))

    def _elements(self, nodes: Sequence[ast.expr]) -> Iterator[Any]:
        for each in nodes:
            if isinstance(each, ast.Starred):
                yield from self._counted(self.data(each.value))
            else:
                yield self.value(each)

    def _counted(self, elements: Iterable[Any]) -> Iterator[Any]:
        for each in elements:
            self._left[0] -= 1
            if self._left[0] < 0:
                raise UnseenError("this may take too long")
            yield each

    def _formatted(self, value: Any, conversion: int, form: ast.expr | None) -> str:
        if conversion != -1:
            value = {ord("r"): repr, ord("a"): ascii}.get(conversion, str)(value)
        text = "" if form is None else self.value(form)
        if len(text) > _WIDEST:
            raise UnseenError("this may take too long")
        return format(value, text)

    def _comprehended(
        self, element: ast.expr, generators: Sequence[ast.comprehension]
    ) -> Iterator[Any]:
        """Yield the elements of a comprehension, whose own names are known in it alone."""
        if not generators:
            yield self.data(element)
            return
        first, *others = generators
        elements = self.value(first.iter)
        for each in self._counted(elements if isinstance(elements, Elements) else data(elements)):
            inner = self.within(_assigned(first.target, each))
            if all(inner.data(test) for test in first.ifs):
                yield from inner._comprehended(element, others)

    # Names, attributes and calls

    def _named(self, name: str) -> Any:
        if name in self._locals:
            if self._locals[name] is _UNKNOWN:
                raise UnseenError(f"{name!r} has no value here")
            return self._locals[name]
        if self._is_owned:
            for attribute in (f"{self._state}.{name}", name):
                with suppress(MissingError):
                    return self._attribute(self._owner, attribute)
        if name in self._globals:
            return self._globals[name]
        if name in _OF_PYTHON:
            return _OF_PYTHON[name]
        if isinstance(found := vars(builtins).get(name), type):
            return found
        raise UnseenError(f"no name {name!r}")

    def _attribute(self, owner: Any, name: str) -> Any:
        """Return an attribute whose reading runs no code, but for what is known to be harmless."""
        is_own = owner is self._owner
        if is_own and name in self._attributes:
            return self._attributes[name]
        is_state = is_own and isinstance(owner, Machine) and name in ("name", "state_name")
        if isinstance(owner, Submachine) or is_state:
            return getattr(owner, name)
        found = member(owner, name)
        if isinstance(found, Sensor):
            return found.default
        if isinstance(found, staticmethod):
            return found.__func__
        if isinstance(owner, ModuleType | type) or not hasattr(type(found), "__get__"):
            return found
        if isinstance(found, property) and isinstance(found.fget, FunctionType):
            return self._inline(found.fget, [owner])
        if isinstance(found, FunctionType):
            return found if name in getattr(owner, "__dict__", ()) else MethodType(found, owner)
        raise UnseenError(name)

    def _call(self, node: ast.Call) -> Any:
        called_name = ast.unparse(node.func).rpartition(".")[2]
        if called_name in CLOCK and len(node.args) == 1 and not node.keywords:
            if self.elapsed_ns is None:
                raise UnseenError("the state was not entered yet")
            return self.elapsed_ns > self.data(node.args[0]) * CLOCK[called_name]
        function, arguments = self.value(node.func), [*self._elements(node.args)]
        keywords = {each.arg or "": self.value(each.value) for each in node.keywords}
        if isinstance(function, MethodType):
            arguments.insert(0, function.__self__)
            function = function.__func__
        if isinstance(function, FunctionType) and not keywords:
            return self._inline(function, arguments)
        return called(function, arguments, keywords)

    def _inline(self, function: FunctionType, arguments: Sequence[Any]) -> Any:
        text = expression_of(function)
        if text is None or self._depth == _DEEPEST:
            raise UnseenError(f"{function.__name__} is more than an expression")
        inner = copy.copy(self)
        inner._depth += 1
        inner._enter(function, arguments)
        return inner.value(parsed(text))


def _assigned(target: ast.expr, value: Any) -> Mapping[str, Any]:
    """Return the names that an element of a comprehension is assigned to."""
    match target:
        case ast.Name(name):
            return {name: value}
        case ast.Tuple(elts) | ast.List(elts) if not any(isinstance(e, ast.Starred) for e in elts):
            found: dict[str, Any] = {}
            for each, part in zip(elts, value, strict=True):
                found |= _assigned(each, part)
            return found
    raise UnseenError(ast.unparse(target))


_UNITS: Final = {"after_ms": "ms", "after": "s", "timeout": "us"}
_SCOPES: Final = (ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp, ast.Lambda)
_SHOWN: Final = (
    *(ast.Name, ast.Attribute, ast.Subscript, ast.Call, ast.JoinedStr),
    *(ast.ListComp, ast.SetComp, ast.DictComp),
)


_texts: Final = ValueText(60)


def seen_text(operands: Operands, text: str) -> str:
    """Return an expression with values in place of all that is not constant.

    What has no value stays as it is written.
    """
    tree = ast.parse(text.strip(), mode="eval").body  # one of its own, which is changed
    return ast.unparse(_Substitution(operands).visit(tree))


def elapsed_text(elapsed_ns: int, limit: float, function: str = "after_ms") -> str:
    """Return for how long a machine has been in its state, against a limit."""
    passed, unit = elapsed_ns / CLOCK[function], _UNITS[function]
    is_near = f"{passed:.6g}" == f"{limit:.6g}"  # more digits show which is greater
    return f"{passed:.{12 if is_near else 6}g} {unit} > {limit:.12g} {unit}"


class _Substitution(ast.NodeTransformer):
    """Put values in place of names and calls."""

    def __init__(self, operands: Operands):
        self._operands = operands
        self._is_exact = False  # whether numbers are shown with all of their digits
        self._is_reached = True  # whether the part was evaluated, as far as that is known

    def visit(self, node: ast.AST) -> Any:
        """Return a node in place of another one."""
        match node:
            case ast.NamedExpr():
                with suppress(Exception):  # then the name has no value
                    self._operands.value(node)
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
        return self._inside(node)

    def _in_turn(self, values: Sequence[ast.expr], decisive: bool) -> Iterator[ast.expr]:
        is_reached = True
        for each in values:
            value = self._truth(each)
            with self._reaching(is_reached):
                yield self.visit(each)
            is_reached = is_reached and value is not decisive

    def _compared(self, operands: Sequence[ast.expr]) -> list[ast.expr]:
        """Return what is compared, so that what differs looks different."""
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
            return node if is_part or isinstance(node, ast.JoinedStr) else self._inside(node)
        if text.startswith("-"):
            return ast.UnaryOp(ast.USub(), ast.Name(text[1:]))  # it may be raised to a power
        return ast.Name(text)

    def _text(self, node: ast.expr) -> str:
        match node:
            case ast.Call(ast.Name(name) | ast.Attribute(attr=name), [limit], []) if name in CLOCK:
                if self._operands.elapsed_ns is not None:
                    return elapsed_text(self._operands.elapsed_ns, self._operands.data(limit), name)
        value = self._operands.data(node)
        if isinstance(value, enum.Enum) and not isinstance(value, enum.Flag):
            return f"{type(value).__name__}.{value.name}"
        is_short = isinstance(value, float) and not self._is_exact
        return f"{value:.6g}" if is_short else _texts.text(value)

    def _inside(self, node: ast.AST) -> ast.AST:
        outer = self._operands
        if isinstance(node, _SCOPES):
            self._operands = outer.hiding(_bound_in(node))
        found = self.generic_visit(node)
        self._operands = outer
        return found

    def _truth(self, node: ast.expr) -> bool | None:
        value = self._value(node)
        return None if value is _UNKNOWN else bool(value)

    def _value(self, node: ast.expr) -> Any:
        with suppress(Exception):
            return self._operands.data(node)
        return _UNKNOWN

    @contextmanager
    def _reaching(self, is_reached: bool) -> Iterator[None]:
        outer = self._is_reached
        self._is_reached = outer and is_reached
        yield
        self._is_reached = outer


def _bound_in(scope: ast.AST) -> Iterator[str]:
    for node in ast.walk(scope):
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def _look_alike(one: Any, other: Any) -> bool:
    """Return whether two numbers that differ have the same first digits."""
    are_numbers = isinstance(one, int | float) and isinstance(other, int | float)
    return are_numbers and one != other and f"{one:.6g}" == f"{other:.6g}"
