"""Machines made of machines: one after the other, one of several, several at once, again.

Each function here makes the class of a machine whose states run others, of which a state can run
one in turn. What they run is given as to `State(runs=...)`: a machine class, a function of the
machine that makes one, or the name of one. A machine is done when it accepts, and has failed when
its code has raised; a failure that none of these handles is one of the machine that runs it.

They are machines like all others: drawn, watched, debugged and proved like those, and `stopping`
reaches what they run.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

from llfsm.errors import LlfsmError
from llfsm.runtime import Machine, Sensor, State
from llfsm.runtime.engine.errors import DefinitionError
from llfsm.runtime.engine.machine import define
from llfsm.runtime.engine.state import Runs
from llfsm.runtime.engine.table import run_names

__all__ = [
    "Cooldown",
    "Fallback",
    "Parallel",
    "Repeat",
    "Retry",
    "Sequence",
    "Timeout",
    "TookTooLongError",
    "While",
]


class TookTooLongError(LlfsmError):
    """A `Timeout` has ended what it ran; this is its failure."""


def Sequence(*steps: Runs, name: str = "Sequence") -> type[Machine]:  # noqa: N802  # makes classes
    """Make a machine that runs its steps one after the other, and is done after the last.

    It fails with the first step that fails.
    """
    states = [State(f"STEP_{number}", runs=step) for number, step in enumerate(steps, 1)]
    done = State("DONE")
    for state, after in pairwise([*_some(name, states), done]):
        state.to(after, when_done=True)
    return _made(name, [*states, done])


def Fallback(*options: Runs, name: str = "Fallback") -> type[Machine]:  # noqa: N802
    """Make a machine that runs the next of its options if one fails, and is done after the first.

    It fails with the last option, if all have failed.
    """
    states = [State(f"OPTION_{number}", runs=option) for number, option in enumerate(options, 1)]
    done = State("DONE")
    for state in _some(name, states):
        state.to(done, when_done=True)
    for state, after in pairwise(states):
        state.to(after, when_failed=True)
    return _made(name, [*states, done])


def Parallel(*branches: Runs, until: str = "all", name: str = "Parallel") -> type[Machine]:  # noqa: N802
    """Make a machine that runs its branches at once, until "all" of them are done, or "any" is.

    Their turns come in this order in each round. It fails with the first that fails, and ends the
    others.
    """
    if until not in ("all", "any"):
        raise DefinitionError(f'{name}: until is {until!r}; it must be "all" or "any"')
    work, done = State("WORK", runs=_some(name, list(branches))), State("DONE")
    if until == "all":
        work.to(done, when_done=True)
    else:
        work.to(done, when=lambda self: any(each.done for each in self.work.each), label="any done")
    return _made(name, [work, done], work=work)


def Retry(inner: Runs, tries: int = 3, *, name: str = "Retry") -> type[Machine]:  # noqa: N802
    """Make a machine that runs another one again if it fails, `tries` times in all (1 or more).

    It fails with the last failure.
    """
    _check(name, "tries", tries, 1)
    work, again, done = State("WORK", runs=inner), State("AGAIN"), State("DONE")
    work.to(done, when_done=True)
    work.to(again, when=lambda self: self.failures < tries - 1, when_failed=True, label="try again")
    again.to(work)

    @again.on_entry
    def count(self: Any) -> None:
        self.failures += 1

    return _made(name, [work, again, done], {"failures": (int, 0)})


def Timeout(inner: Runs, ms: float, *, name: str = "Timeout") -> type[Machine]:  # noqa: N802
    """Make a machine that fails with `TookTooLongError` if another one takes longer than `ms`."""
    _check(name, "ms", ms, 0)
    work, late, done = State("WORK", runs=inner), State("LATE"), State("DONE")
    work.to(done, when_done=True)
    work.to(late, after_ms=ms)

    @late.on_entry
    def fail(_: Any) -> None:
        raise TookTooLongError(f"not done within {ms:g} ms")

    return _made(name, [work, late, done])


def Repeat(inner: Runs, times: int | None = None, *, name: str = "Repeat") -> type[Machine]:  # noqa: N802
    """Make a machine that runs another one again and again, `times` times (None: for ever)."""
    _check(name, "times", 1 if times is None else times, 1)
    work, again, done = State("WORK", runs=inner), State("AGAIN"), State("DONE")
    if times is None:
        work.to(again, when_done=True)
        again.to(work, when=lambda self: not self.stopping, label="not stopping")
        again.to(done)
        return _made(name, [work, again, done])
    work.to(again, when_done=True)
    again.to(done, when=lambda self: self.finished == times, label=f"{times} times")
    again.to(work)

    @again.on_entry
    def count(self: Any) -> None:
        self.finished += 1

    return _made(name, [work, again, done], {"finished": (int, 0)})


def While(  # noqa: N802
    inner: Runs, sensor: Sensor[Any, Any], holds: Callable[[Any], bool], *, name: str = "While"
) -> type[Machine]:
    """Make a machine that runs another one while something holds, and is done when it does not.

    `holds` is asked in each turn for the message of `sensor`, and returns True or False. It is done
    when what it runs is, too.
    """
    begin, work, done = State("BEGIN"), State("WORK", runs=inner), State("DONE")
    begin.to(work, when=lambda self: holds(self.seen), label="holds")
    begin.to(done)
    work.to(done, when=lambda self: not holds(self.seen), label="holds no more")
    work.to(done, when_done=True)
    return _made(name, [begin, work, done], seen=sensor)


def Cooldown(inner: Runs, ms: float, *, name: str = "Cooldown") -> type[Machine]:  # noqa: N802
    """Make a machine that runs another one, and is done `ms` after that."""
    _check(name, "ms", ms, 0)
    work, cool, done = State("WORK", runs=inner), State("COOL"), State("DONE")
    work.to(cool, when_done=True)
    cool.to(done, after_ms=ms)
    return _made(name, [work, cool, done])


def _some(name: str, each: list[Any]) -> list[Any]:
    if not each:
        raise DefinitionError(f"{name} of nothing: give it a machine to run")
    return each


def _check(name: str, what: str, value: float, least: int) -> None:
    if not isinstance(value, int | float) or isinstance(value, bool) or value < least:
        raise DefinitionError(f"{name}: {what} is {value!r}; it must be {least} or more")


def _made(
    name: str,
    states: list[State],
    variables: dict[str, tuple[type, Any]] | None = None,
    **attributes: Any,
) -> type[Machine]:
    inner = ", ".join(each for state in states for each in run_names(state))
    path = f"{__name__}:{name}({inner})"
    return define(name, states, variables=variables, attributes=attributes, path=path)
