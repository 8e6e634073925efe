"""The patrol with Navigation2, on every transport: drives, backs away, leaves out, cancels."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from llfsm.bridges.ros2.actions import ActionServer, ServerGoal
from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.threads import CallQueue
from llfsm.runtime import Arrangement, ManualClock
from llfsm.runtime.engine.events import Reason
from llfsm.runtime.goals import GoalStatus
from llfsm.runtime.plans import read_toml
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist
from waiting import wait_for

FOLDER = Path(__file__).parents[4] / "examples" / "nav2_patrol"

pytestmark = pytest.mark.usefixtures("nav2_msgs")


@pytest.fixture
def patrol(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Import the example; forget it in the end."""
    monkeypatch.syspath_prepend(FOLDER)
    yield import_module("patrol")
    del sys.modules["patrol"]


class Robot:
    """Navigation2's part, the bridge of the example, and the machine by a clock of the test's."""

    def __init__(self, patrol: Any, board: Whiteboard, world: Any) -> None:
        config = read_toml(FOLDER / "bridge.toml", BridgeConfig)
        plan, faults = make_plan(config, FOLDER, [])
        assert not faults
        self.queue, self.goals = CallQueue(), list[ServerGoal]()
        self.of = patrol.NAVIGATE.of
        ActionServer(
            world.open().node("bt_navigator"),
            "navigate_to_pose",
            self.of,
            patrol.TYPES,
            begin=lambda goal: self.goals.append(goal) is None,
            cancel=lambda _: True,
            put=self.queue.put,
        )
        self.bridge = Bridge(plan, board, world.open(), lambda _: None)
        (client,) = filter(None, (link.client for link in self.bridge.links))
        wait_for(lambda: client.ready)
        self.clock = ManualClock()
        self.arrangement = Arrangement([patrol.Patrol], whiteboard=board, clock=self.clock)

    def until(self, ready: Any) -> None:
        def go_on() -> None:
            self.queue.run_pending()
            self.clock.advance(ms=100)
            self.arrangement.round()

        wait_for(ready, between=go_on)

    def ends(self, status: GoalStatus) -> tuple[float, float]:
        """Wait for the next goal and end it; return where it was."""
        number = len(self.goals) + 1
        self.until(lambda: len(self.goals) == number)
        goal = self.goals[-1]
        self.until(lambda: self.arrangement.state_name_of("Patrol") == "driving")
        goal.end(status, self.of.result.message())
        return goal.message.pose.pose.position.x, goal.message.pose.pose.position.y


@pytest.fixture
def robot(patrol: Any, board: Whiteboard, world: Any) -> Iterator[Robot]:
    robot = Robot(patrol, board, world)
    yield robot
    robot.bridge.close()


def test_it_drives_to_each_waypoint_and_round_again(robot: Robot, patrol: Any) -> None:
    places = [robot.ends(GoalStatus.SUCCEEDED) for _ in range(5)]
    assert places == [(x, y) for x, y, _ in (*patrol.WAYPOINTS, patrol.WAYPOINTS[0])]


@pytest.mark.parametrize("world", ["memory"], indirect=True)
def test_a_waypoint_out_of_reach_is_tried_three_times_then_left_out(
    robot: Robot, patrol: Any
) -> None:
    drive = robot.arrangement.whiteboard[Slot("cmd_vel", Twist)]  # type: ignore[index]
    places = [robot.ends(GoalStatus.ABORTED) for _ in range(3)]
    assert places == [patrol.WAYPOINTS[0][:2]] * 3
    assert robot.ends(GoalStatus.SUCCEEDED) == patrol.WAYPOINTS[1][:2]
    assert drive.count == 4  # it has backed away twice, and stopped
    assert drive.get() == Twist()


def test_its_end_cancels_the_goal(robot: Robot) -> None:
    robot.until(lambda: robot.goals and robot.goals[0].status.active)
    robot.arrangement.end(Reason.STOPPED)
    wait_for(lambda: robot.goals[0].status is GoalStatus.CANCELING, between=robot.queue.run_pending)
