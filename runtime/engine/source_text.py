"""Source texts of functions, and where they are: for labels, drawings and checks.

The engine imports this when a text is asked for, because a machine that runs alone needs none.
"""

from __future__ import annotations

import ast
import linecache
from collections.abc import Callable, Iterator
from functools import lru_cache
from textwrap import dedent
from types import CodeType
from typing import Any, TypeAlias

FunctionSyntax: TypeAlias = ast.FunctionDef | ast.Lambda

EXPRESSION = "<expression>"
"""The name of a function whose file holds nothing but the expression that it returns."""


class TextOnly:
    """Stand for a section of which only the text is known, as of another process's machine."""

    def __init__(self, text: str):
        self.text = text

    def __call__(self, machine: Any) -> None:
        """Raise: there is no code."""
        raise TypeError("only the text of this section is known: it cannot be run")


def syntax_of(function: object) -> FunctionSyntax | None:
    """Return the syntax tree of the ``def`` or ``lambda`` that made `function`.

    None if it is not a Python function, its file cannot be read, or several lambdas on a line
    cannot be distinguished because their code is the same.
    """
    code = getattr(function, "__code__", None)
    return _syntax(code.co_filename, code) if isinstance(code, CodeType) else None


def expression_of(function: Callable[..., Any]) -> str | None:
    """Return the text of what a lambda, or a function that is one `return`, returns.

    None if there is no such expression or its source cannot be read.
    """
    code = getattr(function, "__code__", None)
    return None if code is None else _expression(code.co_filename, code)


def body_of(function: Callable[..., Any]) -> str | None:
    """Return the text of a function's statements, without its docstring; None without source.

    That of a bundle's section is all of its file.
    """
    if isinstance(function, TextOnly):
        return function.text
    code = getattr(function, "__code__", None)
    return None if code is None else _body(code.co_filename, code)


@lru_cache(maxsize=1024)
def _body(filename: str, code: CodeType) -> str | None:
    parsed = parse_file(filename)
    if parsed is None:
        return None
    text, _ = parsed
    if code.co_varnames and not code.co_varnames[0].isidentifier():
        return text  # a bundle's code has a machine that it cannot name
    node = _syntax(filename, code)
    if not isinstance(node, ast.FunctionDef):
        return _expression(filename, code)
    body = _undocumented(node)
    return "" if not body else _lines_of(text.splitlines(), node, body)


@lru_cache(maxsize=16)
def parse_file(filename: str) -> tuple[str, ast.Module] | None:
    """Return text and syntax tree of a file that was imported; None if it cannot be read.

    A file that has changed since then is not read again.
    """
    text = "".join(linecache.getlines(filename))
    try:
        return (text, ast.parse(text)) if text else None
    except SyntaxError:
        return None


def _lines_of(lines: list[str], node: ast.FunctionDef, body: list[ast.stmt]) -> str:
    """Return the lines of statements, with the comments right above them."""
    start, end = body[0].lineno, body[-1].end_lineno
    if start == node.lineno:  # def f(self): a; b
        return lines[start - 1].encode()[body[0].col_offset :].decode()
    while lines[start - 2].lstrip()[:1] == "#":
        start -= 1
    return dedent("\n".join(lines[start - 1 : end]))


@lru_cache(maxsize=1024)
def _expression(filename: str, code: CodeType) -> str | None:
    """Find the expression of `code`; of another file, equal code may be written differently."""
    parsed = parse_file(filename)
    if parsed is None:
        return None
    text, tree = parsed
    match tree.body if code.co_name == EXPRESSION else _syntax(filename, code):
        case [ast.Expr(value), *_] | ast.Lambda(body=value):
            pass
        case ast.FunctionDef() as function:
            match _undocumented(function):
                case [ast.Return(ast.expr() as value)]:
                    pass
                case _:
                    return None
        case _:
            return None
    segment = ast.get_source_segment(text, value)
    return ast.unparse(value) if segment is None or "\n" in segment else segment


@lru_cache(maxsize=1024)
def _syntax(filename: str, code: CodeType) -> FunctionSyntax | None:
    here = _functions(filename).get(code.co_firstlineno, ())
    if code.co_name == "<lambda>":
        return _lambda([node for node in here if isinstance(node, ast.Lambda)], code)
    for node in here:
        if isinstance(node, ast.FunctionDef) and node.name == code.co_name:
            return node
    return None


@lru_cache(maxsize=16)
def _functions(filename: str) -> dict[int, list[FunctionSyntax]]:
    """Return the functions and lambdas of a file by the line on which each begins."""
    parsed = parse_file(filename)
    found: dict[int, list[FunctionSyntax]] = {}
    for node in ast.walk(parsed[1]) if parsed else ():
        if isinstance(node, ast.FunctionDef):
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            found.setdefault(first, []).append(node)
        elif isinstance(node, ast.Lambda):
            found.setdefault(node.lineno, []).append(node)
    return found


def _lambda(on_line: list[ast.Lambda], code: CodeType) -> ast.Lambda | None:
    """Return the lambda that `code` was compiled from, by compiling those on its line again."""
    if len(on_line) > 1:
        wanted = _fingerprint(code)
        on_line = [
            node
            for node in on_line
            for compiled in _code_of(node, code.co_filename)
            if _fingerprint(compiled) == wanted
        ]
    same = len({ast.unparse(node) for node in on_line}) == 1
    return on_line[0] if same else None


def _code_of(node: ast.Lambda, filename: str) -> Iterator[CodeType]:
    outer = compile(ast.Expression(node), filename, "eval", dont_inherit=True)
    yield from (each for each in outer.co_consts if isinstance(each, CodeType))


def _fingerprint(code: CodeType) -> object:
    """Make a key that is equal wherever a lambda is compiled, in a function or alone.

    The columns of its instructions are enough but for lambdas that return a constant, which
    have none on Python 3.12.
    """
    spans = {span for span in code.co_positions() if span[2] != span[3]}
    constants = [repr(each) for each in code.co_consts if not isinstance(each, CodeType)]
    return spans, constants, code.co_varnames


def _undocumented(function: ast.FunctionDef) -> list[ast.stmt]:
    return function.body[ast.get_docstring(function, clean=False) is not None :]
