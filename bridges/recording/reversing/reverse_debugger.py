"""Reverse debugging: forwards and backwards through a recording, with the machines' code in place.

A moment is a turn that is to come, by its number. The machines are rerun up to it, with a debugger
attached as to live ones. To go back is to rerun them to an earlier moment. That is the same
each time, as everything that machines can learn comes from the recording; so each moment looks
alike from both sides, and no machine has to undo anything. A number suffices to find one again.

Going back needs to know which number: of the turn before, of the last round, of the last
transition, of the turn in which a machine came to its state, of the last hit of a breakpoint.
:class:`RerunDebugger` notes these numbers on the way. Breakpoints count their hits from the
beginning, but pause only from the turn `since` on; before, the last that would have is noted.

Here the machines run in a thread, each time from the beginning. :mod:`.worker` has them run on
from checkpoints.
"""

from __future__ import annotations

import threading
from array import array
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import attrgetter
from types import FunctionType
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from llfsm.bridges.recording.errors import RecordingError
from llfsm.runtime.debugging.debugger import Debugger, Goal, Step
from llfsm.runtime.debugging.section_pdb import SectionPdb
from llfsm.runtime.engine.errors import ArrangementEndedError, NotPausedError
from llfsm.runtime.engine.events import Eval, Event, Reason, Section, Turn

if TYPE_CHECKING:
    from llfsm.bridges.recording.rerun import Rerun
    from llfsm.runtime.debugging.breakpoints import Breakpoint
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.errors import ExecutionError
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.seat import Seat


_LOOK_S: Final = 0.05  # between two looks whether the thread has ended
NEVER: Final = 1 << 62
"""The number of a turn that never comes."""
NO_BREAKPOINT: Final = "no breakpoint is reached before this moment"


class SectionPlace(NamedTuple):
    """A section of a state, in which to open a pdb."""

    machine: str
    state: str
    section: str


class Abandoned(BaseException):  # no error of machines, whatever they catch
    """Nobody looks at this run any more."""


class RerunDebugger(Debugger):
    """A debugger of machines that are rerun; it counts turns, and is attached all the time."""

    def __init__(self, rerun: Rerun, since: int):
        super().__init__(rerun.arrangement)
        self._rerun = rerun
        self.number = 0
        """The number of the latest turn that has begun, from 1."""
        self.since = since
        """The number of the turn from which on breakpoints pause."""
        self.passed = 0
        """The last turn before that at which one would have paused."""
        self.time_ns = 0
        """The time of the latest event, by the recording's clock, which never stood still."""
        self.begun_ns = -1 << 62
        """The time of the latest turn that has run."""
        self.rounds = array("q")
        """The numbers of the turns with which rounds have begun."""
        self.arrivals = array("q")
        """The numbers of the turns before which a transition has fired."""
        self._round = 0
        self._states: dict[str, str] = {}  # at the latest turn that has begun
        self._since: dict[str, int] = {}  # the number of the first turn in which they were so
        self.place: SectionPlace | None = None
        """Where to open a pdb, once; names that are empty are those of any."""
        self._is_abandoned = False
        rerun.arrangement.attach(self)

    @property
    def behind_ns(self) -> int:
        """Nanoseconds by which the machines' clock is behind the recording's."""
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
        state = self.arrangement.state_name_of(machine)
        is_new = self._states.get(machine) != state  # since the last turn
        return self.number if is_new else self._since[machine] - 1

    def run_to(self, goal: Goal, since: int = 0) -> None:
        """Go on until the goal; breakpoints pause from the turn of number `since` on."""
        self.since = since
        self._run(goal)

    def proceed(self) -> None:
        """Go on to a breakpoint, or to the end."""
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
        """Note what an event says of this moment; abandon the run after a difference."""
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


class Jump(NamedTuple):
    """A moment to which machines run from an earlier one, and what to call the pause there."""

    why: str
    since: int = 0
    """The number of the turn from which on breakpoints pause."""
    moment: int = 1
    after_ns: int | None = None
    """Instead of `moment`: it is the first one after that time."""
    breakpoints: tuple[str, ...] = ()

    def goal(self, debugger: RerunDebugger) -> Goal:
        """Return the goal of a debugger: to be at this moment."""
        after_ns = self.after_ns
        if after_ns is None:
            return Goal(self.why, lambda _: debugger.number >= self.moment)
        return Goal(self.why, lambda _: debugger.time_ns > after_ns)


