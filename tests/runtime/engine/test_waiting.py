"""Machines that wait sleep until something can change, whatever that is; others are polled.

Where a test says that news ends the sleep, nothing else does: what else would is switched off.
"""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from definition import BUILT, Defined
from llfsm.runtime import (
    Actuator,
    Arrangement,
    LiveEnvironment,
    Machine,
    ManualClock,
    Reason,
    Sensor,
    State,
    TimeSlot,
    Timetable,
    variable,
)
from llfsm.runtime.engine.clock import FOREVER
from llfsm.runtime.engine.events import IdleSleep, RoundBegin
from llfsm.runtime.engine.waiting import Stillness
from llfsm.runtime.expressions.waiting import waiting_in
from llfsm.runtime.presence.remote import Directory
from llfsm.runtime.presence.status_publisher import StatusPublisher
from llfsm.runtime.testing import run_until
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

GO, OUT = Slot("go", Int32), Slot("out", Int32)
KINDS = [Arrangement, Defined] if BUILT else [Arrangement]
PACES: list[dict[str, Any]] = [{}, {"period_us": 5_000}]


class Waits(Machine):
    """Wait for a message, a long time, or a stop."""

    go = Sensor(GO)
    out = Actuator(OUT, at_suspend=Int32(-1))
    count: int = 0

    waiting = State()
    done = State()
    end = State(final=True)
    waiting.to(end, when=lambda m: m.stopping)
    waiting.to(done, when=lambda m: m.go is not None and m.go.data > 5)
    waiting.to(done, when=lambda m: m.count > 5)
    waiting.to(done, after_ms=3_600_000)
    done.to(end, when=lambda m: m.stopping)

    @done.on_entry
    def _(self) -> None:
        self.out(Int32(1))


class Reads(Machine):
    """Wait for what `Waits` posts."""

    out = Sensor(OUT)

    waiting = State()
    found = State()
    end = State(final=True)
    waiting.to(end, when=lambda m: m.stopping)
    waiting.to(found, when=lambda m: m.out is not None and m.out.data == 7)
    found.to(end, when=lambda m: m.stopping)


class Counting(LiveEnvironment):
    """Count the sleeps of machines that wait."""

    waits = 0

    def wait_until_ns(self, deadline_ns: int) -> bool:
        self.waits += 1
        return super().wait_until_ns(deadline_ns)


class Run:
    """An arrangement in a thread of its own, on a board of several processes.

    It finds out at once whether its machines wait.
    """

    look_ns = 500_000_000

    def __init__(self, board: Whiteboard, machines: list[Any], **options: Any):
        self.board = board
        self.environment = Counting(board)
        self.kind = options.pop("kind", Arrangement)
        self.arrangement = self.kind(machines, environment=self.environment, **options)
        pace = self.arrangement.pace._replace(patience_ns=1_000_000, look_ns=self.look_ns)
        self.arrangement.pace = pace
        self.thread = threading.Thread(target=self.arrangement.run, daemon=True)

    def state(self, machine: str) -> str:
        return str(self.arrangement.state_name_of(machine))

    def wait_for_sleep(self, number: int = 1) -> None:
        before = self.environment.waits
        wait_for(lambda: self.environment.waits >= before + number, "it waits")


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Whiteboard]:
    with Whiteboard("board", directory=tmp_path) as found:
        yield found


