"""An idle sleep ends when there is news for the machines, and nothing else about a run changes.

The sleeps here last longer than a test may take. What happens meanwhile comes from another thread
or process, once the arrangement sleeps.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from llfsm.runtime import (
    Actuator,
    Arrangement,
    Machine,
    ManualClock,
    MonotonicClock,
    Sensor,
    State,
    Trace,
)
from llfsm.runtime.engine.events import Event, IdleSleep, RoundBegin
from llfsm.runtime.engine.kernel import Control
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Board, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

A, B, C = (Slot(name, Int32) for name in "abc")
LONG_US = 600_000_000


class Waits(Machine):
    """Accept when there is a message in A."""

    a = Sensor(A)

    waiting = State()
    done = State()
    waiting.to(done, when=lambda m: m.a is not None or m.stopping)


class Posts(Machine):
    """Post to B and C at every turn, and accept when asked to stop."""

    b = Actuator(B)
    c = Actuator(C)

    posting = State()
    done = State()
    posting.to(done, when=lambda m: m.stopping)

    @posting.internal
    def _(self) -> None:
        self.b(Int32())
        self.c(Int32())


class Reads(Posts):
    """Read what it posts, and what others post before it and after it."""

    reads_b = Sensor(B)
    reads_c = Sensor(C, max_age_ms=1000)


class Calls(Machine):
    """Call a machine, and accept when that is done."""

    callee: type[Machine] = Waits

    calling = State()
    failed = State()
    done = State()

    @calling.on_entry
    def _(self) -> None:
        self.call = self.call_machine(self.callee)

    @calling.to(done)
    def is_done(self) -> bool:
        return self.call.done

    @calling.to(failed)
    def has_failed(self) -> bool:
        return self.call.failed


class Stops(Machine):
    """Accept when asked to stop."""

    state = State()
    done = State()
    state.to(done, when=lambda m: m.stopping)


class Ends(Machine):
    """Accept at once."""

    done = State()


class Raises(Machine):
    """Fail at once."""

    state = State()
    state.to(state, when=lambda m: 1 / 0 > 0)


@pytest.fixture(params=["shared", "local"])
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Board]:
    with ExitStack() as stack:
        if request.param == "shared":
            yield stack.enter_context(Whiteboard("board", directory=tmp_path))
        else:
            yield Whiteboard.local()


@contextmanager
def running(*machines: Any, **options: Any) -> Iterator[tuple[Arrangement, threading.Semaphore]]:
    """Run an arrangement in a thread, which ends within the context; a semaphore counts sleeps."""
    sleeps = threading.Semaphore(0)

    def observe(event: Event) -> None:
        if isinstance(event, IdleSleep):
            sleeps.release()

    options = {"idle_us": LONG_US} | options
    arrangement = Arrangement(machines, observers=[observe], **options)
    thread = threading.Thread(target=arrangement.run, daemon=True)
    thread.start()
    try:
        yield arrangement, sleeps
    finally:
        arrangement.stop()
        thread.join()


def accepts(arrangement: Arrangement) -> None:
    wait_for(lambda: not arrangement.machines, "all machines accept")


def test_a_message_that_a_machine_reads_ends_the_sleep(board: Board) -> None:
    with running(Waits, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        board.add_message(A, Int32())
        accepts(arrangement)


@pytest.mark.parametrize("sensor", [Sensor(A, default=Int32(7)), Sensor(A, max_age_ms=60_000)])
def test_every_kind_of_sensor_is_one(board: Board, sensor: Any) -> None:
    class Sees(Waits):
        a = sensor

    with running(Sees, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        board.add_message(A, Int32(8))
        accepts(arrangement)


def test_a_slot_of_another_name_is_one(board: Board) -> None:
    class Loads(Posts):
        @Posts.posting.on_entry
        def _(self) -> None:
            self.load(Waits, slots={"a": "other"})

    with running(Loads, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        board.add_message(Slot("other", Int32), Int32())
        wait_for(lambda: len(arrangement.machines) == 1, "the loaded machine accepts")


def test_other_messages_do_not_end_it(board: Board) -> None:
    with running(Waits, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        for _ in range(1000):
            board.add_message(B, Int32())
        assert not sleeps.acquire(blocking=False)
        assert arrangement.rounds == 1
        board.add_message(A, Int32())
        accepts(arrangement)
        assert arrangement.rounds <= 4


def test_a_message_that_came_during_the_round_is_news(board: Board) -> None:
    """After the machine's own turn, and before the sleep."""

    class Late(Machine):
        state = State()
        done = State()
        state.to(done, when=lambda m: bool(board.get_message(B)))

        @state.internal
        def _(self) -> None:
            board.add_message(A, Int32())  # as another process would
            board.add_message(B, Int32())

    with running(Waits, Late, whiteboard=board) as (arrangement, _):
        accepts(arrangement)


