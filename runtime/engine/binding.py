"""Bind a machine's table: fill the states of its seat with what the ringlet wants.

The ringlet runs plain functions, and knows nothing of who watches or of machines inside machines.
So whatever is to happen besides a section's own code is wrapped around it here, where it is wanted:
reports to observers, the safe values of a suspension, and what begins and ends with a state.
"""

from __future__ import annotations

from collections.abc import Callable
from math import floor
from typing import TYPE_CHECKING, Any, Literal, Protocol

from llfsm.runtime.engine.clock import FOREVER
from llfsm.runtime.engine.events import Eval, Event, Section
from llfsm.runtime.engine.nest import Nest, Nested
from llfsm.runtime.engine.ringlet import BoundState, BoundTransition
from llfsm.runtime.engine.state import SECTIONS, Guard, SectionCode, State, Transition

if TYPE_CHECKING:
    from llfsm.runtime.engine.table import Table


class Emitting(Protocol):
    """The kernel, as reports are made to its observers."""

    def stamp(self) -> tuple[int, int]:
        """Return the round and the time, with which every event begins."""

    def emit(self, event: Event, /) -> object:
        """Report an event."""


class Bindable(Nested, Protocol):
    """A seat, as its table is bound."""

    @property
    def kernel(self) -> Emitting:
        """The kernel."""

    nest: Nest[Any]
    now: Callable[[], int]
    entered_ns: int
    notifies: bool
    source: BoundState | None
    stood: tuple[int, int] | None
    fired: int
    doing: str | None

    @property
    def table(self) -> Table:
        """The table of the machine's class."""

    def post_safe(self, when: Literal["at_suspend"]) -> None:
        """Post the safe values of the machine's actuators."""


_ON_SUSPEND = SECTIONS.index("OnSuspend")


def _never(_: Any) -> bool:
    """Keep a machine in a state without transitions that is not final."""
    return False


def bind(seat: Bindable, *, observed: bool) -> None:
    """Fill the bound states of `seat` from its machine's table."""
    for state in seat.table.states:
        bound = seat.states[state.name]
        code = [state.sections.get(section) for section in SECTIONS]
        code[_ON_SUSPEND] = _suspending(seat, code[_ON_SUSPEND])
        transitions = [_transition(seat, state, number) for number in range(len(state.transitions))]
        if observed:
            code = [_watch_section(seat, state, *pair) for pair in zip(SECTIONS, code, strict=True)]
            transitions = [_watch_transition(seat, state, *pair) for pair in enumerate(transitions)]
        if state.resume == "in_place":
            code[0] = _entering(seat, state, code[0])
        bound.on_entry, bound.on_exit, bound.internal, bound.on_suspend, bound.on_resume = code
        if not transitions and not state.final:
            transitions = [(None, _never, bound)]
        bound.transitions = tuple(transitions)
        if state.runs or bound in seat.nest.calling:
            _nest_in(seat, state, bound)
    if seat.suspension.name not in seat.states and seat.suspension in seat.nest.calling:
        seat.suspension.on_exit = seat.suspension.on_suspend = seat.suspension.on_resume = None
        _nest_in(seat, None, seat.suspension)
    stands = any(state.resume == "in_place" for state in seat.table.states)
    if stands and seat.suspension.name in seat.states:  # else no transition leads out of it
        seat.suspension.on_exit = _then(_leaving_suspension(seat), seat.suspension.on_exit)
    states = seat.states.values()
    seat.notifies = any(bound.on_suspend or bound.on_resume for bound in states)


def _suspending(seat: Bindable, code: SectionCode | None) -> SectionCode | None:
    """Return OnSuspend's code, after the safe values if the machine has any."""
    actuators = seat.table.actuators.values()
    if all(actuator.at_suspend is None for actuator in actuators):
        return code

    def post_and_run(machine: Any) -> None:
        if seat.failure is None:  # else the values for that were posted, and stay
            seat.post_safe("at_suspend")
        if code is not None:
            code(machine)

    return post_and_run