_START = Jump("start")


@dataclass(eq=False)
class ReverseDebugger:
    """Debug the machines of a recording, which `make` arranges anew, at any of its moments.

    `library` is as for `Debugger.break_at`; `begin_ns` is the time that counts as 0 s. Methods that
    move return as `wait` does. Leaving the ``with`` block ends the thread of the machines.
    """

    make: Callable[[], Rerun]
    library: Mapping[str, type[Machine]]
    begin_ns: int
    jump: Jump = _START

    def __post_init__(self) -> None:
        self._thread = threading.Thread()
        self._error: Exception | None = None
        self.end = ""
        """Why there is no moment after this one; "" if there is."""
        self.difference = ""
        """A description of how the machines differ at this moment; "" if they act as recorded."""
        self._begin(self.jump)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._abandon()

    @property
    def machine(self) -> str:
        """The name of the machine to look at; of the first one if that is not known."""
        return self.debugger.machine or next(iter(self.library))

    @property
    def now_s(self) -> float:
        """The seconds at this moment."""
        return (self.debugger.time_ns - self.begin_ns) / 1e9

    def wait(self) -> str:
        """Wait until the machines are paused, and return why; "" at the end.

        Raise as `Rerun.compare` does.
        """
        while self._thread.is_alive():
            with suppress(NotPausedError):
                try:
                    return self.debugger.wait(_LOOK_S)
                except ArrangementEndedError:
                    self._thread.join()
        if self._error is not None:
            raise self._error
        return ""

    def break_at(self, *texts: str) -> None:
        """Replace all breakpoints; raise `BreakpointError`."""
        self.debugger.break_at(*texts, library=self.library)

    # Forwards

    def step(self, until: Step, machine: str | None = None) -> str:
        """Make a step; raise `RecordingError` at the end."""
        self._require_more()
        self.debugger.step(until, machine)
        return self.wait()

    def proceed(self) -> str:
        """Go on to a breakpoint, or to the end; raise `RecordingError` if it is reached already."""
        self._require_more()
        self.debugger.proceed()
        return self.wait()

    def open_pdb(self, place: SectionPlace) -> str:
        """Go on until that section runs, open a pdb in it, and pause after it.

        A breakpoint before that ends the search for it. Raise `RecordingError` for a section
        without code, and at the end.
        """
        self._require_more()
        if place.section:
            self._require_code(place)
        self.debugger.place = place
        self.debugger.proceed()
        return self.wait()

    def goto(self, seconds: float) -> str:
        """Go to the first moment at or after that time, in seconds since the beginning."""
        return self.go_past(self.begin_ns + round(seconds * 1e9) - 1)

    def go_past(self, time_ns: int) -> str:
        """Go to the first moment after that time, by the recording's clock."""
        jump, turn = Jump("goto", NEVER, after_ns=time_ns), self.debugger.turn
        if self.debugger.begun_ns > time_ns:
            return self._go_to(jump)
        if not self.end and (turn is None or self.debugger.time_ns <= time_ns):
            return self._go_on_to(jump)
        return self.wait()

    # Backwards

    def back(self, until: Step, machine: str | None = None) -> str:
        """Go back to where a step like this could have ended.

        With "leave", that is before the turn in which the machine came to its state. Raise
        `RecordingError` if there is no such moment.
        """
        name, state, now = machine or self.machine, "", self.debugger.moment
        match until:
            case "turn":
                moment = now - 1
            case "round":
                moment = _last_before(now, self.debugger.rounds)
            case "transition":
                moment = _last_before(now, self.debugger.arrivals)
            case "leave":
                state = self.arrangement.state_name_of(name)
                moment = self.debugger.before_state(name)
        if not moment:
            what = {
                "transition": "no transition has fired before this moment",
                "leave": f"{name} has been in {state} from the beginning",
            }
            raise RecordingError(what.get(until, "the recording begins here"))
        return self._go_to(Jump(f"back: {until}", moment, moment))

    def back_to_breakpoint(self) -> str:
        """Go back to the last hit of a breakpoint before this moment.

        Raise `RecordingError` if there is none.
        """
        why, now = self.debugger.paused or "back", self.debugger.moment
        is_after_end = bool(self.end)
        self._go_to(Jump(why, now, now))  # looking for those that are passed
        passed = self.debugger.last_hit(is_after_end=is_after_end)
        if not passed:
            raise RecordingError(NO_BREAKPOINT)
        return self._go_to(Jump("back", passed, passed))

    # The machines' thread

    def _go_to(self, jump: Jump) -> str:
        """Run from the beginning to a moment, with the breakpoints of now."""
        self._begin(jump._replace(breakpoints=self._abandon()))
        return self.wait()

    def _go_on_to(self, jump: Jump) -> str:
        self.debugger.run_to(jump.goal(self.debugger), jump.since)
        return self.wait()

    def _begin(self, jump: Jump) -> None:
        rerun = self._arrange(jump)
        self._thread = threading.Thread(target=self._run, args=(rerun,), name="machines")
        self._thread.start()

    def _arrange(self, jump: Jump) -> Rerun:
        """Arrange the machines, to run from the beginning."""
        self._error, self.end, self.difference = None, "", ""
        rerun = self.make()
        self.arrangement = rerun.arrangement
        self.debugger = debugger = self._debugger_of(rerun, jump.since)
        debugger.break_at(*jump.breakpoints, library=self.library)
        debugger.run_to(jump.goal(debugger), jump.since)
        return rerun

    def _debugger_of(self, rerun: Rerun, since: int) -> RerunDebugger:
        return RerunDebugger(rerun, since)

    def _abandon(self) -> tuple[str, ...]:
        """End the thread, if there is one, and return its breakpoints."""
        self.debugger.abandon()
        self._thread.join()
        return self.debugger.breakpoints

    def _run(self, rerun: Rerun) -> None:
        try:
            with suppress(Abandoned):  # also after the first difference, before the next turn
                rerun.compare()
        except Exception as error:
            self._error = error
        if rerun.difference is not None:
            what = "from here on the machines do not act as recorded"
            self.end = self.difference = f"{what}: {rerun.difference}"
        elif rerun.lost:
            self.end = f"the recorder lost what follows, at {self.now_s:.6f} s"
        else:
            failure = _failure_of(rerun.arrangement)
            self.end = f"the recording ends here, at {self.now_s:.6f} s{failure and f': {failure}'}"

    def _require_more(self) -> None:
        if self.end:
            raise RecordingError(f"{self.end}; go back, or to an earlier time")

    def _require_code(self, place: SectionPlace) -> None:
        cls = self.library.get(place.machine) or type(self.arrangement.machine(place.machine))
        if section_of(cls, place.state, place.section) is None:
            known = [
                f"{state.name}.{section}"
                for state in cls.table.states
                for section in state.sections
            ]
            raise RecordingError(
                f"{place.machine} has no code {place.state}.{place.section}; "
                f"it has: {', '.join(known) or 'none'}"
            )


def section_of(machine: type[Machine], state: str, section: str) -> FunctionType | None:
    """Return the code of a section; None if there is none."""
    sections = next((each.sections for each in machine.table.states if each.name == state), {})
    found = sections.get(section)
    return found if isinstance(found, FunctionType) else None


def _failure_of(arrangement: Arrangement) -> str:
    """Return the error of the machine whose code has ended the arrangement; "" if none has."""
    failures = [seat.failure for seat in arrangement.roster if seat.failure is not None]
    if arrangement.reason is not Reason.FAILED or not failures:
        return ""
    return str(max(failures, key=attrgetter("time_ns")).error)


def _last_before(moment: int, moments: Sequence[int]) -> int:
    """Return the last of ascending moments that is before that one; 0 if there is none."""
    found = bisect_left(moments, moment)
    return moments[found - 1] if found else 0
