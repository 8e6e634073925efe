"""The value of an expression of a machine's code, beside the machine and without an effect.

Expressions are evaluated from their text, on what the machine had when it evaluated them, or has
now. Nothing is called that could have an effect: of functions, those that compute (`purity`), those
of the state's clock, and others that are one expression, which is evaluated likewise. The machines
wait for the answer, so that what could take long is refused.
"""

from __future__ import annotations

import ast
import builtins
import copy
import math
import sys
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from types import FunctionType, MethodType, ModuleType
from typing import Any, Final, Self

from llfsm.runtime.engine.ports import Sensor
from llfsm.runtime.engine.source_text import expression_of
from llfsm.runtime.engine.state import SubmachineState
from llfsm.runtime.engine.submachine import Polled
from llfsm.runtime.engine.table import Table
from llfsm.runtime.expressions.purity import (
    FUNCTIONS,
    Elements,
    EvaluationError,
    MissingError,
    apply,
    as_argument,
    as_data,
    call,
    item,
    member,
)
from llfsm.runtime.expressions.reads import CLOCK

_DEEPEST: Final = 5  # calls of functions that are one expression
_LONGEST: Final = 1000  # elements of all comprehensions: machines wait for the answer
_OF_PYTHON: Final = {each.__name__: each for each in FUNCTIONS} | {"math": math}
UNKNOWN: Final = object()
"""The value of a name that has none."""
_WIDEST: Final = 6  # characters of a format


@lru_cache(maxsize=1024)
def parsed(text: str) -> ast.expr:
    """Parse an expression; its tree is shared, and not to be changed."""
    return ast.parse(text.strip(), mode="eval").body