@pytest.fixture
def only_news(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no beat and no look end a sleep."""
    monkeypatch.setattr(Run, "look_ns", 10**15)
    monkeypatch.setattr(StatusPublisher, "due_ns", FOREVER)


@contextmanager
def running(board: Whiteboard, *machines: Any, **options: Any) -> Iterator[Run]:
    run = Run(board, list(machines), **options)
    run.thread.start()
    try:
        yield run
    finally:
        run.arrangement.stop()
        run.thread.join(30)
    assert not run.thread.is_alive()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pace", PACES)
def test_machines_that_wait_have_as_many_rounds_as_there_are_sleeps(
    board: Whiteboard, kind: type[Arrangement], pace: dict[str, Any]
) -> None:
    with running(board, Waits, Reads, kind=kind, timed=True, **pace) as run:
        run.wait_for_sleep(2)
        waits, turns = run.environment.waits, turns_of(run.arrangement)
        run.wait_for_sleep(4)
        more = run.environment.waits - waits
        assert turns_of(run.arrangement) - turns <= more + 1
    assert run.arrangement.reason is Reason.ACCEPTING


def turns_of(arrangement: Arrangement) -> int:
    (waits, _) = arrangement.statistics()
    return waits.ringlets - waits.passed_over


class Posting(Machine):
    """Post by a thread of its own, which is not in a turn."""

    out = Actuator(OUT)

    waiting = State()
    end = State(final=True)
    waiting.to(end, when=lambda m: m.stopping)


def post_by_thread(run: Run) -> None:
    machine: Any = run.arrangement.machine("Posting")
    machine.out(Int32(7))


NEWS: dict[str, tuple[Callable[[Run], object], Callable[[Run], object]]] = {
    "a message": (
        lambda run: run.board.add_message(GO, Int32(7)),
        lambda run: run.state("Waits") == "done",
    ),
    "a message of a machine's thread": (post_by_thread, lambda run: run.state("Reads") == "found"),
    "a request": (
        lambda run: run.arrangement.suspend("Waits"),
        lambda run: run.board.get_message(OUT) == Int32(-1),
    ),
    "a request of another process": (
        lambda run: Directory(run.board).find("Waits", ()).request("suspend"),
        lambda run: run.arrangement.is_suspended("Waits"),
    ),
    "a stop": (lambda run: run.arrangement.stop(), lambda run: not run.thread.is_alive()),
    "a stop of one": (
        lambda run: run.arrangement.stop_machine("Waits"),
        lambda run: "Waits" not in run.arrangement.states(),
    ),
    "an override": (
        lambda run: run.arrangement.override("Waits", "go", Int32(9)),
        lambda run: run.state("Waits") == "done",
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pace", PACES)
@pytest.mark.parametrize("news", NEWS)
@pytest.mark.usefixtures("only_news")
def test_news_ends_the_sleep(
    board: Whiteboard, kind: type[Arrangement], pace: dict[str, Any], news: str
) -> None:
    happen, has_happened = NEWS[news]
    with running(board, Waits, Reads, Posting, kind=kind, **pace) as run:
        run.wait_for_sleep()
        happen(run)
        wait_for(lambda: has_happened(run), news)


@pytest.mark.usefixtures("only_news")
def test_an_observer_that_comes_sees_whole_rounds(board: Whiteboard) -> None:
    events: list[object] = []
    with running(board, Waits) as run:
        run.wait_for_sleep()
        run.arrangement.attach(events.append)
        wait_for(lambda: len(events) > 20, "rounds are observed")
        run.arrangement.detach(events.append)
    first = next(event for event in events if not isinstance(event, IdleSleep))
    assert isinstance(first, RoundBegin)


class Beats(Machine):
    """Wait until a message is too old, and then some time."""

    go = Sensor(GO, max_age_ms=300)

    waiting = State()
    silent = State()
    late = State(final=True)
    waiting.to(silent, when=lambda m: m.go is None)
    silent.to(late, after_ms=250)


@pytest.mark.parametrize("pace", PACES)
@pytest.mark.usefixtures("only_news")
def test_time_ends_the_sleep(board: Whiteboard, pace: dict[str, Any]) -> None:
    board.add_message(GO, Int32(1))
    with running(board, Beats, **pace) as run:
        run.thread.join(30)
        assert run.arrangement.reason is Reason.ACCEPTING
    assert run.environment.waits


def test_what_no_analysis_sees_is_noticed_late(board: Whiteboard) -> None:
    with running(board, Waits) as run:
        run.wait_for_sleep()
        machine: Any = run.arrangement.machine("Waits")
        machine.count = 6
        wait_for(lambda: run.state("Waits") == "done", "its variable is looked at")


def test_the_end_of_the_board_ends_it(tmp_path: Path) -> None:
    board = Whiteboard("board", directory=tmp_path)
    with running(board, Waits) as run:
        run.wait_for_sleep()
        Whiteboard("board", directory=tmp_path).remove()
        run.thread.join(30)
        assert run.arrangement.stop_cause == "the whiteboard was closed or removed"
    board.close()


@pytest.mark.parametrize("pace", [{}, {"period_us": 20_000}])
def test_an_hour_is_as_long_as_what_happens_in_it(pace: dict[str, Any]) -> None:
    clock = ManualClock()
    arrangement = Arrangement(
        [Waits], whiteboard=Whiteboard.local(), clock=clock, timed=not pace, **pace
    )
    rounds = 3_600_000 // (20 if pace else 10) + 10
    assert arrangement.run(max_rounds=rounds) is Reason.MAX_ROUNDS
    (statistics,) = arrangement.statistics()
    assert statistics.state_s["waiting"] >= 3600
    assert statistics.ringlets == arrangement.rounds == rounds
    assert statistics.ringlets - statistics.passed_over < 30


# What is polled, and why


def is_odd(machine: Any) -> bool:
    """Depend on what changes unseen."""
    return random.random() > machine.limit


class Asks(Machine):
    """Have guards of all kinds."""

    go = Sensor(GO)
    limit: float = 20
    inner: Any = variable(None)

    plain = State()
    internal = State()
    empty = State()
    opens = State()
    ages = State()
    computed = State()
    asks = State()
    end = State(final=True)
    plain.to(internal, when=lambda m: m.after_ms(40) and m.go is None)
    plain.to(internal, when=lambda m: m.after_ms(m.limit) and m.go is None)
    plain.to(internal, after_ms=70.5, when=lambda m: m.is_suspended("Other"))
    internal.to(empty, after_ms=3)
    empty.to(opens, after_ms=3)
    opens.to(ages, when=is_odd)
    ages.to(computed, when=lambda m: m.age_ms("go") == 3)
    computed.to(asks, when=lambda m: m.after_ms(m.limit + 1))
    asks.to(end, when=lambda m: m.is_suspended(f"{m.limit}"))

    @internal.internal
    def _(self) -> None:
        self.inner = None

    @empty.internal
    def _(self) -> None:
        """Do nothing."""


POLLS = {
    "plain": "",
    "internal": "its Internal",
    "empty": "",
    "opens": "random.random, in the guard to ages",
    "ages": "m.age_ms, in the guard to computed",
    "computed": "a limit of time that is computed, in the guard to asks",
    "asks": "the status of a machine that is not named, in the guard to end",
    "end": "",
}


def test_why_a_state_is_polled_is_known() -> None:
    found = {state.name: waiting_in(Asks.table, state) for state in Asks.table.states}
    assert {name: each.polls for name, each in found.items()} == POLLS
    plain = found["plain"]
    assert plain.sensors == {"go"}
    assert plain.machines == {"Other"}
    assert plain.limits_ns == (40_000_000, 70_500_000)
    assert plain.limits_in == (("limit", 1e6),)


class Other(Machine):
    """Be there."""

    waiting = State()
    end = State(final=True)
    waiting.to(end, when=lambda m: m.stopping)


class AsksOther(Machine):
    """Ask of a machine by its name."""

    waiting = State()
    end = State(final=True)
    waiting.to(end, when=lambda m: m.is_suspended("Other"))


def test_the_status_of_a_machine_of_another_process_is_polled() -> None:
    board, clock = Whiteboard.local(), ManualClock()
    arrangement = Arrangement([AsksOther, Other], whiteboard=board, clock=clock)
    arrangement.round()
    stillness = Stillness(arrangement.kernel, waiting_in)
    assert stillness.until_ns() == FOREVER
    arrangement.unload("Other")  # so it would be another process's
    assert stillness.until_ns() == 0


def test_each_limit_is_waited_for() -> None:
    board, clock = Whiteboard.local(), ManualClock()
    board.add_message(GO, Int32(1))  # so that no guard is true
    arrangement = Arrangement([Asks, Other], whiteboard=board, clock=clock)
    arrangement.round()
    stillness = Stillness(arrangement.kernel, waiting_in)
    found = []
    for _ in range(4):
        found.append(stillness.until_ns())
        clock.sleep_until_ns(min(found[-1], 10**12))
        assert not arrangement.round()
    assert found == [20_000_001, 40_000_001, 70_500_001, FOREVER]


def test_a_turn_that_is_to_do_something_is_not_waited_for() -> None:
    arrangement = Arrangement([Other], whiteboard=Whiteboard.local(), clock=ManualClock())
    stillness = Stillness(arrangement.kernel, waiting_in)
    assert stillness.until_ns() == 0  # it has yet to enter its state
    arrangement.round()
    assert stillness.until_ns() == FOREVER
    arrangement.suspend("Other")
    assert stillness.until_ns() == 0


def test_the_age_of_a_message_is_waited_for() -> None:
    board, clock = Whiteboard.local(), ManualClock()
    arrangement = Arrangement([Beats], whiteboard=board, clock=clock)
    board.add_message(GO, Int32(1))
    clock.advance(ms=100)
    arrangement.round()
    until_ns = Stillness(arrangement.kernel, waiting_in).until_ns()
    assert until_ns == 300_000_001
    clock.sleep_until_ns(until_ns - 1)
    assert not arrangement.round()
    clock.sleep_until_ns(until_ns)
    assert arrangement.round()


def test_a_timetable_has_all_of_its_turns() -> None:
    table = Timetable([TimeSlot("Other", 0, 1_000)], 10_000)
    board, clock = Whiteboard.local(), ManualClock()
    arrangement = Arrangement([Other], whiteboard=board, clock=clock, timetable=table)
    arrangement.round()
    assert Stillness(arrangement.kernel, waiting_in).until_ns() == 0


@pytest.mark.parametrize("watcher", ["observer", "instrument"])
def test_who_watches_sees_each_round(watcher: str) -> None:
    from llfsm.runtime.debugging.debugger import Debugger

    arrangement = Arrangement([Other], whiteboard=Whiteboard.local(), clock=ManualClock())
    arrangement.round()
    stillness = Stillness(arrangement.kernel, waiting_in)
    assert stillness.until_ns() == FOREVER
    if watcher == "observer":
        arrangement.attach(lambda event: None)
    else:
        Debugger.of(arrangement)
    assert stillness.until_ns() == 0


def test_a_round_that_was_not_run_has_not_changed_nothing() -> None:
    """In between, a machine may have posted, and stand as before."""
    arrangement = Arrangement([Other], whiteboard=Whiteboard.local(), clock=ManualClock())
    stillness = Stillness(arrangement.kernel, waiting_in)
    found: list[bool] = []
    for rounds in (1, 1, 1, 2, 1):
        for _ in range(rounds):
            arrangement.round()
        found.append(stillness.is_since_last_round())
    assert found == [False, True, True, False, True]


def test_what_a_machine_posts_between_a_round_and_the_sleep_is_news(board: Whiteboard) -> None:
    """As a thread of it may; in other sleeps it is none, as it may be of the round before."""
    environment = LiveEnvironment(board)
    arrangement = Arrangement([Posting, Reads], environment=environment)
    arrangement.round()
    now_ns, machine = environment.clock.now_ns, arrangement.machine("Posting")
    assert not environment.sleep_until_ns(now_ns())
    machine.out(Int32(7))  # type: ignore[attr-defined]
    assert environment.wait_until_ns(now_ns() + 10**10)
    machine.out(Int32(7))  # type: ignore[attr-defined]
    assert not environment.sleep_until_ns(now_ns() + 1_000_000)


def test_machines_are_where_rounds_are_that_were_passed_over() -> None:
    """So what is published of them then, as how long they have been in a state, is of that time."""
    clock = ManualClock()
    arrangement = Arrangement([Other], clock=clock, period_us=1_000)
    pacer = arrangement.kernel.pacer
    arrangement.round()
    assert pacer is not None
    pacer.pass_over(7)
    assert (arrangement.environment.due_ns, pacer.next_ns) == (7_000_000, 8_000_000)


class Posts(Machine):
    """Post to `Reads`, which had its turn before, when it comes into a state to wait there."""

    out = Actuator(OUT)

    begin = State()
    waiting = State()
    end = State(final=True)
    begin.to(waiting, after_ms=100)
    waiting.to(end, when=lambda m: m.stopping)

    @waiting.on_entry
    def _(self) -> None:
        self.out(Int32(7))


@pytest.mark.parametrize("pace", PACES)
def test_what_a_machine_posts_as_it_begins_to_wait_is_read_in_the_next_round(
    pace: dict[str, Any],
) -> None:
    found: list[tuple[float, int]] = []
    for analysis in (Arrangement.analysis, None):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Arrangement, "analysis", staticmethod(analysis) if analysis else None)
            board, clock = Whiteboard.local(), ManualClock()
            arrangement = Arrangement([Reads, Posts], whiteboard=board, clock=clock, **pace)
            took_ms = run_until(arrangement, "Reads.found", within_ms=10_000)
            found.append((took_ms, arrangement.rounds))
    assert found[0] == found[1]
