"""Closed guards: those whose value depends on nothing that could change unseen.

A closed guard reads only sensors and variables of its machine, constants, the time in the state,
`stopping` and other machines' statuses, through operators and functions that only compute. So as
long as none of these has changed it returns what it returned before, and need not be evaluated.

The guard's text is followed once, without values, into the properties, methods and functions that
it calls. Every value in it has to be data, by the types that annotations declare (`holds_data`):
then no operator runs code, and what operators make of data is data again. Whatever is not
understood makes a guard open: to take an open guard for closed would be an error, but the opposite
only costs its evaluation. So only what guards are usually written with is understood. Assumed, and
not checked, is that variables and parameters hold what they declare, and that nothing assigns to
names in capitals, functions or classes while machines run.
"""

from __future__ import annotations

import ast
import copy
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from inspect import CO_VARARGS, CO_VARKEYWORDS
from types import FunctionType, NoneType
from typing import Any, Final, NoReturn

from llfsm.runtime.engine.source_text import EXPRESSION, expression_of, syntax_of
from llfsm.runtime.engine.state import DEFERRED
from llfsm.runtime.engine.submachine import Polled
from llfsm.runtime.engine.table import Table
from llfsm.runtime.expressions.evaluation import parsed
from llfsm.runtime.expressions.purity import (
    METHODS,
    cannot_change,
    holds_data,
    is_constant,
    is_ordinary,
    only_computes,
)
from llfsm.runtime.expressions.reads import (
    CLOCK,
    COMPREHENSIONS,
    MACHINE,
    QUESTIONS,
    Code,
    bound_names,
    inner_names,
)
from llfsm.runtime.expressions.types import (
    MISSING,
    Options,
    Types,
    fields_of,
    hints_of,
    is_message,
    kind_of,
    options_of,
)

_STATUSES: Final = QUESTIONS - {"index_of"}
_OF_ITSELF: Final = ("name", "state_name")  # neither changes while a guard is evaluated again
_OF_CALLED: Final = ("done", "failed", "name")
_ENGINE: Final = Polled.__module__.rpartition(".")[0]
_MACHINE: Options = ("the machine",)
"""Stands for the types of an argument that is the machine itself."""
_DEFERRED: Final = DEFERRED | CO_VARARGS | CO_VARKEYWORDS
# What has a value made of those of its parts, of which all are evaluated or some.
_COMPOSED: Final = (
    *(ast.BoolOp, ast.UnaryOp, ast.BinOp, ast.IfExp, ast.NamedExpr, ast.Tuple, ast.List, ast.Set),
    *(ast.Dict, ast.Starred, ast.Subscript, ast.Slice, ast.JoinedStr, ast.FormattedValue),
    *(ast.Compare, ast.comprehension, *COMPREHENSIONS),
)
_SIGNS: Final = (
    *(ast.Constant, ast.expr_context, ast.boolop, ast.unaryop, ast.operator, ast.cmpop),
    *(ast.Pass, ast.Break, ast.Continue),
)


@dataclass
class GuardReads:
    """All that a guard reads; of one that is open, as far as it was followed."""

    sensors: set[str] = field(default_factory=set)
    variables: set[str] = field(default_factory=set)
    machines: set[str] = field(default_factory=set)
    """The machines whose status it asks; "" stands for those whose names are not in the text."""
    limits_ns: set[float] = field(default_factory=set)
    """The times in the state at which it may change its value."""
    limits_in: set[tuple[str, float]] = field(default_factory=set)
    """The variables that hold such a time, each with the nanoseconds of its unit."""
    reads_time: bool = False
    """True if it compares the time in the state with a limit that is computed."""
    stopping: bool = False
    open: str = ""
    """The name because of which it is open; "" if it is closed."""

    @property
    def is_closed(self) -> bool:
        """True if nothing but what is listed here can change its value."""
        return not self.open


def reads_of_guard(guard: Callable[..., Any], table: Table) -> GuardReads:
    """Find out what a guard reads; `table` is that of the class of its machine."""
    reads = GuardReads()
    states = (each for each in table.states for leads in each.transitions if leads.guard is guard)
    state = next((each.name for each in states), "")
    try:
        if not isinstance(guard, FunctionType):
            raise _OpenError(type(guard).__name__)
        _Machine(table, state, reads).enter(guard, _MACHINE)
    except _OpenError as error:
        reads.open = str(error).replace(f"{MACHINE}.", "")
    return reads


class _OpenError(Exception):
    """A guard is open; the text is the name because of which it is."""


def _refuse(node: ast.AST) -> NoReturn:
    raise _OpenError(ast.unparse(node).partition("\n")[0])


