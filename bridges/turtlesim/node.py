"""The simulator on a whiteboard: commands in, poses and colours out, positions on request."""

from __future__ import annotations

from typing import NamedTuple

from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.whiteboard import Board, BoundSlot, Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER, REQUEST, TurtlePositionAnswer
from llfsm.whiteboard.messages.turtlesim import Color, Pose

_REPORTED = "turtle1"  # the turtle whose position the service returns, as in the original system


class _TurtleSlots(NamedTuple):
    command: BoundSlot[Twist]
    pose: BoundSlot[Pose]
    color: BoundSlot[Color]


class TurtlesimNode:
    """Connect a simulator to a board.

    For each turtle ``t`` it pulls ``t/cmd_vel`` (geometry_msgs Twist) and posts ``t/pose`` and
    ``t/color_sensor`` at every step. A command that was there before the turtle is ignored.
    """

    def __init__(self, simulator: Simulator, board: Board) -> None:
        self.simulator = simulator
        self._board = board
        self._slots: dict[str, _TurtleSlots] = {}
        self._obeyed: dict[str, int] = {}
        self._requests = board[REQUEST]
        self._answers = board[ANSWER]
        self._answered = self._requests.count

    def step(self) -> None:
        """Pull commands, advance by 16 ms of simulated time, post poses and colors."""
        for name in self.simulator.turtles:
            command = self._slots_of(name).command
            count = command.count
            if count != self._obeyed[name]:
                self._obeyed[name] = count
                twist = command.get()
                assert twist is not None, "a slot with a count has a message"
                linear = twist.linear
                self.simulator.command(name, linear.x, linear.y, twist.angular.z)
        self.simulator.step()
        for name, turtle in self.simulator.turtles.items():
            slots = self._slots_of(name)
            slots.pose.add(Pose(*turtle.pose))
            slots.color.add(Color(*turtle.color))
        self._answer()

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
        request = self._requests.get()
        assert request is not None, "a slot with a count has a message"
        turtle = self.simulator.turtles.get(_REPORTED)
        if turtle is None:
            answer = TurtlePositionAnswer(request.number, failure=f"there is no {_REPORTED}")
        else:
            x, y, theta, *_ = turtle.pose
            answer = TurtlePositionAnswer(request.number, x, y, theta)
        self._answers.add(answer)
