"""A reactive machine: it asks for the turtle's position and keeps it away from the walls."""

from llfsm.machines.common import CMD_VEL, stopping, twist
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtle_sensor_poster import (
    ANSWER,
    REQUEST,
    TurtlePositionAnswer,
    TurtlePositionRequest,
)

__all__ = ["RosWallTurttleBot"]


class RosWallTurttleBot(Machine):
    """Drive ahead, stop, and ask for the position; near a wall, back off and turn right.

    The original calls the position service in an expression, which blocks every machine until the
    service answers. Here the request is posted to a slot, and the expression reads the answer.
    """

    drive = Actuator(CMD_VEL, at_end=Twist())
    ask = Actuator(REQUEST)
    asked = Sensor(REQUEST, default=TurtlePositionRequest())
    answer = Sensor(ANSWER, default=TurtlePositionAnswer())
    linear_x: float = 0.0  # m/s
    angular_z: float = 0.0  # rad/s
    number: int = 0  # of the latest request
    pos_x: int = 0  # whole metres
    pos_y: int = 0

    INITIAL = State()
    STRAIGHT = State()
    STOP = State()
    TEST = State()
    BACK = State()
    TURN_RIGHT = State()
    END = State()

    def move(self, linear_x: float, angular_z: float) -> None:
        """Post a command."""
        self.linear_x, self.angular_z = linear_x, angular_z
        self.drive(twist(linear_x, angular_z))

    def ask_position(self) -> None:
        """Post a request with a number that no earlier request or answer has."""
        self.number = max(self.asked.number, self.answer.number) + 1
        self.ask(TurtlePositionRequest(self.number))

    @INITIAL.on_entry
    def _(self) -> None:
        self.linear_x = self.angular_z = 0.0

    @STRAIGHT.on_entry
    def _(self) -> None:
        self.move(2.0, 0.0)

    @STOP.on_entry
    def _(self) -> None:
        self.move(0.0, 0.0)
        self.ask_position()

    @STOP.internal
    def _(self) -> None:
        if self.answer.number >= self.number and self.answer.failure:
            self.ask_position()  # like the original, which repeats its call

    @TEST.on_entry
    def _(self) -> None:
        self.pos_x, self.pos_y = int(self.answer.x), int(self.answer.y)

    @BACK.on_entry
    def _(self) -> None:
        self.move(-2.0, 0.0)

    @TURN_RIGHT.on_entry
    def _(self) -> None:
        self.move(0.0, -2.0)

    INITIAL.to(STRAIGHT, after_ms=1000)
    STRAIGHT.to(STOP, after_ms=1000)

    @STOP.to(TEST, after_ms=1000)
    def answered(self) -> bool:
        """True once the latest request was answered."""
        return self.answer.number >= self.number and not self.answer.failure

    @TEST.to(STRAIGHT)
    def away_from_walls(self) -> bool:
        """True if the turtle may drive ahead."""
        return self.pos_x > 2 and self.pos_y > 2 and self.pos_x < 9 and self.pos_y < 9

    TEST.to(BACK, after_ms=1000)
    BACK.to(TURN_RIGHT, after_ms=1000)
    TURN_RIGHT.to(STRAIGHT, after_ms=1000)

    INITIAL.to(END, when=stopping)
    STRAIGHT.to(END, when=stopping)
    STOP.to(END, when=stopping)
    TEST.to(END, when=stopping)
    BACK.to(END, when=stopping)
    TURN_RIGHT.to(END, when=stopping)