def _entering(seat: Bindable, state: State, code: SectionCode | None) -> SectionCode:
    """Return OnEntry's code, which does not run when the machine goes on in the state in place."""

    def enter(machine: Any) -> None:
        stood, seat.stood = seat.stood, None
        if stood is None or seat.source is not seat.suspension:
            if code is not None:
                code(machine)
            return
        entered_ns, suspended_ns = stood
        stopped_ns = seat.now() - suspended_ns if state.clock == "stops" else 0
        seat.entered_ns = entered_ns + stopped_ns

    return enter


def _leaving_suspension(seat: Bindable) -> SectionCode:
    """Return code for a transition of the suspend state: nothing goes on in place then."""

    def leave(_: Any) -> None:
        if seat.current is not seat.suspension:
            seat.stood = None

    return leave


def _transition(seat: Bindable, state: State, number: int) -> BoundTransition:
    transition = state.transitions[number]
    guard, target = _guard(transition), transition.target
    after_ms, limit_ns = transition.after_ms, None
    if after_ms is not None:
        limit_ns = floor(min(after_ms * 1_000_000, FOREVER))

    def evaluate_and_note(machine: Any) -> bool:  # the target alone does not identify it
        value = guard is None or guard(machine)
        if value is True:
            seat.fired = number
        return value

    alone = sum(each.target is target for each in state.transitions) == 1
    return limit_ns, guard if alone else evaluate_and_note, seat.states[target.name]


def _watch_section(
    seat: Bindable, state: State, section: str, code: SectionCode | None
) -> SectionCode:
    kernel = seat.kernel

    def report_and_run(machine: Any) -> None:
        kernel.emit(Section(*kernel.stamp(), seat.name, state.name, section))
        if code is not None:
            outer, seat.doing = seat.doing, state.name
            try:
                code(machine)
            finally:
                seat.doing = outer

    return report_and_run


def _watch_transition(
    seat: Bindable, state: State, number: int, bound: BoundTransition
) -> BoundTransition:
    kernel, (limit_ns, guard, target) = seat.kernel, bound
    label = state.transitions[number].label

    def evaluate_and_report(machine: Any) -> bool:
        outer, seat.doing = seat.doing, None
        try:
            due = limit_ns is None or seat.now() - seat.entered_ns > limit_ns
            value = due and (guard is None or guard(machine))
        finally:
            seat.doing = outer
        kernel.emit(Eval(*kernel.stamp(), seat.name, state.name, number, label, target.name, value))
        return value

    return None, evaluate_and_report, target


def _nest_in(seat: Bindable, state: State | None, bound: BoundState) -> None:
    """Let the inner machines of a state begin and end with it; None for a default state."""
    nest, entering, internal = seat.nest, bound.on_entry, bound.internal

    def enter(machine: Any) -> None:
        if entering is not None:
            entering(machine)
        if state is not None:
            nest.enter(state, bound)

    def check(machine: Any) -> None:
        nest.check(bound)
        if internal is not None:
            internal(machine)

    def leave(_: Any) -> None:
        if seat.current is not bound:  # else it is a transition to the same state
            nest.leave(bound, keep=True)
            if bound is seat.suspension:  # the machine is not resumed where it was
                nest.leave_all(keep=True)

    if state is not None and state.runs:
        bound.on_entry, bound.internal = enter, check
    bound.on_exit = _then(leave, bound.on_exit)
    bound.on_suspend = _then(lambda _: nest.halt(bound), bound.on_suspend)
    if bound is seat.suspension:
        bound.on_resume = _then(lambda _: nest.leave(bound, keep=True), bound.on_resume)


def _then(end: SectionCode, code: SectionCode | None) -> SectionCode:
    def end_and_run(machine: Any) -> None:
        end(machine)
        if code is not None:
            code(machine)

    return end_and_run


def _guard(transition: Transition) -> Guard | None:
    """Return the guard of a transition, with the ends for which it waits."""
    guard, ends, name = transition.guard, transition.ends, transition.source.name
    if not ends:
        return guard

    def has_ended(machine: Any) -> bool:
        work = machine._seat.work(name)
        return any(getattr(work, end) for end in ends) and (guard is None or guard(machine))

    return has_ended