def test_what_the_machines_post_themselves_is_no_news(board: Board) -> None:
    """However they read it: before, after, or in the machine itself."""
    with running(Reads, Posts, Reads, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        board.add_message(A, Int32())
        assert not sleeps.acquire(timeout=0.1)  # less only makes this test weaker
        assert arrangement.rounds == 1
        board.add_message(B, Int32())
        sleeps.acquire()
        assert arrangement.rounds == 2


def test_a_stop_ends_it(board: Board) -> None:
    with running(Waits, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        arrangement.stop()
        accepts(arrangement)


def test_the_end_of_the_board_ends_it(board: Board) -> None:
    with running(Stops, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        board.close()
        accepts(arrangement)
    assert arrangement.stop_cause == "the whiteboard was closed or removed"


def test_a_request_ends_it(board: Board) -> None:
    suspended = threading.Event()

    class Obeys(Waits):
        away = State(suspend=True)

        @away.on_entry
        def _(self) -> None:
            suspended.set()

    with running(Obeys, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        machine = Directory(board).find("Obeys")
        machine.request("suspend")
        suspended.wait()
        machine.request("resume")
        board.add_message(A, Int32())
        accepts(arrangement)


def test_a_request_to_another_process_does_not_end_it(board: Board) -> None:
    with running(Waits, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        with running(Waits, whiteboard=board) as (other, others_sleeps):
            others_sleeps.acquire()
            Directory(board).find("Waits.0").request("suspend")
            others_sleeps.acquire()
            assert arrangement.rounds == 1
            assert other.rounds == 2


@pytest.mark.parametrize("on_board", [True, False])
@pytest.mark.parametrize("ask", [Control.suspend, Control.hold, Control.restart])
def test_a_request_of_another_thread_ends_it(
    board: Board, on_board: bool, ask: Callable[[Control, str], object]
) -> None:
    with running(Stops, Ends, whiteboard=board if on_board else None) as (arrangement, sleeps):
        sleeps.acquire()
        ask(arrangement.control, "Stops")
        sleeps.acquire()
        assert arrangement.roster.find("Stops").standing().request is None


def test_a_request_of_a_machine_does_not_end_it(board: Board) -> None:
    class Asks(Stops):
        @Stops.state.internal
        def _(self) -> None:
            self.restart("Stops")

    with running(Stops, Asks, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        assert not sleeps.acquire(timeout=0.1)  # less only makes this test weaker
        assert arrangement.roster.find("Stops").standing().request == "restart"


@pytest.mark.parametrize("on_board", [True, False])
@pytest.mark.parametrize("unload", [True, False])
@pytest.mark.parametrize("callee", [Ends, Raises])
def test_the_end_of_a_called_machine_ends_it(
    callee: type[Machine], unload: bool, on_board: bool
) -> None:
    board = Whiteboard.local() if on_board else None
    calls = Calls(callee=callee)
    arrangement = Arrangement(
        [calls], whiteboard=board, idle_us=500_000, unload_accepting=unload, on_error="suspend"
    )
    trace = Trace()
    arrangement.attach(trace)
    arrangement.run(max_rounds=4)
    assert calls.state_name == ("done" if callee is Ends else "failed")
    begun = [event.time_ns for event in trace if isinstance(event, RoundBegin)]
    assert begun[1] - begun[0] < 400_000_000


def test_a_called_machine_is_woken_as_its_caller_is(board: Board) -> None:
    with running(Calls, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        board.add_message(A, Int32())
        accepts(arrangement)


def test_machines_that_were_unloaded_are_not_woken(board: Board) -> None:
    with running(Waits, Posts, whiteboard=board) as (arrangement, sleeps):
        sleeps.acquire()
        board.add_message(A, Int32())  # Waits accepts, in round 3
        wait_for(lambda: len(arrangement.machines) == 1, "Waits accepts")
        sleeps.acquire()
        rounds = arrangement.rounds
        board.add_message(A, Int32())
        assert not sleeps.acquire(timeout=0.1)
        assert arrangement.rounds == rounds


SLEEPS: dict[str, Callable[[], dict[str, Any]]] = {
    "clfsm's": lambda: {"wake": False, "clock": MonotonicClock()},
    "a manual clock's": lambda: {"clock": ManualClock()},
}


@pytest.mark.parametrize("how", SLEEPS)
def test_other_sleeps_last_to_their_ends(board: Board, how: str) -> None:
    trace = Trace()
    arrangement = Arrangement([Waits], whiteboard=board, idle_us=300_000, **SLEEPS[how]())

    def add(event: Event) -> None:
        if isinstance(event, IdleSleep):
            board.add_message(A, Int32())

    arrangement.attach(add)
    arrangement.attach(trace)
    arrangement.run()
    begun = [event.time_ns for event in trace if isinstance(event, RoundBegin)]
    assert begun[1] - begun[0] >= 300_000_000


@pytest.mark.parametrize("clock", [MonotonicClock, ManualClock])
def test_rounds_with_a_period_begin_at_their_times(board: Board, clock: Any) -> None:
    trace = Trace()
    arrangement = Arrangement([Reads], whiteboard=board, period_us=100_000, clock=clock())

    def add(event: Event) -> None:
        board.add_message(B, Int32())

    arrangement.attach(add)
    arrangement.attach(trace)
    arrangement.run(max_rounds=4)
    begun = [event.time_ns for event in trace if isinstance(event, RoundBegin)]
    assert begun[3] - begun[0] >= 250_000_000  # the first may be late, no other one early
