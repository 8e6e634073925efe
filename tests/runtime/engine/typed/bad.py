"""Mistakes that mypy --strict must find, each on a line so marked."""

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot


class Pose(Message):
    x: float = 0.0


class Twist(Message):
    linear: float = 0.0


class Wrong(Machine):
    pose = Sensor(Slot("pose", Pose))
    drive = Actuator(Slot("cmd_vel", Twist))
    turns: int = 0

    a = State()
    b = State()

    @a.on_entry
    def _(self) -> None:
        self.drive(Pose())  # wrong
        self.tunrs += 1  # wrong
        print(self.pose.x)  # wrong

    @a.to(b)
    def misspelt(self) -> bool:
        return self.trns > 3  # wrong

    @a.to(b)  # wrong
    def no_bool(self) -> int:
        return self.turns

    @a.internal  # wrong
    def returns(self) -> int:
        return 1

    a.to("b")  # wrong


Wrong(turns="3")  # wrong
Wrong(turn=3)  # wrong
Sensor(Slot("pose", Pose), default=Twist())  # wrong
Actuator(Slot("pose", Pose), at_end=Twist())  # wrong
