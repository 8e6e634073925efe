"""The rules that need types: each yields what is wrong with a machine that has been loaded.

A rule is a function of a `Piece` and a node of it, listed in `_RULES` with its kinds of nodes. The
rules find what every run of the code would find, and nothing where a type is unknown.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from pathlib import Path
from types import FunctionType, ModuleType, NoneType
from typing import Any, TypeAlias

import msgspec

from llfsm.errors import did_you_mean
from llfsm.runtime.bundles import SUFFIX
from llfsm.runtime.checking import _operand_rules as operand_rules
from llfsm.runtime.checking import _value_rules as value_rules
from llfsm.runtime.checking._subject import Finding, Piece, Subject
from llfsm.runtime.checking._time_rules import of_waiting
from llfsm.runtime.engine.errors import DefinitionError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.ports import Actuator, Sensor, messages_of_domain
from llfsm.runtime.engine.source_text import syntax_of
from llfsm.runtime.engine.state import State
from llfsm.runtime.engine.table import REQUIRED, Table
from llfsm.runtime.expressions.purity import reads_outside
from llfsm.runtime.expressions.reads import LOADING, Code, nodes_of, uses_of
from llfsm.runtime.expressions.types import (
    BUILT_IN,
    PLAIN,
    Options,
    Types,
    fields_of,
    is_message,
    kind_of,
    may_be,
    named,
    options_of,
)

_SAFE_VALUES = ("at_end", "at_suspend", "at_failure")


def of_ports(subject: Subject, table: Table) -> Iterator[Finding]:
    """Find defaults, safe values and domains that are not messages of their slot's type."""
    ports: list[tuple[str, Sensor[Any, Any] | Actuator[Any], Sequence[str]]] = [
        *((name, each, ("default",)) for name, each in table.sensors.items()),
        *((name, each, _SAFE_VALUES) for name, each in table.actuators.items()),
    ]
    slots: dict[str, tuple[str, Any]] = {}
    for name, port, options in ports:
        declared = subject.declared.get(name)
        where = subject.states[0].where if declared is None else declared.where
        first, slot = slots.setdefault(port.slot.name, (name, port.slot))
        if slot.fingerprint != port.slot.fingerprint:
            types = f"{slot.type.__name__} and {port.slot.type.__name__}"
            text = f"{first!r} and {name!r} use slot {slot.name!r} for messages of {types}"
            yield Finding(*where, "error", text)
        for option in options:
            value = getattr(port, option)
            if value is not None and not isinstance(value, port.slot.type):
                wanted = port.slot.type.__name__
                given = f"the class {value.__name__}" if isinstance(value, type) else repr(value)
                text = f"{name!r}: {option} is a {wanted}, as {wanted}(), not {given}"
                yield Finding(*where, "error", text)
                break
        if isinstance(port, Sensor) and port.domain is not None:
            try:
                messages_of_domain(port.slot, port.domain)
            except DefinitionError as error:
                yield Finding(*where, "error", f"{name!r}: {error}")


def signature_of(function: FunctionType) -> inspect.Signature:
    """Give a function's signature; in bundles, the parameter for the machine becomes ``self``."""
    try:
        return _unevaluated(function)
    except ValueError:
        code = function.__code__
        names = tuple(each if each.isidentifier() else "self" for each in code.co_varnames)
        code = code.replace(co_varnames=names)
        named = FunctionType(code, {}, function.__name__, function.__defaults__)
        named.__kwdefaults__ = function.__kwdefaults__
        return _unevaluated(named)


def _unevaluated(function: FunctionType) -> inspect.Signature:
    """Leave annotations that wait to be evaluated: they may name what only type checkers import."""
    if sys.version_info >= (3, 14):
        import annotationlib

        return inspect.signature(function, annotation_format=annotationlib.Format.STRING)
    return inspect.signature(function)


_CONTROLS = {*dir(Machine), "table"}
_SIMPLE = {"float": float, "int": int, "str": str}


_Rule: TypeAlias = Callable[[Piece, Any], Iterator[Finding]]


def typed_findings(subject: Subject, table: Table) -> list[Finding]:
    """Apply the rules that need types; sort what they find by file and line."""
    found = {*_of_defaults(subject, table), *of_ports(subject, table)}
    found.update(operand_rules.of_optional(subject, table))
    found.update(value_rules.own_posts(subject, table))
    for code in subject.all_code():
        piece = Piece(code, Types(code, table), table)
        for node in nodes_of(code):
            for kind, rule in _RULES:
                if isinstance(node, kind):
                    found.update(rule(piece, node))
    for guard in subject.guards():
        found.update(_of_guard(Piece(guard, Types(guard, table), table)))
    return sorted(found)


