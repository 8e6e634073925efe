"""All turtles of a field, and every request that turtlesim answers.

The simulator does nothing by itself: `step` advances it by 16 ms, and a request takes effect where
turtlesim's would, some at once and some at the next step. The same requests at the same steps give
the same poses, bit for bit. Numbers that are float32 in turtlesim's services are rounded to it
here, so that callers need not. Where turtlesim would crash (an illegal name) or lose a turtle for
good (a number that is not finite) the request is refused and an ERROR logged.
"""

import re
from collections.abc import Callable, Mapping
from math import isfinite
from types import MappingProxyType

from llfsm.bridges.turtlesim.canvas import Canvas, Pen
from llfsm.bridges.turtlesim.errors import TurtlesimError
from llfsm.bridges.turtlesim.parameters import Parameters
from llfsm.bridges.turtlesim.turtle import FIELD, Level, Log, RotateGoal, Turtle, float32
from llfsm.runtime.engine.clock import Clock, MonotonicClock

STEP_NS = 16_000_000
"""Nanoseconds of a step: 62.5 steps a second."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_LONGEST_NAME = 247 - len("/" + "/rotate_absolute/_action/cancel_goal")  # 247: rmw's longest topic


def run(step: Callable[[], None], is_over: Callable[[], bool], clock: Clock | None = None) -> None:
    """Step every 16 ms until `is_over`. A late step is not made up for, as in turtlesim."""
    clock = clock or MonotonicClock()
    due = clock.now_ns()
    while not is_over():
        step()
        due = max(due + STEP_NS, clock.now_ns())
        clock.sleep_until_ns(due)


class Simulator:
    """The field, as turtlesim starts with it: turtle1 in the centre, heading right.

    log: called with the level and text of each line that turtlesim logs.
    parameters: the background's colour and `holonomic`; None: as turtlesim starts.
    canvas: all that the pens have drawn.
    """

    def __init__(self, log: Log = lambda *_: None, parameters: Parameters | None = None) -> None:
        self.parameters = parameters or Parameters()
        self.canvas = Canvas()
        self._log = log
        self._turtles: dict[str, Turtle] = {}
        self._spawned_unnamed = 0
        self._spawn_first()

    @property
    def turtles(self) -> Mapping[str, Turtle]:
        """The turtles there are now by name, in the order in which they step."""
        return MappingProxyType(self._turtles)

    def turtle(self, name: str) -> Turtle:
        """Return a turtle; raise `TurtlesimError`, which lists those that exist."""
        try:
            return self._turtles[name]
        except KeyError:
            others = ", ".join(self._turtles) or "none"
            raise TurtlesimError(f"no turtle is named {name!r}; there are: {others}") from None

    def step(self) -> None:
        """Advance all turtles by 16 ms of simulated time, in the order of their names."""
        for turtle in self._turtles.values():
            turtle.step()

    def spawn(self, x: float, y: float, theta: float, name: str = "") -> str:
        """Make a turtle at (x, y) in m, heading theta in rad, and return its name.

        Without a name it is the first free of turtle1, turtle2, ... not yet given since the last
        reset. Return "" and log why if the name is taken or no legal topic name, or if a number
        is not finite.
        """
        x, y, theta = float32(x), float32(y), float32(theta)
        if not self._finite("spawn a turtle", x, y, theta):
            return ""
        if not name:
            name = self._next_name()
        elif name in self._turtles:
            self._log(Level.ERROR, f"A turtle named [{name}] already exists")
            return ""
        elif fault := _name_fault(name):
            self._log(Level.ERROR, f"Cannot spawn a turtle named {name!r}: {fault}")
            return ""
        turtle = Turtle(name, x, y, theta, self.canvas, self.parameters, self._log)
        # turtlesim keeps its turtles in a std::map: they step by name.
        self._turtles = dict(sorted({**self._turtles, name: turtle}.items()))
        self._log(
            Level.INFO, f"Spawning turtle [{name}] at x=[{x:f}], y=[{y:f}], theta=[{theta:f}]"
        )
        return name

    def kill(self, name: str) -> None:
        """Remove a turtle; what it drew stays. Log an error if there is none of that name."""
        turtle = self._turtles.get(name)
        if turtle is None:
            self._log(Level.ERROR, f"Tried to kill turtle [{name}], which does not exist")
            return
        self._turtles = {other: t for other, t in self._turtles.items() if other != name}
        turtle.kill()

    def clear(self) -> None:
        """Remove everything that was drawn."""
        self._log(Level.INFO, "Clearing turtlesim.")
        self.canvas.clear()

    def reset(self) -> None:
        """Kill every turtle, make turtle1 anew and remove everything that was drawn.

        The parameters stay as they are.
        """
        self._log(Level.INFO, "Resetting turtlesim.")
        for turtle in self._turtles.values():
            turtle.kill()
        self._turtles = {}
        self._spawned_unnamed = 0
        self._spawn_first()
        self.canvas.clear()

    def command(self, name: str, linear_x: float, linear_y: float, angular_z: float) -> None:
        """Move a turtle at these speeds (m/s, m/s, rad/s) for 1 s: 63 steps, or until the next.

        `linear_y` counts only while the parameter `holonomic` is set. A rotation goal is aborted.
        """
        turtle = self.turtle(name)
        if self._finite(f"move turtle [{name}]", linear_x, linear_y, angular_z):
            turtle.command(linear_x, linear_y, angular_z)

    def set_pen(self, name: str, r: int, g: int, b: int, width: int, off: bool = False) -> None:
        """Give a turtle a pen, at once; `off` only lifts the one it has.

        Each number is from 0 to 255, else TurtlesimError; width is in pixels and 0 the same as 1.
        """
        turtle = self.turtle(name)
        pen = Pen.of(r, g, b, width)
        turtle.pen_down = not off
        if not off:
            turtle.pen = pen

    def teleport_absolute(self, name: str, x: float, y: float, theta: float) -> None:
        """Put a turtle at (x, y) in m, heading theta in rad, at the next step."""
        turtle = self.turtle(name)
        x, y, theta = float32(x), float32(y), float32(theta)
        if self._finite(f"teleport turtle [{name}]", x, y, theta):
            turtle.teleport_absolute(x, y, theta)

    def teleport_relative(self, name: str, linear: float, angular: float) -> None:
        """Turn a turtle by `angular` rad and then move it ahead by `linear` m, at the next step."""
        turtle = self.turtle(name)
        linear, angular = float32(linear), float32(angular)
        if self._finite(f"teleport turtle [{name}]", linear, angular):
            turtle.teleport_relative(linear, angular)

    def rotate_absolute(self, name: str, theta: float) -> RotateGoal | None:
        """Accept a goal to turn a turtle to the heading theta in rad; None if it is refused."""
        turtle = self.turtle(name)
        theta = float32(theta)
        finite = self._finite(f"rotate turtle [{name}]", theta)
        return turtle.rotate_absolute(theta) if finite else None

    def _spawn_first(self) -> None:
        self.spawn(FIELD / 2, FIELD / 2, 0.0)

    def _next_name(self) -> str:
        while True:
            self._spawned_unnamed += 1
            name = f"turtle{self._spawned_unnamed}"
            if name not in self._turtles:
                return name

    def _finite(self, act: str, *numbers: float) -> bool:
        if all(map(isfinite, numbers)):
            return True
        self._log(Level.ERROR, f"Cannot {act}: not all finite: {', '.join(map(str, numbers))}")
        return False


def _name_fault(name: str) -> str:
    """Name the fault of a name that is no valid prefix of a turtle's topics; "" without one."""
    if len(name) > _LONGEST_NAME:
        return f"it has more than {_LONGEST_NAME} characters"
    if not _NAME.fullmatch(name):
        return (
            "a name is made of letters, digits and '_', does not start with a digit, and may join "
            "several such parts by '/'"
        )
    return ""
