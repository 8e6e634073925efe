"""The names in code: attributes of its machine, those it binds itself, and those of its module.

Code is seen as a `Code`: statements, in which the machine has a name. In a class that is the first
parameter, usually ``self``; in a bundle, whose code names attributes alone, a name that nothing can
write. Only the text is looked at, so a machine that is handed on (`Uses.escapes`) may have any
attribute used elsewhere.
"""

from __future__ import annotations

import ast
import builtins
import dis
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from inspect import CO_VARARGS, CO_VARKEYWORDS
from itertools import pairwise
from types import CodeType, FunctionType, MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

from llfsm.runtime.engine.source_text import syntax_of

MACHINE: Final = "<machine>"
"""The first parameter of a bundle's functions, their machine: a name that code cannot contain."""
CLOCK: Final = {"after_ms": 1e6, "after": 1e9, "timeout": 1e3}
"""The machine's functions of the time in its state, each with the nanoseconds in its unit."""
QUESTIONS: Final = frozenset({"index_of", "is_running", "is_suspended", "state_name_of", "status"})
"""The machine's questions about another one, whose name is the first argument."""
LOADING: Final = frozenset({"call_machine", "load", "load_suspended"})
"""The machine's functions that load another one."""
CONTROLLING: Final = frozenset({"abandon", "restart", "resume", "suspend", "unload"})
"""The machine's requests to another one, whose name is the first argument."""
REQUESTS: Final = (
    LOADING | CONTROLLING | {"restart_self", "resume_self", "suspend_all", "suspend_self"}
)
"""All requests that a machine can make."""

COMPREHENSIONS: Final = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
_ANY_NAME: Final = frozenset({"__dict__", "eval", "exec", "globals", "locals", "super"})
_ENGINE: Final = syntax_of.__module__.rpartition(".")[0]
_Function: TypeAlias = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


class Code(NamedTuple):
    """Statements, the name of their machine in them, the names of their module, and parameters."""

    body: Sequence[ast.AST]
    machine: str
    file: str
    names: Mapping[str, Any] = MappingProxyType({})
    parameters: frozenset[str] = frozenset()

    @property
    def truth(self) -> bool | None:
        """True or False if that is all that the code can return; else None."""
        match self.body:
            case [ast.Return(ast.expr() as value)]:
                return truth_of(value)
        return None


def truth_of(condition: ast.expr) -> bool | None:
    """Decide a condition whose text is enough, as ``ready and False``; None if it is not."""
    match condition:
        case ast.Constant(bool(value)):
            return value
        case ast.UnaryOp(ast.Not(), operand):
            truth = truth_of(operand)
            return None if truth is None else not truth
        case ast.BoolOp(op, values):
            decides = isinstance(op, ast.Or)
            truths = {truth_of(value) for value in values}
            if decides in truths:
                return decides
            return not decides if truths == {not decides} else None
    return None


# Attributes of the machine


@dataclass
class Uses:
    """The attributes of the machine that a piece of code names, each with its first line.

    `escapes` is True if the machine itself is passed on, so that other code may use it;
    `returns` is True if the code can return a value.
    """

    loaded: dict[str, int] = field(default_factory=dict)
    stored: dict[str, int] = field(default_factory=dict)
    called: dict[str, int] = field(default_factory=dict)
    escapes: bool = False
    returns: bool = False


def uses_of(code: Code) -> Uses:
    """Collect what `code` does with its machine."""
    uses = Uses()
    for node in code.body:
        _note(node, code.machine, uses, is_inner=False)
    return uses


def _note(node: ast.AST, machine: str, uses: Uses, *, is_inner: bool) -> None:
    """Note what a node does with the machine; `is_inner` in a function inside of the code."""
    match node:
        case ast.Attribute(ast.Name(name), attribute, ctx) if name == machine:
            names = uses.loaded if isinstance(ctx, ast.Load) else uses.stored
            names.setdefault(attribute, node.lineno)
            return
        case ast.AugAssign(ast.Attribute(ast.Name(name), attribute), _, value) if name == machine:
            uses.loaded.setdefault(attribute, node.lineno)  # it must be there
            _note(value, machine, uses, is_inner=is_inner)
            return
        case ast.Call(ast.Attribute(ast.Name(name), attribute)) if name == machine:
            uses.called.setdefault(attribute, node.lineno)
        case ast.Name(name):
            uses.escapes |= name == machine
        case ast.Return(ast.expr()):
            uses.returns |= not is_inner
        case ast.FunctionDef(args=args) | ast.AsyncFunctionDef(args=args) | ast.Lambda(args):
            if machine in parameter_names(args):
                return
            is_inner = True
    for each in ast.iter_child_nodes(node):
        _note(each, machine, uses, is_inner=is_inner)


