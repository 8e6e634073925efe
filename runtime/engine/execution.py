"""An arrangement's execution from its first round to its end: pace, sleep, stop, and the world."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

from llfsm.runtime.engine.clock import pace_of
from llfsm.runtime.engine.events import IdleSleep, Reason
from llfsm.runtime.engine.realtime import collect_if_due, in_real_time
from llfsm.runtime.engine.watchdog import Watchdog

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement


_NAP_NS = 20_000_000  # a sleep is cut into these, to notice a stop, a request or the board's end
_EARLY_NS = 100_000  # before a turn in real time, to have what it needs in the caches
_FOREVER_NS = 2**63 - 1
_BUSY_ROUNDS = 64  # rounds without a sleep after which to check that the world still exists


class Execution:
    """Run rounds until all machines accept, or the time that a stop leaves them is over.

    Between rounds the environment's attendant publishes the machines' statuses and obeys requests.
    A machine that has failed waits for such a request, if one can come.
    """

    def __init__(self, arrangement: Arrangement, grace_s: float, watchdog_ms: float | None):
        self._arrangement = arrangement
        self._clock = arrangement.clock
        self._now = self._clock.now_ns
        self._grace_ns = round(grace_s * 1e9)
        self._give_up_ns: int | None = None  # when the grace period ends
        self._woken = False  # whether the last sleep between rounds ended early
        self._due_ns = 0  # when, of rounds that change nothing, one is to be looked after
        self._last_round: int | None = None
        self._slumber: Callable[[], bool] = self._doze  # sleeps between rounds that change nothing
        self._attendant = arrangement.environment.attend(arrangement)
        self._watchdog = None
        if watchdog_ms is not None:
            self._watchdog = Watchdog(arrangement, self._attendant, watchdog_ms / 1e3)

    def run(self, max_rounds: int | None) -> Reason:
        """Run rounds and return why no more are to be run."""
        realtime = self._arrangement.realtime
        with ExitStack() as stack:
            if self._watchdog is not None:
                self._watchdog.start()
                stack.callback(self._watchdog.stop)
            if realtime is not None:  # this thread alone, not the watchdog's
                stack.enter_context(in_real_time(realtime, self._arrangement.cpu))
                self._arrangement.in_real_time = True
            return self._run(max_rounds)

    def _run(self, max_rounds: int | None) -> Reason:
        arrangement = self._arrangement
        self._last_round = max_rounds
        rests = False
        while True:
            fired = arrangement.rest(self._slumber) if rests else arrangement.round()
            if arrangement.reason is not None:  # a machine or an observer has ended it
                return arrangement.reason
            idle = not fired and (arrangement.paced or arrangement.idle_us > 0) and not self._woken
            self._look(idle=idle)
            if arrangement.realtime is not None:
                collect_if_due()
            if max_rounds is not None and arrangement.rounds >= max_rounds:
                return Reason.MAX_ROUNDS
            finished = arrangement.finished
            failed = finished and not arrangement.stopping and bool(arrangement.failed_machines)
            if failed and self._attendant is not None and self._attendant.reachable:
                finished = False
            if not finished and self._grace_is_over():
                return Reason.STOPPED
            self._woken = False
            if not arrangement.paced and not fired and arrangement.idle_us:
                self._sleep(arrangement.idle_us * 1_000)
            elif arrangement.rounds % _BUSY_ROUNDS == 0:
                self._look_at_world()
            if finished:
                return Reason.FAILED if failed else Reason.ACCEPTING
            rests = idle and not failed and self._may_rest()

    def sleep_to_turn(self, due_ns: int) -> bool:
        """Sleep until a turn is due, also while stopping; False if there is to be none any more."""
        arrangement = self._arrangement
        left_ns = due_ns - self._now()
        if left_ns > 0:
            self._report_sleep(left_ns)
        if arrangement.realtime is not None:
            self._nap(due_ns - _EARLY_NS, self._is_over, arrangement.clock.sleep_until_ns)
        self._nap(due_ns, self._is_over, arrangement.clock.sleep_until_ns)
        return not self._is_over()

    def beat(self) -> None:
        """Publish the machines' statuses, obey requests and look whether the world still exists."""
        self._look_at_world()
        if self._attendant is not None:
            self._attendant.beat()

    def end(self) -> None:
        """End the attendance: the machines are gone."""
        if self._attendant is not None:
            self._attendant.end()

    def _sleep(self, duration_ns: int) -> None:
        """Sleep between rounds; news, a request or a stop cuts it short."""
        deadline_ns = self._now() + duration_ns
        self._report_sleep(duration_ns)
        self._sleep_on(deadline_ns)

    def _sleep_on(self, deadline_ns: int) -> None:
        arrangement = self._arrangement
        stopping = arrangement.stopping
        self._woken = self._nap(
            deadline_ns,
            lambda: arrangement.stopping is not stopping or self._grace_is_over(),
            (arrangement.environment if arrangement.wake else arrangement.clock).sleep_until_ns,
        )

    def _may_rest(self) -> bool:
        """Return whether nothing is to be done between rounds until one changes something.

        Only if all was published that there is, and what others ask for would end a sleep.
        """
        arrangement = self._arrangement
        if arrangement.stopping or arrangement.asked_to_stop or arrangement.realtime is not None:
            return False
        if not arrangement.wake or arrangement.paced or pace_of(self._clock) is not self._clock:
            return False
        attendant = self._attendant
        self._due_ns = 0 if self._woken else _FOREVER_NS if attendant is None else attendant.due_ns
        self._slumber, idle_ns = self._doze, arrangement.idle_us * 1_000
        if self._due_ns and self._last_round is None and idle_ns <= _NAP_NS:
            self._slumber = arrangement.environment.doze(idle_ns, self._due_ns, self._doze)
        return True

    def _doze(self, deadline_ns: int = 0) -> bool:
        """Sleep between two rounds that change nothing; return False if others are to be asked.

        A sleep that has begun, and in which something has happened, is to end at `deadline_ns`. It
        does no more than it must: a machine that waits does this a hundred times a second.
        """
        arrangement, now_ns, last = self._arrangement, self._now(), self._last_round
        if not deadline_ns:
            if now_ns >= self._due_ns or arrangement.stopping or arrangement.rounds == last:
                return False
            deadline_ns = now_ns + arrangement.idle_us * 1_000
        elif not self._due_ns:  # what ended the last sleep would end each: prepare them anew
            return False
        woken = arrangement.environment.sleep_until_ns(min(deadline_ns, now_ns + _NAP_NS))
        obeyed = self._attendant is not None and self._attendant.obey()
        if obeyed or woken or self._now() < deadline_ns:
            self._due_ns = 0
            self._woken = woken
            if not woken:
                self._sleep_on(deadline_ns)
        return True

    def _report_sleep(self, duration_ns: int) -> None:
        if self._arrangement.observers:
            self._arrangement.emit(IdleSleep(*self._arrangement.stamp(), duration_ns))

    def _nap(
        self, deadline_ns: int, is_over: Callable[[], bool], sleep: Callable[[int], bool | None]
    ) -> bool:
        """Sleep until the deadline, unless `is_over`; return whether news has ended the sleep."""
        # Look before each nap: what the looking takes must not delay a turn that is due.
        has_looked = True  # at what others want, after the round
        while (now_ns := self._now()) < deadline_ns:
            self._look_at_world()
            if not has_looked:
                self._look(idle=False)
            has_looked = False
            if is_over():
                return False
            news = sleep(min(deadline_ns, now_ns + _NAP_NS))
            if self._attendant is not None:
                self._attendant.obey()  # a request made in the sleep is one for the next turn
            if news:
                return True
        return False

    def _is_over(self) -> bool:
        arrangement = self._arrangement
        return arrangement.reason is not None or (arrangement.stopping and self._grace_is_over())

    def _grace_is_over(self) -> bool:
        if not self._arrangement.stopping:
            return False
        now_ns = self._now()
        if self._give_up_ns is None:
            self._give_up_ns = now_ns + self._grace_ns
        return now_ns >= self._give_up_ns

    def _look_at_world(self) -> None:
        if not self._arrangement.environment.alive:
            self._arrangement.stop("the whiteboard was closed or removed")

    def _look(self, *, idle: bool) -> None:
        if self._attendant is not None:
            self._attendant.look(idle=idle)
        self._arrangement.unload_stopped(self._grace_ns)
