"""The simulator on a whiteboard: commands in, poses and colours out, positions on request."""

from __future__ import annotations

import logging
from typing import Any, NamedTuple, TypeVar

from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.errors import one_line
from llfsm.whiteboard import Board, BoundSlot, Message, MessageUnreadableError, Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER, REQUEST, TurtlePositionAnswer
from llfsm.whiteboard.messages.turtlesim import Color, Pose

M = TypeVar("M", bound=Message)
_logger = logging.getLogger("turtlesim")
_REPORTED = "turtle1"  # the turtle whose position the service returns, as in the original system


class _TurtleSlots(NamedTuple):
    command: BoundSlot[Twist]
    pose: BoundSlot[Pose]
    color: BoundSlot[Color]


class TurtlesimNode:
    """Connect a simulator to a board.

    For each turtle ``t`` it pulls ``t/cmd_vel`` (geometry_msgs Twist) and posts ``t/pose`` and
    ``t/color_sensor`` at every step. A command that was there before the turtle is ignored, and so
    is what cannot be read; the first of it in a slot is logged.
    """

    def __init__(self, simulator: Simulator, board: Board) -> None:
        self.simulator = simulator
        self._board = board
        self._slots: dict[str, _TurtleSlots] = {}
        self._obeyed: dict[str, int] = {}
        self._requests = board[REQUEST]
        self._answers = board[ANSWER]
        self._answered = self._requests.count
        self._unreadable: set[BoundSlot[Any]] = set()  # slots of which it was logged

    def step(self) -> None:
        """Pull commands, advance by 16 ms of simulated time, post poses and colors."""
        for name in self.simulator.turtles:
            command = self._slots_of(name).command
            count = command.count
            if count != self._obeyed[name]:
                self._obeyed[name] = count
                if (twist := self._read(command)) is not None:
                    linear = twist.linear
                    self.simulator.command(name, linear.x, linear.y, twist.angular.z)
        self.simulator.step()
        for name, turtle in self.simulator.turtles.items():
            slots = self._slots_of(name)
            slots.pose.add(Pose(*turtle.pose))
            slots.color.add(Color(*turtle.color))
        self._answer()

    def _read(self, slot: BoundSlot[M]) -> M | None:
        """Return the latest message; None if what another program wrote is none."""
        try:
            return slot.get()
        except MessageUnreadableError as error:
            if slot not in self._unreadable:
                self._unreadable.add(slot)
                _logger.warning("%s", one_line(error))
            return None

    def _slots_of(self, name: str) -> _TurtleSlots:
        slots = self._slots.get(name)
        if slots is None:
            board = self._board
            slots = self._slots[name] = _TurtleSlots(
                board[Slot(f"{name}/cmd_vel", Twist)],
                board[Slot(f"{name}/pose", Pose)],
                board[Slot(f"{name}/color_sensor", Color)],
            )
            self._obeyed[name] = slots.command.count
        return slots

    def _answer(self) -> None:
        count = self._requests.count
        if count == self._answered:
            return
        self._answered = count
        request = self._read(self._requests)
        if request is None:
            return
        turtle = self.simulator.turtles.get(_REPORTED)
        if turtle is None:
            answer = TurtlePositionAnswer(request.number, failure=f"there is no {_REPORTED}")
        else:
            x, y, theta, *_ = turtle.pose
            answer = TurtlePositionAnswer(request.number, x, y, theta)
        self._answers.add(answer)
