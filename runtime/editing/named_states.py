"""The names of states in code: what `state_name` is compared with."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator

from ..converting.edited_text import EditedText
from .draft import Draft
from .text_edits import text_of

__all__ = ["rename_in_texts"]

_VARIABLE = "state_name"


def rename_in_texts(draft: Draft, old: str, new: str) -> None:
    """Let the texts of a machine compare `state_name` with another name; all else stays."""
    found = [name for name, data in draft.files.items() if _may_name(name, data, old)]
    if not found:
        return
    own = {f"{draft.bundle.name}_Methods.py"}.union(
        *(draft.files_of(state.name) for state in draft.bundle.states)
    )
    for name in own.intersection(found):
        draft.put_text(name, _renamed(text_of(draft.files[name]), old, new))


def _may_name(file: str, data: bytes, state: str) -> bool:
    return file.endswith((".py", ".expr")) and _VARIABLE.encode() in data and state.encode() in data


def _renamed(text: str, old: str, new: str) -> str:
    shift = len(text) - len(text.lstrip(" \t"))  # of an expression
    try:
        tree = ast.parse(text[shift:])
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return text
    edited = EditedText(text[shift:])
    for node in _compared(tree):
        if node.value == old:
            start, end = edited.start(node), edited.end(node)
            written = edited.text(start, end)
            if written[1:-1] == old:
                edited.replace(start, end, f"{written[0]}{new}{written[-1]}")
    return text[:shift] + edited.text()


def _compared(tree: ast.AST) -> Iterator[ast.Constant]:
    """Give the constants with which the name of the state is compared."""
    for node in ast.walk(tree):
        match node:
            case ast.Compare(ast.Name(name), comparators=others) if name == _VARIABLE:
                yield from _constants(others)
            case ast.Compare(ast.Constant() as one, comparators=[ast.Name(name)]):
                if name == _VARIABLE:
                    yield one
            case ast.Match(ast.Name(name), cases) if name == _VARIABLE:
                yield from _constants(each.pattern for each in cases)


def _constants(nodes: Iterable[ast.AST]) -> Iterator[ast.Constant]:
    """Give the constants in nodes, and in the tuples and patterns that these are."""
    for each in nodes:
        if isinstance(each, ast.Constant):
            yield each
        elif isinstance(each, ast.Tuple | ast.List | ast.Set | ast.MatchValue | ast.MatchOr):
            yield from _constants(ast.iter_child_nodes(each))
