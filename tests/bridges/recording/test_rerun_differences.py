"""What machines do differently when they run again is found, and shown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.bridges.recording.errors import (
    NoEventsError,
    OtherMachinesError,
    RecordingFileError,
    RerunError,
)
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.rerun import assert_reruns, rerun
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.runtime import Actuator, Machine, Sensor
from llfsm.runtime.journal.entries import Entry
from llfsm.whiteboard import Message, Slot

from .conftest import entries_in, keep_journal, write
from .journalled_run import Patrol, keep, patrol
from .machines import SEEN, Follower, Number


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


@pytest.mark.parametrize(
    ("cls", "recorded", "now"),
    [
        (OtherValue, "message=[9]", "message=[10]"),
        (Mute, "Posted(machine='Patrol', actuator='post', slot='seen', message=[9]", "Eval("),
        (Chatty, "RoundEnd(", "Posted(machine='Patrol', actuator='post', slot='seen', message=[0]"),
        (AtEnd, "message=[-1]", "message=[-2]"),
        (Raising, "RoundEnd(", "Posted("),
    ],
)
def test_the_first_difference_is_shown(cls: type[Machine], recorded: str, now: str) -> None:
    difference, _ = patrol().again([named(cls)])
    assert difference is not None
    head, before, after = str(difference).splitlines()
    assert head.startswith(f"event {difference.number} differs, ")
    assert before.startswith("  recorded: ")
    assert recorded in before
    assert after.startswith("  now:      ")
    assert now in after


def test_how_often_the_time_is_asked_for_is_no_difference() -> None:
    difference, _ = patrol().again([named(AskingOften)])
    assert difference is None


def test_pytest_shows_it(file: Path) -> None:
    keep(patrol(), file)
    assert_reruns(file, [Patrol])
    with pytest.raises(RerunError, match=r"event \d+ differs.*\n.*\n.*message=\[10\]"):
        assert_reruns(str(file), [named(OtherValue)])


def test_other_machines_are_refused(file: Path) -> None:
    keep(patrol(), file)
    for wrong in ([], [Follower], [Patrol, Follower]):
        with pytest.raises(OtherMachinesError, match=f"{file}: its machines are Patrol, not "):
            rerun(file, wrong)


def test_a_recording_without_events_says_how_to_make_one(file: Path) -> None:
    write(file, [])
    with pytest.raises(NoEventsError, match="llfsm run --record"):
        rerun(file, [Patrol])


class Text(Message):
    value: str


def test_messages_that_are_no_longer_of_the_sensors_type_are_told(file: Path) -> None:
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
def test_an_event_that_is_none_is_told(file: Path, entry: Entry) -> None:
    with RecordingWriter(file, {}) as writer:
        keep_journal(writer, [entry])
    with pytest.raises(RecordingFileError, match="has an invalid event"):
        entries_in(Recording(file))
