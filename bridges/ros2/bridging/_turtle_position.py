"""The service ``turtle_position``, in ROS and in slots: the place of a turtle.

turtlesim has no such service. Before the first pose a call in ROS gets no response, and a request
on the board gets the reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from llfsm.bridges.ros2.bridging._slot_service import unanswered
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.transport import ServiceRequest
from llfsm.bridges.ros2.types import RosService
from llfsm.whiteboard import Board, BoundSlot, Sample, Slot
from llfsm.whiteboard.messages.turtle_sensor_poster import (
    ANSWER,
    REQUEST,
    TurtlePositionAnswer,
    TurtlePositionRequest,
)
from llfsm.whiteboard.messages.turtlesim import Pose

NODE = "turtle_sensor_poster"
SERVICE = "turtle_position"
TYPE = "turtle_sensor_poster/srv/TurtlePosition"


@dataclass(eq=False)
class PositionServer:
    """Answers from the latest pose in a slot; :meth:`asked` is the handler of the ROS service.

    A pose from before the bridge started does not count: its writer may have ended long ago.
    """

    board: Board
    slot: Slot[Pose]
    of: RosService
    in_ros: BridgeLink
    in_slots: BridgeLink

    def __post_init__(self) -> None:
        self._pose = self.board[self.slot]
        self._before = self._pose.count
        self._answers: BoundSlot[TurtlePositionAnswer] = self.board[ANSWER]
        requests: BoundSlot[TurtlePositionRequest] = self.board[REQUEST]
        after = requests.count
        if unanswered(requests, self._answers) is not None:
            after -= 1  # requested before the bridge started, and to be answered now
        self._subscription = requests.subscribe(
            self._asked_in_slot, after=after, on_error=self.in_slots.count_fault
        )

    def asked(self, request: ServiceRequest[Any, Any]) -> None:
        """Answer a request from ROS, or fail it."""
        pose = self._latest()
        if isinstance(pose, str):
            self.in_ros.failed += 1
            request.fail(pose)
        else:
            request.answer(self.of.response.message(pose.x, pose.y, pose.theta))
            self.in_ros.count()

    def finish(self) -> None:
        """Stop after the request that is on the slot by now."""
        self._subscription.finish()

    def close(self) -> None:
        """Wait for that."""
        self._subscription.close()

    def _latest(self) -> Pose | str:
        sample = self._pose.sample()
        if sample is None or sample.count <= self._before:
            return f"no pose in slot {self.slot.name} since the bridge started"
        return sample.message

    def _asked_in_slot(self, sample: Sample[TurtlePositionRequest]) -> None:
        number = sample.message.number
        pose = self._latest()
        if isinstance(pose, str):
            self.in_slots.failed += 1
            self._answers.add(TurtlePositionAnswer(number, failure=pose))
        else:
            self._answers.add(TurtlePositionAnswer(number, pose.x, pose.y, pose.theta))
            self.in_slots.count()
