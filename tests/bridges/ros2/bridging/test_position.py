"""The service turtle_position, in ROS and in slots."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.bridging._turtle_position import TYPE
from llfsm.bridges.ros2.bridging.bridge_config import turtlesim_config
from llfsm.bridges.ros2.errors import CallFailedError
from llfsm.machines import RosWallTurttleBot
from llfsm.runtime import Arrangement, ManualClock
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtle_sensor_poster import (
    ANSWER,
    REQUEST,
    TurtlePositionRequest,
)
from llfsm.whiteboard.messages.turtlesim import Pose
from waiting import PATIENCE_S, wait_for

POSE = Slot("turtle1/pose", Pose)
HERE = Pose(5.5, 6.5, 1.0)


@pytest.fixture
def ask(peer, types):
    of = types.service("turtle_sensor_poster/srv/TurtlePosition")
    client = peer.node("caller").client("/turtle_position", of)
    return lambda: client.call(of.request.message(), timeout=PATIENCE_S).result(PATIENCE_S)


@pytest.fixture
def post_pose(peer, types, board):
    """Publish a pose in ROS and see it on the board."""
    publisher = peer.node("turtlesim").publisher(
        "turtle1/pose", types.message("turtlesim/msg/Pose")
    )

    def post(pose):
        publisher.publish(pose)
        wait_for(lambda: board.get_message(POSE) == pose)

    return post


@pytest.fixture
def preset(start):
    """Start the bridge of `llfsm bridge turtlesim`."""
    import msgspec

    def starting(*turtles):
        return start(**msgspec.to_builtins(turtlesim_config(turtles or ("turtle1",))))

    return starting


def answer(board, number):
    bound = board[ANSWER]
    sample = bound.sample()
    while sample is None or sample.message.number != number:
        sample = bound.wait(after=0 if sample is None else sample.count, timeout=PATIENCE_S)
        assert sample is not None
    return sample.message


def test_before_the_first_pose_a_caller_in_ros_gets_no_response(preset, ask):
    preset()
    with pytest.raises(CallFailedError, match="no pose"):
        ask()


def test_the_latest_pose_is_the_answer(preset, ask, post_pose):
    preset()
    for pose in (HERE, Pose(1.5, 2.5, -3.0)):
        post_pose(pose)
        response = ask()
        assert (response.x, response.y, response.theta) == (pose.x, pose.y, pose.theta)


def test_a_pose_from_before_the_bridge_is_none(board, preset, ask):
    board.add_message(POSE, HERE)
    preset()
    with pytest.raises(CallFailedError, match="no pose"):
        ask()


def test_in_slots_it_is_answered_likewise(board, preset, post_pose):
    preset()
    board.add_message(REQUEST, TurtlePositionRequest(1))
    assert "no pose in slot turtle1/pose" in answer(board, 1).failure
    post_pose(HERE)
    board.add_message(REQUEST, TurtlePositionRequest(2))
    reported = answer(board, 2)
    assert (reported.x, reported.y, reported.theta, reported.failure) == (
        HERE.x,
        HERE.y,
        HERE.theta,
        "",
    )


def test_who_asked_before_the_bridge_was_there_is_answered(board, preset):
    board.add_message(REQUEST, TurtlePositionRequest(1))
    preset()
    assert answer(board, 1).failure  # and so knows to ask again


def test_without_its_type_in_ros_the_slots_are_answered_still(
    board, preset, post_pose, reported, memory
):
    """As with rclpy, where nobody has built the package of the type."""
    memory.missing_types.add(TYPE)
    preset()
    assert [f"{TYPE} is not built" in notice.text for notice in reported] == [True]
    post_pose(HERE)
    board.add_message(REQUEST, TurtlePositionRequest(1))
    assert not answer(board, 1).failure


def test_the_first_turtle_is_the_one_that_is_reported(board, preset, ask):
    preset("bob", "turtle1")
    board.add_message(Slot("bob/pose", Pose), HERE)
    assert ask().x == HERE.x


def test_the_wall_machine_drives_a_turtle_of_ros(board, preset, peer, types, post_pose, seen):
    """Unchanged, and only through the bridge."""
    preset()
    commands = seen()
    peer.node("turtlesim2").subscription(
        "turtle1/cmd_vel", types.message("geometry_msgs/msg/Twist"), lambda a: commands(a.decode())
    )
    clock = ManualClock()
    arrangement = Arrangement([RosWallTurttleBot], whiteboard=board, clock=clock)

    def state():
        return arrangement.state_name_of("RosWallTurttleBot")

    def until(name):
        for _ in range(200):
            arrangement.round()
            if state() == name:
                arrangement.round()
                return
            clock.advance(ms=101)
        raise AssertionError(state())

    post_pose(Pose(10.0, 5.0))
    until("STRAIGHT")
    commands.wait(lambda got: got[-1:] and got[-1].linear.x == 2.0)
    until("STOP")
    commands.wait(lambda got: got[-1] == Twist())
    answer(board, board.get_message(REQUEST).number)
    until("BACK")
    commands.wait(lambda got: got[-1].linear.x == -2.0)
