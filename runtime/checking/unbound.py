"""The names in a function that neither it, its module nor Python defines."""

from __future__ import annotations

import builtins
import dis
from collections.abc import Callable, Iterator
from types import CodeType
from typing import Any

__all__ = ["unbound_names"]


def unbound_names(function: Callable[..., Any]) -> Iterator[tuple[str, int]]:
    """Return the global names that `function` reads and that nothing defines, with their lines.

    A name that the function itself makes global counts as defined.
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
                yield name, (each.positions and each.positions.lineno) or 1


def _instructions(code: CodeType) -> Iterator[dis.Instruction]:
    yield from dis.get_instructions(code)
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _instructions(inner)
