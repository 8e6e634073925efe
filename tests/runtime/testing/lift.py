"""Machines for the tests of the testing kit: one with a bug, one that settles, one that spins."""

from __future__ import annotations

from llfsm.runtime import (
    Actuator,
    Arrangement,
    Machine,
    ManualClock,
    Sensor,
    State,
)
from llfsm.whiteboard import Message, Slot, Whiteboard

__all__ = [
    "CALL",
    "DOOR",
    "MOTOR",
    "Door",
    "Floor",
    "Lift",
    "Motor",
    "Settler",
    "Spinner",
    "door_is_closed_while_moving",
    "under_clock",
]


class Door(Message):
    open: bool = False


class Floor(Message):
    number: int = 0


class Motor(Message):
    up: bool = False


DOOR, CALL, MOTOR = Slot("door", Door), Slot("call", Floor, 64), Slot("motor", Motor)


class Lift(Machine):
    """It looks at the door before it starts, but not while it moves: the bug."""

    door = Sensor(DOOR, default=Door())
    call = Sensor(CALL, default=Floor())
    motor = Actuator(MOTOR)

    WAITING = State()
    MOVING = State()

    @WAITING.on_entry
    def _(self) -> None:
        self.motor(Motor(up=False))

    @MOVING.on_entry
    def _(self) -> None:
        self.motor(Motor(up=True))

    @WAITING.to(MOVING)
    def called(self) -> bool:
        return self.call.number > 3 and not self.door.open

    MOVING.to(WAITING, after_ms=1000)


class Settler(Machine):
    A = State()
    B = State()
    A.to(B, after_ms=100)


class Spinner(Machine):
    A = State()
    B = State()
    A.to(B)
    B.to(A)


def door_is_closed_while_moving(arrangement: Arrangement) -> bool:
    lift = arrangement.machine("Lift")
    assert isinstance(lift, Lift)
    return not (lift.state_name == "MOVING" and lift.door.open)


def under_clock(*machines: type[Machine], **options: object) -> Arrangement:
    return Arrangement(
        machines, clock=ManualClock(), whiteboard=Whiteboard.local(), **options  # type: ignore[arg-type]
    )  # fmt: skip