class _Machine:
    """A machine class, and the functions that were followed from one of its guards."""

    def __init__(self, table: Table, state: str, reads: GuardReads):
        self.table = table
        self.state = state
        self.reads = reads
        self._class = table.states[0].owner or object
        self._entered: set[object] = set()
        for name in ("__getattr__", "__getattribute__"):
            if self.found(name) not in (MISSING, object.__getattribute__):
                raise _OpenError(name)

    def found(self, name: str) -> Any:
        """Look up an attribute of the class; `MISSING` if there is none."""
        return _class_attribute(self._class, name)

    def enter(self, function: FunctionType, first: Options) -> None:
        """Follow a function, whose first argument is `_MACHINE` or of other types, if known."""
        if (function, first) in self._entered:
            return  # also if it calls itself
        self._entered.add((function, first))
        code = function.__code__
        if code.co_flags & _DEFERRED:
            raise _OpenError(function.__name__)
        if code.co_freevars:
            raise _OpenError(code.co_freevars[0])
        defaults = (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values())
        if not all(map(cannot_change, defaults)):
            raise _OpenError("a default value")
        hints = hints_of(function)
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        given = {name: options_of(hints.get(name, Any)) for name in names}
        if first:
            given |= dict(zip(names[:1], [first], strict=False))
        body = _statements(function)
        machine = names[0] if names and first is _MACHINE else ""
        given.pop(machine, None)
        if machine == MACHINE:
            resolver = _Resolver(self, {*given} | _scoped_names(body))
            body = [resolver.visit(each) for each in copy.deepcopy([*body])]
        code_of = Code(body, machine, code.co_filename, function.__globals__)
        _Function(self, code_of, given).follow(body)


class _Resolver(ast.NodeTransformer):
    """Make a bundle's bare names of its machine attributes, as its loading does."""

    def __init__(self, whole: _Machine, own: set[str]):
        self._whole = whole
        self._own = own

    def visit_Name(self, node: ast.Name) -> ast.expr:
        machine = ast.Name(MACHINE, ast.Load())
        for name in (f"{self._whole.state}.{node.id}", node.id):
            if name in self._whole.table.variables or self._whole.found(name) is not MISSING:
                if node.id in self._own:
                    _refuse(node)  # it means the machine's in one place and not in another
                return ast.Attribute(machine, name, node.ctx)
        return machine if node.id == "self" and "self" not in self._own else node


