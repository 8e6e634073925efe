"""Properties: what must never, always, or can happen.

A property's function gets a `View` of a state and returns True or False. It must depend on nothing
else: it is called once for all states that agree in what it looks at.
"""

from __future__ import annotations

import dis
from collections.abc import Callable, Iterable
from itertools import dropwhile
from math import inf
from types import CodeType
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeAlias

from ..engine.source_text import expression_of
from ..engine.state import State
from .errors import PredicateError
from .state_view import View

if TYPE_CHECKING:
    from ..engine.machine import Machine
    from .witness import Witness

__all__ = [
    "NO_FAILURE",
    "Predicate",
    "Property",
    "StepPredicate",
    "Verdict",
    "always",
    "evaluate",
    "leads_to",
    "monitor",
    "never",
    "reachable",
    "step",
]

Predicate: TypeAlias = Callable[[Any], bool]
"""A function of a `View`; Any, as a view's machines and their variables have no types of theirs."""
StepPredicate: TypeAlias = Callable[[Any, Any], bool]
"""A function of the views before and after a turn."""
Kind: TypeAlias = Literal["never", "always", "reachable", "step", "leads_to"]


class Property(NamedTuple):
    """A property: its kind, its functions, and what reports call it."""

    kind: Kind
    functions: tuple[Callable[..., bool], ...]
    name: str
    assuming: tuple[Predicate, ...] = ()
    """Of `leads_to`: what happens again and again."""
    within_ms: float | None = None
    """Of `leads_to`: the time that it may take."""
    monitor: type[Machine] | None = None
    """A machine that is explored after the others, because the property asks for its states."""

    def __str__(self) -> str:
        return self.name


class Verdict(NamedTuple):
    """What was found of a property.

    `holds` is None if the exploration ended before that was known. `witness` is the shortest way
    to a violation or, for `reachable`, to a state that was to be reached. A `vacuous` property
    holds only because its trigger never does.
    """

    property: Property
    holds: bool | None
    witness: Witness | None
    vacuous: bool = False


def never(predicate: Predicate, name: str | None = None) -> Property:
    """Require that no state satisfies `predicate`."""
    return _property("never", name, predicate)


def always(predicate: Predicate, name: str | None = None) -> Property:
    """Require that every state satisfies `predicate`."""
    return _property("always", name, predicate)


def reachable(predicate: Predicate, name: str | None = None) -> Property:
    """Require that some state satisfies `predicate`."""
    return _property("reachable", name, predicate)


def step(predicate: StepPredicate, name: str | None = None) -> Property:
    """Require that every turn satisfies `predicate`, of the states before and after it."""
    return _property("step", name, predicate)


def leads_to(
    trigger: Predicate,
    response: Predicate,
    name: str | None = None,
    *,
    within_ms: float | None = None,
    assuming: Predicate | Iterable[Predicate] = (),
) -> Property:
    """Require that every state that satisfies `trigger` is or leads to one with `response`.

    It must come within `within_ms` milliseconds, counted by the periods that pass, or else at
    some time: there must be no cycle without it. Of the cycles only those count in which each
    function of `assuming` holds somewhere. An execution that ends without it violates it, too,
    if the assumptions hold in its last state.
    """
    assumed = (assuming,) if callable(assuming) else tuple(assuming)
    if within_ms is not None and assumed:
        raise PredicateError(
            "leads_to has within_ms or assuming, not both: what happens again and again may take "
            "any time"
        )
    if within_ms is not None and not (isinstance(within_ms, int | float) and 0 <= within_ms < inf):
        raise PredicateError(f"within_ms is {within_ms!r}; it must be a number, 0 or more")
    prop = _property("leads_to", name, trigger, response)
    for function in assumed:
        _check_function("leads_to(..., assuming=...)", function)
    return prop._replace(assuming=assumed, within_ms=within_ms)


def monitor(
    machine: type[Machine], bad: State | Iterable[State], name: str | None = None
) -> Property:
    """Require that a machine that watches the others never comes into a state of `bad`.

    It has its turn after the others, posts nothing, and finds in slots of the environment what the
    others found there last.
    """
    states = [bad] if isinstance(bad, State) else list(bad)
    known = [state.name for state in machine.table.states]
    for state in states:
        if not isinstance(state, State) or state.name not in known:
            raise PredicateError(
                f"monitor: {machine.__name__} has no state {state!r}; it has: {', '.join(known)}"
            )
    if machine.table.actuators:
        raise PredicateError(
            f"monitor: {machine.__name__} posts to {next(iter(machine.table.actuators))}; what "
            f"watches must not act"
        )
    named, watcher = {state.name for state in states}, machine.__name__

    def is_bad(view: View) -> bool:
        return str(view[watcher].state) in named

    text = name or f"{watcher} never in {' or '.join(sorted(named))}"
    return Property("never", (is_bad,), text, monitor=machine)


NO_FAILURE: Final = Property("never", (), "no machine's code raises")
"""What is checked without being asked for."""


def _property(kind: Kind, name: str | None, *functions: Callable[..., bool]) -> Property:
    for function in functions:
        _check_function(kind, function)
    return Property(kind, functions, name or f"{kind}({', '.join(map(_text_of, functions))})")


def _check_function(what: str, function: object) -> None:
    if not callable(function) or isinstance(function, type):
        raise PredicateError(
            f"{what} needs a function of the view, such as lambda v: v.Timer.minutes > 0, "
            f"not {function!r}"
        )
    if _asks_which_state(getattr(function, "__code__", None)):
        raise PredicateError(
            f"{what}: the function compares a state by `is`, but a state is its name: use =="
        )


def _asks_which_state(code: CodeType | None) -> bool:
    """Return whether code has `v.Machine.state is ...`, or the other way round."""
    steps = [] if code is None else list(dis.get_instructions(code))
    for number, (view, machine, state) in enumerate(zip(steps, steps[1:], steps[2:], strict=False)):
        named = machine.opname == state.opname == "LOAD_ATTR" and state.argval == "state"
        if named and view.opname.startswith("LOAD_FAST"):
            rest = dropwhile(lambda step: step.opname.startswith("LOAD_"), steps[number + 3 :])
            if next(rest).opname == "IS_OP":
                return True
    return False


def _text_of(function: Callable[..., bool]) -> str:
    named = str(getattr(function, "__name__", "<lambda>"))
    return (expression_of(function) or named) if named == "<lambda>" else named


def evaluate(prop: Property, function: Callable[..., bool], *views: View) -> bool:
    """Return what a property's function says of states; raise `PredicateError`."""
    try:
        value = function(*views)
    except PredicateError as error:
        raise PredicateError(f"{prop}: {error}") from None
    except (Exception, SystemExit) as error:
        raise PredicateError(
            f"{prop} raised {type(error).__name__}: {error}{_line(error)}"
        ) from error
    if value is not True and value is not False:
        raise PredicateError(f"{prop} returned {value!r}; it must return True or False")
    return value


def _line(error: BaseException) -> str:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f" ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})"
