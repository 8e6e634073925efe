"""Closed guards: those whose value depends on nothing that could change unseen.

A closed guard reads only sensors and variables of its machine, constants, the time in the state,
`stopping` and other machines' statuses, through operators and functions that only compute. So as
long as none of these has changed it returns what it returned before, and need not be evaluated.

The guard's text is followed once, without values, into the properties, methods and functions that
it calls. Every value in it has to be data, by the types that annotations declare (`holds_data`):
then no operator runs code, and what operators make of data is data again. Whatever is not
understood makes a guard open: to take an open guard for closed would be an error, but the opposite
only costs its evaluation. Assumed, and not checked, is that variables hold what they declare, and
that nothing assigns to names in capitals, functions or classes while machines run.
"""

from __future__ import annotations

import ast
import copy
import math
from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from inspect import CO_VARARGS, CO_VARKEYWORDS
from types import FunctionType, MappingProxyType, NoneType
from typing import Any, Final, NoReturn

import msgspec

from llfsm.runtime.engine.source_text import EXPRESSION, expression_of, syntax_of
from llfsm.runtime.engine.state import DEFERRED
from llfsm.runtime.engine.table import Polled, Table
from llfsm.runtime.expressions.evaluation import parsed
from llfsm.runtime.expressions.purity import (
    FUNCTIONS,
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
    nodes_of,
)
from llfsm.runtime.expressions.types import (
    MISSING,
    PLAIN,
    Options,
    Types,
    fields_of,
    is_message,
    kind_of,
)

