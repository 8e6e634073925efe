"""The table of a loaded machine as the ringlet wants it: plain functions and their targets.

While there are observers, each function is wrapped in one that reports it, so that the one
ringlet serves both and pays for observers only when there are some.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .events import Eval, Section
from .state import SECTIONS, Guard, SectionCode, State, Transition

if TYPE_CHECKING:
    from .seat import Seat

__all__ = ["BoundState", "bind"]

_ON_SUSPEND = SECTIONS.index("OnSuspend")


class BoundState:
    """A state of one loaded machine: plain functions and targets, nothing to look up.

    It stays the same object while observers come and go; only what it holds is exchanged.
    """

    __slots__ = (
        "internal",
        "name",
        "on_entry",
        "on_exit",
        "on_resume",
        "on_suspend",
        "transitions",
    )

    def __init__(self, name: str):
        self.name = name
        self.on_entry: SectionCode | None = None
        self.on_exit: SectionCode | None = None
        self.internal: SectionCode | None = None
        self.on_suspend: SectionCode | None = None
        self.on_resume: SectionCode | None = None
        self.transitions: tuple[tuple[Guard | None, BoundState], ...] = ()


def bind(seat: Seat, *, observed: bool) -> None:
    """Fill the bound states of `seat` from its machine's table."""
    for state in type(seat.machine).table.states:
        bound = seat.states[state.name]
        code = [state.sections.get(section) for section in SECTIONS]
        code[_ON_SUSPEND] = _suspending(seat, code[_ON_SUSPEND])
        guards = [_guard(seat, state, number) for number in range(len(state.transitions))]
        if observed:
            code = [_watch_section(seat, state, *pair) for pair in zip(SECTIONS, code, strict=True)]
            guards = [_watch_guard(seat, state, *pair) for pair in enumerate(guards)]
        bound.on_entry, bound.on_exit, bound.internal, bound.on_suspend, bound.on_resume = code
        targets = [seat.states[transition.target.name] for transition in state.transitions]
        bound.transitions = tuple(zip(guards, targets, strict=True))
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


def _guard(seat: Seat, state: State, number: int) -> Guard | None:
    """Return the function that evaluates a transition; None if it always fires."""
    guard = _timed(seat, state.transitions[number])
    target = state.transitions[number].target
    if sum(each.target is target for each in state.transitions) == 1:
        return guard

    def evaluate_and_note(machine: Any) -> bool:  # the target alone does not identify it
        value = guard is None or guard(machine)
        if value is True:
            seat.fired = number
        return value

    return evaluate_and_note


def _timed(seat: Seat, transition: Transition) -> Guard | None:
    guard = transition.guard
    if transition.after_ms is None:
        return guard
    now, limit_ns = seat.arrangement.environment.clock.now_ns, transition.after_ms * 1_000_000
    if guard is None:
        return lambda _: now() - seat.entered_ns > limit_ns
    return lambda machine: now() - seat.entered_ns > limit_ns and guard(machine)


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


def _watch_guard(seat: Seat, state: State, number: int, guard: Guard | None) -> Guard:
    arrangement = seat.arrangement
    transition = state.transitions[number]
    label, target = transition.label, transition.target.name

    def evaluate_and_report(machine: Any) -> bool:
        outer, seat.doing = seat.doing, None
        try:
            value = guard is None or guard(machine)
        finally:
            seat.doing = outer
        arrangement.emit(
            Eval(*arrangement.stamp(), seat.name, state.name, number, label, target, value)
        )
        return value

    return evaluate_and_report
