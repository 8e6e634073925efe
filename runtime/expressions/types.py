"""The types that expressions have, as far as messages, variables and literals determine them.

An expression's `Options` are the types one of which its value has. They are empty where they are
unknown: then no rule of the checker finds anything, as nothing wrong is known of values from
elsewhere, and no guard is closed. So a type is given only if it is certain: that of a name of the
code's own only if it is bound once, and that of an operator's result only for built-in operands.
"""

from __future__ import annotations

import ast
import builtins
import sys
from collections.abc import Callable, Iterator, Mapping
from datetime import date
from enum import Enum
from functools import cache
from types import FunctionType, GeneratorType, MethodType, ModuleType, NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Final,
    Literal,
    TypeAlias,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec

from llfsm.runtime.engine.table import Table
from llfsm.runtime.expressions.reads import Code, assigned_values, nodes_of

Options: TypeAlias = tuple[Any, ...]

MISSING: Final = object()
"""Stands for the value of what is no name of a module."""
NUMBERS: Final = {bool, int, float}
PLAIN: Final = NUMBERS | {str, NoneType}
BUILT_IN: Final = NUMBERS | {bytes, dict, frozenset, list, set, str, tuple}
_UNKNOWN: Options = ()
_RESULTS: dict[Callable[..., Any], type] = {
    all: bool, any: bool, bool: bool, callable: bool, chr: str, dict: dict, float: float,
    frozenset: frozenset, hasattr: bool, input: str, int: int, isinstance: bool, len: int,
    list: list, ord: int, repr: str, set: set, sorted: list, str: str, tuple: tuple,
}  # fmt: skip
_DISPLAYS = {
    ast.Tuple: tuple, ast.List: list, ast.Dict: dict, ast.Set: set, ast.JoinedStr: str,
    ast.ListComp: list, ast.DictComp: dict, ast.SetComp: set, ast.GeneratorExp: GeneratorType,
}  # fmt: skip
_RETURN_NONE: dict[Any, set[str]] = {
    list: {"append", "clear", "extend", "insert", "remove", "reverse", "sort"},
    set: {"add", "clear", "discard", "remove", "update"},
    dict: {"clear", "update"},
}
_COLLECTIONS = (tuple, list, set, frozenset)


