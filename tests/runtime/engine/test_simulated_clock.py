"""A simulated clock never goes back, and arrangements wait for it however it stands and jumps."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain, count, pairwise

from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import Arrangement, Machine, Sensor, SimulatedClock, State
from llfsm.runtime.engine.events import Eval, Event, IdleSleep, Reason
from llfsm.runtime.journal.entries import Journal
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import status_slot
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import PATIENCE_S, wait_for

MS = 1_000_000
NUMBER = Slot("number", Int32)


class Timer(Machine):
    """Accept a second after the start, or 50 ms after a message."""

    number = Sensor(NUMBER, max_age_ms=200)

    waiting = State()
    seen = State()
    done = State()
    waiting.to(seen, when=lambda m: m.number is not None)
    waiting.to(done, after_ms=1000)
    seen.to(done, after_ms=50)


class Fired:
    """The times at which transitions fired."""

    def __init__(self) -> None:
        self.at_ms: list[tuple[str, float]] = []

    def __call__(self, event: Event) -> None:
        if isinstance(event, Eval) and event.value:
            self.at_ms.append((event.target, event.time_ns / MS))


class Player:
    """Set a clock to these milliseconds, then on, as far as each sleep lasts."""

    def __init__(self, clock: SimulatedClock, times_ms: list[float]) -> None:
        self._clock = clock
        self._times_ms = chain(times_ms, count(times_ms[-1] + 10, 10))
        self._set()

    def _set(self) -> None:
        self._clock.set_ns(round(next(self._times_ms) * MS))

    def __call__(self, event: Event) -> None:
        if isinstance(event, IdleSleep):
            while self._clock.now_ns() < event.time_ns + event.duration_ns:
                self._set()


def played(times_ms: list[float], *, wake: bool = True) -> list[tuple[str, float]]:
    """Return when the timer's transitions fired by a clock that was set to these milliseconds."""
    clock, fired = SimulatedClock(), Fired()
    player = Player(clock, times_ms)
    with Whiteboard.local() as board:
        Arrangement(
            [Timer], whiteboard=board, clock=clock, wake=wake, observers=[player, fired]
        ).run()
    return fired.at_ms


@given(st.lists(st.integers(0, 2**62), min_size=1, max_size=30))
def test_it_adds_up_the_ways_ahead_from_its_first_time(times: list[int]) -> None:
    clock = SimulatedClock()
    for number, time_ns in enumerate(times):
        before = clock.now_ns()
        clock.set_ns(time_ns)
        assert clock.now_ns() >= before or number == 0
    assert clock.now_ns() == times[0] + sum(max(b - a, 0) for a, b in pairwise(times))


def test_it_has_been_set_from_the_first_time_on() -> None:
    clock = SimulatedClock()
    assert not clock.wait_set(0)
    clock.set_ns(0)
    assert clock.wait_set(0)


def test_machines_wait_for_the_first_time_that_is_late_enough() -> None:
    steps = [3_000_000.0 + 16 * n for n in range(80)]
    expected = next(at for at in steps if at > steps[0] + 1000)
    assert played(steps) == played(steps, wake=False) == [("done", expected)]


def test_a_jump_ahead_is_time_that_has_passed() -> None:
    assert played([10, 20, 90_000]) == [("done", 90_000)]


def test_a_jump_back_is_none_and_what_comes_after_it_counts() -> None:
    """As when a player begins a recording again: 700 ms, and 400 ms of the second time."""
    again = [*range(0, 701, 100), *range(0, 401, 100)]
    assert played([float(at) for at in again]) == [("done", 1100)]


@contextmanager
def running(arrangement: Arrangement) -> Iterator[list[Reason]]:
    reasons: list[Reason] = []
    thread = threading.Thread(
        target=lambda: reasons.append(arrangement.run(grace_s=0.05)), daemon=True
    )
    thread.start()
    try:
        yield reasons
    finally:
        arrangement.stop()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def test_while_it_stands_still_all_goes_on_that_is_not_time() -> None:
    clock, journal = SimulatedClock(), Journal(lambda _: None)
    clock.set_ns(5_000 * MS)
    with Whiteboard.local() as board:
        environment = JournalledEnvironment(LiveEnvironment(board, clock), journal)
        arrangement = Arrangement([Timer], environment=environment)
        with running(arrangement) as reasons:
            status = board[status_slot("Timer")]
            wait_for(lambda: status.count >= 3, "a status that still holds, posted again")
            first = status.get()
            assert first is not None
            assert (first.state, first.ringlets, first.in_state_s) == ("waiting", 1, 0.0)
            board.add_message(NUMBER, Int32())
            wait_for(lambda: (status.get() or first).state == "seen", "the message was read")
            clock.set_ns(5_040 * MS)
            wait_for(lambda: (status.get() or first).in_state_s == 0.04, "time went on")
            assert not reasons
    assert reasons  # as the time passed by itself after the stop


def test_messages_age_by_it() -> None:
    clock = SimulatedClock()
    clock.set_ns(0)
    with Whiteboard.local() as board:
        arrangement = Arrangement([Timer], whiteboard=board, clock=clock)
        machine = arrangement.machine("Timer")
        board.add_message(NUMBER, Int32())
        clock.set_ns(150 * MS)
        arrangement.round()
        assert machine.age_ms("number") == 150
