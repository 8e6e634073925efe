"""`NavigateTo` through the bridge, where Navigation2's definitions are not installed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from llfsm.bridges.ros2.actions import ActionServer, ServerGoal
from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.threads import CallQueue
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.machines import NavigateTo
from llfsm.runtime import Arrangement, ExecutionError, ManualClock, Reason
from llfsm.runtime.goals import GoalStatus
from llfsm.whiteboard import Whiteboard
from waiting import wait_for

TYPE = "nav2_msgs/action/NavigateToPose"
CONFIG = {"action": [{"action": "navigate_to_pose", "type": TYPE}]}

pytestmark = pytest.mark.parametrize("world", ["memory", "zenoh"], indirect=True)


class Robot:
    """A navigator, a bridge, and the machine by a clock of the test's."""

    def __init__(self, board: Whiteboard, world: Any) -> None:
        plan, faults = make_plan(msgspec.convert(CONFIG, BridgeConfig), Path(), board.slots())
        assert not faults
        types = TypeLibrary()
        self.queue, self.goals = CallQueue(), list[ServerGoal]()
        self.of = types.action(TYPE)
        self.server = ActionServer(
            world.open().node("bt_navigator"),
            "navigate_to_pose",
            self.of,
            types,
            begin=lambda goal: self.goals.append(goal) is None,
            cancel=lambda _: True,
            put=self.queue.put,
        )
        self.bridge = Bridge(plan, board, world.open(), lambda _: None)
        (client,) = filter(None, (link.client for link in self.bridge.links))
        wait_for(lambda: client.ready)
        self.clock = ManualClock()
        self.arrangement = Arrangement([NavigateTo(x=3.0)], whiteboard=board, clock=self.clock)

    def until(self, ready: Any) -> None:
        def go_on() -> None:
            self.queue.run_pending()
            self.clock.advance(ms=100)
            if not self.arrangement.finished:
                self.arrangement.round()

        wait_for(ready, between=go_on)

    def end(self, status: GoalStatus, **result: Any) -> None:
        self.until(lambda: self.goals)
        self.goals[0].end(status, self.of.result.message(**result))


@pytest.fixture
def robot(board: Whiteboard, world: Any) -> Iterator[Robot]:
    robot = Robot(board, world)
    yield robot
    robot.bridge.close()


def test_it_is_done_when_the_robot_is_there(robot: Robot) -> None:
    robot.end(GoalStatus.SUCCEEDED)
    robot.until(lambda: robot.arrangement.finished)
    assert robot.goals[0].message.pose.pose.position.x == 3.0


def test_it_fails_with_the_reason_of_the_navigator(robot: Robot) -> None:
    robot.end(GoalStatus.ABORTED, error_code=9002, error_msg="no transform")
    with pytest.raises(ExecutionError, match=r"was aborted: no transform \(error 9002\)"):
        robot.until(lambda: robot.arrangement.finished)


def test_its_end_cancels_the_goal(robot: Robot) -> None:
    robot.until(lambda: robot.goals and robot.goals[0].status.active)
    robot.arrangement.end(Reason.STOPPED)
    wait_for(lambda: robot.goals[0].status is GoalStatus.CANCELING, between=robot.queue.run_pending)