def nodes_of(code: Code) -> Iterator[ast.AST]:
    """Yield the nodes of `code`, without functions in which the machine's name means another."""
    todo = [*code.body]
    while todo:
        node = todo.pop()
        if not (isinstance(node, _Function) and code.machine in parameter_names(node.args)):
            yield node
            todo += ast.iter_child_nodes(node)


# Names that code binds itself


def all_parameters(arguments: ast.arguments) -> list[ast.arg]:
    """List the parameters of a function, ``*args`` and ``**options`` last."""
    several = (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)
    return [*several, *(each for each in (arguments.vararg, arguments.kwarg) if each)]


def parameter_names(arguments: ast.arguments) -> frozenset[str]:
    """Name all parameters of a function."""
    return frozenset(each.arg for each in all_parameters(arguments))


def defaults_of(arguments: ast.arguments) -> list[ast.expr]:
    """List the defaults of parameters, which are evaluated outside of the function."""
    return [each for each in (*arguments.defaults, *arguments.kw_defaults) if each is not None]


def header_of(function: ast.FunctionDef) -> list[ast.expr]:
    """List the defaults and annotations of a function."""
    annotations = [each.annotation for each in all_parameters(function.args)]
    found = [each for each in (function.returns, *annotations) if each is not None]
    return [*defaults_of(function.args), *found]


def bound_names(nodes: Sequence[ast.AST]) -> set[str]:
    """Name what a scope with these nodes binds itself, as Python's compiler decides it."""
    bound: set[str] = set()
    freed: set[str] = set()
    todo = [(node, True) for node in nodes]
    while todo:
        node, direct = todo.pop()
        match node:
            case ast.Name(name, ctx):
                if direct and not isinstance(ctx, ast.Load):
                    bound.add(name)
            case ast.AugAssign(ast.Name(), _, value):
                todo.append((value, direct))  # what is only changed must be there already
                continue
            case ast.NamedExpr(ast.Name(name)):  # binds around the comprehension that it is in
                bound.add(name)
            case ast.Nonlocal(names):
                freed.update(names)
            case ast.Import(aliases) | ast.ImportFrom(names=aliases):
                bound.update(imported_names(aliases))
            case ast.ExceptHandler(name=str(name)):
                bound.add(name)
            case ast.pattern():
                bound.update(_captured(node))
            case ast.FunctionDef(name) | ast.AsyncFunctionDef(name) | ast.ClassDef(name):
                bound.add(name)
                bound.update(each.name for each in getattr(node, "type_params", ()))
        match node:
            case ast.Lambda(args):
                inner: Sequence[ast.AST] = defaults_of(args)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                inner = [*node.decorator_list, *defaults_of(node.args)]
            case ast.ClassDef():
                inner = [*node.decorator_list, *node.bases]
            case _:
                direct = direct and not isinstance(node, COMPREHENSIONS)
                inner = [*ast.iter_child_nodes(node)]
        todo += [(each, direct) for each in inner]
    return bound - freed


def imported_names(aliases: Sequence[ast.alias]) -> list[str]:
    """List the names that an import binds."""
    return [each.asname or each.name.partition(".")[0] for each in aliases]


def inner_names(scope: ast.AST) -> Iterator[str]:
    """Yield what a comprehension or a lambda binds inside of itself."""
    for node in ast.walk(scope):
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def captured_names(node: ast.AST) -> Iterator[str]:
    """Yield the names to which a pattern, with the patterns in it, gives values."""
    for each in ast.walk(node):
        yield from _captured(each)


def _captured(pattern: ast.AST) -> Iterator[str]:
    match pattern:
        case ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
            yield name
        case ast.MatchMapping(rest=str(name)):
            yield name