class Evaluator:
    """Evaluate expressions of `owner`, a machine or a message.

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
            raise EvaluationError(f"{function.__name__} is called otherwise")
        given = [*arguments, *defaults[len(defaults) - missing :]]
        cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
        enclosing = {name: cell.cell_contents for name, cell in cells}
        self._locals = ChainMap(enclosing | dict(zip(names, given, strict=True)))
        self._globals = function.__globals__
        self._is_owned = not all(map(str.isidentifier, names[:1]))  # of a bundle

    def within(self, names: Mapping[str, Any]) -> Self:
        """Make the evaluator of an inner scope with these names."""
        inner = copy.copy(self)
        inner._locals = self._locals.new_child(dict(names))
        return inner

    def hiding(self, names: Iterable[str]) -> Self:
        """Make the evaluator of an inner scope whose own names have no value."""
        return self.within(dict.fromkeys(names, UNKNOWN))

    def value(self, node: ast.expr) -> Any:
        """Evaluate an expression; raise `EvaluationError`, or what its operators raise."""
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
                return apply(op, self.data(operand))
            case ast.BinOp(left, op, right) if not isinstance(op, ast.MatMult):
                return apply(op, self.data(left), self.data(right))
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
        """Evaluate what operators can be applied to; raise as `value` does."""
        return as_data(self.value(node))

    def _compared(self, node: ast.Compare) -> bool:
        value = self.value(node.left)
        for comparison, right in zip(node.ops, node.comparators, strict=True):
            other = self.value(right)
            if not isinstance(comparison, ast.Is | ast.IsNot):
                value, other = as_data(value), as_data(other)
            if not apply(comparison, value, other):
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
                return {*map(as_data, self._elements(elts))}
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
        raise EvaluationError(ast.unparse(node))

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
                raise EvaluationError("this may take too long")
            yield each

    def _formatted(self, value: Any, conversion: int, form: ast.expr | None) -> str:
        if conversion != -1:
            value = {ord("r"): repr, ord("a"): ascii}.get(conversion, str)(value)
        text = "" if form is None else self.value(form)
        if len(text) > _WIDEST:
            raise EvaluationError("this may take too long")
        return format(value, text)

    def _comprehended(
        self, element: ast.expr, generators: Sequence[ast.comprehension]
    ) -> Iterator[Any]:
        """Yield the elements of a comprehension, whose own names are known in it alone."""
        if not generators:
            yield self.data(element)
            return
        first, *others = generators
        for each in self._counted(as_argument(self.value(first.iter))):
            inner = self.within(_assigned(first.target, each))
            if all(inner.data(test) for test in first.ifs):
                yield from inner._comprehended(element, others)

    # Names, attributes and calls

    def _named(self, name: str) -> Any:
        if name in self._locals:
            if self._locals[name] is UNKNOWN:
                raise EvaluationError(f"{name!r} has no value here")
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
        raise EvaluationError(f"no name {name!r}")

    def _attribute(self, owner: Any, name: str) -> Any:
        """Read an attribute; of code that would run for it, evaluate what is one expression."""
        is_own = owner is self._owner
        if is_own and name in self._attributes:
            return self._attributes[name]
        is_machine = isinstance(getattr(type(owner), "table", None), Table)
        is_state = is_own and is_machine and name in ("name", "state_name")
        if isinstance(owner, Polled) or is_state:
            return getattr(owner, name)
        found = member(owner, name)
        if isinstance(found, Sensor):
            return found.default
        if isinstance(found, SubmachineState) and not isinstance(owner, type):
            return getattr(owner, name)  # to be polled
        if isinstance(found, staticmethod):
            return found.__func__
        if isinstance(owner, ModuleType | type) or not hasattr(type(found), "__get__"):
            return found
        if isinstance(found, property) and isinstance(found.fget, FunctionType):
            return self._inline(found.fget, [owner])
        if isinstance(found, FunctionType):
            return found if name in getattr(owner, "__dict__", ()) else MethodType(found, owner)
        raise EvaluationError(name)

    def _call(self, node: ast.Call) -> Any:
        if (clock := self.clock_of(node)) is not None:
            if self.elapsed_ns is None:
                raise EvaluationError("the state was not entered yet")
            name, limit = clock
            return self.elapsed_ns > self.data(limit) * CLOCK[name]
        function, arguments = self.value(node.func), [*self._elements(node.args)]
        keywords = {each.arg or "": self.value(each.value) for each in node.keywords}
        if isinstance(function, MethodType):
            arguments.insert(0, function.__self__)
            function = function.__func__
        if isinstance(function, FunctionType) and not keywords:
            return self._inline(function, arguments)
        return call(function, arguments, keywords)

    def clock_of(self, node: ast.expr) -> tuple[str, ast.expr] | None:
        """Return the function of the state's clock that is called, and its limit; else None."""
        match node:
            case ast.Call(ast.Name(name), [limit], []) if name in CLOCK and self._is_owned:
                return None if name in self._locals else (name, limit)
            case ast.Call(ast.Attribute(of, name), [limit], []) if name in CLOCK:
                with suppress(Exception):  # what has no value is not the machine
                    return (name, limit) if self.value(of) is self._owner else None
        return None

    def without_owner(self, node: ast.expr) -> ast.expr:
        """Copy an expression, in which attributes of the owner are names."""
        found: ast.expr = _Bare(self._locals, self._owner).visit(copy.deepcopy(node))
        return found

    def _inline(self, function: FunctionType, arguments: Sequence[Any]) -> Any:
        text = expression_of(function)
        if text is None or self._depth == _DEEPEST:
            raise EvaluationError(f"{function.__name__} is more than an expression")
        inner = copy.copy(self)
        inner._depth += 1
        inner._enter(function, arguments)
        return inner.value(parsed(text))


class _Bare(ast.NodeTransformer):
    """Write attributes of the owner as names."""

    def __init__(self, names: Mapping[str, Any], owner: Any):
        self._names = names
        self._owner = owner

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        """Leave out the owner, or look inside."""
        if isinstance(node.value, ast.Name) and self._names.get(node.value.id) is self._owner:
            return ast.Name(node.attr)
        node.value = self.visit(node.value)
        return node


def _assigned(target: ast.expr, value: Any) -> Mapping[str, Any]:
    """Give the names of a comprehension's target their parts of an element."""
    match target:
        case ast.Name(name):
            return {name: value}
        case ast.Tuple(elts) | ast.List(elts) if not any(isinstance(e, ast.Starred) for e in elts):
            found: dict[str, Any] = {}
            for each, part in zip(elts, value, strict=True):
                found |= _assigned(each, part)
            return found
    raise EvaluationError(ast.unparse(target))
