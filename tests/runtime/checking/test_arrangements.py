"""Mistakes between the machines of one arrangement."""

from __future__ import annotations

from pathlib import Path

import pytest

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.checking import check_arrangement
from llfsm.runtime.plans import Plan, PlannedMachine
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtlesim import Pose


def found(read: Slot[Pose], posted: Slot[Pose] | Slot[Twist], **slots: str) -> list[str]:
    """Check a machine that reads a slot beside one that posts to another."""

    class Poster(Machine):
        out = Actuator(posted)
        a, b = State(), State()
        a.to(b)

    class Reader(Machine):
        pose = Sensor(read)
        a, b = State(), State()
        a.to(b)

    plan = Plan(
        machines=(
            PlannedMachine(definition="m:Poster"),
            PlannedMachine(definition="m:Reader", slots=slots),
        )
    )
    classes: dict[str, type[Machine]] = {"Poster": Poster, "Reader": Reader}
    return [each.text for each in check_arrangement(Path("m.toml"), plan, classes)]


@pytest.mark.parametrize(
    ("read", "posted"),
    [("gaol", "goal"), ("goals", "goal"), ("/goal", "goal"), ("Goal", "goal"), ("gowl", "goal")],
)
def test_slots_that_differ_in_a_letter_are_found(read: str, posted: str) -> None:
    (text,) = found(Slot(read, Pose), Slot(posted, Pose))
    assert text == f"Reader reads {read!r} and Poster posts to {posted!r}: one is misspelt?"


@pytest.mark.parametrize(("read", "posted"), [("pose", "goal"), ("arm/1", "arm/2"), ("a", "a")])
def test_other_slots_are_not(read: str, posted: str) -> None:
    assert found(Slot(read, Pose), Slot(posted, Pose)) == []


def test_slots_of_other_messages_are_not() -> None:
    assert found(Slot("gaol", Pose), Slot("goal", Twist)) == []


def test_slots_are_those_of_the_arrangement() -> None:
    assert found(Slot("gaol", Pose), Slot("goal", Pose), gaol="goal") == []
    assert found(Slot("pose", Pose), Slot("goal", Pose), pose="gola") != []
