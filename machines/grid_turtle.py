"""A world for the wall machine: a turtle on a grid of metres, which answers for its position."""

from llfsm.machines.common import CMD_VEL
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtle_sensor_poster import (
    ANSWER,
    REQUEST,
    TurtlePositionAnswer,
    TurtlePositionRequest,
)

__all__ = ["FIELD", "GRIP", "GRIPS", "GridTurtle", "Grip"]

FIELD = 11  # metres, as turtlesim's
AHEAD = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))


class Grip(Message):
    """The ground: if firm, the turtle turns by a quarter in half a second, or else by an eighth."""

    firm: bool = True


GRIP = Slot("grid_turtle/grip", Grip)
GRIPS = (Grip(False), Grip(True))
"""The domains: all messages that the sensors can read."""


class GridTurtle(Machine):
    """Move as half a second of a command moves the turtle, and answer requests at once.

    Two metres a second are one metre a turn. Two radians a second are one radian a turn, which lies
    between an eighth and a quarter of a circle: which of them it is, is left to `GRIP`. Requests
    are numbered from 1 again once the turtle drives, so that there are finitely many states.
    """

    command = Sensor(CMD_VEL, default=Twist())
    request = Sensor(REQUEST, default=TurtlePositionRequest())
    grip = Sensor(GRIP, default=Grip(), domain=GRIPS)
    answer = Actuator(ANSWER)
    forget = Actuator(REQUEST)
    x: int = 2  # metres
    y: int = 7
    heading: int = 0  # eighths of a circle from the x axis, to the left

    MOVING = State()

    @MOVING.on_exit
    def _(self) -> None:
        linear, angular = self.command.linear.x, self.command.angular.z
        if angular:
            eighths = 2 if self.grip.firm else 1
            self.heading = (self.heading + (eighths if angular > 0 else -eighths)) % 8
        if linear:
            way = 1 if linear > 0 else -1
            ahead = AHEAD[self.heading]
            self.x = min(max(self.x + way * ahead[0], 0), FIELD)
            self.y = min(max(self.y + way * ahead[1], 0), FIELD)
        if linear or angular:
            self.forget(TurtlePositionRequest())
            self.answer(TurtlePositionAnswer())
        elif self.request.number:
            self.answer(TurtlePositionAnswer(self.request.number, float(self.x), float(self.y)))

    MOVING.to(MOVING)  # every turn, so that the world does not end
