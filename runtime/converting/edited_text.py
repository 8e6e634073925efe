"""A text that is changed at the places of nodes of its syntax tree, and nowhere else.

`ast.unparse` would lose comments and the user's own layout. The tree therefore only says where, in
bytes as `ast` counts columns, and the text between changes is copied as it is.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Callable
from copy import deepcopy
from functools import lru_cache

_F_STRING = {getattr(tokenize, f"FSTRING_{end}", None): end for end in ("START", "END")}
"""Tokens of Python 3.12 and later; before, an f-string is one token, as other strings are."""


class EditedText:
    """A text in Python, whose lines end in ``\\n``, and what is to take the place of its parts.

    Of changes that overlap, the first one in the text is made.
    """

    def __init__(self, text: str):
        self._lines = text.encode().split(b"\n")
        self._starts = [0]
        for line in self._lines:
            self._starts.append(self._starts[-1] + len(line) + 1)
        self._text = text.encode()
        self._in_strings = _lines_in_strings(text)
        self._changes: list[tuple[int, int, bytes]] = []

    def start(self, node: ast.expr | ast.stmt | ast.arg) -> int:
        """Return the place in bytes at which a node begins."""
        return self._starts[node.lineno - 1] + node.col_offset

    def end(self, node: ast.expr | ast.stmt | ast.arg) -> int:
        """Return the place in bytes behind a node."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._starts[node.end_lineno - 1] + node.end_col_offset

    def line(self, number: int) -> str:
        """Return a line, from 1."""
        return self._lines[number - 1].decode()

    def line_start(self, number: int) -> int:
        """Return the place of a line, from 1, in bytes; behind the last line, the text's end."""
        return min(self._starts[number - 1], len(self._text))

    def find(self, pattern: bytes, start: int) -> re.Match[bytes] | None:
        """Match a pattern with the text at `start`; None if it does not match there."""
        return re.compile(pattern).match(self._text, start)

    def replace(self, start: int, end: int, text: str) -> None:
        """Replace the text between two places."""
        self._changes.append((start, end, text.encode()))

    def indent(self, first: int, last: int, by: int) -> None:
        """Move the lines from `first` to `last` right by so many spaces, or left if `by` is < 0.

        What is in strings stays as it is.
        """
        for number in range(first, last + 1):
            line = self._lines[number - 1]
            if not line.strip() or number in self._in_strings:
                continue
            start = self._starts[number - 1]
            blank = len(line) - len(line.lstrip(b" \t"))
            if by < 0:
                self.replace(start, start + min(blank, -by), "")
            else:
                self.replace(start, start, " " * by)

    def join_blank_lines(self) -> None:
        """Leave one of several blank lines in a row."""
        for number in range(2, len(self._lines)):
            above, line = self._lines[number - 2 : number]
            if not above.strip() and not line.strip() and number not in self._in_strings:
                start = self._starts[number - 1]
                self.replace(start, self._starts[number], "")

    def replace_names(self, tree: ast.AST, new: Callable[[ast.expr], ast.expr | None]) -> None:
        """Replace the expressions for which `new` returns another one.

        An f-string with such expressions is written again as a whole: before Python 3.12, their
        places in it are unknown.
        """
        if isinstance(tree, ast.JoinedStr):
            transformer = _Transformer(new)
            text = ast.unparse(transformer.visit(deepcopy(tree)))
            if transformer.has_changed:
                self.replace(self.start(tree), self.end(tree), text)
            return
        found = new(tree) if isinstance(tree, ast.expr) else None
        if found is not None:
            assert isinstance(tree, ast.expr)
            self.replace(self.start(tree), self.end(tree), ast.unparse(found))
            return
        for child in ast.iter_child_nodes(tree):
            self.replace_names(child, new)

    def text(self, start: int = 0, end: int | None = None) -> str:
        """Return the text between two places, by default all, with the changes in it."""
        end = len(self._text) if end is None else end
        made, rest = b"", start
        for begin, stop, new in sorted(self._changes, key=lambda change: change[:2]):
            if rest <= begin and stop <= end:
                made += self._text[rest:begin] + new
                rest = stop
        return (made + self._text[rest:end]).decode()


class _Transformer(ast.NodeTransformer):
    def __init__(self, new: Callable[[ast.expr], ast.expr | None]):
        self._new = new
        self.has_changed = False

    def generic_visit(self, node: ast.AST) -> ast.AST:
        found = self._new(node) if isinstance(node, ast.expr) else None
        if found is None:
            return super().generic_visit(node)
        self.has_changed = True
        return found


@lru_cache(maxsize=16)
def _lines_in_strings(text: str) -> frozenset[int]:
    """Find the lines, by number, that begin inside a string: their indentation is its contents."""
    inside: set[int] = set()
    opened: list[int] = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        first = token.start[0]
        if _F_STRING.get(token.type) == "START":
            opened.append(first)
            continue
        if _F_STRING.get(token.type) == "END":
            first = opened.pop()
        elif token.type != tokenize.STRING:
            continue
        inside |= {*range(first + 1, token.end[0] + 1)}
    return frozenset(inside)
