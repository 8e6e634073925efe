"""What machines do differently when they run again is found, and shown."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.bridges.recording.errors import (
    RecordingError,
    RecordingFileError,
    RerunError,
)
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.rerun import (
    COMPARISONS,
    Comparison,
    Difference,
    Rerun,
    assert_reruns,
    rerun,
)
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.journal.entries import Entry
from llfsm.whiteboard import Message, Slot
from thoroughness import examples

from .conftest import entries_in, keep_journal, write
from .journalled_run import JumpingClock, Patrol, Run, keep, patrol
from .machines import COMMAND, SEEN, Follower, Number


class OtherValue(Patrol):
    @Patrol.go.on_entry
    def _(self) -> None:
        self.post(Number(self.command.value + 1))


class Mute(Patrol):
    @Patrol.go.on_entry
    def _(self) -> None:
        pass


class Chatty(Patrol):
    @Patrol.go.internal
    def _(self) -> None:
        self.post(Number(0))


class AtEnd(Patrol):
    post = Actuator(SEEN, at_end=Number(-2))


class Raising(Patrol):
    @Patrol.go.internal
    def _(self) -> None:
        raise ValueError("new")


class AskingOften(Patrol):
    """As Patrol, but for how often it asks for the time."""

    @Patrol.wait.internal
    def _(self) -> None:
        for _ in range(5):
            self.after_ms(3)


def named(cls: type[Machine]) -> Callable[[], Machine]:
    return type(cls)("Patrol", (cls,), type(cls).__prepare__("Patrol", (cls,)))  # type: ignore


class Rewritten(Machine):
    """As Patrol, with other guards."""

    command = Sensor(COMMAND, default=Number(0))
    post = Actuator(SEEN, at_end=Number(-1))

    wait, go = State(), State()

    @go.on_entry
    def _(self) -> None:
        self.post(Number(self.command.value))

    @wait.to(go)
    def is_large(self) -> bool:
        return self.command.value > 5

    go.to(wait, when=lambda m: m.after_ms(50))


class Renamed(Machine):
    """As Patrol, with other states."""

    command = Sensor(COMMAND, default=Number(0))
    post = Actuator(SEEN, at_end=Number(-1))

    idle, walk = State(), State()

    @walk.on_entry
    def _(self) -> None:
        self.post(Number(self.command.value))

    idle.to(walk, when=lambda m: m.command.value > 5)
    walk.to(idle, after_ms=50)


@pytest.mark.parametrize(
    ("cls", "said", "row"),
    [
        (
            OtherValue,
            "now posts seen = 10 at S, where it posted seen = 9",
            r"message +\[9\] +\[10\]",
        ),
        (Mute, "no longer posts seen = 9 at S", r"event +Posted +Eval"),
        (Chatty, "now posts seen = 0 at S, where it posted nothing", r"event +RoundEnd +Posted"),
        (AtEnd, "now posts seen = -2 at S, where it posted seen = -1", r"message +\[-1\] +\[-2\]"),
        (Raising, "now posts seen = -1 at S, where it posted nothing", r"event +RoundEnd +Posted"),
    ],
)
def test_the_first_difference_is_shown(cls: type[Machine], said: str, row: str) -> None:
    difference, _ = patrol().again([named(cls)])
    assert difference is not None
    first, head, columns, *rows = str(difference).splitlines()
    assert re.sub(r"[0-9.]+ s\b", "S", first) == f"Patrol {said}"
    assert head.startswith(f"event {difference.number} differs, ")
    assert columns.split() == ["recorded", "now"]
    assert re.search(rf"^\* {row}$", "\n".join(rows), re.MULTILINE)


def test_a_guard_or_a_state_that_differs_is_said() -> None:
    guard: Entry = {"event": "Eval", "round": 3, "time_ns": 0, "machine": "M", "state": "A"}
    guard |= {"transition": 0, "label": "near", "target": "B", "value": False}
    said = str(Difference(7, 1.5, guard, guard | {"value": True})).splitlines()[0]
    assert said == "M: A -> B is now true at 1.500 s, where it was false"
    turn: Entry = {"event": "Turn", "round": 3, "time_ns": 0, "index": 0, "machine": "M"}
    turn |= {"state": "A", "previous": None, "request": None}
    said = str(Difference(7, 1.5, turn, turn | {"state": "B"})).splitlines()[0]
    assert said == "M is now in B at 1.500 s, where it was in A"


def test_what_the_machine_saw_is_shown() -> None:
    difference, _ = patrol().again([named(OtherValue)])
    assert str(difference).splitlines()[-1] == "Patrol saw command = Number(value=9)"


@pytest.mark.parametrize(
    ("cls", "accepted"),
    [
        (Patrol, {"all", "states", "posts"}),
        (Rewritten, {"states", "posts"}),
        (Renamed, {"posts"}),
        (OtherValue, set()),
        (Mute, set()),
        (Chatty, set()),
        (AtEnd, set()),
    ],
)
def test_what_is_compared(file: Path, cls: type[Machine], accepted: set[Comparison]) -> None:
    keep(patrol(), file)
    same = {how for how in COMPARISONS if rerun(file, [named(cls)], compare=how) is None}
    assert same == accepted


@given(st.lists(st.integers(0, 12), max_size=30))
@settings(deadline=None, max_examples=examples(20))
def test_a_guard_that_means_the_same_may_be_written_in_another_way(values: list[int]) -> None:
    run = Run([Patrol], clock=JumpingClock())
    for value in values:
        run.board.add_message(COMMAND, Number(value))
        run.clock.advance(ms=20)
        run.arrangement.round()
    run.arrangement.end()
    again = Rerun(run.entries, how="states")
    again.arrange([named(Rewritten)])
    assert again.compare() is None


def test_how_often_the_time_is_asked_for_is_no_difference() -> None:
    difference, _ = patrol().again([named(AskingOften)])
    assert difference is None


def test_pytest_shows_it(file: Path) -> None:
    keep(patrol(), file)
    assert_reruns(file, [Patrol])
    with pytest.raises(RerunError, match=r"event \d+ differs(.*\n)+.*message.*\[10\]"):
        assert_reruns(str(file), [named(OtherValue)])


def test_other_machines_are_refused(file: Path) -> None:
    keep(patrol(), file)
    for wrong in ([], [Follower], [Patrol, Follower]):
        with pytest.raises(RecordingError, match=f"{file}: its machines are Patrol, not "):
            rerun(file, wrong)


def test_a_recording_without_events_says_how_to_make_one(file: Path) -> None:
    write(file, [])
    with pytest.raises(RecordingError, match="llfsm run --record"):
        rerun(file, [Patrol])


class Text(Message):
    value: str


def test_messages_that_are_no_longer_of_the_sensors_type_are_reported(file: Path) -> None:
    class Changed(Patrol):
        command = Sensor(Slot("command", Text), default=Text("6"))

    keep(patrol(), file)
    with pytest.raises(RecordingFileError, match="Patrol cannot read what its sensor 'command'"):
        rerun(file, [named(Changed)])


POSTED = {"machine": "m", "actuator": "a", "slot": "s", "count": 1}


@pytest.mark.parametrize(
    "entry",
    [
        {"event": "Posted", **POSTED, "message": "?"},
        {"event": "Posted", **POSTED},
        {"event": "Dreamt", **POSTED},
    ],
)
def test_an_event_that_is_none_is_reported(file: Path, entry: Entry) -> None:
    with RecordingWriter(file, {}) as writer:
        keep_journal(writer, [entry])
    with pytest.raises(RecordingFileError, match="has an invalid event"):
        entries_in(Recording(file))
