"""An arrangement's execution from its first round to its end: pace, sleep, stop, and the world.

Two loops alternate. `_run` looks after everything after each round: statuses, requests, the world,
the end. Where a round has changed nothing, and all is published, `Kernel.rest` gives rounds with
no more than a sleep between them, until something changes or is due: a machine that is polled does
this a hundred times a second, and pays for little else. Where all machines wait, as `waiting`
describes, that sleep lasts until something can change; with a period, rounds are passed over.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, NamedTuple

from llfsm.runtime.engine.clock import FOREVER
from llfsm.runtime.engine.events import IdleSleep, Reason
from llfsm.runtime.engine.realtime import collect_if_due, in_real_time
from llfsm.runtime.engine.waiting import Stillness
from llfsm.runtime.engine.watchdog import Watchdog

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import Control
    from llfsm.runtime.engine.schedule import Pacer
    from llfsm.runtime.engine.waiting import Analysis


_NAP_NS = 20_000_000  # a sleep is cut into these, to notice a stop, a request or the board's end
_EARLY_NS = 100_000  # before a turn in real time, to have what it needs in the caches
_BUSY_ROUNDS = 64  # rounds without a sleep after which to check that the world still exists
_PART = 50  # of the time that passes, the part that may be spent on finding that out


class Pace(NamedTuple):
    """The options of a run; `priority` is that of SCHED_FIFO, 1 to 99, and `cpu` the only core.

    `grace_s` is how long machines have to reach accepting states once they are to stop. After
    `patience_ns` it is found out whether machines wait; those that do have a round at least every
    `look_ns`.
    """

    idle_us: int = 10_000
    wake: bool = True
    watchdog_ms: float | None = None
    priority: int | None = None
    cpu: int | None = None
    grace_s: float = 1.0
    patience_ns: int = 200_000_000
    look_ns: int = 500_000_000


class Execution:
    """Run rounds until all machines accept, or the time that a stop leaves them is over.

    Between rounds the kernel's attendant publishes the machines' statuses and obeys requests.
    A machine that has failed waits for such a request, if one can come.
    """

    def __init__(self, control: Control, pace: Pace, analysis: Analysis | None = None):
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
        self._stillness: Stillness | None = None
        may_wait = pace.wake and pace.priority is None and self._kernel.environment.may_wait
        if analysis is not None and may_wait:
            self._stillness = Stillness(self._kernel, analysis)
        self._is_polled = False  # whether a machine is polled in the rest under way
        self._check_ns = self._now()  # when to find out whether all wait
        if self._clock.passes:
            self._check_ns += pace.patience_ns
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
            if idle and not failed and self._kernel.pacer is not None:
                self._pass_over_rounds(self._kernel.pacer)

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
        self._due_ns = 0 if self._woken else FOREVER if attendant is None else attendant.due_ns
        self._slumber, idle_ns = self._doze, self._pace.idle_us * 1_000
        # A clock that stands still lets a limit be found out when it is needed.
        looks = not self._clock.passes and self._stillness is not None
        if looks or self._still_until_ns() > self._now() + idle_ns:
            self._slumber, self._is_polled = self._wait, False
            return True
        if self._stillness is not None and self._clock.passes:
            self._due_ns = min(self._due_ns, max(self._check_ns, self._now() + idle_ns))
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

    def _still_until_ns(self) -> int:
        """Return until when rounds change nothing, by the machines' time; 0 if the next one may.

        To find it out is left out if it was too costly, or if it has not been worth it.
        """
        stillness, begin_ns = self._stillness, self._now()
        if stillness is None or (begin_ns < self._check_ns and not stillness.has_just_looked):
            return 0
        if self._clock.passes and self._last_round is not None:  # each round is wanted
            return 0
        until_ns = stillness.until_ns()
        if self._clock.passes:
            end_ns = self._now()
            patience_ns = 0 if until_ns else self._pace.patience_ns
            self._check_ns = end_ns + max(_PART * (end_ns - begin_ns), patience_ns)
        return until_ns

    def _wait(self) -> bool:
        """Sleep until a round may change something, as all machines wait; return as `_doze`."""
        kernel, now_ns, stillness = self._kernel, self._now(), self._stillness
        if stillness is None or self._is_polled:
            return self._doze()
        if now_ns >= self._due_ns:  # to publish again what holds is all that is due
            self._look(idle=True)
            self._due_ns = FOREVER if self._attendant is None else self._attendant.due_ns
        kernel.look_at_world()
        if kernel.stopping or kernel.reason is not None or kernel.rounds == self._last_round:
            return False
        until_ns, idle_ns = stillness.until_ns(), self._pace.idle_us * 1_000
        # With a clock that stands still, nobody knows when a message comes that is waited for.
        self._is_polled = until_ns in (0, FOREVER) if not self._clock.passes else not until_ns
        if self._is_polled or until_ns <= now_ns + idle_ns or self._control.asked_to_stop:
            return self._doze()
        if not self._clock.passes:
            rounds = self._rounds_until(until_ns, now_ns + idle_ns, idle_ns)
            stillness.pass_over(rounds)
            kernel.environment.clock.sleep_until_ns(now_ns + (rounds + 1) * idle_ns)
            return True
        if not self._sleep_soundly(min(until_ns, self._due_ns)):
            self._due_ns = 0
        kernel.show_stop()
        return not kernel.observers

    def _pass_over_rounds(self, pacer: Pacer) -> None:
        """Sleep through the rounds that can change nothing, and count them."""
        kernel, stillness, first_ns = self._kernel, self._stillness, pacer.next_ns
        if stillness is None or first_ns is None or kernel.stopping or self._control.asked_to_stop:
            return
        until_ns = self._still_until_ns()
        if not until_ns or not stillness.is_since_last_round():
            return
        if until_ns == FOREVER and not self._clock.passes:
            return
        rounds = self._rounds_until(until_ns, first_ns, pacer.cycle_ns)
        if rounds and self._clock.passes:
            begin_ns = first_ns + rounds * pacer.cycle_ns
            end_ns = min(begin_ns, self._now() + self._pace.look_ns)
            if self._attendant is not None:
                end_ns = min(end_ns, self._attendant.due_ns)
            if end_ns > first_ns:
                self._sleep_soundly(end_ns)
            # What has come meanwhile is found in the first round that is due after it.
            rounds = -(-(min(self._now(), end_ns) - first_ns) // pacer.cycle_ns)
        if rounds > 0:
            stillness.pass_over(rounds)
            pacer.pass_over(rounds)
            if not self._clock.passes:
                kernel.environment.clock.sleep_until_ns(first_ns + rounds * pacer.cycle_ns)

    def _rounds_until(self, until_ns: int, first_ns: int, cycle_ns: int) -> int:
        """Count the rounds from `first_ns` on that are before `until_ns`, without the last one."""
        rounds = -(-max(until_ns - first_ns, 0) // cycle_ns)
        if self._last_round is None:
            return rounds
        return min(rounds, self._last_round - self._kernel.rounds - 1)

    def _sleep_soundly(self, until_ns: int) -> bool:
        """Sleep until then, or until there is news; return False if others have ended it."""
        deadline_ns = min(until_ns, self._now() + self._pace.look_ns)
        woken = self._kernel.environment.wait_until_ns(deadline_ns)
        obeyed = self._attendant is not None and self._attendant.obey()
        return not obeyed and (woken or self._now() >= deadline_ns)

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
