"""Rules for states that run machines: ends that nobody waits for, and machines without end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any

from llfsm.runtime.checking._subject import Finding, Place
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.state import State
from llfsm.runtime.engine.table import run_by
from llfsm.runtime.expressions.reads import names_in


def inner_findings(
    cls: type[Machine], place_of: Callable[[State], Place], functions: Iterator[tuple[str, Any]]
) -> Iterator[Finding]:
    """Yield what is wrong with the states of `cls` that run machines."""
    states = [state for state in cls.table.states if state.runs]
    if not states:
        return
    named = _named([function for _, function in functions], cls)
    for state in states:
        inner = [each for runs in state.runs for each in run_by(runs)]
        for each in inner if state is cls.table.initial else ():
            if way := _way_back(each, cls):
                text = f"{cls.__qualname__} runs {way}, and so on without end"
                yield Finding(*place_of(state), "error", f"state {state.name!r}: {text}")
        waits = not state.transitions or any(each.ends for each in state.transitions)
        called = {name for name, value in vars(cls).items() if value is state}
        ending = [each for each in inner if any(one.accepting for one in each.table.states)]
        if ending and not waits and named.isdisjoint(called):
            text = (
                f"nothing waits for {ending[0].__qualname__}, which the state runs and which can "
                f"end: give it a transition with when_done=True"
            )
            yield Finding(*place_of(state), "warning", f"state {state.name!r}: {text}")


def _named(functions: list[Any], cls: type[Machine]) -> set[str]:
    """Collect the names in all code of a class."""
    code: list[Any] = [each for state in cls.table.states for each in state.sections.values()]
    code += [t.guard for state in cls.table.states for t in state.transitions if t.guard]
    code += functions
    return {
        name for each in code if isinstance(each, FunctionType) for name in names_in(each.__code__)
    }


def _way_back(cls: type[Machine], goal: type[Machine], seen: tuple[Any, ...] = ()) -> str:
    """Describe how the first states of `cls` run `goal` again, at once; "" if they do not."""
    if cls is goal:
        return goal.__qualname__
    if cls in seen:
        return ""
    for runs in cls.table.initial.runs:
        for each in run_by(runs):
            if way := _way_back(each, goal, (*seen, cls)):
                return f"{cls.__qualname__}, which runs {way}"
    return ""
