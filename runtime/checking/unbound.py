"""The names in a function that neither it, its module nor Python defines."""

from __future__ import annotations

import builtins
import dis
from collections.abc import Callable, Iterator
from inspect import CO_VARARGS, CO_VARKEYWORDS
from itertools import pairwise
from types import CodeType
from typing import Any

__all__ = ["unbound_names"]


def unbound_names(function: Callable[..., Any]) -> Iterator[tuple[str, int]]:
    """Return the names that `function` reads and that nothing defines, with their lines.

    A name that the function itself makes global counts as defined. One of its own that it only
    ever changes, as by ``count += 1``, does not.
    """
    instructions = [*_instructions(function.__code__)]
    made = {each.argval for each in instructions if each.opname == "STORE_GLOBAL"}
    for each in instructions:
        if each.opname == "LOAD_GLOBAL":
            name = each.argval
            if (
                name not in made
                and name not in function.__globals__
                and not hasattr(builtins, name)
            ):
                yield name, _line(each)
    yield from _only_changed(function.__code__)


def _only_changed(code: CodeType) -> Iterator[tuple[str, int]]:
    given = code.co_argcount + code.co_kwonlyargcount
    given += sum(bool(code.co_flags & flag) for flag in (CO_VARARGS, CO_VARKEYWORDS))
    made = {*code.co_varnames[:given]}
    changed: dict[str, int] = {}
    for before, each in pairwise(dis.get_instructions(code)):
        if each.opname.startswith("STORE_FAST"):
            name, *others = (each.argval,) if isinstance(each.argval, str) else each.argval
            made.update(others)
            if before.opname == "BINARY_OP" and before.argrepr.endswith("="):
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
