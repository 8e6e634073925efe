"""Compile and run the texts of a bundle; errors name the file and the line.

A bundle may come from anybody. A text so deep that Python's parser, or a walk over its tree, would
run out of stack is refused with an error of its own.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from typing import Any

from llfsm.runtime.bundles.model import Fragment
from llfsm.runtime.engine.state import DEFERRED
from llfsm.runtime.expressions.reads import MACHINE

_NAME = re.compile(r"[\w.:]+")  # of what a state runs
_DEEPEST = 200
_TOO_DEEP = f"it is nested more than {_DEEPEST} deep, such as by a sum of as many parts"


def parse(fragment: Fragment) -> ast.Module:
    """Parse a text of statements; raise `BundleError`."""
    try:
        tree = ast.parse(fragment.text, fragment.source)
    except SyntaxError as error:
        raise fragment.error(f"SyntaxError: {error.msg}", error.lineno) from error
    except ValueError as error:
        raise fragment.error(f"SyntaxError: {error}") from error
    except (RecursionError, MemoryError) as error:  # as the parser calls a text that it gives up
        raise fragment.error(_TOO_DEEP) from error
    if deep := too_deep(tree):
        raise fragment.error(_TOO_DEEP, getattr(deep[0], "lineno", None))
    return tree


def too_deep(tree: ast.AST) -> list[ast.AST]:
    """Return the nodes that are too deep in a tree for a walk by recursion."""
    level = [tree]
    for _ in range(_DEEPEST):
        level = [child for node in level for child in ast.iter_child_nodes(node)]
    return level


def parse_expression(fragment: Fragment) -> ast.expr:
    """Parse a text that must be one expression; raise `BundleError`."""
    tree = parse(Fragment(fragment.text.lstrip(" \t"), fragment.file))
    only = tree.body[0] if len(tree.body) == 1 else None
    if not isinstance(only, ast.Expr):
        raise fragment.error("not a single expression", tree.body[0].lineno if only else 1)
    return only.value


def parse_run(fragment: Fragment) -> tuple[str, list[ast.keyword]]:
    """Read what a state runs: a machine's name, and values for its variables, if there are any.

    Raise `BundleError` for another text.
    """
    text = fragment.text.strip()
    if _NAME.fullmatch(text):
        return text, []
    if "(" not in text:
        raise fragment.error(f"{text!r} is not the name of a machine", line_of(fragment))
    match parse_expression(fragment):
        case ast.Call(ast.Name(name), [], values) if all(each.arg for each in values):
            return name, values
    what = "gives no values by name, as Drive(to=goal) does"
    raise fragment.error(f"{text!r} {what}", line_of(fragment))


def line_of(fragment: Fragment) -> int:
    """Count the lines up to the first that is not empty."""
    return 1 + len(fragment.text) - len(fragment.text.lstrip("\n"))


def label_of(fragment: Fragment) -> str:
    """Return the label of a transition with this expression: its text, on one line."""
    label = fragment.text.strip()
    if label in ("true", "True"):
        return "true"
    if "\n" in label or "#" in label:
        return ast.unparse(parse_expression(fragment))
    return label


def function_of(
    name: str, body: list[ast.stmt], fragment: Fragment, module: dict[str, Any]
) -> Callable[[Any], Any]:
    """Make a function of a machine, its hidden parameter, with this body. Raise `BundleError`."""
    tree = ast.parse("def function(machine): ...")
    function = tree.body[0]
    assert isinstance(function, ast.FunctionDef)
    function.name = name
    function.args.args[0].arg = MACHINE
    function.body = body
    function.lineno = function.end_lineno = body[0].lineno
    made = run(tree, fragment, module, {})
    if made[name].__code__.co_flags & DEFERRED:
        raise fragment.error("a machine runs each section to its end: no yield, no await")
    found: Callable[[Any], Any] = made[name]
    return found


def run(
    tree: ast.Module, fragment: Fragment, module: dict[str, Any], made: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Run statements in `module`; return the names that they define: `made`, or else `module`."""
    _execute(tree, "exec", fragment, module, made)
    return module if made is None else made


def evaluate(node: ast.expr, fragment: Fragment, module: dict[str, Any]) -> Any:
    """Evaluate an expression in `module`; raise `BundleError` for what it raises."""
    return _execute(ast.Expression(node), "eval", fragment, module, None)


def _execute(
    tree: ast.Module | ast.Expression,
    mode: str,
    fragment: Fragment,
    module: dict[str, Any],
    made: dict[str, Any] | None,
) -> Any:
    try:
        code = compile(ast.fix_missing_locations(tree), fragment.source, mode, dont_inherit=True)
    except SyntaxError as error:
        raise fragment.error(f"SyntaxError: {error.msg}", error.lineno) from error
    try:
        return eval(code, module, module if made is None else made)
    except Exception as error:  # of the bundle's own code, whatever it is
        line, trace = None, error.__traceback__
        while trace is not None:
            if trace.tb_frame.f_code.co_filename == fragment.source:
                line = trace.tb_lineno
            trace = trace.tb_next
        raise fragment.error(f"{type(error).__name__}: {error}", line) from error
