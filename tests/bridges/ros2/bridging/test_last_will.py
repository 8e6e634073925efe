"""A machine that is killed stops the robot, through to the topic that drives it."""

from __future__ import annotations

from driving import DRIVE, GO, SAFE, Runs, kill
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.runtime.presence.guard import GuardThread

TO_ROS = {"slot": DRIVE.name, "type": "std_msgs/msg/Int32", "direction": "to_ros"}


def test_the_last_message_on_the_topic_is_the_safe_value(board, start, peer, seen):
    got, number = seen(), TypeLibrary().message("std_msgs/msg/Int32")
    peer.node("robot").subscription("drive", number, lambda a: got(a.decode().data))
    start(relay=[TO_ROS])
    runs = Runs(board)
    try:
        with GuardThread(board.name, board.path.parent):
            machine = runs.start()
            got.wait(lambda got: GO.data in got)
            kill(machine)
            got.wait(lambda got: got[-1] == SAFE.data)
    finally:
        runs.end()
    assert got.count(SAFE.data) == 1
