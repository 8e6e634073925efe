"""Runs recorded from turtlesim 1.8.2 replay bit for bit through a ROS graph."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.node_time import CLOCK_QOS, CLOCK_TYPE, from_ns, to_ns
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.ros_arguments import split_ros_arguments
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.turtlesim.ros import RosTurtlesim
from llfsm.bridges.turtlesim.turtle import COMMAND_STEPS
from llfsm.whiteboard.messages.geometry_msgs import Vector3
from memory_transport import MemoryTransport, MemoryWorld
from waiting import wait_for

RUNS = sorted((Path(__file__).parents[2] / "data" / "turtlesim").glob("*.jsonl"))
OVER_THE_WIRE = "turtlesim_i_zigzag_0"


def test_the_runs_are_there():
    assert len(RUNS) == 5
    assert OVER_THE_WIRE in {path.stem for path in RUNS}


@pytest.mark.parametrize(
    ("path", "ros"),
    [
        *((path, "memory") for path in RUNS),
        *((path, "zenoh") for path in RUNS if path.stem == OVER_THE_WIRE),
    ],
    ids=lambda value: value if isinstance(value, str) else value.stem,
    indirect=["ros"],
)
def test_replayed_poses_are_identical(path, ros):
    head, *records = map(json.loads, path.read_text().splitlines())
    start = {key: head["start"][key] for key in ("x", "y", "theta")}
    ros.call("/turtle1/teleport_absolute", "turtlesim/srv/TeleportAbsolute", **start)
    poses = ros.hear("/turtle1/pose", "turtlesim/msg/Pose")
    waiting, expected = [], []
    for record in records:
        if record["k"] == "cmd":
            waiting.append(record)
            continue
        # A command applied at the first later pose that reports its speeds.
        while waiting and (abs(waiting[0]["linear_x"]), waiting[0]["angular_z"]) == (
            record["v"],
            record["w"],
        ):
            command = waiting.pop(0)
            ros.command(command["linear_x"], command["linear_y"], command["angular_z"])
        ros.step()
        expected.append(tuple(record[key] for key in ("x", "y", "theta", "v", "w")))
    assert not waiting
    assert len(expected) >= 100
    ros.until(lambda: len(poses) == len(expected))
    seen = [(p.x, p.y, p.theta, p.linear_velocity, p.angular_velocity) for p in poses]
    assert seen == expected


def test_a_command_lasts_for_a_second_of_a_simulated_time():
    world, types = MemoryWorld(), TypeLibrary()
    clock, twist = types.message(CLOCK_TYPE), types.message("geometry_msgs/msg/Twist")
    _, arguments = split_ros_arguments(["--ros-args", "-p", "use_sim_time:=true"])
    with MemoryTransport(world) as ours, MemoryTransport(world) as theirs:
        turtlesim = RosTurtlesim(ours, lambda *_: None, arguments)
        turtle = turtlesim.simulator.turtle("turtle1")
        node = theirs.node("other")
        tick = node.publisher("/clock", clock, CLOCK_QOS).publish
        command = node.publisher("/turtle1/cmd_vel", twist, Qos(depth=7)).publish

        def is_moving_at(ns):
            tick(clock.message(clock=from_ns(ns)))
            wait_for(lambda: turtlesim.time.now_ns() == ns)
            turtlesim.step()
            return turtle.pose.linear_velocity != 0

        assert not is_moving_at(5 * 10**9)
        command(twist.message(linear=Vector3(x=1.0)))
        wait_for(lambda: turtlesim.step() or turtle.pose.linear_velocity)
        for _ in range(2 * COMMAND_STEPS):  # the time stands still
            turtlesim.step()
        assert turtle.pose.linear_velocity == 1
        assert is_moving_at(6 * 10**9)
        assert not is_moving_at(6 * 10**9 + 1)


def test_the_simulators_time_is_on_the_clock():
    world, of, got = MemoryWorld(), TypeLibrary().message(CLOCK_TYPE), []
    with MemoryTransport(world) as ours, MemoryTransport(world) as theirs:
        theirs.node("other").subscription(
            "/clock",
            of,
            lambda arrival: got.append(to_ns(arrival.decode().clock)),
            CLOCK_QOS._replace(depth=9),
        )
        turtlesim = RosTurtlesim(ours, lambda *_: None, clock=True)
        for _ in range(3):
            turtlesim.step()
        wait_for(lambda: len(got) == 3)
        assert got == [16_000_000, 32_000_000, 48_000_000]
        (end,) = ours.graph().ends("/clock", Role.PUBLISHER)
        assert end.qos == CLOCK_QOS
