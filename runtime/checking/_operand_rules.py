"""The rules for what operators are applied to, and for code that computes to no purpose.

Four kinds of them need the types of expressions: None where it is known, or may be (`of_none`,
`of_none_inside`, `of_optional`); operands that do not go together (`of_comparison`, `of_operator`,
`of_division`, `of_items`); code that does nothing, or always the same (`of_effectless`,
`of_identity`, `of_condition`); and what was meant otherwise (`of_sign`, `of_hidden`, `of_text`).
`typed_rules` lists them with the nodes that they are for.

That a sensor or field may be None is only found if no code of the machine ever looks: in which
states it has been looked at is not known here.
"""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Iterator, Sequence
from enum import Enum, EnumMeta
from itertools import pairwise, product
from math import inf, nan
from types import MethodType, NoneType
from typing import Any, Literal, NamedTuple, TypeAlias, get_args, get_origin

import msgspec

from llfsm.runtime.checking._subject import Finding, Piece, Subject
from llfsm.runtime.engine.table import Table
from llfsm.runtime.expressions.reads import Code, nodes_of, uses_of
from llfsm.runtime.expressions.types import (
    BUILT_IN,
    NUMBERS,
    PLAIN,
    Options,
    Types,
    fields_of,
    is_message,
    kind_of,
    named,
)
from llfsm.whiteboard import Message

# None, where it is known


def of_none(piece: Piece, node: ast.BoolOp) -> Iterator[Finding]:
    """Find attributes of what is None there, as in `x is None and x.y`, or is tested only later."""
    met = isinstance(node.op, ast.And)
    none: dict[str, str] = {}
    for place, value in enumerate(node.values):
        unknown = none.keys() - _looked_at_again(value)
        for name, at in _used(value):
            if name in unknown:
                text = f"{name} is None here; was {none[name]} meant?"
                yield piece.finding(at, "error", text)
        tested = _tested(piece, value)
        if tested is None:
            continue
        name, is_none, other = tested
        if is_none is met:
            none[name] = other
        else:
            used = {each: at for part in node.values[:place] for each, at in _used(part)}
            if name in used and name not in _looked_at_again(*node.values[:place]):
                text = f"{name} is used here before it is tested: put the test first"
                yield piece.finding(used[name], "warning", text)


def of_none_inside(piece: Piece, node: ast.If) -> Iterator[Finding]:
    """Find attributes of what an `if` has just found to be None."""
    tested = _tested(piece, node.test)
    if tested is None:
        return
    name, is_none, other = tested
    body = node.body if is_none else node.orelse
    given = {ast.unparse(e) for part in body for e in _given(part)}
    if name in given | _looked_at_again(*body):
        return
    if not name.isidentifier() and not _is_sensor(piece, name):
        return  # what the code calls may change it
    for part in body:
        for used, at in _used(part):
            if used == name:
                text = f"{name} is None here; was {other} meant?"
                yield piece.finding(at, "error", text)
                return


def _tested(piece: Piece, value: ast.expr) -> tuple[str, bool, str] | None:
    """Read a test for None: what it tests, if it is True for None alone, and the opposite test."""
    match value:
        case ast.Compare(left, [ast.Is()], [ast.Constant(None)]) if not _has_call(left):
            return ast.unparse(left), True, "'is not None'"
        case ast.Compare(left, [ast.IsNot()], [ast.Constant(None)]) if not _has_call(left):
            return ast.unparse(left), False, "'is None'"
        case ast.UnaryOp(ast.Not(), left) if _is_message_or_none(piece, left):
            return ast.unparse(left), True, f"{ast.unparse(left)!r}"
        case ast.Attribute() | ast.Name() if _is_message_or_none(piece, value):
            return ast.unparse(value), False, f"'not {ast.unparse(value)}'"
    return None


def _is_message_or_none(piece: Piece, node: ast.expr) -> bool:
    """Check that of the values of an expression only None is false."""
    options = piece.types.of(node)
    messages = [each for each in options if each is not NoneType]
    plain = all(
        is_message(e) and not hasattr(e, "__bool__") and not hasattr(e, "__len__") for e in messages
    )
    return NoneType in options and bool(messages) and plain and not _has_call(node)


def _is_sensor(piece: Piece, name: str) -> bool:
    machine, _, sensor = name.partition(".")
    return machine == piece.code.machine and sensor.partition(".")[0] in piece.table.sensors