def _of_attribute(piece: Piece, node: ast.Attribute) -> Iterator[Finding]:
    """Find fields that a message does not have, and names that a module or a class has not."""
    owner = piece.types.value_of(node.value)
    is_class = isinstance(owner, type) and isinstance(node.ctx, ast.Load)
    if is_class or (isinstance(owner, ModuleType) and not hasattr(owner, "__path__")):
        if not hasattr(owner, node.attr):
            what = f"{owner.__name__} has no {node.attr!r}{did_you_mean(node.attr, dir(owner))}"
            yield piece.finding(node, "error", what)
        return
    options = [each for each in piece.types.of(node.value) if each is not NoneType]
    kinds = [*map(kind_of, options)]
    if kinds and all(each in BUILT_IN and not hasattr(each, node.attr) for each in kinds):
        near = did_you_mean(node.attr, dir(kinds[0]))
        yield piece.finding(node, "error", f"{named(tuple(kinds))} has no {node.attr!r}{near}")
    if not options or not all(map(is_message, options)):
        return
    if not any(hasattr(each, node.attr) for each in options):
        fields = list(dict.fromkeys(name for each in options for name in fields_of(each)))
        text = (
            f"{named(tuple(options))} has no field {node.attr!r}; it has: "
            f"{', '.join(fields) or 'none'}{did_you_mean(node.attr, fields)}"
        )
        yield piece.finding(node, "error", text)
    elif isinstance(node.ctx, ast.Store) and all(each.__struct_config__.frozen for each in options):
        text = f"a message cannot be changed: post a new {named(tuple(options))}"
        yield piece.finding(node, "error", text)


def _of_call(piece: Piece, node: ast.Call) -> Iterator[Finding]:
    """Find messages that cannot be made, and calls of ports that fail."""
    match node.func:
        case ast.Attribute(ast.Name(name), port) if name == piece.code.machine:
            if port in piece.table.actuators:
                yield from _of_post(piece, node, port)
            elif port in piece.table.sensors:
                yield piece.finding(node, "error", f"sensor {port!r} is a value, not a function")
            elif port in piece.table.variables:
                given = piece.types.of(node.func)
                if given and {*given} <= PLAIN:
                    text = f"variable {port!r} is {named(given)}, not a function"
                    yield piece.finding(node, "error", text)
            elif isinstance(function := _class_attribute(piece.table, port), FunctionType):
                yield from _of_method(piece, node, function)
            elif _is_state(piece.table, port):
                yield piece.finding(node, "error", f"{port!r} is a state: a transition enters it")
            return
        case ast.Attribute(ast.Attribute(ast.Name(name), state), called) if (
            name == piece.code.machine and _is_state(piece.table, state)
        ):
            text = f"{state}.{called} declares code of a state: call it in the class, not here"
            yield piece.finding(node, "error", text)
            return
    message = piece.types.value_of(node.func)
    if reads_outside(message):
        text = f"{ast.unparse(node.func)} makes every run different: use a sensor, or after_ms"
        yield piece.finding(node, "warning", text)
    if is_message(message):
        yield from _of_message(piece, node, message)


def _class_attribute(table: Table, name: str) -> Any:
    return inspect.getattr_static(table.states[0].owner or Machine, name, None)


def _is_state(table: Table, name: str) -> bool:
    return isinstance(_class_attribute(table, name), State)


def _of_method(piece: Piece, node: ast.Call, function: FunctionType) -> Iterator[Finding]:
    """Find calls of the machine's methods with too few, too many or wrong arguments."""
    keywords = {each.arg: each.value for each in node.keywords if each.arg is not None}
    starred = any(isinstance(each, ast.Starred) for each in node.args)
    if starred or len(keywords) < len(node.keywords) or hasattr(function, "__wrapped__"):
        return
    signature, called = signature_of(function), function.__name__
    try:
        bound = signature.bind(None, *node.args, **keywords).arguments
    except TypeError:
        shown = ", ".join(map(str, [*signature.parameters][1:]))
        text = f"{called} is called as {called}({shown})"
        if not signature.parameters:
            text = f"{called} has no parameter for the machine: write def {called}(self)"
        yield piece.finding(node, "error", text)
        return
    for name, value in [*bound.items()][1:]:
        annotation = signature.parameters[name].annotation  # a class, or a text
        wanted = _SIMPLE.get(str(getattr(annotation, "__name__", annotation)))
        given = piece.types.of(value) if wanted else ()
        if wanted and not may_be(value, given, wanted):
            text = f"{called}: {name} is {wanted.__name__}, not {named(given)}"
            yield piece.finding(node, "error", text)
    if called in LOADING:
        yield from _of_name(piece, node)
    match called, node.args:
        case "age_ms", [ast.Constant(str(sensor))] if sensor not in piece.table.sensors:
            known = piece.table.sensors
            text = f"the machine has no sensor {sensor!r}; it has: {', '.join(known) or 'none'}"
            yield piece.finding(node, "error", text + did_you_mean(sensor, known))


