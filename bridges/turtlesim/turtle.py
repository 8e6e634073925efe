"""One turtle: what a step of 16 ms does to it.

The arithmetic follows turtlesim 1.8.2's turtle.cpp to the bit. The state is double precision with
y pointing *down*, as in Qt's image; poses are published with y up. What crosses a message or
service is float32, and so is the size of the field. The order of every operation is that of
turtle.cpp: double-precision addition is not associative, so regrouping a term changes poses.

A step applies, in this order: teleports, the rotation goal, the time-out, the motion, the walls.
Then it publishes pose and colour, and only then draws, so that a turtle does not sense the line it
is drawing.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from math import cos, floor, sin, sqrt
from typing import NamedTuple

from llfsm.bridges.turtlesim.canvas import Canvas, Pen, Rgb
from llfsm.bridges.turtlesim.parameters import Parameters
from llfsm.runtime.goals import GoalStatus

PI = 3.14159265
"""turtlesim's pi, short as it is: with math.pi headings drift from the recorded ones."""
_TWO_PI = 2.0 * PI

METER = 45.0
"""Pixels in a metre: the height of turtlesim's turtle images."""

DT = 0.016
"""Seconds of simulated time in a step."""


SPEED = 1.0
"""Rad/s at which a goal is turned to."""
NEAR = 0.02
"""Rad; closer than this the goal is reached."""
COMMAND_STEPS = 63
"""Steps that a command lasts: those that begin at most 1 s after it."""

_BARE = Rgb(255, 255, 255)
_SAME = 1e-12  # metres; Qt takes points about this close for equal, and no line is drawn


def float32(value: float) -> float:
    """Round to the nearest float32; beyond its range to an infinity, as C's conversion does."""
    return array("f", (value,))[0]


FIELD = float32(499 / METER)
"""Width and height of the field in metres: from the first to the last of its 500 pixels."""


def normalize(angle: float) -> float:
    """Wrap a finite angle into [-PI, PI), up to a rounding of the last digit."""
    return angle - _TWO_PI * floor((angle + PI) / _TWO_PI)


class RotateGoal:
    """A goal of the action rotate_absolute, followed to its end: turn on the spot to a heading.

    theta: the wanted heading in rad, float32; it may lie beyond pi.
    status: where the goal stands; SUCCEEDED, CANCELED and ABORTED are final.
    remaining: the latest feedback, rad still to turn, float32; new after each step that begins
        with the status EXECUTING, the one that succeeds included.
    delta: the result, start minus end in rad, float32, as of the latest feedback.
    """

    __slots__ = ("_start", "delta", "remaining", "status", "theta")

    def __init__(self, theta: float, start: float) -> None:
        self.theta = theta
        self.status = GoalStatus.EXECUTING
        self.remaining = 0.0
        self.delta = 0.0
        self._start = start

    @property
    def active(self) -> bool:
        """True until the goal has ended."""
        return self.status.active

    def cancel(self) -> bool:
        """Ask for the goal's end at the next step; return False if it has ended already."""
        if self.active:
            self.status = GoalStatus.CANCELING
            return True
        return False

    def advance(self, heading: float) -> float:
        """Go on by a step from a heading in rad; return the speed to turn at, 0 at the end."""
        if self.status is GoalStatus.CANCELING:
            self.status = GoalStatus.CANCELED
            return 0.0
        # turtlesim mixes precisions here: the heading as float32, the goal wrapped as double.
        goal = normalize(self.theta)
        remaining = normalize(goal - float32(heading))
        self.delta = float32(normalize(float32(self._start - heading)))
        self.remaining = float32(remaining)
        if abs(normalize(float32(heading) - goal)) < NEAR:
            self.status = GoalStatus.SUCCEEDED
            return 0.0
        return -SPEED if remaining < 0.0 else SPEED


class Level(IntEnum):
    """The severity of a log line, numbered as in rcl_interfaces/msg/Log and in `logging`."""

    INFO = 20
    WARN = 30
    ERROR = 40


Log = Callable[[Level, str], object]
"""It takes a log line, without a time stamp; `logging.getLogger("turtlesim").log` will do."""


class TurtlePose(NamedTuple):
    """turtlesim/msg/Pose: metres, rad, m/s without a sign, rad/s; each value a float32."""

    x: float
    y: float
    theta: float
    linear_velocity: float
    angular_velocity: float


