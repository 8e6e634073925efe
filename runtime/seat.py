"""A machine's seat in an arrangement: where it stands, and its table bound for speed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from .errors import LoadError
from .events import Eval, MachineStatus, Request, Section
from .failure import logger
from .ports import Actuator
from .state import SECTIONS, Guard, SectionCode, State, Transition

if TYPE_CHECKING:
    from llfsm.whiteboard import Board

    from .machine import Machine
    from .roster import Roster

__all__ = ["BoundState", "Request", "Seat"]

NEVER = -1

Read: TypeAlias = Callable[[], object]


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


class Seat:
    """One machine in one arrangement: its place in the order and where its execution stands.

    `current`, `previous` (None before the first ringlet and after a restart) and `remembered`
    (where resume leads) are what the semantics speak of; `request` is the scheduled action.
    """

    __slots__ = (
        "current",
        "doing",
        "entered_ns",
        "index",
        "initial",
        "machine",
        "name",
        "now",
        "path",
        "previous",
        "remembered",
        "request",
        "roster",
        "sensors",
        "states",
        "suspension",
        "taken",
    )

    def __init__(self, machine: Machine, roster: Roster, index: int, name: str, path: str):
        table = type(machine).table
        self.machine = machine
        self.roster = roster
        self.index = index
        self.name = name
        self.path = path
        self.now = roster.clock.now_ns
        self.states = {state.name: BoundState(state.name) for state in table.states}
        self.initial = self.states[table.initial.name]
        self.suspension = (
            BoundState("Suspended") if table.suspend is None else self.states[table.suspend.name]
        )
        self.current = self.remembered = self.initial
        self.previous: BoundState | None = None
        self.request: Request | None = None
        self.entered_ns = NEVER  # when the state clock started
        self.doing: str | None = None  # the state whose section runs, while observed
        self.sensors: tuple[tuple[str, Read], ...] = ()
        self.taken = True

    @property
    def suspended(self) -> bool:
        """Whether the machine is in its suspend state."""
        return self.current is self.suspension

    @property
    def settled(self) -> bool:
        """Whether the machine does not keep the execution alive.

        It accepts (and did not just get there), or is suspended with nothing pending that
        would end this. A machine without a turn yet is never settled.
        """
        if self.current is self.suspension:
            waking = self.request is Request.RESUME or self.request is Request.RESTART
            return not waking and self.entered_ns != NEVER
        return self.current is self.previous and not self.current.transitions

    def suspend(self) -> None:
        """Go to the suspend state and remember the current one; nothing if suspended."""
        if self.current is not self.suspension:
            self.previous = self.remembered = self.current
            self.current = self.suspension

    def perform_request(self) -> None:
        """Apply and clear the request."""
        request, self.request = self.request, None
        if request is Request.SUSPEND:
            self.suspend()
        elif request is Request.RESTART:
            self.current, self.previous = self.initial, None
        elif self.suspended and self.remembered is not self.suspension:
            self.current, self.previous = self.remembered, self.suspension

    def declared(self, state: BoundState) -> State:
        """Return the declaration of `state`; not of a suspend state that nobody declared."""
        return next(s for s in type(self.machine).table.states if s.name == state.name)

    def status(self) -> MachineStatus:
        """Describe where the machine stands."""
        entered_ns = None if self.entered_ns == NEVER else self.entered_ns
        return MachineStatus(
            self.index, self.name, self.current.name, self.suspended, self.request, entered_ns
        )

    def connect(self, board: Board | None) -> None:
        """Bind the machine's sensors and actuators to the slots of `board`."""
        table = type(self.machine).table
        if board is None:
            slots = [port.slot for port in table.sensors.values()]
            slots += [port.slot for port in table.actuators.values()]
            if slots:
                raise LoadError(
                    f"{self.name} uses slot {slots[0].name!r}: give the Arrangement a whiteboard"
                )
            return
        self.sensors = tuple((name, port.bind(board)) for name, port in table.sensors.items())
        for name, port in table.actuators.items():
            setattr(self.machine, name, port.bind(board))

    def finish(self) -> None:
        """Leave the seat and post what is to be posted at the end: once, whatever comes after."""
        if not self.taken:
            return
        self.taken = False
        for name, port in type(self.machine).table.actuators.items():
            if port.at_end is not None:
                self._post_last(name, port)

    def bind(self, observed: bool) -> None:
        """Fill the bound states from the table, with code that reports each step if observed."""
        for state in type(self.machine).table.states:
            bound = self.states[state.name]
            code = [
                self._watch_section(state.name, section, state.sections.get(section))
                if observed
                else state.sections.get(section)
                for section in SECTIONS
            ]
            bound.on_entry, bound.on_exit, bound.internal, bound.on_suspend, bound.on_resume = code
            bound.transitions = tuple(
                (
                    self._watch_guard(state, number, self._guard(transition))
                    if observed
                    else self._guard(transition),
                    self.states[transition.target.name],
                )
                for number, transition in enumerate(state.transitions)
            )

    def _post_last(self, name: str, port: Actuator[Any]) -> None:
        from llfsm.whiteboard import WhiteboardError

        try:
            getattr(self.machine, name)(port.at_end)
        except WhiteboardError as error:  # the other messages must go out all the same
            logger().warning("%s: the last %s was not posted: %s", self.name, name, error)

    def _guard(self, transition: Transition) -> Guard | None:
        """Return the function that evaluates `transition`; None if it always fires."""
        guard = transition.guard
        if transition.after_ms is None:
            return guard
        now, limit_ns = self.now, transition.after_ms * 1_000_000
        if guard is None:
            return lambda _: now() - self.entered_ns > limit_ns
        return lambda machine: now() - self.entered_ns > limit_ns and guard(machine)

    def _watch_section(self, state: str, section: str, code: SectionCode | None) -> SectionCode:
        roster = self.roster

        def report_and_run(machine: Any) -> None:
            roster.emit(Section(*roster.stamp(), self.name, state, section))
            if code is not None:
                outer, self.doing = self.doing, state
                try:
                    code(machine)
                finally:
                    self.doing = outer

        return report_and_run

    def _watch_guard(self, state: State, number: int, guard: Guard | None) -> Guard:
        roster = self.roster
        transition = state.transitions[number]
        label, target = transition.label, transition.target.name

        def evaluate_and_report(machine: Any) -> bool:
            outer, self.doing = self.doing, None
            try:
                value = guard is None or guard(machine)
            finally:
                self.doing = outer
            roster.emit(Eval(*roster.stamp(), self.name, state.name, number, label, target, value))
            return value

        return evaluate_and_report
