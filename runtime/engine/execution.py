"""An arrangement's execution from its first round to its end: pace, sleep, stop, and the world.

Two loops alternate. `_run` looks after everything after each round: statuses, requests, the world,
the end. Where a round has changed nothing, and all is published, `Kernel.rest` gives rounds with
no more than a sleep between them, until something changes or is due: a machine that waits does
this a hundred times a second, and pays for little else.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, NamedTuple

from llfsm.runtime.engine.events import IdleSleep, Reason
from llfsm.runtime.engine.realtime import collect_if_due, in_real_time
from llfsm.runtime.engine.watchdog import Watchdog

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import Control


_NAP_NS = 20_000_000  # a sleep is cut into these, to notice a stop, a request or the board's end
_EARLY_NS = 100_000  # before a turn in real time, to have what it needs in the caches
_FOREVER_NS = 2**63 - 1
_BUSY_ROUNDS = 64  # rounds without a sleep after which to check that the world still exists


class Pace(NamedTuple):
    """The options of a run; `priority` is that of SCHED_FIFO, 1 to 99, and `cpu` the only core.

    `grace_s` is how long machines have to reach accepting states once they are to stop.
    """

    idle_us: int = 10_000
    wake: bool = True
    watchdog_ms: float | None = None
    priority: int | None = None
    cpu: int | None = None
    grace_s: float = 1.0


class Execution:
    """Run rounds until all machines accept, or the time that a stop leaves them is over.

    Between rounds the kernel's attendant publishes the machines' statuses and obeys requests.
    A machine that has failed waits for such a request, if one can come.
    """

    def __init__(self, control: Control, pace: Pace):
        self._control = control
        self._kernel = control.kernel
        self._pace = pace
        self._clock = self._kernel.environment.clock
        self._now = self._clock.now_ns
        self._grace_ns = round(pace.grace_s * 1e9)
        self._give_up_ns: int | None = None  # when the grace period ends
        self._woken = False  # whether the last sleep between rounds ended early
        self._due_ns = 0  # when, of rounds that change nothing, one is to be looked after
        self._last_round: int | None = None
        self._slumber: Callable[[], bool] = self._doze  # sleeps between rounds that change nothing
        self._attendant = self._kernel.attendant
        self._watchdog = None
        if pace.watchdog_ms is not None:
            self._watchdog = Watchdog(self._kernel, pace.watchdog_ms / 1e3)
        self._is_paced = self._kernel.pacer is not None
        if self._kernel.pacer is not None:
            self._kernel.pacer.sleep_until = self._sleep_to_turn

    def run(self, max_rounds: int | None) -> Reason:
        """Run rounds and return why no more are to be run."""
        priority, cpu = self._pace.priority, self._pace.cpu
        with ExitStack() as stack:
            if self._watchdog is not None:
                self._watchdog.start()
                stack.callback(self._watchdog.stop)
            if priority is not None:  # this thread alone, not the watchdog's
                stack.enter_context(in_real_time(priority, cpu))
                self._kernel.achieved = priority, cpu
            return self._run(max_rounds)

    def _run(self, max_rounds: int | None) -> Reason:
        kernel = self._kernel
        self._last_round = max_rounds
        rests = False
        while True:
            fired = kernel.rest(self._slumber) if rests else kernel.round()
            if kernel.reason is not None:  # a machine or an observer has ended it
                return kernel.reason
            idle = not fired and (self._is_paced or self._pace.idle_us > 0) and not self._woken
            self._look(idle=idle)
            if self._pace.priority is not None:
                collect_if_due()
            if max_rounds is not None and kernel.rounds >= max_rounds:
                return Reason.MAX_ROUNDS
            finished = kernel.finished
            failed = finished and not kernel.stopping and bool(kernel.roster.failed)
            if failed and self._attendant is not None and self._attendant.reachable:
                finished = False
            if not finished and self._is_over():
                return Reason.STOPPED
            self._woken = False
            if not self._is_paced and not fired and self._pace.idle_us:
                deadline_ns = self._now() + self._pace.idle_us * 1_000
                self._report_sleep(self._pace.idle_us * 1_000)
                self._sleep_on(deadline_ns)
            elif kernel.rounds % _BUSY_ROUNDS == 0:
                self._kernel.look_at_world()
            if finished:
                return Reason.FAILED if failed else Reason.ACCEPTING
            rests = idle and not failed and self._may_rest()

    def _sleep_to_turn(self, due_ns: int) -> bool:
        """Sleep until a turn is due, also while stopping; False if there is to be none any more."""
        kernel = self._kernel
        left_ns = due_ns - self._now()
        if left_ns > 0:
            self._report_sleep(left_ns)
        if self._pace.priority is not None:
            self._nap(due_ns - _EARLY_NS, self._hurries, kernel.environment.clock.sleep_until_ns)
        self._nap(due_ns, self._hurries, kernel.environment.clock.sleep_until_ns)
        return not self._is_over()

    def _sleep_on(self, deadline_ns: int) -> None:
        """Sleep between rounds; news, a request or a stop cuts it short."""
        kernel = self._kernel
        stopping = kernel.stopping
        self._woken = self._nap(
            deadline_ns,
            lambda: kernel.stopping is not stopping or self._hurries(),
            (kernel.environment if self._pace.wake else kernel.environment.clock).sleep_until_ns,
        )

    def _may_rest(self) -> bool:
        """Check that nothing is to be done between rounds until one changes something.

        Only if all was published that there is, and what others ask for would end a sleep.
        """
        kernel = self._kernel
        if kernel.stopping or self._control.asked_to_stop or self._pace.priority is not None:
            return False
        if not self._pace.wake or self._is_paced or self._clock.of_statuses() is not self._clock:
            return False
        attendant = self._attendant
        self._due_ns = 0 if self._woken else _FOREVER_NS if attendant is None else attendant.due_ns
        self._slumber, idle_ns = self._doze, self._pace.idle_us * 1_000
        if self._due_ns and self._last_round is None and idle_ns <= _NAP_NS:
            self._slumber = kernel.environment.doze(idle_ns, self._due_ns, self._doze)
        return True

    def _doze(self, deadline_ns: int = 0) -> bool:
        """Sleep between two rounds that change nothing; return False if others are to be asked.

        A sleep that has begun, and in which something has happened, is to end at `deadline_ns`. It
        does no more than it must: a machine that waits does this a hundred times a second.
        """
        kernel, now_ns, last = self._kernel, self._now(), self._last_round
        if not deadline_ns:
            if now_ns >= self._due_ns or kernel.stopping or kernel.rounds == last:
                return False
            deadline_ns = now_ns + self._pace.idle_us * 1_000
        elif not self._due_ns:  # what ended the last sleep would end each: prepare them anew
            return False
        woken = kernel.environment.sleep_until_ns(min(deadline_ns, now_ns + _NAP_NS))
        kernel.show_stop()
        obeyed = self._attendant is not None and self._attendant.obey()
        if obeyed or woken or self._now() < deadline_ns:
            self._due_ns = 0
            self._woken = woken
            if not woken:
                self._sleep_on(deadline_ns)
        return True

    def _report_sleep(self, duration_ns: int) -> None:
        if self._kernel.observers:
            self._kernel.emit(IdleSleep(*self._kernel.stamp(), duration_ns))

    def _nap(
        self, deadline_ns: int, is_over: Callable[[], bool], sleep: Callable[[int], bool | None]
    ) -> bool:
        """Sleep until the deadline, unless `is_over`; return whether news has ended the sleep."""
        # Look before each nap: what the looking takes must not delay a turn that is due.
        has_looked = True  # at what others want, after the round
        while (now_ns := self._now()) < deadline_ns:
            self._kernel.look_at_world()
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
        """Check that no turn is to follow: after a stop, machines have at least one to see it."""
        kernel = self._kernel
        if kernel.reason is not None:
            return True
        return kernel.stop_is_seen and kernel.rounds > kernel.stop_round and self._hurries()

    def _hurries(self) -> bool:
        """Check that there is no time left to sleep, as all ends or the grace period is over."""
        if not self._kernel.stopping:
            return self._kernel.reason is not None
        now_ns = self._now()
        if self._give_up_ns is None:
            self._give_up_ns = now_ns + self._grace_ns
        return now_ns >= self._give_up_ns

    def _look(self, *, idle: bool) -> None:
        if self._attendant is not None:
            self._attendant.look(idle=idle)
        self._control.unload_stopped(self._grace_ns)
