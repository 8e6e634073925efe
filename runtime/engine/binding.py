"""The table of a loaded machine as the ringlet wants it: plain functions and their targets.

While there are observers, each function is wrapped in one that reports it, so that the one
ringlet serves both and pays for observers only when there are some.
"""

from __future__ import annotations

from collections.abc import Callable
from math import floor
from typing import TYPE_CHECKING, Any, TypeAlias

from .clock import NEVER
from .events import Eval, Section
from .state import SECTIONS, Guard, SectionCode, State
from .twin import StateFields

if TYPE_CHECKING:
    from .environment import Read
    from .seat import Seat

__all__ = ["BoundSensor", "BoundState", "BoundTransition", "Running", "bind"]

BoundSensor: TypeAlias = tuple[str, "Read", object]
"""A sensor's name, what reads it, and what stands for None in the snapshot."""
BoundTransition: TypeAlias = tuple[int | None, Guard | None, "BoundState"]
"""Nanoseconds in the state that must have passed (None: any), the guard and the target."""

_FOREVER_NS = 2**63 - 1  # by any clock
_ON_SUSPEND = SECTIONS.index("OnSuspend")

Running: TypeAlias = tuple["BoundState", Callable[[Any], object] | None, int]
"""What a ringlet runs: the state it began in, code (None: it takes the snapshot), and its step."""


class BoundState(StateFields):
    """A state of one loaded machine: plain functions and targets, nothing to look up.

    It stays the same object while observers come and go; only what it holds is exchanged.
    """

    __slots__ = ("name",)

    def __init__(self, name: str):
        self.name = name
        self.on_entry: SectionCode | None = None
        self.on_exit: SectionCode | None = None
        self.internal: SectionCode | None = None
        self.on_suspend: SectionCode | None = None
        self.on_resume: SectionCode | None = None
        self.transitions: tuple[BoundTransition, ...] = ()
        self.spent_ns = NEVER  # how long the machine was in it, if its turns are timed


def bind(seat: Seat, *, observed: bool) -> None:
    """Fill the bound states of `seat` from its machine's table."""
    for state in type(seat.machine).table.states:
        bound = seat.states[state.name]
        code = [state.sections.get(section) for section in SECTIONS]
        code[_ON_SUSPEND] = _suspending(seat, code[_ON_SUSPEND])
        transitions = [_transition(seat, state, number) for number in range(len(state.transitions))]
        if observed:
            code = [_watch_section(seat, state, *pair) for pair in zip(SECTIONS, code, strict=True)]
            transitions = [_watch_transition(seat, state, *pair) for pair in enumerate(transitions)]
        bound.on_entry, bound.on_exit, bound.internal, bound.on_suspend, bound.on_resume = code
        bound.transitions = tuple(transitions)
    states = seat.states.values()
    seat.notifies = any(bound.on_suspend or bound.on_resume for bound in states)


def _suspending(seat: Seat, code: SectionCode | None) -> SectionCode | None:
    """Return OnSuspend's code, after the safe values if the machine has any."""
    actuators = type(seat.machine).table.actuators.values()
    if all(actuator.at_suspend is None for actuator in actuators):
        return code

    def post_and_run(machine: Any) -> None:
        if seat.failure is None:  # else the values for that were posted, and stay
            seat.post_safe("at_suspend")
        if code is not None:
            code(machine)

    return post_and_run


def _transition(seat: Seat, state: State, number: int) -> BoundTransition:
    transition = state.transitions[number]
    guard, target = transition.guard, transition.target
    after_ms, limit_ns = transition.after_ms, None
    if after_ms is not None:
        limit_ns = floor(min(after_ms * 1_000_000, _FOREVER_NS))

    def evaluate_and_note(machine: Any) -> bool:  # the target alone does not identify it
        value = guard is None or guard(machine)
        if value is True:
            seat.fired = number
        return value

    alone = sum(each.target is target for each in state.transitions) == 1
    return limit_ns, guard if alone else evaluate_and_note, seat.states[target.name]


def _watch_section(seat: Seat, state: State, section: str, code: SectionCode | None) -> SectionCode:
    arrangement = seat.arrangement

    def report_and_run(machine: Any) -> None:
        arrangement.emit(Section(*arrangement.stamp(), seat.name, state.name, section))
        if code is not None:
            outer, seat.doing = seat.doing, state.name
            try:
                code(machine)
            finally:
                seat.doing = outer

    return report_and_run


def _watch_transition(
    seat: Seat, state: State, number: int, bound: BoundTransition
) -> BoundTransition:
    arrangement, (limit_ns, guard, target) = seat.arrangement, bound
    now, label = arrangement.environment.clock.now_ns, state.transitions[number].label

    def evaluate_and_report(machine: Any) -> bool:
        outer, seat.doing = seat.doing, None
        try:
            due = limit_ns is None or now() - seat.entered_ns > limit_ns
            value = due and (guard is None or guard(machine))
        finally:
            seat.doing = outer
        arrangement.emit(
            Eval(*arrangement.stamp(), seat.name, state.name, number, label, target.name, value)
        )
        return value

    return None, evaluate_and_report, target
