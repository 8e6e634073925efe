"""The debugger of machines that run again: it knows at which moment they are."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from types import FunctionType
from typing import TYPE_CHECKING, NamedTuple

from llfsm.runtime.debugging.debugger import Debugger, Goal, Step
from llfsm.runtime.debugging.section_pdb import SectionPdb
from llfsm.runtime.engine.events import Eval, Event, Section, Turn

if TYPE_CHECKING:
    from llfsm.runtime.debugging.breakpoints import Breakpoint
    from llfsm.runtime.engine.errors import ExecutionError
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.seat import Seat

    from .rerun import Rerun

__all__ = ["Abandoned", "SectionPlace", "TravelDebugger", "section_of"]


class SectionPlace(NamedTuple):
    """A section of a state, in which to open a pdb."""

    machine: str
    state: str
    section: str


class Abandoned(BaseException):  # no error of machines, whatever they catch
    """Nobody looks at this run any more."""


class TravelDebugger(Debugger):
    """A debugger of machines that run again; it counts turns, and is attached all the time."""

    def __init__(self, rerun: Rerun, since: int):
        super().__init__(rerun.arrangement)
        self._rerun = rerun
        self.number = 0
        """The number of the latest turn that has begun, from 1."""
        self.since = since
        """The number of the turn from which on breakpoints pause."""
        self.passed = 0
        """The last turn before that at which one would have."""
        self.time_ns = 0
        """The time of the latest event, by the recording's clock, which never stood still."""
        self.begun_ns = -1 << 62
        """The time of the latest turn that was not only to come."""
        self.rounds = array("q")
        """The numbers of the turns with which rounds have begun."""
        self.arrivals = array("q")
        """The numbers of the turns before which a transition has fired."""
        self._round = 0
        self._states: dict[str, str] = {}  # at the latest turn that has begun
        self._since: dict[str, int] = {}  # the number of the first turn at which they were so
        self.place: SectionPlace | None = None
        """Where to open a pdb, once; names that are empty are those of any."""
        self._is_abandoned = False
        rerun.arrangement.attach(self)

    @property
    def behind_ns(self) -> int:
        """How far the machines' clock is behind the recording's."""
        return self._rerun.behind_ns

    @property
    def moment(self) -> int:
        """The number of the turn that is to come."""
        return self.number + (self.turn is None)

    def last_hit(self, *, is_after_end: bool) -> int:
        """Return the last moment before this one at which a breakpoint is reached; 0 if none.

        The failure that has ended all is before the end, though no turn comes after it.
        """
        is_at_failure = self.turn is None and bool(self._hits)
        return self.moment if is_after_end and is_at_failure else self.passed

    def before_state(self, machine: str) -> int:
        """Return the last moment at which a machine was not in its state; 0 if there is none."""
        state = self.arrangement.standing(machine).state
        is_new = self._states.get(machine) != state  # since the last turn
        return self.number if is_new else self._since[machine] - 1

    def run_to(self, goal: Goal, since: int = 0) -> None:
        """Go on until that; breakpoints pause from the turn of number `since` on."""
        self.since = since
        self._run(goal)

    def proceed(self) -> None:
        """Go on to a breakpoint, or the end."""
        self.since, self._goal = 0, None
        self._release()

    def step(
        self, until: Step = "turn", machine: str | None = None, *, lease_s: float | None = None
    ) -> None:
        """Go on, and pause again."""
        self.since = 0
        super().step(until, machine, lease_s=lease_s)

    def abandon(self) -> None:
        """End the thread of the machines, at its next turn if it runs."""
        self._is_abandoned = True
        self._go.set()

    def failed(self, seat: Seat, error: ExecutionError) -> None:
        """Pause at a failure that ends all."""
        if self.number + 1 >= self.since:
            super().failed(seat, error)
        else:
            self._probes.test_failures(seat)  # it counts its hits, and can be gone back to

    def __call__(self, event: Event) -> None:
        """Take an event."""
        self.time_ns = event.time_ns + self.behind_ns
        if isinstance(event, Turn):
            if self._is_abandoned or self._rerun.difference is not None:
                raise Abandoned
            self.number += 1
            if event.round > self._round:
                self._round = event.round
                self.rounds.append(self.number)
            self._note_states()
            super().__call__(event)
            self.begun_ns = self.time_ns
            return
        super().__call__(event)
        if isinstance(event, Eval) and event.value is True:
            self.arrivals.append(self.number + 1)
        elif isinstance(event, Section) and self.place is not None:
            self._open_pdb(event)

    def _note_states(self) -> None:
        states = self.arrangement.states()
        if states != self._states:
            for name in states:
                if states[name] != self._states.get(name):
                    self._since[name] = self.number
            self._states = states

    def _open_pdb(self, event: Section) -> None:
        here = event.machine, event.state, event.section
        if any(
            wanted not in ("", name) for wanted, name in zip(self.place or (), here, strict=True)
        ):
            return
        machine = self.arrangement.machine(event.machine)
        code = section_of(type(machine), event.state, event.section)
        if code is not None:
            self.place = None
            self._goal = Goal(f"after {event.section} of {event.state}")
            SectionPdb().open_at(code.__code__)

    def _hit(self, breakpoint: Breakpoint, problem: str, seat: Seat, source: str) -> None:
        if self.number + 1 >= self.since:
            super()._hit(breakpoint, problem, seat, source)
        else:
            self.passed = self.number + 1

    def _begin(self, why: str) -> None:
        self.place = None
        super()._begin(why)

    def _hold(self, is_over: Callable[[], bool]) -> None:
        while not is_over():  # also after the stop that was recorded
            pass
        if self._is_abandoned:
            raise Abandoned


def section_of(machine: type[Machine], state: str, section: str) -> FunctionType | None:
    """Return the code of a section; None if there is none."""
    for each in machine.table.states:
        if each.name == state:
            found = each.sections.get(section)
            return found if isinstance(found, FunctionType) else None
    return None
