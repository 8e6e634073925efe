"""Running an arrangement: when it sleeps, when it ends and why."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from typing import Any

import pytest

from llfsm.runtime import (
    Arrangement,
    ArrangementEndedError,
    Machine,
    ManualClock,
    OptionError,
    Reason,
    State,
    Trace,
)
from llfsm.runtime.engine.events import End, IdleSleep, RoundEnd
from llfsm.whiteboard import Whiteboard
from waiting import PATIENCE_S


class Brief(Machine):
    a = State()
    b = State()
    a.to(b)


class Waiting(Machine):
    """Accept when asked to stop."""

    stops: int = 0

    waiting = State()
    done = State()
    waiting.to(done, when=lambda m: m.stopping)


class Stubborn(Machine):
    rounds: int = 0

    a = State()
    a.to(a, when=lambda m: False)

    @a.internal
    def _(self) -> None:
        self.rounds += 1


class Busy(Machine):
    a = State()
    b = State()
    a.to(b)
    b.to(a)


class CountingClock(ManualClock):
    """Call `at` when asked to sleep for the n-th time."""

    def __init__(self, at: dict[int, Any] | None = None):
        super().__init__()
        self.sleeps: list[int] = []
        self.at = at or {}

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self.sleeps.append(deadline_ns - self.now_ns())
        super().sleep_until_ns(deadline_ns)
        if len(self.sleeps) in self.at:
            self.at[len(self.sleeps)]()


def test_run_ends_when_all_accept():
    arrangement = Arrangement([Brief, Brief], clock=ManualClock())
    assert arrangement.run() is Reason.ACCEPTING
    assert (arrangement.rounds, arrangement.reason) == (2, Reason.ACCEPTING)


def test_a_round_after_the_end_is_refused():
    arrangement = Arrangement([Brief], clock=ManualClock())
    arrangement.run()
    with pytest.raises(ArrangementEndedError, match="has ended: accepting"):
        arrangement.round()
    with pytest.raises(ArrangementEndedError):
        arrangement.run()
    assert arrangement.reason is Reason.ACCEPTING


def test_rounds_go_on_until_it_is_ended():
    arrangement = Arrangement([Brief])
    assert [arrangement.round() for _ in range(4)] == [True, False, False, False]
    assert arrangement.finished


def test_it_sleeps_only_after_a_round_in_which_nothing_fired():
    clock = CountingClock()
    arrangement = Arrangement([Brief], clock=clock, idle_us=5_000)
    arrangement.run()
    assert clock.sleeps == [5_000_000]


def test_no_idle_time_is_no_sleep():
    clock = CountingClock()
    Arrangement([Stubborn], clock=clock, idle_us=0).run(max_rounds=5)
    assert clock.sleeps == []


def test_a_long_sleep_is_cut_into_naps():
    clock = CountingClock()
    Arrangement([Brief], clock=clock, idle_us=50_000).run()
    assert clock.sleeps == [20_000_000, 20_000_000, 10_000_000]


def test_a_fixed_period():
    clock, trace = CountingClock(), Trace()
    arrangement = Arrangement([Busy], clock=clock, period_us=2_000, observers=[trace])

    def be_late(event: object) -> None:
        if isinstance(event, RoundEnd):
            clock.advance(us={2: 1_500, 3: 3_000}.get(event.round, 0))

    arrangement.attach(be_late)
    arrangement.run(max_rounds=6)
    begins = [e.time_ns // 1000 for e in trace if type(e).__name__ == "RoundBegin"]
    assert begins == [0, 2_000, 4_000, 7_000, 8_000, 10_000]  # round 4 was late, no other
    sleeps = [e.duration_ns // 1000 for e in trace if isinstance(e, IdleSleep)]
    assert sleeps == [2_000, 500, 1_000, 2_000]


def test_an_observer_may_end_it():
    arrangement = Arrangement([Busy])
    arrangement.attach(lambda event: arrangement.rounds == 3 and arrangement.end())
    assert arrangement.run() is Reason.CLOSED
    assert arrangement.rounds == 3


# Stopping


def test_stop_gives_the_machines_time_to_accept():
    arrangement = Arrangement([Waiting], clock=CountingClock({3: lambda: arrangement.stop("now")}))
    assert arrangement.run() is Reason.ACCEPTING
    assert arrangement.stopping
    assert arrangement.stop_cause == "now"
    assert arrangement.rounds == 5


def test_the_first_cause_to_stop_stays():
    arrangement = Arrangement()
    arrangement.stop("one")
    arrangement.stop("two")
    assert arrangement.stop_cause == "one"


def test_after_the_grace_period_it_stops_anyway():
    stubborn, clock = Stubborn(), CountingClock({3: lambda: arrangement.stop()})
    arrangement = Arrangement([stubborn], clock=clock, idle_us=10_000)
    assert arrangement.run(grace_s=0.05) is Reason.STOPPED
    # three rounds before; one at the stop, five more in 50 ms
    assert stubborn.rounds == 3 + 1 + 5


def test_no_grace():
    arrangement = Arrangement([Stubborn], clock=CountingClock({3: lambda: arrangement.stop()}))
    assert arrangement.run(grace_s=0) is Reason.STOPPED
    assert arrangement.rounds == 4


def test_stop_cuts_a_sleep_short():
    clock = CountingClock({2: lambda: arrangement.stop()})
    arrangement = Arrangement([Waiting], clock=clock, idle_us=10_000_000)
    arrangement.run()
    assert clock.sleeps[:2] == [20_000_000, 20_000_000]
    assert clock.now_ns() < 11_000_000_000


def test_stop_from_another_thread():
    arrangement = Arrangement([Waiting], idle_us=1_000)
    started = threading.Event()
    arrangement.attach(lambda event: started.set())
    thread = threading.Thread(target=arrangement.run)
    thread.start()
    assert started.wait(PATIENCE_S)
    arrangement.stop()
    thread.join(PATIENCE_S)
    assert arrangement.reason is Reason.ACCEPTING


@pytest.mark.parametrize("machine", [Waiting, Busy])
def test_the_end_of_the_board_stops_it(machine: type[Machine]):
    board = Whiteboard.local()
    clock = CountingClock({3: board.close})
    arrangement = Arrangement([machine], whiteboard=board, clock=clock)
    if machine is Busy:  # which never sleeps

        def close(event: object) -> None:
            clock.advance(ms=1)
            if arrangement.rounds == 10:
                board.close()

        arrangement.attach(close)
    arrangement.run(grace_s=0.1, max_rounds=100_000)
    assert arrangement.stop_cause == "the whiteboard was closed or removed"
    assert arrangement.rounds < 1_000


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_it_and_the_handlers_come_back(number: signal.Signals):
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    arrangement = Arrangement(
        [Waiting], clock=CountingClock({2: lambda: os.kill(os.getpid(), number)})
    )
    assert arrangement.run() is Reason.ACCEPTING
    assert arrangement.stop_cause == number.name
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_second_ctrl_c_interrupts():
    def kill() -> None:
        os.kill(os.getpid(), signal.SIGINT)

    arrangement = Arrangement([Stubborn], clock=CountingClock({2: kill, 3: kill}))
    with pytest.raises(KeyboardInterrupt):
        arrangement.run()
    assert arrangement.reason is Reason.INTERRUPTED


def test_handlers_come_back_also_after_an_error():
    before = signal.getsignal(signal.SIGINT)

    def fail(event: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Arrangement([Busy], observers=[fail]).run()
    assert signal.getsignal(signal.SIGINT) is before


def test_a_process_ends_cleanly_at_sigterm():
    program = (
        "from llfsm.runtime import *\n"
        "class W(Machine):\n"
        "    a = State(); b = State()\n"
        "    a.to(b, when=lambda m: m.stopping)\n"
        "    a.on_entry(lambda m: print('ready', flush=True))\n"
        "arrangement = Arrangement([W])\n"
        "print(arrangement.run(), arrangement.stop_cause)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.terminate()
        assert process.stdout.read() == "accepting SIGTERM\n"
    assert process.returncode == 0


# Options


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"idle_us": -1}, "idle_us is -1; it must be 0 or more"),
        ({"period_us": 0}, "period_us is 0; it must be 1 or more"),
        ({"on_error": "ignore"}, "on_error is 'ignore'"),
    ],
)
def test_impossible_options(options: dict[str, Any], match: str):
    with pytest.raises(OptionError, match=match):
        Arrangement(**options)


def test_the_end_is_reported_once():
    trace = Trace()
    with Arrangement([Brief], clock=ManualClock(), observers=[trace]) as arrangement:
        arrangement.run()
    assert [e.reason for e in trace if isinstance(e, End)] == ["accepting"]


def test_a_stop_within_a_turn_is_seen_in_the_next_round():
    """So all code of a ringlet sees the same, as it does in a proof."""
    seen: list[tuple[bool, bool]] = []

    class Asked(Machine):
        on, off = State(), State()

        @on.to(off)
        def _(self) -> bool:
            before = self.stopping
            if len(seen) == 1:
                signal.raise_signal(signal.SIGINT)
            seen.append((before, self.stopping))
            return before

    Arrangement([Asked]).run()
    assert seen == [(False, False), (False, False), (True, True)]
