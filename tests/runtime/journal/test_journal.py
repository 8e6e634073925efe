"""A journal changes nothing of what machines do, and what is asked for comes between ringlets."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Actuator, Arrangement, Machine, ManualClock, Sensor, State, Trace
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.journal.entries import Entry, Journal, entries_of
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Board, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32, String

NUMBER = Slot("number", Int32)
TEXT = Slot("text", String)


class Teller(Machine):
    number = Sensor(NUMBER)
    tell = Actuator(TEXT, at_end=String(data="bye"))
    saw: tuple[bool, ...] = ()

    low = State()
    high = State()

    @low.internal
    def _(self) -> None:
        self.tell(String(data=f"{self.number}"))

    low.to(high, when=lambda m: m.number is not None and m.number.data > 3)
    high.to(low, after_ms=30)


def run(make: Any) -> Trace:
    trace, clock, board = Trace(), ManualClock(), Whiteboard.local()
    arrangement = make([Teller], clock=clock, whiteboard=board, observers=[trace])
    for value in (0, 2, 4, 4, 4, 1, 9):
        board.add_message(NUMBER, Int32(data=value))
        clock.advance(ms=11)
        arrangement.round()
    arrangement.end()
    return trace


class Kept:
    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.journal = Journal(self.written.append)

    @property
    def entries(self) -> list[Entry]:
        return [entry for data in self.written for entry in entries_of(data)]

    def of(self, kind: str) -> list[Entry]:
        return [entry for entry in self.entries if entry["event"] == kind]

    def make(
        self, *machines: Any, whiteboard: Board | None = None, clock: Any = None, **options: Any
    ) -> Arrangement:
        inner = Environment(clock)
        if whiteboard is not None:
            inner = LiveEnvironment(whiteboard, clock)
        environment = JournalledEnvironment(inner, self.journal)
        return Arrangement(*machines, environment=environment, **options)


@pytest.fixture
def kept() -> Kept:
    return Kept()


def test_machines_do_the_same_with_and_without_one(kept: Kept) -> None:
    assert run(kept.make) == run(Arrangement)
    assert len([entry for entry in kept.entries if "reads" in entry]) == len(run(Arrangement))


def test_a_sensor_is_reported_when_it_changes_and_a_post_each_time(kept: Kept) -> None:
    run(kept.make)
    sensed = [NUMBER.decoder.decode(entry["message"]).data for entry in kept.of("Sensed")]
    assert sensed == [0, 2, 4, 4, 4, 1, 9]  # each a message of its own, though some are equal
    posted = kept.of("Posted")
    assert [entry["count"] for entry in posted] == list(range(1, len(posted) + 1))
    assert TEXT.decoder.decode(posted[-1]["message"]) == String(data="bye")
    assert {entry["slot"] for entry in posted} == {"text"}


def test_slots_are_called_as_on_the_board(kept: Kept) -> None:
    board = Whiteboard.local()
    with kept.make(whiteboard=board) as arrangement:
        arrangement.load(Teller, name="bob", slots={"number": "bob/number", "text": "bob/text"})
        board.add_message(Slot("bob/number", Int32), Int32(data=1))
        arrangement.round()
    assert {entry["slot"] for entry in kept.of("Sensed")} == {"bob/number"}
    assert {entry["slot"] for entry in kept.of("Posted")} == {"bob/text"}
    assert kept.of("Loaded")[0]["machine"] == "bob"


def test_the_time_that_passes_between_rounds_is_nobodys_input(kept: Kept) -> None:
    with kept.make([Teller], whiteboard=Whiteboard.local(), clock=ManualClock()) as arrangement:
        for _ in range(3):
            arrangement.clock.now_ns()
            arrangement.round()
    assert all(entry["reads"] == [] for entry in kept.of("RoundBegin"))
    assert any(entry["reads"] for entry in kept.entries if entry["event"] == "Section")


class Stopped(Machine):
    """Ask for a stop in its ringlet, as a signal may come there."""

    seen: tuple[bool, ...] = ()

    here = State()
    there = State()

    @here.internal
    def _(self) -> None:
        self._seat.kernel.stop("stop() was called")
        self.seen += (self.stopping,)

    here.to(there, when=lambda m: m.stopping)


class Beside(Machine):
    seen: tuple[bool, ...] = ()

    here = State()
    there = State()

    @here.internal
    def _(self) -> None:
        self.seen += (self.stopping,)

    here.to(there, when=lambda m: m.stopping)


def test_a_stop_in_a_ringlet_is_seen_from_the_next_round_on(kept: Kept) -> None:
    stopped, beside = Stopped(), Beside()
    with kept.make([stopped, beside]) as arrangement:
        arrangement.round()
        assert (stopped.seen, beside.seen) == ((False,), (False,))
        arrangement.round()
        assert stopped.state_name == beside.state_name == "there"
    kinds = [entry["event"] for entry in kept.entries]
    assert kinds[kinds.index("Asked") - 1] == "RoundEnd"
    assert kept.of("Asked") == [{"event": "Asked", "action": "stop", "machine": None}]


def test_a_stop_between_rounds_is_seen_at_once(kept: Kept) -> None:
    arrangement = kept.make([Beside])
    arrangement.round()
    arrangement.stop()
    assert arrangement.stopping
    arrangement.stop()
    arrangement.round()
    arrangement.end()
    assert len(kept.of("Asked")) == 1


def test_what_code_asks_is_not_reported_as_asked_from_outside(kept: Kept) -> None:
    class Asker(Machine):
        here = State()
        there = State()

        @here.on_entry
        def _(self) -> None:
            self.suspend("Beside")

        here.to(there)

    arrangement = kept.make([Asker, Beside])
    arrangement.round()
    arrangement.resume("Beside")
    arrangement.round()
    arrangement.end()
    assert [entry["action"] for entry in kept.of("Asked")] == ["resume"]
    assert [entry["operation"] for entry in kept.of("Call")] == ["suspend"]


def test_round_ends_tell_only_of_machines_that_stand_elsewhere(kept: Kept) -> None:
    run(kept.make)
    news = [entry["machines"] for entry in kept.of("RoundEnd")]
    states = [each[0][2] for each in news if each]
    assert states == ["low", "high", "low"]
    assert [] in news


def test_it_is_written_many_entries_at_once(kept: Kept) -> None:
    clock = ManualClock()
    with kept.make([Beside], clock=clock) as arrangement:
        for _ in range(100):
            clock.advance(ms=1)
            arrangement.round()
    assert 3 < len(kept.written) < 10
