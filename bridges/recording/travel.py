"""Forwards and backwards through a recording, with the machines' code in place.

The machines run again in a thread, up to the moment to be looked at. To go back is to run them from
the beginning to an earlier moment: that is the same each time, as they learn what they learnt then.
"""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from operator import attrgetter
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from llfsm.runtime.debugging.debugger import Goal, Step
from llfsm.runtime.engine.errors import ArrangementEndedError, NotPausedError
from llfsm.runtime.engine.events import Reason

from .errors import MomentError
from .travel_debugger import Abandoned, SectionPlace, TravelDebugger, section_of

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.machine import Machine

    from .rerun import Rerun

__all__ = ["NEVER", "NO_BREAKPOINT", "Jump", "Travel"]

_LOOK_S: Final = 0.05  # between two looks whether the thread has ended
NEVER: Final = 1 << 62
"""The number of a turn that never comes."""
NO_BREAKPOINT: Final = "no breakpoint is reached before this moment"


class Jump(NamedTuple):
    """A moment to which machines run from an earlier one, and what to call the pause there."""

    why: str
    since: int = 0
    """The number of the turn from which on breakpoints pause."""
    moment: int = 1
    after_ns: int | None = None
    """Instead of `moment`: it is the first one after that time."""
    breakpoints: tuple[str, ...] = ()

    def goal(self, debugger: TravelDebugger) -> Goal:
        """Return until when machines run."""
        after_ns = self.after_ns
        if after_ns is None:
            return Goal(self.why, lambda _: debugger.number >= self.moment)
        return Goal(self.why, lambda _: debugger.time_ns > after_ns)


class Travel:
    """Debug the machines of a recording, which `make` arranges anew, at any of its moments.

    `library` is as for `Debugger.break_at`; `begin_ns` the time that counts as 0 s. A moment is a
    turn that is to come; breakpoints count their hits from the beginning. Leaving the ``with``
    block ends the thread of the machines.
    """

    def __init__(
        self,
        make: Callable[[], Rerun],
        library: Mapping[str, type[Machine]],
        begin_ns: int,
        jump: Jump = Jump("start"),  # noqa: B008  # it cannot change
    ):
        self._make = make
        self._begin_ns = begin_ns
        self.library = library
        self._thread = threading.Thread()
        self._error: Exception | None = None
        self.end = ""
        """Why there is no moment after this one; "" if there is."""
        self.difference = ""
        """What the machines do differently at this moment; "" if they act as recorded."""
        self._begin(jump)

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
        return self._seconds(self.debugger.time_ns)

    def wait(self) -> str:
        """Wait until the machines are paused, and return why; "" at the end.

        Raise what `Rerun.compare` raises.
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
        """Make a step, and return as `wait` does; raise `MomentError` at the end."""
        self._require_more()
        self.debugger.step(until, machine)
        return self.wait()

    def proceed(self) -> str:
        """Go on to a breakpoint, and return as `wait` does; raise `MomentError` at the end."""
        self._require_more()
        self.debugger.proceed()
        return self.wait()

    def open_pdb(self, place: SectionPlace) -> str:
        """Go on until that section runs, open a pdb in it, and return as `wait` does after it.

        A breakpoint before that ends the search for it. Raise `MomentError` for a section without
        code, and at the end.
        """
        self._require_more()
        if place.section:
            self._require_code(place)
        self.debugger.place = place
        self.debugger.proceed()
        return self.wait()

    def goto(self, seconds: float) -> str:
        """Go to the first moment at or after that time, and return as `wait` does."""
        return self.go_past(self._begin_ns + round(seconds * 1e9) - 1)

    def go_past(self, time_ns: int) -> str:
        """Go to the first moment after that time, and return as `wait` does."""
        jump, turn = Jump("goto", NEVER, after_ns=time_ns), self.debugger.turn
        if self.debugger.begun_ns > time_ns:
            return self._go_to(jump)
        if not self.end and (turn is None or self.debugger.time_ns <= time_ns):
            return self._go_on_to(jump)
        return self.wait()

    # Backwards

    def back(self, until: Step, machine: str | None = None) -> str:
        """Go back to where a step like this could have ended, and return as `wait` does.

        With "leave", that is before the turn in which the machine came to its state. Raise
        `MomentError` if there is no such moment.
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
                state = self.arrangement.standing(name).state
                moment = self.debugger.before_state(name)
        if not moment:
            what = {
                "transition": "no transition has fired before this moment",
                "leave": f"{name} has been in {state} from the beginning",
            }
            raise MomentError(what.get(until, "the recording begins here"))
        return self._go_to(Jump(f"back: {until}", moment, moment))

    def back_to_breakpoint(self) -> str:
        """Go back to the last hit of a breakpoint before this moment, and return as `wait` does.

        Raise `MomentError` if there is none.
        """
        why, now = self.debugger.paused or "back", self.debugger.moment
        is_after_end = bool(self.end)
        self._go_to(Jump(why, now, now))  # looking for those that are passed
        passed = self.debugger.last_hit(is_after_end=is_after_end)
        if not passed:
            raise MomentError(NO_BREAKPOINT)
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
        rerun = self._make()
        self.arrangement = rerun.arrangement
        self.debugger = debugger = self._debugger_of(rerun, jump.since)
        debugger.break_at(*jump.breakpoints, library=self.library)
        debugger.run_to(jump.goal(debugger), jump.since)
        return rerun

    def _debugger_of(self, rerun: Rerun, since: int) -> TravelDebugger:
        return TravelDebugger(rerun, since)

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

    def _seconds(self, time_ns: int) -> float:
        return (time_ns - self._begin_ns) / 1e9

    def _require_more(self) -> None:
        if self.end:
            raise MomentError(f"{self.end}; go back, or to an earlier time")

    def _require_code(self, place: SectionPlace) -> None:
        cls = self.library.get(place.machine) or type(self.arrangement.machine(place.machine))
        if section_of(cls, place.state, place.section) is None:
            known = [
                f"{state.name}.{section}"
                for state in cls.table.states
                for section in state.sections
            ]
            raise MomentError(
                f"{place.machine} has no code {place.state}.{place.section}; "
                f"it has: {', '.join(known) or 'none'}"
            )


def _failure_of(arrangement: Arrangement) -> str:
    """Return which machine's code has ended the arrangement, and how; "" if none has."""
    failures = [seat.failure for seat in arrangement.roster if seat.failure is not None]
    if arrangement.reason is not Reason.FAILED or not failures:
        return ""
    return str(max(failures, key=attrgetter("time_ns")).error)


def _last_before(moment: int, moments: Sequence[int]) -> int:
    """Return the last of ascending moments that is before that one; 0 if there is none."""
    found = bisect_left(moments, moment)
    return moments[found - 1] if found else 0