def _of_name(piece: Piece, node: ast.Call) -> Iterator[Finding]:
    """Find misspelt names of machines; which others a run has in its library is not known."""
    match node.args:
        case [ast.Constant(str(name)), *_]:
            module = sys.modules.get(piece.table.path.partition(":")[0])
            found = [] if module is None else vars(module).values()
            known = {each.__name__ for each in found if _is_kind_of(each, Machine)}
            beside = Path(piece.code.file).parent
            beside = beside.parent if beside.suffix == SUFFIX else beside
            known |= {each.stem for each in beside.glob(f"*{SUFFIX}")}
            if name not in known and (near := did_you_mean(name, known)):
                yield piece.finding(node, "warning", f"no machine {name!r} is here{near}")


def _of_post(piece: Piece, node: ast.Call, port: str) -> Iterator[Finding]:
    slot = piece.table.actuators[port].slot
    match node.args, node.keywords:
        case ([ast.Starred()], _) | (_, [ast.keyword(arg=None), *_]):
            return
        case [posted], []:
            given = piece.types.of(posted)
            if piece.types.value_of(posted) is slot.type:
                text = f"actuator {port!r} posts a message, not its class: {slot.type.__name__}()"
            elif given and not any(_may_be(each, slot.type) for each in given):
                text = f"actuator {port!r} posts {slot.type.__name__}, not {named(given)}"
            else:
                return
        case _:
            text = f"actuator {port!r} takes one message: {slot.type.__name__}(...)"
    yield piece.finding(node, "error", text)


def _may_be(given: object, kind: type) -> bool:
    """Check that a value of type `given` may be one of `kind`: also if only a base is declared."""
    return _is_kind_of(given, kind) or (isinstance(given, type) and issubclass(kind, given))


def _of_message(piece: Piece, node: ast.Call, message: type[msgspec.Struct]) -> Iterator[Finding]:
    fields = fields_of(message)
    if not fields and message.__struct_fields__:
        return  # its annotations do not resolve yet
    name = message.__name__
    names = [each.name for each in fields.values()]
    starred = any(isinstance(each, ast.Starred) for each in node.args)
    more = starred or any(each.arg is None for each in node.keywords)
    if not starred and len(node.args) > len(names):
        yield piece.finding(node, "error", f"{name} has {len(names)} fields, not {len(node.args)}")
        return
    given = {} if starred else dict(zip(names, node.args, strict=False))
    for keyword in node.keywords:
        if keyword.arg is not None and keyword.arg not in fields:
            near = did_you_mean(keyword.arg, names)
            text = (
                f"{name} has no field {keyword.arg!r}; it has: {', '.join(names) or 'none'}{near}"
            )
            yield piece.finding(keyword.value, "error", text)
        elif keyword.arg is not None:
            given[keyword.arg] = keyword.value
    missing = [each for each in names if fields[each].required and each not in given]
    if missing and not more:
        yield piece.finding(node, "error", f"{name} needs a value for {', '.join(missing)}")
    for field, value in given.items():
        if not may_be(value, piece.types.of(value), fields[field].type):
            wanted, found = options_of(fields[field].type), piece.types.of(value)
            text = f"{name}: field {field!r} is {named(wanted)}, not {named(found)}"
            yield piece.finding(value, "error", text)


def _of_assignment(piece: Piece, node: ast.Assign | ast.AnnAssign) -> Iterator[Finding]:
    """Find values of another type than the variable's."""
    if node.value is None:
        return
    for target in node.targets if isinstance(node, ast.Assign) else (node.target,):
        match target:
            case ast.Attribute(ast.Name(machine), name) if machine == piece.code.machine:
                variable = piece.table.variables.get(name)
                given = piece.types.of(node.value)
                if variable is not None and not _may_hold(node.value, given, variable.type):
                    text = _wrong_variable(name, variable.type, named(given))
                    yield piece.finding(node, "warning", text)
                replaced = isinstance(_class_attribute(piece.table, name), FunctionType)
                if replaced and given and {*given} <= PLAIN and name not in _CONTROLS:
                    text = f"{name!r} is a function of the machine, and no longer after this"
                    yield piece.finding(node, "warning", text)


