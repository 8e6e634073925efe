"""Where a function is written and what it says: the labels of transitions."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from types import CodeType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import ast

__all__ = ["EXPRESSION", "TextOnly", "body_of", "expression_of", "location_of"]

EXPRESSION = "<expression>"
"""The name of a function whose file holds nothing but the expression that it returns."""


class TextOnly:
    """Stand for a section of which only the text is known, as of another process's machine."""

    def __init__(self, text: str):
        self.text = text

    def __call__(self, machine: Any) -> None:
        """Raise: there is no code."""
        raise TypeError("only the text of this section is known: it cannot be run")


def location_of(function: Callable[..., Any]) -> tuple[str, int] | None:
    """Return file and line of `function`, or None if it is no Python function."""
    code = getattr(function, "__code__", None)
    return None if code is None else (code.co_filename, code.co_firstlineno)


def expression_of(function: Callable[..., Any]) -> str | None:
    """Return the text of what a lambda, or a function that is one `return`, returns.

    None if there is no such expression or its source cannot be read.
    """
    code = getattr(function, "__code__", None)
    return None if code is None else _expression(code)


def body_of(function: Callable[..., Any]) -> str | None:
    """Return the text of a function's statements, without its docstring; None without source.

    That of a bundle's section is all of its file.
    """
    if isinstance(function, TextOnly):
        return function.text
    code = getattr(function, "__code__", None)
    parsed = None if code is None else _parse(code.co_filename)
    if code is None or parsed is None:
        return None
    text, tree = parsed
    if code.co_varnames and not code.co_varnames[0].isidentifier():
        return text  # a bundle's code has a machine that it cannot name
    if code.co_name == "<lambda>":
        return _expression(code)
    node = _definition(tree, code)
    if node is None:
        return None
    body = _undocumented(node)
    return "" if not body else _lines_of(text.splitlines(), node, body)


def _lines_of(lines: list[str], node: ast.FunctionDef, body: list[ast.stmt]) -> str:
    """Return the lines of statements, with the comments right above them."""
    from textwrap import dedent

    start, end = body[0].lineno, body[-1].end_lineno
    if start == node.lineno:  # def f(self): a; b
        return lines[start - 1].encode()[body[0].col_offset :].decode()
    while lines[start - 2].lstrip()[:1] == "#":
        start -= 1
    return dedent("\n".join(lines[start - 1 : end]))


@lru_cache(maxsize=1024)
def _expression(code: CodeType) -> str | None:
    import ast  # here, because only drawings and reports ask

    parsed = _parse(code.co_filename)
    if parsed is None:
        return None
    text, tree = parsed
    node = _find(tree, code)
    if node is None:
        return None
    segment = ast.get_source_segment(text, node)
    return ast.unparse(node) if segment is None or "\n" in segment else segment


@lru_cache(maxsize=16)
def _parse(filename: str) -> tuple[str, ast.Module] | None:
    import ast
    import linecache

    text = "".join(linecache.getlines(filename))
    try:
        return (text, ast.parse(text)) if text else None
    except SyntaxError:
        return None


def _find(tree: ast.Module, code: CodeType) -> ast.expr | None:
    import ast

    if code.co_name == EXPRESSION:
        only = tree.body[0]
        return only.value if isinstance(only, ast.Expr) else None
    if code.co_name != "<lambda>":
        function = _definition(tree, code)
        body = [] if function is None else _undocumented(function)
        return body[0].value if len(body) == 1 and isinstance(body[0], ast.Return) else None
    lambdas = [
        node.body
        for node in ast.walk(tree)
        if isinstance(node, ast.Lambda) and node.lineno == code.co_firstlineno
    ]
    if len(lambdas) > 1:  # several on one line: the instructions know their columns
        spans = set(code.co_positions())
        lambdas = [
            b for b in lambdas if (b.lineno, b.end_lineno, b.col_offset, b.end_col_offset) in spans
        ]
    return lambdas[0] if len(lambdas) == 1 else None


def _definition(tree: ast.Module, code: CodeType) -> ast.FunctionDef | None:
    import ast

    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name == code.co_name:
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            if first == code.co_firstlineno:
                return node
    return None


def _undocumented(function: ast.FunctionDef) -> list[ast.stmt]:
    import ast

    return function.body[ast.get_docstring(function, clean=False) is not None :]