def _used(part: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Find what has its attributes read in some code, is computed with or ordered, and where."""
    for each in ast.walk(part):
        match each:
            case ast.Attribute(value):
                yield ast.unparse(value), each
            case ast.BinOp(left, op, right) if not isinstance(op, ast.Mod | ast.BitOr):
                yield from ((ast.unparse(one), each) for one in (left, right))
            case ast.Compare(left, [op], [right]) if isinstance(op, _ORDERS):
                yield from ((ast.unparse(one), each) for one in (left, right))


def _looked_at_again(*parts: ast.AST) -> set[str]:
    """Name what is compared or gets another value inside, as in `x is None or (x and x.y)`."""
    found: list[ast.expr] = []
    for each in (each for part in parts for each in ast.walk(part)):
        match each:
            case ast.BoolOp(_, values):
                found += values
            case ast.Compare(_, [op]) if isinstance(op, _ORDERS):
                pass  # which None does not survive
            case ast.Compare(one) | ast.IfExp(one) | ast.If(one) | ast.While(one):
                found.append(one)
            case ast.UnaryOp(ast.Not(), one) | ast.NamedExpr(one):
                found.append(one)
    return {ast.unparse(each) for each in found}


def _given(part: ast.AST) -> Iterator[ast.expr]:
    """Find what gets another value."""
    for each in ast.walk(part):
        if isinstance(each, ast.Name | ast.Attribute) and isinstance(each.ctx, ast.Store):
            yield each


def _has_call(node: ast.AST) -> bool:
    return any(isinstance(each, ast.Call) for each in ast.walk(node))


# Operands that do not go together


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
    """Give the same to all types whose values may be equal; None to those that are unknown."""
    if option in (bool, int, float):
        return "number"
    if option in (str, bytes, NoneType):
        return option
    if is_message(option):
        return "message" if option.__eq__ is msgspec.Struct.__eq__ else None
    if isinstance(option, type) and issubclass(option, Enum):
        mixed = issubclass(option, int | float | str | bytes) or option.__eq__ is not Enum.__eq__
        return None if mixed else option
    return None


def _member(options: Options, value: ast.expr) -> str:
    """Suggest the member of an enum that was meant by its value, if one was."""
    for option in options:
        if isinstance(value, ast.Constant) and isinstance(option, EnumMeta):
            members: list[Enum] = list(option)
            for member in members:
                if member.value == value.value:
                    return f"; did you mean {option.__name__}.{member.name}?"
    return ""


def of_operator(piece: Piece, node: ast.BinOp | ast.Compare) -> Iterator[Finding]:
    """Find operands that an operator does not take, such as messages, methods and texts."""
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
        kinds = [{*map(kind_of, one)} for one in (left, right)]
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
    """Check if an operator takes values of two built-in types; True where that is unknown."""
    if isinstance(op, ast.Eq | ast.NotEq) or not {one, other} <= BUILT_IN:
        return True
    numbers = [each in NUMBERS for each in (one, other)]
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


_SEQUENCES = {bytes, list, str, tuple}
_ORDERS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
_ORDERING = ["__lt__", "__le__", "__gt__", "__ge__"]
_ARITHMETIC = ["__add__", "__radd__", "__sub__", "__rsub__", "__mul__", "__rmul__", "__mod__",
               "__truediv__", "__rtruediv__", "__pow__", "__matmul__", "__or__"]  # fmt: skip


def _defines(messages: Sequence[Any], special: Sequence[str]) -> bool:
    """Check if a message class, or a parent of its own, defines one of these methods."""
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
    if divides and zero and not piece.catches:
        yield piece.finding(node, "error", "this divides by 0")


def of_items(piece: Piece, node: ast.AST) -> Iterator[Finding]:
    """Find items, lengths and loops of what has none, and those that a tuple does not have."""
    match node:
        case ast.Subscript(value) if isinstance(piece.types.value_of(value), type):
            return  # a generic class, as list[float]
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


def of_nothing(piece: Piece, node: ast.Call) -> Iterator[Finding]:
    """Find the least or greatest of a sensor's field that its default leaves empty."""
    match node:
        case ast.Call(called, [value], []) if piece.types.value_of(called) in (min, max):
            path = ast.unparse(value).split(".")
        case _:
            return
    if path[0] != piece.code.machine or path[1] not in piece.table.sensors:
        return
    found: Any = piece.table.sensors[path[1]].default
    for name in path[2:]:
        found = getattr(found, name, None)
    text = ast.unparse(value)
    looked_at = sum(ast.unparse(each).count(text) for each in piece.code.body) > 1
    if isinstance(found, tuple | list | dict | str | bytes) and not found and not looked_at:
        what = f"{text} is empty at first, and {ast.unparse(called)} of nothing raises"
        yield piece.finding(node, "warning", f"{what}: give it a default=")


def _length(piece: Piece, value: ast.expr) -> int | None:
    """Count the items of a tuple, if its type tells their number."""
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
    kinds = [*map(kind_of, options)]
    if kinds and not any(hasattr(each, name) for each in kinds for name in methods):
        messages = [each for each in kinds if is_message(each)]
        fields = dict.fromkeys(name for each in messages for name in fields_of(each))
        more = f"; its fields are: {', '.join(fields)}" if fields else ""
        text = f"{ast.unparse(value)} is {named(options)}, which has no {what}{more}"
        yield piece.finding(value, "error", text)


# None, where no code looks for it

_Path: TypeAlias = tuple[str, ...]
"""A sensor's name, then those of fields."""
_Use: TypeAlias = Literal["needs a value", "tests", "hands on", "names"]

_NEED_A_VALUE = {abs, enumerate, float, int, len, list, max, min, round, sorted, sum, tuple}


class _Seen(NamedTuple):
    code: Code
    node: ast.expr
    types: Types


def of_optional(subject: Subject, table: Table) -> Iterator[Finding]:
    """Find sensors and fields that may be None where a value is needed."""
    if subject.opaque or any(uses_of(code).escapes for code in subject.all_code()):
        return  # code that is not here may look
    needed: dict[_Path, _Seen] = {}
    looked_at: set[_Path] = set()
    handed_on: set[_Path] = set()
    for code in subject.all_code():
        paths = _Paths(code, table)
        for node, path, use in paths.uses():
            if use == "needs a value":
                needed.setdefault(path, _Seen(code, node, paths.types))
            elif use != "names":
                looked_at.add(path)
                if use == "hands on":
                    handed_on.add(path)
    for path, seen in needed.items():
        above = {path[:length] for length in range(1, len(path))}
        if path in looked_at or not above.isdisjoint(handed_on):
            continue
        text = _of_sensor(path, table) if len(path) == 1 else _of_field(path, seen, looked_at)
        if text:
            yield Finding(seen.code.file, seen.node.lineno, "warning", text)


def _of_sensor(path: _Path, table: Table) -> str:
    if table.sensors[path[0]].default is not None:
        return ""
    return (
        f"sensor {path[0]!r} is None before its first message, and no code of the machine "
        f"checks for that: test it, or give it a default"
    )


def _of_field(path: _Path, seen: _Seen, looked_at: set[_Path]) -> str:
    *within, field = path
    if any(len(each) == len(path) and [*each[:-1]] == within for each in looked_at):
        return ""  # another field may decide it
    options = seen.types.of(seen.node)
    if type(None) not in options or len(options) == 1:
        return ""
    return (
        f"field {field!r} may be None, as it is {named(options)}, and no code of the machine "
        f"checks for that: test it"
    )


class _Paths:
    """The places where code names a sensor, or a field of its message."""

    def __init__(self, code: Code, table: Table):
        self.types = Types(code, table)
        self._code = code
        self._table = table
        self._parents = {
            child: node for node in nodes_of(code) for child in ast.iter_child_nodes(node)
        }

    def uses(self) -> Iterator[tuple[ast.expr, _Path, _Use]]:
        for node in nodes_of(self._code):
            if isinstance(node, ast.Attribute | ast.Name | ast.NamedExpr) and not isinstance(
                getattr(node, "ctx", None), ast.Store | ast.Del
            ):
                path = self._path(node)
                if path:
                    yield node, path, self._use(node, self._parents.get(node))

    def _path(self, node: ast.expr | None, deep: int = 8) -> _Path:
        match node:
            case ast.Attribute(ast.Name(self._code.machine), name):
                return (name,) if name in self._table.sensors else ()
            case ast.Attribute(value, name):
                within = self._path(value, deep)
                return (*within, name) if within else ()
            case ast.NamedExpr(_, value):
                return self._path(value, deep)
            case ast.Name(name) if deep:
                return self._path(self.types.assigned(name), deep - 1)
        return ()

    def _use(self, node: ast.expr, parent: ast.AST | None) -> _Use:
        match parent:
            case ast.Attribute():
                return "needs a value"
            case ast.Subscript(value) | ast.For(_, value) | ast.comprehension(_, value) if (
                value is node
            ):
                return "needs a value"
            case ast.UnaryOp(op):
                return "tests" if isinstance(op, ast.Not) else "needs a value"
            case ast.BinOp(left, op) if left is node or not isinstance(op, ast.Mod):
                return "needs a value"  # but % may write None into a text
            case ast.AugAssign(_, op, value) if value is node and not isinstance(op, ast.Mod):
                return "needs a value"
            case ast.Compare():
                return self._compared(node, parent)
            case ast.Call(called, [value, *_]) if value is node:
                function = self.types.value_of(called)
                known = isinstance(function, type | type(len)) and function in _NEED_A_VALUE
                return "needs a value" if known else "hands on"
            case ast.If() | ast.While() | ast.IfExp() | ast.BoolOp() | ast.Assert():
                return "tests"
            case ast.NamedExpr() | ast.Expr():
                return "names"
            case ast.Assign([ast.Name(name)]) if self._path(self.types.assigned(name)):
                return "names"
        return "hands on"

    def _compared(self, node: ast.expr, parent: ast.Compare) -> _Use:
        operands = [parent.left, *parent.comparators]
        place = operands.index(node)
        beside = [*parent.ops[max(place - 1, 0) : place + 1]]
        if any(isinstance(op, _ORDERS) for op in beside):
            return "needs a value"
        if place and isinstance(parent.ops[place - 1], ast.In | ast.NotIn):
            return "needs a value"
        others = operands[:place] + operands[place + 1 :]
        none = all(isinstance(each, ast.Constant) and each.value is None for each in others)
        return "tests" if none else "hands on"


# Code that does nothing, or does what was not meant


def of_effectless(piece: Piece, node: ast.Expr) -> Iterator[Finding]:
    """Find statements that only make a value."""
    match node.value:
        case ast.Compare(_, [ast.Eq()], _):
            text = "this compares, and does nothing else: write = to assign"
        case ast.Compare() | ast.BinOp() | ast.UnaryOp() | ast.Name() | ast.JoinedStr():
            text = "this makes a value that nothing uses"
        case ast.Attribute() if piece.types.of(node.value) not in ((), (MethodType,)):
            text = "this makes a value that nothing uses"
        case ast.Call(called) if is_message(piece.types.value_of(called)):
            text = "this makes a message that nothing posts: call an actuator with it"
            yield piece.finding(node, "warning", text)
            return
        case _:
            return
    if not piece.catches and not _has_call(node):
        yield piece.finding(node, "warning", text)


def of_identity(piece: Piece, node: ast.Compare) -> Iterator[Finding]:
    """Find numbers and texts that are compared by `is`."""
    for op, value in zip(node.ops, node.comparators, strict=True):
        plain = isinstance(value, ast.Constant) and isinstance(
            value.value, int | float | str | bytes
        )
        if isinstance(op, ast.Is | ast.IsNot) and plain and not _is_truth(value):
            shown = "==" if isinstance(op, ast.Is) else "!="
            text = f"'is' asks for the same object, not for an equal one: write {shown}"
            yield piece.finding(node, "warning", text)


def _is_truth(value: ast.expr) -> bool:
    return isinstance(value, ast.Constant) and isinstance(value.value, bool)


def of_sign(piece: Piece, node: ast.Assign) -> Iterator[Finding]:
    """Find =+ and =- where += and -= were meant."""
    match node.value:
        case ast.UnaryOp(ast.UAdd() | ast.USub() as sign, ast.Constant() as number):
            if number.col_offset == node.value.col_offset + 2:  # a blank after the sign
                shown = "+" if isinstance(sign, ast.UAdd) else "-"
                text = f"this assigns {shown}{number.value!r}: was {shown}= meant?"
                yield piece.finding(node, "warning", text)


def of_hidden(piece: Piece, node: ast.Assign | ast.AnnAssign) -> Iterator[Finding]:
    """Find values that code keeps for itself, under a variable's name, and never reads."""
    match node:
        case ast.Assign([ast.Name(name)]) | ast.AnnAssign(ast.Name(name)):
            pass
        case _:
            return
    if name in piece.table.variables and not any(
        isinstance(each, ast.Global | ast.Nonlocal)
        or (isinstance(each, ast.Name) and each.id == name and isinstance(each.ctx, ast.Load))
        for each in nodes_of(piece.code)
    ):
        text = f"this does not set the variable: write {piece.code.machine}.{name}"
        yield piece.finding(node, "warning", text)


def of_text(piece: Piece, node: ast.Assign | ast.Call) -> Iterator[Finding]:
    """Find texts that would be filled in if they began with f."""
    values = [node.value] if isinstance(node, ast.Assign) else node.args
    for value in values:
        match value:
            case ast.Constant(str(text)) if f"{{{piece.code.machine}." in text and "}" in text:
                what = 'this text is not filled in: write f before it, as f"..."'
                yield piece.finding(value, "warning", what)


def of_format(piece: Piece, node: ast.FormattedValue | ast.Call) -> Iterator[Finding]:
    """Find formats that the value does not take."""
    match node:
        case ast.FormattedValue(value, -1, ast.JoinedStr([ast.Constant(str(form))])):
            pass
        case ast.Call(ast.Name("format"), [value, ast.Constant(str(form))]):
            pass
        case _:
            return
    options = piece.types.of(value)
    if options and not any(_takes(kind_of(each), form) for each in options):
        text = f"{ast.unparse(value)} is {named(options)}, which takes no format {form!r}"
        yield piece.finding(value, "error", text)


def _takes(kind: Any, form: str) -> bool:
    """Check that values of a class can be formatted so; True where that is not known."""
    if not isinstance(kind, type):
        return True
    if kind in _SAMPLES:
        try:
            format(_SAMPLES[kind], form)
        except ValueError:
            return False
        return True
    return inspect.getattr_static(kind, "__format__") is not vars(object)["__format__"]


_SAMPLES: dict[type, Any] = {int: 1, float: 1.0, str: "", bool: True}


def of_condition(piece: Piece, node: ast.BoolOp | ast.Compare) -> Iterator[Finding]:
    """Find conditions on one value that nothing, or everything, satisfies."""
    if isinstance(node, ast.Compare):
        match node:
            case ast.Compare(one, [first, second], [_, other]):
                kinds, ends = {type(first), type(second)}, (_number(one), _number(other))
                if (kinds <= {ast.Lt, ast.LtE} and ends[0] > ends[1]) or (
                    kinds <= {ast.Gt, ast.GtE} and ends[0] < ends[1]
                ):
                    yield piece.finding(node, "warning", "this is never True: no value is between")
        return
    by_left: dict[str, list[tuple[ast.cmpop, ast.expr]]] = {}
    for value in node.values:
        match value:
            case ast.Compare(left, [op], [right]) if not _has_call(value):
                by_left.setdefault(ast.unparse(left), []).append((op, right))
    for name, parts in by_left.items():
        if isinstance(node.op, ast.And):
            low = max((_number(v) for op, v in parts if isinstance(op, _OVER)), default=-inf)
            high = min((_number(v) for op, v in parts if isinstance(op, _UNDER)), default=inf)
            if low > high or len(_constants(parts, ast.Eq)) > 1:
                text = f"this is never True: no {name} satisfies all of it; was 'or' meant?"
                yield piece.finding(node, "warning", text)
        elif len(_constants(parts, ast.NotEq)) > 1:
            text = f"this is always True: {name} always differs from one; was 'and' meant?"
            yield piece.finding(node, "warning", text)


_OVER = (ast.Gt, ast.GtE)
_UNDER = (ast.Lt, ast.LtE)


def _constants(parts: list[tuple[ast.cmpop, ast.expr]], kind: type[ast.cmpop]) -> set[str]:
    return {
        repr(value.value)
        for op, value in parts
        if isinstance(op, kind) and isinstance(value, ast.Constant) and not _is_truth(value)
    }


def _number(node: ast.expr) -> float:
    """Read the number that is written there; nan, which satisfies no comparison, without one."""
    if _is_truth(node):
        return nan
    match node:
        case ast.UnaryOp(ast.USub(), operand):
            return -_number(operand)
        case ast.Constant(int(value) | float(value)):
            return value
    return nan
