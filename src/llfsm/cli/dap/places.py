"""Where machines are in files: the breakpoint of a line, and the line of a state."""

from __future__ import annotations

import ast
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from llfsm.runtime.bundles import SUFFIX
from llfsm.runtime.engine.source_text import location_of, parse_file, syntax_of

if TYPE_CHECKING:
    from llfsm.runtime.engine.machine import Machine

__all__ = ["SourceRange", "breakpoints_at", "section_at", "state_at"]

_END: Final = 2**31


class SourceRange(NamedTuple):
    """Lines of a file, from 1, and the breakpoint that stands for them."""

    file: str
    first: int
    last: int
    breakpoint: str


def breakpoints_at(
    machines: Mapping[str, type[Machine]], file: str, line: int
) -> list[SourceRange]:
    """Return what is on a line: the narrowest place of each machine that is defined there."""
    found = []
    for name, cls in machines.items():
        here = [
            place
            for place in _places(name, cls)
            if _is_same(place.file, file) and place.first <= line <= place.last
        ]
        if here:
            found.append(min(here, key=lambda place: place.last - place.first))
    return found


def state_at(cls: type[Machine], state: str) -> tuple[str, int] | None:
    """Return file and line of a state; of its first code if it is declared in no class body."""
    declared = _declared(cls).get(state)
    if declared is not None:
        return declared.file, declared.first
    for each in cls.table.states:
        if each.name == state:
            return next(filter(None, map(location_of, each.sections.values())), None)
    return None


def section_at(cls: type[Machine], state: str, section: str) -> tuple[str, int] | None:
    """Return file and line of a section; None if the state has none."""
    for each in cls.table.states:
        if each.name == state and section in each.sections:
            return location_of(each.sections[section])
    return None


def _places(name: str, cls: type[Machine]) -> Iterator[SourceRange]:
    declared = _declared(cls)
    for state in cls.table.states:
        if state.name in declared:
            yield declared[state.name]._replace(breakpoint=f"{name}:{state.name}")
        for section, code in state.sections.items():
            leaves = "->" if section == "OnExit" else ""
            yield from _lines(cls, code, f"{name}:{state.name}{leaves}")
        for transition in state.transitions:
            text = f"{name}:{state.name}->{transition.target.name}"
            yield SourceRange(*transition.location, transition.location[1], text)
            if transition.guard is not None:
                yield from _lines(cls, transition.guard, text)


def _lines(cls: type[Machine], code: Callable[..., Any], breakpoint: str) -> Iterator[SourceRange]:
    where, node = location_of(code), syntax_of(code)
    if where is None:
        return
    last = getattr(node, "end_lineno", None) or where[1]
    if SUFFIX in cls.table.path:  # each text of a bundle is a file of its own
        where, last = (where[0], 1), _END
    yield SourceRange(*where, last, breakpoint)


def _declared(cls: type[Machine]) -> dict[str, SourceRange]:
    """Return where the states of a class are assigned, by name, also in the classes above."""
    found: dict[str, SourceRange] = {}
    for each in cls.__mro__:
        file = getattr(sys.modules.get(each.__module__), "__file__", None) or ""
        parsed = parse_file(file)
        for body in ast.walk(parsed[1]) if parsed else ():
            if isinstance(body, ast.ClassDef) and body.name == each.__name__:
                for node in body.body:
                    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                        last = node.end_lineno or node.lineno
                        place = SourceRange(file, node.lineno, last, "")
                        found.setdefault(node.targets[0].id, place)
    return found


def _is_same(one: str, other: str) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)