class Turtle:
    """Move one turtle; `Simulator` makes it and takes the requests for it.

    pose: as published at the latest step; before the first, as it was spawned.
    color: likewise; where nothing is drawn it is white, as turtlesim's image is there (white and
        transparent: one sees the background, the sensor does not).
    pen, pen_down: what it draws with, and whether it draws.
    goal: the rotation goal it is following, or None.
    """

    def __init__(
        self,
        name: str,
        x: float,
        y: float,
        theta: float,
        canvas: Canvas,
        parameters: Parameters,
        log: Log,
    ) -> None:
        self.name = name
        self.pen = Pen()
        self.pen_down = True
        self.goal: RotateGoal | None = None
        self.pose = TurtlePose(x, y, theta, 0.0, 0.0)
        self.color: Rgb = _BARE
        self._x = x
        self._y = float32(FIELD - y)  # turtlesim subtracts in float32 here, and nowhere else
        self._theta = theta
        self._vx = self._vy = self._w = 0.0
        self._steps_left = 0
        self._teleports: list[Callable[[], None]] = []
        self._canvas = canvas
        self._parameters = parameters
        self._log = log

    def command(self, linear_x: float, linear_y: float, angular_z: float) -> None:
        """Move at these speeds (m/s, rad/s) for 1 s; a rotation goal is aborted."""
        self._vx = linear_x
        if self._parameters.holonomic:  # else it keeps the last one, as turtlesim does
            self._vy = linear_y
        self._w = angular_z
        self._steps_left = COMMAND_STEPS
        if self.goal is not None:
            self._log(Level.WARN, "Velocity command received during rotation goal. Aborting goal")
            self._drop_goal(GoalStatus.ABORTED)

    def let_command_last(self, *, lasts: bool) -> None:
        """Let the latest command count in the next step, or no more, however many steps it was."""
        self._steps_left = int(lasts)

    def rotate_absolute(self, theta: float) -> RotateGoal:
        """Turn to a heading (float32, rad); a goal that was being followed is aborted."""
        if self.goal is not None:
            self._log(
                Level.WARN,
                "Rotation goal received before a previous goal finished. Aborting previous goal",
            )
            self._drop_goal(GoalStatus.ABORTED)
        self.goal = RotateGoal(theta, self._theta)
        return self.goal

    def teleport_absolute(self, x: float, y: float, theta: float) -> None:
        """Be at (x, y, theta) (float32; m, rad) at the next step."""
        self._teleports.append(partial(self._place, x, y, theta))

    def teleport_relative(self, linear: float, angular: float) -> None:
        """Turn by `angular`, then go ahead by `linear` (float32; rad, m), at the next step."""
        self._teleports.append(partial(self._shift, linear, angular))

    def kill(self) -> None:
        """Leave the field; a goal it was following ends cancelled."""
        self._drop_goal(GoalStatus.CANCELED)

    def step(self) -> None:
        """Advance by 16 ms of simulated time."""
        for teleport in self._teleports:
            x0, y0 = self._x, self._y
            teleport()
            self._draw(x0, y0)
        self._teleports.clear()
        if self.goal is not None:
            self._follow(self.goal)
        if self._steps_left:
            self._steps_left -= 1
        else:
            self._vx = self._vy = self._w = 0.0
        self._move()

    def _move(self) -> None:
        vx, vy, w = self._vx, self._vy, self._w
        x0, y0 = self._x, self._y
        theta = self._theta = normalize(self._theta + w * DT)
        c, s = cos(theta), sin(theta)
        x = x0 + (c * vx * DT - s * vy * DT)
        y = y0 - (c * vy * DT + s * vx * DT)
        if not (0.0 <= x <= FIELD and 0.0 <= y <= FIELD):
            self._log(Level.WARN, f"Oh no! I hit the wall! (Clamping from [x={x:f}, y={y:f}])")
            x = min(max(x, 0.0), FIELD)
            y = min(max(y, 0.0), FIELD)
        self._x, self._y = x, y

        speed = sqrt(vx * vx + vy * vy)
        self.pose = TurtlePose._make(array("f", (x, FIELD - y, theta, speed, w)))
        self.color = self._canvas.color_at(x * METER, y * METER) or _BARE
        if abs(x - x0) > _SAME or abs(y - y0) > _SAME:
            self._draw(x0, y0)

    def _draw(self, x0: float, y0: float) -> None:
        if self.pen_down:
            self._canvas.draw(
                self.name, self.pen, x0 * METER, y0 * METER, self._x * METER, self._y * METER
            )

    def _place(self, x: float, y: float, theta: float) -> None:
        self._x = x
        self._y = max(0.0, FIELD - y)
        self._theta = theta

    def _shift(self, linear: float, angular: float) -> None:
        self._theta += angular
        self._x += cos(self._theta) * linear
        self._y -= sin(self._theta) * linear

    def _follow(self, goal: RotateGoal) -> None:
        self._vx = self._vy = 0.0
        self._w = goal.advance(self._theta)
        self._steps_left = COMMAND_STEPS
        if goal.status is GoalStatus.SUCCEEDED:
            self._log(Level.INFO, "Rotation goal completed successfully")
            self.goal = None
        elif goal.status is GoalStatus.CANCELED:
            self._log(Level.INFO, "Rotation goal canceled")
            self.goal = None

    def _drop_goal(self, status: GoalStatus) -> None:
        if self.goal is not None:
            self.goal.status = status
            self.goal = None
