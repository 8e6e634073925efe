"""What a user writes, and what mypy --strict and ruff make of it."""

from typing import assert_type

from llfsm.runtime import Actuator, Arrangement, Machine, ManualClock, Sensor, State, define
from llfsm.whiteboard import Message, Slot, Whiteboard


class Pose(Message):
    """Where it is."""

    x: float = 0.0


class Twist(Message):
    """How it moves."""

    linear: float = 0.0


POSE = Slot("pose", Pose)
CMD_VEL = Slot("cmd_vel", Twist)


class Wanderer(Machine):
    """Drive ahead; near a wall, back off."""

    pose = Sensor(POSE)
    sure = Sensor(POSE, default=Pose())
    drive = Actuator(CMD_VEL, at_end=Twist())
    turns: int = 0
    goal: str

    straight = State()
    stop = State()
    asleep = State(suspend=True)

    @straight.on_entry
    def _(self) -> None:
        assert_type(self.pose, Pose | None)
        assert_type(self.sure, Pose)
        assert_type(self.drive(Twist(linear=2.0)), int)

    @straight.to(stop)
    def near_wall(self) -> bool:
        return self.pose is not None and not 2 < self.pose.x < 9

    @stop.on_entry
    @stop.on_resume
    def _(self) -> None:
        self.turns += 1

    @stop.to(straight, after_ms=1000)
    def tired(self) -> bool:
        return self.turns > 3 and self.is_running("Other")

    stop.to(straight, after_ms=5000)
    stop.to(straight, when=lambda m: m.stopping)


class Careful(Wanderer):
    """Wait before going on."""

    waiting = State()

    @Wanderer.stop.to(waiting)
    def unsure(self) -> bool:
        return self.pose is None

    @waiting.to(Wanderer.straight)
    def sure_again(self) -> bool:
        return self.pose is not None and self.near_wall()


machine = Wanderer(goal="here", turns=3)
assert_type(machine.turns, int)
arrangement = Arrangement(
    [machine, Careful(goal="there")],
    whiteboard=Whiteboard.local(),
    clock=ManualClock(),
    library={"Careful": lambda: Careful(goal="x"), "Plain": define("Plain", [State("a")])},
)
assert_type(arrangement.round(), bool)
