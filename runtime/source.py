"""Where a function is written and what it says: the labels of transitions."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from types import CodeType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import ast

__all__ = ["EXPRESSION", "expression_of", "location_of"]

EXPRESSION = "<expression>"
"""The name of a function whose file holds nothing but the expression that it returns."""


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
    lambdas = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Lambda) and node.lineno == code.co_firstlineno:
            lambdas.append(node.body)
        elif isinstance(node, ast.FunctionDef) and node.name == code.co_name:
            first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            body = node.body[ast.get_docstring(node, clean=False) is not None :]
            if first == code.co_firstlineno and len(body) == 1 and isinstance(body[0], ast.Return):
                return body[0].value
    if code.co_name != "<lambda>":
        return None
    if len(lambdas) > 1:  # several on one line: the instructions know their columns
        spans = set(code.co_positions())
        lambdas = [
            b for b in lambdas if (b.lineno, b.end_lineno, b.col_offset, b.end_col_offset) in spans
        ]
    return lambdas[0] if len(lambdas) == 1 else None