def options_of(annotation: Any) -> Options:
    """List the types that an annotation allows; none if one of them is unknown."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return options_of(get_args(annotation)[0])
    if origin is Literal:
        return tuple(dict.fromkeys(type(value) for value in get_args(annotation)))
    if origin in (Union, UnionType):
        return _joined([options_of(each) for each in get_args(annotation)])
    if annotation is None:
        return (NoneType,)
    if annotation in (Any, object):
        return _UNKNOWN
    return (annotation,) if isinstance(origin or annotation, type) else _UNKNOWN


@cache
def fields_of(message: type[msgspec.Struct]) -> dict[str, msgspec.structs.FieldInfo]:
    """Map the fields of a message class by name; none if its annotations do not resolve."""
    try:
        return {field.name: field for field in msgspec.structs.fields(message)}
    except (NameError, AttributeError, TypeError):
        return {}


def kind_of(option: Any) -> Any:
    """Give the class of a type, without its parameters: list of list[int]."""
    return get_origin(option) or option


def is_message(option: Any) -> bool:
    """Check that a type is a message class."""
    return isinstance(option, type) and issubclass(option, msgspec.Struct)


def may_be(node: ast.expr, given: Options, annotation: Any) -> bool:
    """Check if an expression with the types `given` may have a value of `annotation`."""
    wanted = options_of(annotation)
    if not (given and wanted):
        return True
    try:
        value = ast.literal_eval(node)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        return any(_fits(one, other) for one in given for other in wanted)
    try:
        msgspec.convert(value, annotation)
    except msgspec.ValidationError:
        return False
    except TypeError:  # msgspec does not know the type
        return any(_fits(one, other) for one in given for other in wanted)
    return True


def named(options: Options) -> str:
    """Write types for a finding, as "int or None"."""
    names = [
        "None" if each is NoneType else getattr(each, "__name__", str(each)) for each in options
    ]
    return " or ".join(dict.fromkeys(names))


class Types:
    """The types of the expressions in one piece of a machine's code.

    `given` are those of its parameters, where they are known.
    """

    def __init__(self, code: Code, table: Table, given: Mapping[str, Options] | None = None):
        self._machine = code.machine
        self._names: Mapping[str, Any] = code.names
        self._table = table
        self._locals = assigned_values(code)
        self._given = given or {}
        self._under_way: set[str] = set()
        self._imported = dict(_imported(code))

    def of(self, node: ast.expr) -> Options:
        """Infer the types of an expression."""
        match node:
            case ast.Constant(value):
                return (type(value),)
            case ast.Attribute(ast.Name(self._machine), name):
                return self._of_attribute(name)
            case ast.Attribute(value, name):
                return self._of_field(value, name) or self._of_known(node)
            case ast.Name(name) if name in self._locals:
                return self._of_local(name)
            case ast.Name(name) if name in self._given:
                return self._given[name]
            case ast.Name():
                return self._of_known(node)
            case ast.Call():
                return self._of_call(node)
            case ast.NamedExpr(_, value):
                return self.of(value)
            case ast.BoolOp(op, values):
                return self._of_operands(op, values)
            case ast.UnaryOp(ast.Not()):
                return (bool,)
            case ast.UnaryOp(ast.USub(), operand):
                found = self.of(operand)
                return found if {*found} <= {int, float} else _UNKNOWN
            case ast.BinOp(left, op, right):
                return self._of_arithmetic(op, self.of(left), self.of(right))
            case ast.Compare():
                return self._of_comparison(node)
            case ast.IfExp(_, body, orelse):
                return _joined([self.of(body), self.of(orelse)])
            case ast.Subscript(value, index):
                return _of_item(self.of(value), index)
        return (_DISPLAYS[type(node)],) if type(node) in _DISPLAYS else _UNKNOWN

    def value_of(self, node: ast.expr) -> Any:
        """Find what a name of the module, or of what is in it, stands for; else `MISSING`."""
        match node:
            case ast.Name(name) if name in self._imported:
                return self._imported[name]
            case ast.Name(name) if not self.is_own(name):
                return self._names.get(name, getattr(builtins, name, MISSING))
            case ast.Attribute(value, name):
                within = self.value_of(value)
                if isinstance(within, ModuleType) or (
                    isinstance(within, type) and issubclass(within, Enum | date)
                ):
                    return getattr(within, name, MISSING)
        return MISSING

    def is_own(self, name: str) -> bool:
        """Check if a name is one of the code's own, or of a parameter that is given."""
        return name in self._locals or name in self._given

    def origin(self, node: ast.expr) -> ast.expr:
        """Follow a name of the code's own to the only value that it gets, as far as it has one."""
        followed: set[str] = set()
        while isinstance(node, ast.Name) and node.id not in followed:
            followed.add(node.id)
            node = self._locals.get(node.id) or node
        return node

    def assigned(self, name: str) -> ast.expr | None:
        """Give the only value that the code gives a name of its own; None if there are others."""
        return self._locals.get(name)

    def _of_attribute(self, name: str) -> Options:
        if name in self._table.sensors:
            sensor = self._table.sensors[name]
            return tuple(dict.fromkeys((sensor.slot.type, type(sensor.default))))
        if name in self._table.variables:
            return options_of(self._table.variables[name].type)
        found = getattr(self._table.states[0].owner, name, None)
        if isinstance(found, FunctionType):
            return (MethodType,)
        return _result(found.fget) if isinstance(found, property) else _UNKNOWN

    def _of_field(self, value: ast.expr, name: str) -> Options:
        options = [each for each in self.of(value) if each is not NoneType]
        if not all(map(is_message, options)):
            return _UNKNOWN
        fields = [fields_of(each)[name] for each in options if name in fields_of(each)]
        return _joined([options_of(field.type) for field in fields])

    def _of_local(self, name: str) -> Options:
        value = self._locals[name]
        if value is None or name in self._under_way:
            return _UNKNOWN
        self._under_way.add(name)
        found = self.of(value)
        self._under_way.remove(name)
        return found

    def _of_known(self, node: ast.expr) -> Options:
        """Type a module, a class, an enum's member, or a constant in capitals."""
        value = self.value_of(node)
        name = node.id if isinstance(node, ast.Name) else getattr(node, "attr", "")
        simple = isinstance(value, bool | int | float | str | msgspec.Struct)
        if isinstance(value, Enum | ModuleType | type) or (simple and name.isupper()):
            return (type(value),)
        return _UNKNOWN

    def _of_call(self, node: ast.Call) -> Options:
        match node.func:
            case ast.Attribute(ast.Name(self._machine), name):
                return _result(getattr(self._table.states[0].owner, name, None))
            case ast.Attribute(value, name):
                kinds = [*map(kind_of, self.of(value))]
                if kinds and all(name in _RETURN_NONE.get(each, set()) for each in kinds):
                    return (NoneType,)
        called = self.value_of(node.func)
        if is_message(called):
            return (called,)
        if called is round and len(node.args) == 1 and {*self.of(node.args[0])} <= NUMBERS:
            return (int,)
        known = isinstance(called, type | type(len)) and called in _RESULTS
        return (_RESULTS[called],) if known else _UNKNOWN

    def _of_operands(self, op: ast.boolop, values: list[ast.expr]) -> Options:
        """Type `and`, which gives a false operand or the last, and `or`: a true one or the last."""
        found = [self.of(each) for each in values]
        if not all(found):
            return _UNKNOWN
        never = NoneType if isinstance(op, ast.Or) else msgspec.Struct
        kept = [
            each
            for options in found[:-1]
            for each in options
            if not (isinstance(each, type) and issubclass(each, never))
        ]
        return tuple(dict.fromkeys([*kept, *found[-1]]))

    def _of_arithmetic(self, op: ast.operator, left: Options, right: Options) -> Options:
        both = {*left, *right}
        if not (left and right and both <= NUMBERS) or isinstance(op, ast.Pow | ast.MatMult):
            return _UNKNOWN
        if isinstance(op, ast.BitAnd | ast.BitOr | ast.BitXor) and both == {bool}:
            return (bool,)
        return (float,) if isinstance(op, ast.Div) or float in both else (int,)

    def _of_comparison(self, node: ast.Compare) -> Options:
        if all(isinstance(op, ast.Is | ast.IsNot | ast.In | ast.NotIn) for op in node.ops):
            return (bool,)
        known = all(self.of(each) for each in (node.left, *node.comparators))
        return (bool,) if known else _UNKNOWN  # an array's comparison is an array


