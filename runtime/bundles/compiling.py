"""Make a machine class from a Python bundle, equal to one written as a class statement."""

from __future__ import annotations

import ast
import os
import sys
from pathlib import Path
from types import ModuleType

from ..engine.machine import Machine, define
from ..engine.source_text import EXPRESSION
from ..engine.state import State, Transition
from .code import function_of, label_of, parse, parse_expression
from .model import PYTHON, Bundle, BundleState, Fragment
from .names import resolve
from .read import read_bundle
from .scope import LoadedScope

__all__ = ["compile_bundle", "load_bundle", "require_python"]


def load_bundle(folder: str | Path) -> type[Machine]:
    """Return the machine class that the Python bundle in `folder` describes.

    Its `table.path` is the real path of the folder, its `table.layout` is read from
    ``Layout.plist``. Raise `BundleError`, with file and line, for text that cannot be read or
    understood, and `DefinitionError` for an inconsistent table.
    """
    return compile_bundle(read_bundle(folder))


def compile_bundle(bundle: Bundle) -> type[Machine]:
    """Return the machine class that `bundle` describes; raise as `load_bundle` does."""
    require_python(bundle)
    path = bundle.path
    module = ModuleType(path)
    module.__file__ = path
    sys.modules[path] = module  # where message types defined in it look up their annotations
    _extend_search(bundle)
    scope = LoadedScope(vars(module))
    scope.declare(bundle)
    states = {each.name: State(each.name, suspend=each.name == bundle.suspend)
              for each in bundle.states}  # fmt: skip
    for each in bundle.states:
        _fill(states[each.name], each, states, scope.of_state(each))
    cls = define(
        bundle.name,
        states.values(),
        variables=scope.variables,
        attributes={"__module__": path, "__doc__": module.__doc__, **scope.attributes},
        path=path,
    )
    cls.table.layout = bundle.layout
    return cls


def require_python(bundle: Bundle) -> None:
    """Raise `BundleError` for a C++ bundle, which cannot run."""
    if bundle.language != PYTHON:
        where = Fragment("", bundle.folder)
        raise where.error("this is a C++ bundle; convert it to Python with `llfsm import`")


def _fill(state: State, source: BundleState, states: dict[str, State], scope: LoadedScope) -> None:
    """Give a state its sections and transitions."""
    for section, fragment in source.sections.items():
        tree = parse(fragment)
        if tree.body:
            tree = resolve(tree, fragment, scope.known, running=True)
            state.sections[section] = function_of(section, tree.body, fragment, scope.module)
    for each in source.transitions:
        target = states[each.target]
        expression = each.expression or Fragment("true")
        state.transitions.append(_transition(state, target, expression, scope))


def _transition(state: State, target: State, fragment: Fragment, scope: LoadedScope) -> Transition:
    declared, label = (fragment.source, 1), label_of(fragment)
    if label == "true":
        return Transition(state, target, declared, None, None, label)
    expression = parse_expression(fragment)
    after_ms, after, guard = _split(expression)
    transition = Transition(state, target, declared, after_ms, after, label)
    if guard is not None:
        value = resolve(guard, fragment, scope.known, running=True)
        body: list[ast.stmt] = [ast.copy_location(ast.Return(value), guard)]
        transition(function_of(EXPRESSION, body, fragment, scope.module))
    return transition


def _split(expression: ast.expr) -> tuple[float | None, float | None, ast.expr | None]:
    """Return the milliseconds or seconds that `expression` waits for first, and the rest of it."""
    first, rest = expression, None
    if isinstance(expression, ast.BoolOp) and isinstance(expression.op, ast.And):
        first, *others = expression.values
        rest = others[0]
        if len(others) > 1:
            rest = ast.copy_location(ast.BoolOp(ast.And(), others), others[0])
            rest.end_lineno, rest.end_col_offset = expression.end_lineno, expression.end_col_offset
    match first:
        case ast.Call(ast.Name("after_ms"), [ast.Constant(int() | float() as time)], []):
            return time, None, rest
        case ast.Call(ast.Name("after"), [ast.Constant(int() | float() as time)], []):
            return None, time, rest
    return None, None, expression


def _extend_search(bundle: Bundle) -> None:
    """Add the bundle's include folders to the import path."""
    for text in bundle.include_paths:
        path = os.path.expandvars(text)
        if bundle.folder is not None:
            path = os.path.normpath(bundle.folder / path)
        if path not in sys.path:
            sys.path.append(path)