_STATUSES: Final = QUESTIONS - {"index_of"}
_OF_ITSELF: Final = ("name", "state_name")  # neither changes while a guard is evaluated again
_OF_CALLED: Final = ("done", "failed", "name")
_ENGINE: Final = Polled.__module__.rpartition(".")[0]
_MACHINE: Final = ("the machine",)
"""Stands for the types of an argument that is the machine itself."""
_UNCHANGING: Final = PLAIN | {bytes, frozenset, tuple}
_SCOPES: Final = (*COMPREHENSIONS, ast.Lambda)
# What has a value made of those of its parts, of which all are evaluated or some.
_COMPOSED: Final = (
    *(ast.BoolOp, ast.UnaryOp, ast.BinOp, ast.IfExp, ast.NamedExpr, ast.Tuple, ast.List, ast.Set),
    *(ast.Dict, ast.Starred, ast.Subscript, ast.Slice, ast.JoinedStr, ast.FormattedValue),
    *COMPREHENSIONS,
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
    reads_time: bool = False
    """True if it compares the time in the state with a limit that is not in the text."""
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
        _Machine(table, state, reads).enter(guard, [_MACHINE], {})
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

    def has(self, name: str) -> bool:
        """Check if the machine has an attribute."""
        return name in self.table.variables or self.found(name) is not MISSING

    def enter(
        self, function: FunctionType, arguments: Sequence[Options], named: Mapping[str, Options]
    ) -> None:
        """Follow a function that is called with arguments of these types, `_MACHINE` first."""
        code = function.__code__
        key = (function, *arguments, *named.items())
        if key in self._entered:
            return  # also if it calls itself
        self._entered.add(key)
        if code.co_flags & DEFERRED:
            raise _OpenError(function.__name__)
        stars = bool(code.co_flags & CO_VARARGS) + bool(code.co_flags & CO_VARKEYWORDS)
        count = code.co_argcount + code.co_kwonlyargcount
        given: dict[str, Options] = dict.fromkeys(code.co_varnames[: count + stars], ())
        given |= self._defaults(function)
        given |= dict(zip(code.co_varnames[:count], arguments, strict=False))
        given |= named
        machine = code.co_varnames[0] if given and arguments[:1] == [_MACHINE] else ""
        given.pop(machine, None)
        body = _statements(function)
        if machine == MACHINE:
            body = self._resolved(body, machine, {*given})
        names = ChainMap(_enclosing(function), function.__globals__)
        code_of = Code(body, machine, code.co_filename, names)
        _Function(self, code_of, given).statements(body)

    def _defaults(self, function: FunctionType) -> dict[str, Options]:
        code, values = function.__code__, function.__defaults__ or ()
        last = code.co_varnames[code.co_argcount - len(values) : code.co_argcount]
        defaults = dict(zip(last, values, strict=True)) | (function.__kwdefaults__ or {})
        for name, value in defaults.items():
            if not cannot_change(value):
                raise _OpenError(name)
        return {name: (type(value),) for name, value in defaults.items()}

    def _resolved(
        self, body: Sequence[ast.stmt], machine: str, parameters: set[str]
    ) -> list[ast.stmt]:
        """Make a bundle's bare names of its machine attributes, as its loading does."""
        resolver = _Resolver(self, machine, parameters | _scoped_names(body))
        return [resolver.visit(each) for each in copy.deepcopy([*body])]


class _Resolver(ast.NodeTransformer):
    def __init__(self, whole: _Machine, machine: str, own: set[str]):
        self._whole = whole
        self._machine = machine
        self._own = own

    def visit_Name(self, node: ast.Name) -> ast.expr:
        name = node.id
        machine = ast.Name(self._machine, ast.Load())
        for attribute in (f"{self._whole.state}.{name}", name):
            if self._whole.has(attribute):
                if name in self._own:
                    _refuse(node)  # it means the machine's in one place and not in another
                return ast.Attribute(machine, attribute, node.ctx)
        return machine if name == "self" and name not in self._own else node


class _Function:
    """The code of one function, with the types of its parameters."""

    def __init__(self, whole: _Machine, code: Code, given: Mapping[str, Options]):
        self._whole = whole
        self._reads = whole.reads
        self._code = code
        self._types = Types(code, whole.table, given)
        own = bound_names(code.body) | given.keys()
        for name in (_scoped_names(code.body) - own) & code.names.keys():
            raise _OpenError(name)  # it means the module's in one place and not in another

    # Statements, and expressions that are data

    def statements(self, body: Iterable[ast.AST]) -> None:
        for each in body:
            self._statement(each)

    def _statement(self, node: ast.AST) -> None:
        match node:
            case ast.Return(ast.expr() as value) | ast.Expr(value) | ast.Assert(value, None):
                self.value(value)
            case ast.Assign(targets, value):
                self._values([*targets, value])
            case ast.AnnAssign(ast.Name(), _, value):
                self._values([value] if value else [])
            case ast.AugAssign(ast.Name(name), op, value) if not isinstance(op, ast.MatMult):
                self.value(value)
                if not self._begins_unshared(name):
                    _refuse(node)  # it may change a list of the machine's
            case ast.If(test, body, orelse) | ast.While(test, body, orelse):
                self.value(test)
                self.statements([*body, *orelse])
            case ast.For(target, each, body, orelse):
                self._values([target, each])
                self.statements([*body, *orelse])
            case ast.Return() | ast.Pass() | ast.Break() | ast.Continue():
                pass
            case _:
                _refuse(node)

    def _begins_unshared(self, name: str) -> bool:
        """Check that a name of the code's own is only given values that cannot be changed."""
        stored, unshared = 0, 0
        for node in nodes_of(self._code):
            match node:
                case ast.Name(found, ast.Store()) if found == name:
                    stored += 1
                case ast.AugAssign(ast.Name(found)) if found == name:
                    stored -= 1
                case ast.Assign([ast.Name(found)], value) if found == name:
                    kinds = {*map(kind_of, self._types.of(value))}
                    unshared += bool(kinds) and kinds <= _UNCHANGING
        return stored == unshared > 0

    def _values(self, nodes: Iterable[ast.expr]) -> None:
        for each in nodes:
            self.value(each)

    def value(self, node: ast.AST) -> None:
        """Follow what has to be data, or to be a name that is given data."""
        match node:
            case ast.Constant() | ast.expr_context() | ast.boolop() | ast.unaryop():
                pass
            case ast.Name(name):
                self._name(node, name)
            case ast.Attribute(ctx=ast.Load()):
                self._attribute(node, is_data=True)
            case ast.Call():
                self._call(node)
            case ast.Compare(left, ops, comparators):
                operands = [left, *comparators]
                for place, operand in enumerate(operands):
                    beside = ops[max(place - 1, 0) : place + 1]
                    by_identity = all(isinstance(op, ast.Is | ast.IsNot) for op in beside)
                    (self._owner if by_identity else self.value)(operand)
            case ast.BinOp(left, op, right) if not isinstance(op, ast.MatMult):
                self._values([left, right])
            case ast.Subscript(ctx=ast.Store() | ast.Del()) | ast.BinOp():
                _refuse(node)
            case ast.comprehension():
                self._values([node.target, node.iter, *node.ifs])
            case _ if isinstance(node, _COMPOSED):
                for each in ast.iter_child_nodes(node):
                    self.value(each)
            case _:
                _refuse(node)

    def _owner(self, node: ast.expr) -> None:
        """Follow what has an attribute or its identity read: it may have parts that are no data."""
        if isinstance(node, ast.Attribute):
            self._attribute(node, is_data=False)
        else:
            self.value(node)

    # Names and attributes

    def _name(self, node: ast.expr, name: str) -> None:
        if name == self._code.machine:
            _refuse(node)  # it is handed on
        if not self._types.is_own(name):
            self._constant(node, name, self._types.value_of(node))

    def _constant(self, node: ast.expr, name: str, value: object) -> None:
        if value is MISSING or not is_constant(name, value):
            _refuse(node)

    def _attribute(self, node: ast.Attribute, *, is_data: bool) -> None:
        name = node.attr
        match node.value:
            case ast.Name(self._code.machine):
                self._of_machine(node, is_data=is_data)
                return
        if self._types.value_of(node.value) is math:
            return
        known = self._types.value_of(node)
        if known is not MISSING:
            self._constant(node, name, known)
            return
        self._owner(node.value)
        for kind in self._kinds(node.value):
            found = _class_attribute(kind, name)
            if issubclass(kind, Polled) and name in _OF_CALLED:
                self._reads.machines.add("")
            elif is_message(kind) and name in fields_of(kind):
                if is_data and not holds_data(fields_of(kind)[name].type):
                    _refuse(node)
            elif issubclass(kind, Enum) and name in ("name", "value"):
                if not all(cannot_change(each.value) for each in kind):
                    _refuse(node)
            elif is_message(kind) and isinstance(found, property):
                self._enter(node, found.fget, [(kind,)])
            else:
                self._constant(node, name, found)

    def _kinds(self, node: ast.expr) -> list[Any]:
        """List the classes that a value may have, without None, whose use raises."""
        kinds = [kind_of(each) for each in self._types.of(node) if each is not NoneType]
        if not kinds:
            _refuse(node)
        return kinds

    def _of_machine(self, node: ast.Attribute, *, is_data: bool) -> None:
        name, table, found = node.attr, self._whole.table, self._whole.found(node.attr)
        if name in table.sensors:
            self._reads.sensors.add(name)
            if is_data and not holds_data(table.sensors[name].slot.type):
                _refuse(node)
        elif name in table.variables:
            self._reads.variables.add(name)
            if is_data:
                self._variable(node)
        elif name == "stopping":
            self._reads.stopping = True
        elif isinstance(found, property) and name not in _OF_ITSELF:
            self._enter(node, found.fget, [_MACHINE])
        elif name not in _OF_ITSELF:
            self._constant(node, name, found)

    def _variable(self, node: ast.Attribute) -> None:
        options = self._types.of(node)
        for each in options:
            if issubclass(kind_of(each), Polled):
                self._reads.machines.add("")  # whose text has its status
            elif not holds_data(each):
                _refuse(node)
        if not options:
            _refuse(node)

    # Calls

    def _call(self, node: ast.Call) -> None:
        match node.func:
            case ast.Attribute(ast.Name(self._code.machine), name):
                self._call_of_machine(node, name)
                return
        function = self._types.value_of(node.func)
        if function is isinstance and len(node.args) == 2:
            self._owner(node.args[0])
            kinds = node.args[1]
            for each in kinds.elts if isinstance(kinds, ast.Tuple) else [kinds]:
                if not is_ordinary(self._types.value_of(each)):
                    _refuse(each)
            return
        self._arguments(node)
        if function is MISSING and isinstance(node.func, ast.Attribute):
            self._method(node, node.func)
        elif isinstance(function, FunctionType):
            self._enter(node.func, function, *self._given(node))
        elif is_message(function):
            if not _is_made_plainly(function):
                _refuse(node.func)
        elif not only_computes(function) or any(
            each.arg in ("key", None) for each in node.keywords
        ):
            _refuse(node.func)

    def _arguments(self, node: ast.Call) -> None:
        self._values(node.args)
        self._values(each.value for each in node.keywords)

    def _given(self, node: ast.Call, *before: Options) -> tuple[list[Options], dict[str, Options]]:
        """Collect the types of arguments; of those behind a star nothing is known."""
        if any(isinstance(each, ast.Starred) for each in node.args):
            return [*before], {}
        named = {each.arg: self._types.of(each.value) for each in node.keywords if each.arg}
        return [*before, *map(self._types.of, node.args)], named

    def _call_of_machine(self, node: ast.Call, name: str) -> None:
        self._arguments(node)
        found = self._whole.found(name)
        match node.args:
            case [ast.Constant(int(limit) | float(limit))] if name in CLOCK and not node.keywords:
                self._reads.limits_ns.add(limit * CLOCK[name])
            case [_] if name in CLOCK and not node.keywords:
                self._reads.reads_time = True
            case [ast.Constant(str(other))] if name in _STATUSES and not node.keywords:
                self._reads.machines.add(other)
            case [_] if name in _STATUSES and not node.keywords:
                self._reads.machines.add("")
            case _ if name in self._whole.table.variables:
                _refuse(node.func)
            case _ if isinstance(found, staticmethod):
                self._enter(node.func, found.__func__, *self._given(node))
            case _:
                self._enter(node.func, found, *self._given(node, _MACHINE))

    def _method(self, node: ast.Call, func: ast.Attribute) -> None:
        """Follow the method of a value: a message's, or one that only computes."""
        self._owner(func.value)
        for kind in self._kinds(func.value):
            if func.attr in METHODS.get(kind, ()):
                self.value(func.value)
                continue
            if not is_message(kind):
                _refuse(func)
            found = _class_attribute(kind, func.attr)
            if isinstance(found, staticmethod):
                self._enter(func, found.__func__, *self._given(node))
            else:
                self._enter(func, found, *self._given(node, (kind,)))

    def _enter(
        self,
        node: ast.expr,
        function: object,
        arguments: Sequence[Options],
        named: Mapping[str, Options] = MappingProxyType({}),
    ) -> None:
        if not isinstance(function, FunctionType) or str(function.__module__).startswith(_ENGINE):
            _refuse(node)  # it is in no text, or is what every machine has, as requests
        try:
            self._whole.enter(function, arguments, named)
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
    """Name what comprehensions and lambdas in some code bind, each for itself."""
    nodes = (each for part in body for each in ast.walk(part))
    return {name for each in nodes if isinstance(each, _SCOPES) for name in inner_names(each)}


def _enclosing(function: FunctionType) -> dict[str, Any]:
    """Map the variables around a function to what they have now; `MISSING` if nothing."""
    names = function.__code__.co_freevars
    found = dict.fromkeys(names, MISSING)  # hides what the module has of the same name
    for name, cell in zip(names, function.__closure__ or (), strict=True):
        with suppress(ValueError):  # it is empty
            found[name] = cell.cell_contents
    return found


def _class_attribute(kind: Any, name: str) -> Any:
    return next((vars(each)[name] for each in kind.__mro__ if name in vars(each)), MISSING)


def _is_made_plainly(message: type[msgspec.Struct]) -> bool:
    """Check that to make a message runs no code of its class."""
    makers = {each.default_factory for each in msgspec.structs.fields(message)}
    own = makers - {msgspec.NODEFAULT, *FUNCTIONS}
    return holds_data(message) and not hasattr(message, "__post_init__") and not own