def _of_store(piece: Piece, node: ast.Attribute) -> Iterator[Finding]:
    """Find assignments to what is no variable, however they are written."""
    match node:
        case ast.Attribute(ast.Name(piece.code.machine), name, ast.Store() | ast.Del()):
            pass
        case _:
            return
    table = piece.table
    if name in table.sensors:
        text = f"sensor {name!r} cannot be assigned: it is read from its slot"
    elif name in table.actuators:
        text = f"actuator {name!r} cannot be assigned: post by self.{name}(message)"
    elif _is_state(table, name):
        text = f"state {name!r} cannot be assigned: transitions change the state"
    elif name in _CONTROLS:
        text = f"{name!r} cannot be assigned: every machine has it"
    else:
        return
    yield piece.finding(node, "error", text)


def _of_state_name(piece: Piece, node: ast.Compare) -> Iterator[Finding]:
    """Find names that none of the machine's states has."""
    match node:
        case ast.Compare(
            ast.Attribute(ast.Name(machine), "state_name"),
            [ast.Eq() | ast.NotEq()],
            [compared],
        ) if machine == piece.code.machine:
            states = [each.name for each in piece.table.states]
            match compared:
                case ast.Constant(str(name)) if name not in states:
                    text = f"no state {name!r}; the states are: {', '.join(states)}"
                    yield piece.finding(node, "error", text + did_you_mean(name, states))
                case ast.Attribute(ast.Name(), name) if _is_state(piece.table, name):
                    text = f"state_name is a text: compare it with {name!r}, or {name}.name"
                    yield piece.finding(node, "error", text)


def _of_result(piece: Piece, node: ast.AST) -> Iterator[Finding]:
    """Find uses of what a function returns that returns nothing."""
    match node:
        case ast.Return(value) | ast.UnaryOp(ast.Not(), value):
            used = [value]
        case ast.Assign(_, value) | ast.AugAssign(_, _, value):
            used = [value]
        case ast.BoolOp(_, values):
            used = [*values]
        case ast.If(test) | ast.IfExp(test) | ast.While(test):
            used = [test]
        case ast.Compare(left, _, values):
            used = [left, *values]
        case ast.BinOp(left, _, right):
            used = [left, right]
        case _:
            return
    for each in used:
        if not isinstance(each, ast.Call):
            continue
        function = _called(piece, each)
        if isinstance(function, FunctionType) and _returns_nothing(function):
            text = f"{ast.unparse(each.func)} returns nothing"
            yield piece.finding(each, "error", f"{text}: was a return forgotten?")


def _called(piece: Piece, node: ast.Call) -> Any:
    match node.func:
        case ast.Attribute(ast.Name(machine), name) if machine == piece.code.machine:
            return _class_attribute(piece.table, name)
    return piece.types.value_of(node.func)


def _returns_nothing(function: FunctionType) -> bool:
    """Check that the code of a function ends, and that nothing in it returns a value."""
    syntax = None if hasattr(function, "__wrapped__") else syntax_of(function)
    if not isinstance(syntax, ast.FunctionDef) or function.__module__.startswith("llfsm."):
        return False
    code = Code(syntax.body, "", "")
    generates = any(isinstance(each, ast.Yield | ast.YieldFrom) for each in nodes_of(code))
    last, stub = syntax.body[-1], {*map(type, syntax.body)} <= {ast.Expr, ast.Raise}
    is_stub = isinstance(last, ast.Raise) or (stub and _is_documented_only(syntax.body))
    return not (generates or uses_of(code).returns or is_stub)


def _is_documented_only(body: Sequence[ast.stmt]) -> bool:
    """Check that there is nothing but a docstring, or an ellipsis, for subclasses to replace."""
    return all(isinstance(e, ast.Expr) and isinstance(e.value, ast.Constant) for e in body)


def _of_statement(piece: Piece, node: ast.Expr) -> Iterator[Finding]:
    """Find methods and actuators that are named but not called."""
    match node.value:
        case ast.Attribute(ast.Name(machine), name) if machine == piece.code.machine:
            method = isinstance(_class_attribute(piece.table, name), FunctionType)
            if method or name in piece.table.actuators:
                text = f"{name!r} is not called: write {machine}.{name}(...)"
                yield piece.finding(node, "error", text)


