"""Waiting: a round that can change nothing is counted, not run.

Take a ringlet in which no transition fired, of a state that was entered before and has no Internal.
The next one does the same until something changes on which the state's guards depend. Guards that
are *closed* depend on little, and all of it can be listed: sensors of their machine, its own
variables, the time in the state, `stopping`, and the statuses of other machines. So after a round
that changed nothing, in which all machines wait in such states, the next one that may change
something is that after

* a message in a slot that one of them reads, a request, or a stop, each of which ends a sleep,
* the first limit of the time in a state, or
* the moment at which a message gets too old for its sensor.

Until then the arrangement sleeps, whatever its period or idle time is. Rounds that have a time,
since they have a period or the clock is a `ManualClock`, are counted as if they had been run; the
others come when they come. A simulated hour takes as long as what happens in it.

In doubt machines are polled. A guard that is not closed, an Internal, or a limit that is computed
keeps the whole arrangement polling; so do observers, a debugger, a recording, a timetable and the
priority of real time, for which each turn counts. And because variables could be changed by what no
analysis sees, as a thread that a section has started, a round is run at least twice a second.

What states wait for is found out in the machines' texts, once for each, by a function that is
given: the engine reads no texts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import floor
from typing import TYPE_CHECKING, Final, TypeAlias

from llfsm.runtime.engine.clock import FOREVER
from llfsm.runtime.engine.ringlet import marks_of
from llfsm.runtime.engine.state import State, Waiting

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import Kernel
    from llfsm.runtime.engine.seat import Seat
    from llfsm.runtime.engine.table import Table


Analysis: TypeAlias = Callable[["Table", State], Waiting]
"""Find out what machines with a table wait for in one of its states."""

_SUSPENDED: Final = Waiting()  # in a suspend state that is not declared


class Stillness:
    """Find out until when the rounds of an arrangement change nothing, and count those."""

    def __init__(self, kernel: Kernel, analysis: Analysis | None):
        self._kernel = kernel
        self._analysis = analysis
        self._marks: list[tuple[object, ...]] = []
        self._marked_round = -1

    def until_ns(self) -> int:
        """Return until when, by the machines' time, rounds change nothing if the last one did not.

        0 if one of the machines has to be polled, or if its next turn does something anyway.
        """
        kernel, until_ns = self._kernel, FOREVER
        if self._analysis is None or not kernel.environment.may_wait:
            return 0
        if kernel.observers or kernel.instrument is not None or kernel.timetable is not None:
            return 0
        for seat in kernel.roster.seats:
            if seat is None:
                continue
            state = seat.current
            if state is not seat.previous or seat.request is not None:
                return 0
            waiting = state.waiting or self._find_out(seat)
            if waiting.polls:
                return 0
            if waiting.machines and not waiting.machines <= kernel.roster.named.keys():
                return 0  # another process runs it, and publishes its status when it likes
            if waiting.limits_ns or waiting.limits_in or waiting.sensors:
                until_ns = min(until_ns, _until_ns(seat, waiting))
        return until_ns

    def is_since_last_round(self) -> bool:
        """Check that machines stand as at the last look, and that one round was run since then.

        Then this round has changed nothing, unless a transition fired in it.
        """
        kernel = self._kernel
        before, kernel_round = self._marks, self._marked_round
        self._marks = [marks_of(seat) for seat in kernel.roster.seats]
        self._marked_round = kernel.rounds
        return kernel_round + 1 == kernel.rounds and before == self._marks

    @property
    def has_just_looked(self) -> bool:
        """True if the last round but one was followed by a look at how machines stand."""
        return self._marked_round + 1 == self._kernel.rounds

    def pass_over(self, rounds: int) -> None:
        """Count rounds that are not run, as they would have changed nothing."""
        self._kernel.rounds += rounds
        self._marked_round += rounds
        if self._kernel.stopwatch is not None:
            self._kernel.stopwatch.pass_over(rounds)

    def _find_out(self, seat: Seat) -> Waiting:
        """Find out, and note, what a machine waits for in its state."""
        name = seat.current.name
        state = next((each for each in seat.table.states if each.name == name), None)
        assert self._analysis is not None
        found = _SUSPENDED if state is None else self._analysis(seat.table, state)
        seat.current.waiting = found
        return found


def _until_ns(seat: Seat, waiting: Waiting) -> int:
    """Return until when neither the time in the state nor a message's age changes anything."""
    until_ns, now_ns, entered_ns = FOREVER, seat.now(), seat.entered_ns
    limits_ns: Iterable[int] = waiting.limits_ns
    if waiting.limits_in:
        held = (getattr(seat.machine, name) * unit for name, unit in waiting.limits_in)
        limits_ns = sorted((*limits_ns, *(floor(min(limit_ns, FOREVER)) for limit_ns in held)))
    for limit_ns in limits_ns:
        if now_ns - entered_ns <= limit_ns:
            until_ns = entered_ns + limit_ns + 1
            break  # they are in order
    for sensor in waiting.sensors:
        left_ns = seat.freshness_ns(sensor)
        if left_ns is not None:
            until_ns = min(until_ns, now_ns + left_ns)
    return until_ns