class _Function:
    """The code of one function, with the types of its parameters."""

    def __init__(self, whole: _Machine, code: Code, given: dict[str, Options]):
        self._whole = whole
        self._reads = whole.reads
        self._code = code
        self._types = Types(code, whole.table, given)
        own = bound_names(code.body) | given.keys()
        for name in (_scoped_names(code.body) - own) & code.names.keys():
            raise _OpenError(name)  # it means the module's in one place and not in another

    def follow(self, nodes: Iterable[ast.AST | None]) -> None:
        """Follow statements, and expressions that have to be data or names that are given data."""
        for each in nodes:
            if each is not None:
                self._follow(each)

    def _follow(self, node: ast.AST) -> None:
        match node:
            case ast.Return() | ast.Expr() | ast.If() | ast.While() | ast.For() | ast.Assign():
                self.follow(ast.iter_child_nodes(node))
            case ast.Name(name):
                if name == self._code.machine:
                    _refuse(node)  # it is handed on
                if not self._types.is_own(name):
                    self._constant(node, name, self._types.value_of(node))
            case ast.Attribute(ast.Name(self._code.machine), name, ast.Load()):
                self._of_machine(node, name)
            case ast.Attribute(ctx=ast.Load()):
                self._attribute(node, node.attr)
            case ast.Call(ast.Attribute(ast.Name(self._code.machine), name)):
                self._call_of_machine(node, name)
            case ast.Call():
                self._call(node)
            case ast.Subscript(ctx=ast.Store() | ast.Del()) | ast.BinOp(op=ast.MatMult()):
                _refuse(node)
            case _ if isinstance(node, _COMPOSED):
                self.follow(ast.iter_child_nodes(node))
            case _ if not isinstance(node, _SIGNS):
                _refuse(node)

    # Names and attributes

    def _constant(self, node: ast.expr, name: str, value: object) -> None:
        if value is MISSING or not is_constant(name, value):
            _refuse(node)

    def _attribute(self, node: ast.Attribute, name: str) -> None:
        if self._types.value_of(node.value) is math:
            return
        known = self._types.value_of(node)
        if known is not MISSING:
            self._constant(node, name, known)
            return
        self._follow(node.value)
        for kind in self._kinds(node.value):
            found = _class_attribute(kind, name)
            if issubclass(kind, Polled) and name in _OF_CALLED:
                self._reads.machines.add("")
            elif is_message(kind) and isinstance(found, property):
                self._enter(node, found.fget, (kind,))
            elif issubclass(kind, Enum) and name in ("name", "value"):
                if not all(cannot_change(each.value) for each in kind):
                    _refuse(node)
            elif issubclass(kind, Enum) and isinstance(found, property):
                self._enter(node, found.fget, (kind,))
            elif not (is_message(kind) and name in fields_of(kind)):
                self._constant(node, name, found)

    def _kinds(self, node: ast.expr) -> list[Any]:
        """List the classes that a value may have, without None, whose use raises."""
        kinds = [kind_of(each) for each in self._types.of(node) if each is not NoneType]
        if not kinds:
            _refuse(node)
        return kinds

    def _of_machine(self, node: ast.Attribute, name: str) -> None:
        table, found = self._whole.table, self._whole.found(name)
        if name in table.sensors:
            self._reads.sensors.add(name)
            if not holds_data(table.sensors[name].slot.type):
                _refuse(node)
        elif name in table.variables:
            self._reads.variables.add(name)
            for each in self._types.of(node) or (Any,):
                if issubclass(kind_of(each), Polled):
                    self._reads.machines.add("")  # whose text has its status
                elif not holds_data(each):
                    _refuse(node)
        elif name == "stopping":
            self._reads.stopping = True
        elif isinstance(found, property) and name not in _OF_ITSELF:
            self._enter(node, found.fget, _MACHINE)
        elif name not in _OF_ITSELF:
            self._constant(node, name, found)

    # Calls

    def _call(self, node: ast.Call) -> None:
        function, keywords = self._types.value_of(node.func), {each.arg for each in node.keywords}
        if function is isinstance and len(node.args) == 2:
            kinds = node.args[1].elts if isinstance(node.args[1], ast.Tuple) else node.args[1:]
            if not all(is_ordinary(self._types.value_of(each)) for each in kinds):
                _refuse(node)
            self._follow(node.args[0])
            return
        self._arguments(node)
        if isinstance(node.func, ast.Attribute) and function is MISSING:
            self._method(node.func, node.func.value, node.func.attr)
        elif isinstance(function, FunctionType):
            self._enter(node.func, function)
        elif not only_computes(function) or keywords & {"key", None}:
            _refuse(node.func)

    def _arguments(self, node: ast.Call) -> None:
        self.follow([*node.args, *(each.value for each in node.keywords)])

    def _call_of_machine(self, node: ast.Call, name: str) -> None:
        self._arguments(node)
        match node.args:
            case [ast.Constant(int(limit) | float(limit))] if name in CLOCK and not node.keywords:
                self._reads.limits_ns.add(limit * CLOCK[name])
            case [ast.Attribute(ast.Name(self._code.machine), limit)] if (
                name in CLOCK and limit in self._whole.table.variables and not node.keywords
            ):
                self._reads.limits_in.add((limit, CLOCK[name]))
            case [_] if name in CLOCK and not node.keywords:
                self._reads.reads_time = True
            case [other] if name in _STATUSES and not node.keywords:
                known = other.value if isinstance(other, ast.Constant) else ""
                self._reads.machines.add(str(known))
            case _ if name in self._whole.table.variables:
                _refuse(node.func)
            case _:
                self._enter(node.func, self._whole.found(name), _MACHINE)

    def _method(self, node: ast.Attribute, owner: ast.expr, name: str) -> None:
        """Follow the method of a value: a message's, or one that only computes."""
        self._follow(owner)
        for kind in self._kinds(owner):
            if is_message(kind):
                self._enter(node, _class_attribute(kind, name), (kind,))
            elif name not in METHODS.get(kind, ()):
                _refuse(node)

    def _enter(self, node: ast.expr, function: object, first: Options = ()) -> None:
        """Follow a function that gets an argument of these types before those in the text."""
        if isinstance(function, staticmethod):
            function, first = function.__func__, ()
        if not isinstance(function, FunctionType) or str(function.__module__).startswith(_ENGINE):
            _refuse(node)  # it is in no text, or is what every machine has, as requests
        try:
            self._whole.enter(function, first)
        except _OpenError as error:
            raise _OpenError(f"{ast.unparse(node)}: {error}") from None


def _statements(function: FunctionType) -> Sequence[ast.stmt]:
    """Find a function's statements; a lambda, or a bundle's expression, is returned."""
    node = syntax_of(function)
    match node:
        case ast.FunctionDef(body=body):
            return body
        case ast.Lambda(body=body):
            return [ast.Return(body)]
    text = expression_of(function) if function.__code__.co_name == EXPRESSION else None
    if text is None:
        raise _OpenError(f"{function.__name__}, whose source is not found")
    return [ast.Return(parsed(text))]


def _scoped_names(body: Iterable[ast.AST]) -> set[str]:
    """Name what comprehensions in some code bind, each for itself."""
    nodes = (each for part in body for each in ast.walk(part))
    return {n for each in nodes if isinstance(each, COMPREHENSIONS) for n in inner_names(each)}


def _class_attribute(kind: Any, name: str) -> Any:
    return next((vars(each)[name] for each in kind.__mro__ if name in vars(each)), MISSING)