def _imported(code: Code) -> Iterator[tuple[str, Any]]:
    """Yield what the code imports itself, by its names there; nothing is imported for that."""
    for node in nodes_of(code):
        match node:
            case ast.Import(aliases):
                for alias in aliases:
                    name = alias.name if alias.asname else alias.name.partition(".")[0]
                    yield alias.asname or name, sys.modules.get(name, MISSING)
            case ast.ImportFrom(str(module), aliases, 0):
                for alias in aliases:
                    found = getattr(sys.modules.get(module), alias.name, MISSING)
                    yield alias.asname or alias.name, found


def _joined(several: list[Options]) -> Options:
    if not all(several):
        return _UNKNOWN
    return tuple(dict.fromkeys(each for options in several for each in options))


def _fits(given: Any, wanted: Any) -> bool:
    """Check if a value of one type may be of another."""
    one, other = kind_of(given), kind_of(wanted)
    if other is float and one is int:
        return True
    if one is bool:
        return other in (bool, object)
    if one in _COLLECTIONS and other in _COLLECTIONS:
        return True
    return issubclass(one, other) or issubclass(other, one)


def _of_item(options: Options, index: ast.expr) -> Options:
    """Type an item of a tuple or of a string."""
    if len(options) != 1 or isinstance(index, ast.Slice):
        return _UNKNOWN
    collection: Any = options[0]
    if collection is str:
        return (str,)
    if get_origin(collection) is not tuple:
        return _UNKNOWN
    items = get_args(collection)
    return _joined([options_of(each) for each in items if each is not ...])


def hints_of(function: object) -> dict[str, Any]:
    """Map what a function in Python annotates to types; none if they do not resolve."""
    try:
        return get_type_hints(function) if isinstance(function, FunctionType) else {}
    except (NameError, TypeError, AttributeError):
        return {}


def _result(function: object) -> Options:
    return options_of(hints_of(function).get("return", Any))
