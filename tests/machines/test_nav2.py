"""Machines that send goals to Nav2 and to controllers: what they send, how they end, who cancels.

The slots are compared with those that a bridge makes of the actions' types.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.ros2.bridging import action_slots, service_slots
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.machines import arms, lifecycle, nav2
from llfsm.machines.calls import ActionSlots, GoalCaller
from llfsm.runtime import Arrangement, ExecutionError, Machine, ManualClock, State
from llfsm.runtime.checking import check_class
from llfsm.runtime.goals import CancelGoal, GoalStanding, GoalStatus
from llfsm.whiteboard import Slot
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.message import describe
from llfsm.whiteboard.messages.geometry_msgs import Point

ACTIONS: dict[str, tuple[ActionSlots, type[GoalCaller]]] = {
    "nav2_msgs/action/NavigateToPose": (nav2.NAVIGATE_TO_POSE, nav2.NavigateTo),
    "nav2_msgs/action/FollowWaypoints": (nav2.FOLLOW_WAYPOINTS, nav2.FollowWaypoints),
    "nav2_msgs/action/BackUp": (nav2.BACK_UP, nav2.BackUp),
    "nav2_msgs/action/DriveOnHeading": (nav2.DRIVE_ON_HEADING, nav2.DriveOnHeading),
    "nav2_msgs/action/Spin": (nav2.SPIN, nav2.Spin),
    "nav2_msgs/action/AssistedTeleop": (nav2.ASSISTED_TELEOP, nav2.AssistedTeleop),
    "nav2_msgs/action/DockRobot": (nav2.DOCK_ROBOT, nav2.Dock),
    "nav2_msgs/action/UndockRobot": (nav2.UNDOCK_ROBOT, nav2.Undock),
    "control_msgs/action/FollowJointTrajectory": (
        arms.FOLLOW_JOINT_TRAJECTORY,
        arms.FollowJointTrajectory,
    ),
    "control_msgs/action/GripperCommand": (arms.GRIPPER_COMMAND, arms.MoveGripper),
}
SERVICES: dict[str, Any] = {
    "nav2_msgs/srv/ClearEntireCostmap": nav2.CLEAR_GLOBAL_COSTMAP,
    "lifecycle_msgs/srv/ChangeState": lifecycle.change_state_slots("talker"),
}
CALLERS = [caller for _, caller in ACTIONS.values()]


@pytest.mark.parametrize("name", ACTIONS)
def test_the_slots_are_those_of_a_bridge(name: str) -> None:
    slots, _ = ACTIONS[name]
    prefix = slots.goal.name.removesuffix("/goal")
    made = action_slots(prefix, TypeLibrary().action(name))
    assert [slot.name for slot in slots] == [slot.name for slot in made[:5]]
    for ours, theirs in zip(slots, made[:5], strict=True):
        assert describe(ours.type) == describe(theirs.type), ours.name


@pytest.mark.parametrize("name", SERVICES)
def test_the_slots_of_a_service_are_those_of_a_bridge(name: str) -> None:
    slots = SERVICES[name]
    prefix = slots.request.name.removesuffix("/request")
    made = service_slots(prefix, TypeLibrary().service(name))
    for ours, theirs in zip(slots, made[:2], strict=True):
        assert ours.name == theirs.name
        assert describe(ours.type) == describe(theirs.type), ours.name


class Mission:
    """A machine whose state runs another one, in simulated time, a turn every 100 ms."""

    def __init__(self, run: Any) -> None:
        class Runs(Machine):
            CALL = State(runs=run)
            THERE = State(final=False)
            FAILED = State(final=False)
            AWAY = State(final=False)
            CALL.to(AWAY, when=lambda self: self.stopping)
            CALL.to(THERE, when_done=True)
            CALL.to(FAILED, when_failed=True)

        self.clock = ManualClock()
        self.board = LocalBoard(now_ns=self.clock.now_ns)
        self.arrangement = Arrangement([Runs], whiteboard=self.board, clock=self.clock)

    def go_on(self, ms: float = 300) -> str:
        for _ in range(round(ms / 100)):
            self.arrangement.round()
            self.clock.advance(ms=100)
        return self.arrangement.states().get("Runs", "")

    def get(self, slot: Slot[Any]) -> Any:
        return self.board.get_message(slot)

    def stand(self, slots: ActionSlots, status: GoalStatus, failure: str = "") -> None:
        number = self.get(slots.goal).number
        self.board.add_message(slots.status, GoalStanding(number, status, failure))


@pytest.mark.parametrize("name", ACTIONS)
def test_a_goal_that_succeeds_is_done(name: str) -> None:
    slots, caller = ACTIONS[name]
    mission = Mission(caller)
    mission.go_on()
    assert mission.get(slots.goal).number == 1
    mission.stand(slots, GoalStatus.EXECUTING)
    assert mission.go_on(5000) == "CALL"
    mission.stand(slots, GoalStatus.SUCCEEDED)
    assert mission.go_on() == "THERE"


@pytest.mark.parametrize("name", ACTIONS)
@pytest.mark.parametrize("status", [GoalStatus.REFUSED, GoalStatus.CANCELED, GoalStatus.ABORTED])
def test_a_goal_that_does_not_succeed_fails(name: str, status: GoalStatus) -> None:
    slots, caller = ACTIONS[name]
    mission = Mission(caller)
    mission.go_on()
    mission.stand(slots, status)
    assert mission.go_on() == "FAILED"


@pytest.mark.parametrize("name", ACTIONS)
def test_one_that_nobody_answers_fails_and_its_goal_is_canceled(name: str) -> None:
    slots, caller = ACTIONS[name]
    mission = Mission(lambda _: caller(timeout_s=2.0))
    assert mission.go_on(1900) == "CALL"
    assert mission.get(slots.cancel) is None
    assert mission.go_on(600) == "FAILED"
    assert mission.get(slots.cancel) == CancelGoal()


REQUESTS = st.lists(
    st.sampled_from(["suspend", "resume", "restart", "stop", "unload", "round"]), min_size=1
)


@given(caller=st.sampled_from(sorted(ACTIONS)), requests=REQUESTS)
def test_no_goal_goes_on_that_nobody_waits_for(caller: str, requests: Sequence[str]) -> None:
    """Whatever is requested in whichever turn: a machine that does not call has canceled."""
    slots, machine = ACTIONS[caller]
    mission = Mission(machine)
    canceled_at = 0  # the number of the latest goal that had been posted at a cancellation
    canceled = 0
    for request in requests:
        if request != "round" and "Runs" in mission.arrangement.states():
            if request == "stop":
                mission.arrangement.stop_machine("Runs")
            else:
                getattr(mission.arrangement, request)("Runs")
        mission.go_on(200)
        goal = mission.get(slots.goal)
        if mission.board[slots.cancel].count > canceled:
            canceled = mission.board[slots.cancel].count
            canceled_at = goal.number if goal else 0
        states = mission.arrangement.states()
        waits = any(state == "CALLING" for state in states.values())
        if goal is not None and not waits:
            assert canceled_at == goal.number, states


def failure_of(machine: Machine, slots: ActionSlots, result: Any, status: GoalStatus) -> str:
    board = LocalBoard()
    call = Arrangement([machine], whiteboard=board, clock=ManualClock())
    call.round()
    board.add_message(slots.result, result)
    board.add_message(slots.status, GoalStanding(1, status))
    with pytest.raises(ExecutionError) as raised:
        call.run(max_rounds=3)
    return str(raised.value)


def test_the_failure_has_the_reason_of_the_server() -> None:
    aborted = GoalStatus.ABORTED
    result = nav2.NAVIGATE_TO_POSE.result.type
    found = failure_of(
        nav2.NavigateTo(), nav2.NAVIGATE_TO_POSE, result(1, 9002, "no transform"), aborted
    )
    assert "navigate_to_pose/goal: the goal was aborted: no transform (error 9002)" in found
    found = failure_of(nav2.NavigateTo(), nav2.NAVIGATE_TO_POSE, result(1, 7), aborted)
    assert "the goal was aborted: error 7" in found
    found = failure_of(nav2.NavigateTo(), nav2.NAVIGATE_TO_POSE, result(1), GoalStatus.CANCELED)
    assert "the goal was canceled (" in found
    old = failure_of(nav2.NavigateTo(), nav2.NAVIGATE_TO_POSE, result(0, 7, "old"), aborted)
    assert "old" not in old
    slots = arms.FOLLOW_JOINT_TRAJECTORY
    found = failure_of(
        arms.FollowJointTrajectory(), slots, slots.result.type(1, -4, "joint 2"), aborted
    )
    assert "aborted: joint 2 (error -4)" in found
    slots = arms.GRIPPER_COMMAND
    found = failure_of(arms.MoveGripper(), slots, slots.result.type(1, 0.02, 5, True), aborted)
    assert "aborted: the fingers are at 0.02 m (stalled)" in found


def goal_of(machine: Machine, slots: ActionSlots) -> Any:
    board = LocalBoard()
    Arrangement([machine], whiteboard=board, clock=ManualClock()).round()
    return board.get_message(slots.goal)


def test_what_is_sent_is_what_the_parameters_say() -> None:
    goal = goal_of(nav2.NavigateTo(x=2.0, y=1.0, yaw=pi, frame_id="odom"), nav2.NAVIGATE_TO_POSE)
    assert (goal.pose.header.frame_id, goal.pose.pose.position) == ("odom", Point(2.0, 1.0))
    assert (round(goal.pose.pose.orientation.z, 9), goal.behavior_tree) == (1.0, "")
    goal = goal_of(
        nav2.FollowWaypoints(waypoints=((1.0, 2.0, 0.0), (3.0, 4.0, 1.0)), number_of_loops=2),
        nav2.FOLLOW_WAYPOINTS,
    )
    assert [each.pose.position for each in goal.poses] == [Point(1.0, 2.0), Point(3.0, 4.0)]
    assert goal.number_of_loops == 2
    goal = goal_of(nav2.BackUp(distance=0.3, time_allowance=2.5), nav2.BACK_UP)
    assert (goal.target, goal.speed) == (Point(0.3), 0.05)
    assert goal.time_allowance == nav2.duration(2.5)
    assert (goal.time_allowance.sec, goal.time_allowance.nanosec) == (2, 500_000_000)
    by_name = goal_of(nav2.Dock(dock_id="home"), nav2.DOCK_ROBOT)
    by_pose = goal_of(nav2.Dock(x=1.0, dock_type="charger"), nav2.DOCK_ROBOT)
    assert (by_name.use_dock_id, by_name.dock_id) == (True, "home")
    assert (by_pose.use_dock_id, by_pose.dock_pose.pose.position.x) == (False, 1.0)
    goal = goal_of(
        arms.FollowJointTrajectory(
            joint_names=("a", "b"), positions=((0.0, 1.0), (0.5, 1.5)), times=(1.0, 2.5)
        ),
        arms.FOLLOW_JOINT_TRAJECTORY,
    )
    assert [each.positions for each in goal.trajectory.points] == [(0.0, 1.0), (0.5, 1.5)]
    assert goal.trajectory.points[1].time_from_start == nav2.duration(2.5)


def test_a_point_without_a_joint_or_a_time_is_an_error() -> None:
    for wrong, text in (
        ({"positions": ((1.0,),), "times": (1.0,)}, r"positions\[0\] has 1 numbers, for 2 joints"),
        ({"positions": ((1.0, 2.0),), "times": ()}, "argument"),
    ):
        machine = arms.FollowJointTrajectory(joint_names=("a", "b"), **wrong)  # type: ignore[arg-type]
        with pytest.raises(ExecutionError, match=text):
            Arrangement([machine], whiteboard=LocalBoard(), clock=ManualClock()).round()


def test_both_costmaps_are_cleared_one_after_the_other() -> None:
    mission = Mission(nav2.ClearCostmaps)
    mission.go_on(500)
    for which in (nav2.CLEAR_GLOBAL_COSTMAP, nav2.CLEAR_LOCAL_COSTMAP):
        number = mission.get(which.request).number
        mission.board.add_message(which.answer, which.answer.type(number))
        mission.go_on(500)
    assert mission.go_on() == "THERE"


def test_nodes_are_brought_up_in_order_and_a_refusal_is_a_failure() -> None:
    mission = Mission(lifecycle.LifecycleBringUp("camera", "mapper"))
    labels: list[tuple[str, str]] = []
    for node in ("camera", "camera", "mapper", "mapper"):
        slots = lifecycle.change_state_slots(node)
        mission.go_on(500)
        request = mission.get(slots.request)
        labels.append((node, request.transition.label))
        mission.board.add_message(slots.answer, slots.answer.type(request.number, success=True))
    assert mission.go_on(500) == "THERE"
    assert labels == [
        (node, label) for node in ("camera", "mapper") for label in ("configure", "activate")
    ]

    mission = Mission(lifecycle.LifecycleBringUp("camera", "mapper"))
    mission.go_on(500)
    slots = lifecycle.change_state_slots("camera")
    mission.board.add_message(slots.answer, slots.answer.type(1, success=False))
    assert mission.go_on(500) == "FAILED"
    assert mission.get(lifecycle.change_state_slots("mapper").request) is None


class Visits(Machine):
    """Have a variable of which only what makes the inner machine makes use."""

    x: float = 2.0

    GO = State(runs=lambda self: nav2.NavigateTo(x=self.x))
    THERE = State()
    GO.to(THERE, when_done=True)


def test_a_variable_is_used_that_makes_an_inner_machine() -> None:
    assert check_class(Visits) == []


@pytest.mark.parametrize("caller", CALLERS)
def test_there_is_nothing_to_find_in_them(caller: type[GoalCaller]) -> None:
    assert check_class(caller) == []


def test_waiting_is_worth_it() -> None:
    """A navigation of minutes costs no rounds meanwhile: the machine waits for its status."""
    from llfsm.runtime.expressions.waiting import waiting_in

    for caller in CALLERS:
        calling = next(each for each in caller.table.states if each.name == "CALLING")
        assert waiting_in(caller.table, calling).polls == ""