def assigned_values(code: Code) -> dict[str, ast.expr | None]:
    """Map the names that the code binds itself, each to its value if it has only one."""
    bound: Counter[str] = Counter()
    values: dict[str, ast.expr | None] = {}
    for node in nodes_of(code):
        match node:
            case ast.Assign([ast.Name(name)], value) | ast.AnnAssign(ast.Name(name), _, value):
                values[name] = value
            case ast.NamedExpr(ast.Name(name), value):
                values[name] = value
            case ast.For(ast.Name(name), each) | ast.comprehension(ast.Name(name), each):
                values[name] = ast.Subscript(each, ast.Constant(0))  # as any other item
        match node:
            case ast.Name(name, ast.Store() | ast.Del()):
                bound[name] += 1
            case ast.arg(name) | ast.MatchAs(name=str(name)) | ast.MatchStar(str(name)):
                bound[name] += 2  # its value is not here
            case ast.FunctionDef(name) | ast.ClassDef(name) | ast.ExceptHandler(name=str(name)):
                bound[name] += 2
            case ast.Import(aliases) | ast.ImportFrom(names=aliases):
                bound.update(2 * imported_names(aliases))
    return {name: values.get(name) if number == 1 else None for name, number in bound.items()}


# Names of the module, from compiled code, which knows them also where there is no text


def names_in(code: CodeType) -> set[str]:
    """Name the globals and attributes that code, and the functions in it, use."""
    names = {*code.co_names}
    for each in code.co_consts:
        if isinstance(each, CodeType):
            names |= names_in(each)
    return names


def may_use(function: Callable[..., Any], cls: type, names: Collection[str]) -> bool:
    """Check that code of a machine of `cls` may use some attributes: False only if it cannot.

    Its methods and properties that the code names are followed.
    """
    todo: list[Any] = [function]
    followed: set[object] = set()
    while todo:
        code = todo.pop()
        node = syntax_of(code) if isinstance(code, FunctionType) else None
        if node is None:
            return True
        body = node.body if isinstance(node.body, list) else [node.body]
        parameters = [*node.args.posonlyargs, *node.args.args]
        machine = parameters[0].arg if parameters else ""
        found = names_in(code.__code__)
        if found & {*names, *_ANY_NAME} or uses_of(Code(body, machine, "")).escapes:
            return True
        followed.add(code)
        attributes = [getattr(cls, name, None) for name in found]
        within = [each.fget if isinstance(each, property) else each for each in attributes]
        functions = (each for each in within if isinstance(each, FunctionType))
        todo += [each for each in functions if not _is_ours(each) and each not in followed]
    return False


def _is_ours(function: FunctionType) -> bool:
    return function.__module__.startswith(_ENGINE)


def unbound_names(function: Callable[..., Any]) -> Iterator[tuple[str, int]]:
    """Yield the names that `function` reads and that nothing defines, with their lines.

    A name that the function itself makes global counts as defined. One that it only ever changes,
    as by ``count += 1``, does not, global or its own.
    """
    instructions = [*_instructions(function.__code__)]
    made = {
        each.argval
        for before, each in pairwise([None, *instructions])
        if each is not None and each.opname == "STORE_GLOBAL" and not _is_changed(before)
    }
    known = made | function.__globals__.keys() | vars(builtins).keys()
    for each in instructions:
        if each.opname == "LOAD_GLOBAL" and each.argval not in known:
            yield each.argval, _line(each)
    yield from _only_changed(function.__code__)


def _is_changed(before: dis.Instruction | None) -> bool:
    """Check that what is stored after an instruction was made of the same name, as by `+=`."""
    return before is not None and before.opname == "BINARY_OP" and before.argrepr.endswith("=")


def _only_changed(code: CodeType) -> Iterator[tuple[str, int]]:
    given = code.co_argcount + code.co_kwonlyargcount
    given += sum(bool(code.co_flags & flag) for flag in (CO_VARARGS, CO_VARKEYWORDS))
    made = {*code.co_varnames[:given]}
    changed: dict[str, int] = {}
    for before, each in pairwise(dis.get_instructions(code)):
        if each.opname.startswith("STORE_FAST"):
            # From Python 3.13 on, an instruction may have two names.
            name, *others = (each.argval,) if isinstance(each.argval, str) else each.argval
            made.update(others)
            if _is_changed(before):
                changed.setdefault(name, _line(each))
            else:
                made.add(name)
    yield from ((name, line) for name, line in changed.items() if name not in made)


def _line(instruction: dis.Instruction) -> int:
    return (instruction.positions and instruction.positions.lineno) or 1


def _instructions(code: CodeType) -> Iterator[dis.Instruction]:
    yield from dis.get_instructions(code)
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _instructions(inner)