_WITH_ITEMS = (ast.Subscript, ast.Call, ast.For, ast.comprehension, ast.Compare, ast.Assign)
_USES = (
    *(ast.Return, ast.UnaryOp, ast.Assign, ast.AugAssign, ast.BoolOp, ast.If, ast.IfExp),
    *(ast.While, ast.Compare, ast.BinOp),
)
_RULES: list[tuple[type | tuple[type, ...], _Rule]] = [
    (ast.Attribute, _of_attribute),
    (ast.Attribute, _of_store),
    (ast.Call, _of_call),
    (ast.Call, of_waiting),
    (ast.Expr, _of_statement),
    (_USES, _of_result),
    ((ast.Assign, ast.AnnAssign), _of_assignment),
    (ast.Compare, _of_state_name),
    (ast.Compare, operand_rules.of_comparison),
    ((ast.BinOp, ast.Compare), operand_rules.of_operator),
    ((ast.BinOp, ast.AugAssign, ast.Call), operand_rules.of_division),
    (_WITH_ITEMS, operand_rules.of_items),
    (ast.Call, operand_rules.of_nothing),
    (ast.BoolOp, operand_rules.of_none),
    (ast.If, operand_rules.of_none_inside),
    ((ast.BoolOp, ast.Compare), operand_rules.of_condition),
    (ast.Compare, operand_rules.of_identity),
    (ast.Expr, operand_rules.of_effectless),
    (ast.Assign, operand_rules.of_sign),
    ((ast.Assign, ast.AnnAssign), operand_rules.of_hidden),
    ((ast.Assign, ast.Call), operand_rules.of_text),
    ((ast.FormattedValue, ast.Call), operand_rules.of_format),
    (ast.Call, value_rules.of_arguments),
    (ast.Call, value_rules.of_called),
    (ast.Raise, value_rules.of_raised),
    ((ast.For, ast.comprehension), value_rules.of_pairs),
    ((ast.BinOp, ast.Compare), value_rules.of_none_operand),
    (ast.Subscript, value_rules.of_key),
    (ast.UnaryOp, value_rules.of_negation),
    (ast.Delete, value_rules.of_deleted),
    (ast.For, value_rules.of_changed_loop),
    (ast.Attribute, value_rules.of_default),
    (ast.If, value_rules.of_branches),
]


def _of_guard(piece: Piece) -> Iterator[Finding]:
    """Find guards that return something other than True or False, for certain or at times."""
    if not uses_of(piece.code).returns:
        return  # another rule finds that
    if _falls_through(piece.code.body):
        last = piece.code.body[-1]
        text = "this guard can end without a return: return True or False"
        yield Finding(piece.code.file, getattr(last, "lineno", 1), "warning", text)
    for node in _returns(piece.code):
        given = piece.types.of(node.value) if node.value is not None else (NoneType,)
        others = tuple(each for each in given if each is not bool)
        if others:
            always = len(others) == len(given)
            what = "returns" if always else "can return"
            text = f"this guard {what} {named(others)}: return True or False"
            yield piece.finding(node, "error" if always else "warning", text)


def _falls_through(body: Sequence[ast.AST]) -> bool:
    """Check if statements, for certain, end without a return in some case."""
    match body[-1] if body else None:
        case ast.If(_, then, otherwise):
            return _falls_through(then) or _falls_through(otherwise)
        case None | ast.Assign() | ast.AugAssign() | ast.AnnAssign() | ast.Expr() | ast.Pass():
            return True
    return False


def _returns(code: Code) -> Iterator[ast.Return]:
    todo: list[ast.AST] = [*code.body]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Return):
            yield node
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            todo += ast.iter_child_nodes(node)


def _of_defaults(subject: Subject, table: Table) -> Iterator[Finding]:
    """Find defaults of variables that are of another type than the variable."""
    for name, declared in subject.declared.items():
        if declared.kind == "variable" and name in table.variables:
            variable = table.variables[name]
            if variable.default is REQUIRED:
                continue
            given = (type(variable.default),)
            if not _may_hold(ast.Constant(variable.default), given, variable.type):
                text = _wrong_variable(name.rpartition(".")[2], variable.type, named(given))
                yield Finding(*declared.where, "warning", text)


def _is_kind_of(given: Any, wanted: type) -> bool:
    return isinstance(given, type) and issubclass(given, wanted)


def _may_hold(node: ast.expr, given: Options, annotation: Any) -> bool:
    """Check if a variable may have such a value, which is not decoded as a field's is."""
    wanted = options_of(annotation)
    if wanted and all(isinstance(each, type) and issubclass(each, Enum) for each in wanted):
        return not given or any(_is_kind_of(kind, each) for kind in given for each in wanted)
    return may_be(node, given, annotation)


def _wrong_variable(name: str, annotation: Any, given: str) -> str:
    return f"variable {name!r} is {named(options_of(annotation))}, not {given}"
