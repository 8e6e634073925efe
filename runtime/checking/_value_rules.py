"""The rules for what code gives to functions and takes from them, and for loops and branches.

Each finds what fails whenever it runs, or has no effect:

* arguments that a function of Python does not take (`of_arguments`); values that are called, raised
  or unpacked as what they are not (`of_called`, `of_raised`, `of_pairs`, `of_key`); None as an
  operand (`of_none_operand`); methods that are negated and not called (`of_negation`);
* collections that change while a loop goes over them (`of_changed_loop`), branches to which those
  before leave nothing (`of_branches`), functions that only call themselves (`recursions`);
* variables that are deleted (`of_deleted`) or changed for all machines (`of_default`), and what
  sections return (`returned_values`).

`own_posts` finds guards that look at what their own state has just posted, one turn too early.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import math
from collections.abc import Iterator, Sequence
from math import inf
from types import MethodType, NoneType
from typing import Any, Final, NamedTuple

from llfsm.runtime.checking._subject import Finding, Piece, Subject
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.table import Table
from llfsm.runtime.expressions.reads import CLOCK, nodes_of, uses_of
from llfsm.runtime.expressions.types import BUILT_IN, is_message, kind_of, named

_LONG: Final = {"comb", "factorial", "perm", "prod"}
_COMPUTE: Final = {
    *(abs, bool, chr, float, int, len, max, min, ord, round, str, sum),
    *(each for name, each in vars(math).items() if callable(each) and name not in _LONG),
}
"""Functions that may be called here with what is written in code: they do nothing else."""
_ORDERS: Final = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)


def of_arguments(piece: Piece, node: ast.Call) -> Iterator[Finding]:
    """Find arguments that functions of Python and its `math` do not take."""
    function = piece.types.value_of(node.func)
    if not _is_of_python(function) or piece.catches:
        return
    starred = any(isinstance(each, ast.Starred) for each in node.args)
    if starred or any(each.arg is None for each in node.keywords):
        return
    name = ast.unparse(node.func)
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # which some do not have
        signature = None
    if signature is not None:
        try:
            signature.bind(*node.args, **{str(each.arg): each.value for each in node.keywords})
        except TypeError as error:
            yield piece.finding(node, "error", f"{name}: {error}")
            return
    if function is range:
        for each in node.args:
            if {*piece.types.of(each)} == {float}:
                text = f"range counts by whole numbers; {ast.unparse(each)} is float"
                yield piece.finding(each, "error", text)
    elif function in _COMPUTE and node.args and not node.keywords:
        try:
            function(*map(ast.literal_eval, node.args))
        except (ArithmeticError, TypeError, ValueError) as error:
            if not _is_unwritten(node.args):
                text = f"{ast.unparse(node)} raises {type(error).__name__}: {error}"
                yield piece.finding(node, "error", text)
        except (SyntaxError, MemoryError, RecursionError):
            pass


def _is_of_python(function: Any) -> bool:
    """Check for a function or class of the builtins or of `math`."""
    name = getattr(function, "__name__", None)
    return isinstance(name, str) and any(
        vars(home).get(name) is function for home in (builtins, math)
    )


def _is_unwritten(arguments: Sequence[ast.expr]) -> bool:
    """Check for arguments whose values are not written in the code."""
    try:
        [*map(ast.literal_eval, arguments)]
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        return True
    return False


def of_called(piece: Piece, node: ast.Call) -> Iterator[Finding]:
    """Find numbers, texts and collections that are called as functions."""
    match node.func:
        case ast.Attribute(ast.Name(piece.code.machine)):
            return  # of which there are other rules
    options = piece.types.of(node.func)
    if options and all(kind_of(each) in BUILT_IN or is_message(each) for each in options):
        text = f"{ast.unparse(node.func)} is {named(options)}, not a function"
        yield piece.finding(node, "error", text)


def of_raised(piece: Piece, node: ast.Raise) -> Iterator[Finding]:
    """Find what is raised though it is no exception."""
    options = () if node.exc is None else piece.types.of(node.exc)
    if options and all(kind_of(each) in BUILT_IN or is_message(each) for each in options):
        text = f"{ast.unparse(node.exc or node)} is no exception: raise RuntimeError(...), say"
        yield piece.finding(node, "error", text)


def of_pairs(piece: Piece, node: ast.For | ast.comprehension) -> Iterator[Finding]:
    """Find loops over None, and over pairs that are taken apart into another number of names."""
    if piece.types.of(node.iter) == (NoneType,):
        yield piece.finding(
            node.iter, "error", f"{ast.unparse(node.iter)} is None: it has no items"
        )
    match node.target, node.iter:
        case ast.Tuple(names), ast.Call(ast.Attribute(value, "items"), [], []) if _kinds(
            piece, value
        ) == {dict}:
            number = 2
        case ast.Tuple(names), ast.Call(called, arguments, _):
            function = piece.types.value_of(called)
            if function not in (enumerate, zip) or any(
                isinstance(each, ast.Starred) for each in arguments
            ):
                return
            number = 2 if function is enumerate else len(arguments)
        case _:
            return
    if len(names) != number and not any(isinstance(each, ast.Starred) for each in names):
        text = f"{ast.unparse(node.iter)} gives {number} values at a time, not {len(names)}"
        yield piece.finding(node.target, "error", text)


def _kinds(piece: Piece, node: ast.expr) -> set[Any]:
    return {*map(kind_of, piece.types.of(node))}


def of_none_operand(piece: Piece, node: ast.BinOp | ast.Compare) -> Iterator[Finding]:
    """Find operands that are None, and no number."""
    if isinstance(node, ast.BinOp):
        operands = [] if isinstance(node.op, ast.BitOr | ast.Mod) else [node.left, node.right]
    else:
        pairs = zip([node.left, *node.comparators], [*node.ops, node.ops[-1]], strict=True)
        operands = [each for each, op in pairs if isinstance(op, _ORDERS)]
    for each in operands:
        match each:
            case ast.Call(ast.Attribute(value, "get"), [_], []) if _kinds(piece, value) == {dict}:
                text = f"{ast.unparse(each)} is None where there is no such key: give it a default"
                yield piece.finding(each, "warning", text)
        if piece.types.of(each) == (NoneType,):
            text = f"{ast.unparse(each)} is None, which is no number"
            yield piece.finding(node, "error", text)
            return


def of_key(piece: Piece, node: ast.Subscript) -> Iterator[Finding]:
    """Find items that are asked for by a text where items have numbers."""
    match node.slice:
        case ast.Constant(str(key)):
            kinds = _kinds(piece, node.value) - {NoneType}
            if kinds and kinds <= {list, tuple, str, bytes}:
                options = piece.types.of(node.value)
                text = f"{ast.unparse(node.value)} is {named(options)}, whose items have numbers"
                yield piece.finding(node, "error", f"{text}, not names as {key!r}")


def of_negation(piece: Piece, node: ast.UnaryOp) -> Iterator[Finding]:
    """Find methods of the machine that are negated and not called."""
    if isinstance(node.op, ast.Not) and piece.types.of(node.operand) == (MethodType,):
        method = ast.unparse(node.operand)
        text = f"not {method} is always False: call it, as not {method}()"
        yield piece.finding(node, "error", text)


def of_deleted(piece: Piece, node: ast.Delete) -> Iterator[Finding]:
    """Find variables that are deleted."""
    for target in node.targets:
        match target:
            case ast.Attribute(ast.Name(piece.code.machine), name) if name in piece.table.variables:
                text = f"variable {name!r} cannot be deleted: assign to it, such as its default"
                yield piece.finding(target, "error", text)


def of_default(piece: Piece, node: ast.Attribute) -> Iterator[Finding]:
    """Find code that changes what all machines of a class begin with."""
    match node:
        case ast.Attribute(ast.Attribute(ast.Name() as owner, name) as changed, method) if (
            method in _CHANGES
        ):
            pass
        case ast.Attribute(ast.Name() as owner, name, ast.Store()) as changed:
            pass
        case _:
            return
    cls = piece.types.value_of(owner)
    if isinstance(cls, type) and issubclass(cls, Machine) and name in cls.table.variables:
        text = f"{ast.unparse(changed)} is what every {cls.__name__} begins with"
        text += f": write {piece.code.machine}.{name}"
        yield piece.finding(changed, "error", text)


_CHANGES: Final = frozenset({
    *("add", "append", "clear", "discard", "extend", "insert", "pop", "popitem", "remove"),
    "update",
})  # fmt: skip


def of_changed_loop(piece: Piece, node: ast.For) -> Iterator[Finding]:
    """Find collections that a loop over them makes longer or shorter."""
    inside = [each for part in node.body for each in ast.walk(part)]
    if any(isinstance(each, ast.Break | ast.Return | ast.Raise) for each in inside):
        return  # it may end before anything goes wrong
    looped = ast.unparse(node.iter)
    for each in inside:
        match each:
            case ast.Call(ast.Attribute(value, name)) if (
                name in _CHANGES
                and ast.unparse(value) == looped
                and _kinds(piece, value) & {list, dict, set}
            ):
                text = f"{looped} changes while this loop goes over it: loop over a copy of it"
                yield piece.finding(each, "warning", text)
                return


class _Range(NamedTuple):
    """The values of an expression that satisfy a condition, as its bounds and their strictness."""

    low: float
    above: bool
    high: float
    below: bool

    def includes(self, other: _Range) -> bool:
        """Check that all values of another range are in this one."""
        low = (self.low, self.above) <= (other.low, other.above)
        return low and (-self.high, self.below) <= (-other.high, other.below)


def of_branches(piece: Piece, node: ast.If) -> Iterator[Finding]:
    """Find an `elif` whose values an `if` before it has taken."""
    before: list[tuple[str, _Range]] = []
    while True:
        found = _range(node.test)
        if found is not None:
            if any(name == found[0] and each.includes(found[1]) for name, each in before):
                text = "this branch is never taken: one before it is, whenever this is True"
                yield piece.finding(node.test, "warning", text)
                return
            before.append(found)
        match node.orelse:
            case [ast.If() as node]:
                continue
        return


def _range(test: ast.expr) -> tuple[str, _Range] | None:
    """Read a comparison with a number: what is compared, and the values that satisfy it."""
    match test:
        case ast.Compare(left, [op], [ast.Constant(int(value) | float(value))]):
            if any(isinstance(each, ast.Call) for each in ast.walk(left)):
                return None
            name = ast.unparse(left)
            match op:
                case ast.Gt() | ast.GtE():
                    return name, _Range(value, isinstance(op, ast.Gt), inf, False)
                case ast.Lt() | ast.LtE():
                    return name, _Range(-inf, False, value, isinstance(op, ast.Lt))
                case ast.Eq():
                    return name, _Range(value, False, value, False)
    return None


def recursions(subject: Subject) -> Iterator[Finding]:
    """Find functions of the machine that call themselves whatever comes."""
    for name, code in subject.methods.items():
        match code.body:
            case [ast.Return(ast.Call(ast.Attribute(ast.Name(code.machine), called)))] | [
                ast.Expr(ast.Call(ast.Attribute(ast.Name(code.machine), called)))
            ] if called == name:
                line = code.body[0].lineno
                yield Finding(code.file, line, "error", f"{name!r} calls itself without end")


def returned_values(subject: Subject) -> Iterator[Finding]:
    """Find what sections return though nobody takes it, such as a state to go to."""
    states = {state.name for state in subject.states}
    for code in subject.sections:
        for node in nodes_of(code):
            match node:
                case ast.Return(ast.Constant(value)) if value is not None:
                    what = repr(value)
                case ast.Return(ast.Attribute(ast.Name(code.machine), name)) if name in states:
                    what = f"state {name!r}"
                case _:
                    continue
            text = f"{what} is returned to nobody: only transitions change the state"
            yield Finding(code.file, node.lineno, "warning", text)


def own_posts(subject: Subject, table: Table) -> Iterator[Finding]:
    """Find guards that look at slots to which OnEntry of their own state posts."""
    for state in subject.states:
        entry = state.on_entry
        called = () if entry is None else uses_of(entry).called
        posted = {
            table.actuators[each].slot.name: each for each in called if each in table.actuators
        }
        for transition in state.transitions if posted else ():
            if transition.guard is None or transition.after_ms:
                continue
            uses = uses_of(transition.guard)
            for name in () if uses.called.keys() & CLOCK.keys() else uses.loaded:  # one that waits
                sensor = table.sensors.get(name)
                if sensor is not None and sensor.slot.name in posted:
                    text = (
                        f"sensor {name!r} has what was in its slot when the turn began: in the "
                        f"turn in which OnEntry posts by {posted[sensor.slot.name]!r}, this guard "
                        f"finds the message before that"
                    )
                    yield Finding(*transition.where, "warning", text)
