"""Start turtlesim and a machine that keeps a turtle away from the walls.

ros2 launch llfsm wall.launch.py turtle:=bob domain:=7

The machine is a node itself: no bridge, and no whiteboard unless one is named.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    OpaqueFunction,
    SetEnvironmentVariable,
    Shutdown,
)
from launch_ros.actions import Node

ARGUMENTS = {
    "turtle": ("turtle1", "The turtle to drive; any other than turtle1 is spawned."),
    "machine": ("RosWallTurttleBot", "The machine, as `llfsm run` names it."),
    "transport": ("auto", "How the machine reaches ROS: auto, rclpy or zenoh."),
    "domain": ("", "The ROS domain of all; by default, that of the environment."),
    "board": ("", "A whiteboard on which others see the machine; it is removed at the end."),
}


def generate_launch_description() -> LaunchDescription:
    """Return what to start; all ends when the turtles' window is closed."""
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_start)])


def _start(context: LaunchContext) -> list:
    turtle, machine, transport, domain, board = map(context.launch_configurations.get, ARGUMENTS)
    started = [SetEnvironmentVariable("ROS_DOMAIN_ID", domain)] if domain else []
    started.append(Node(package="turtlesim", executable="turtlesim_node", on_exit=Shutdown()))
    if turtle != "turtle1":
        place = f"{{x: 2.0, y: 2.0, theta: 0.0, name: {turtle}}}"
        spawn = ["ros2", "service", "call", "/spawn", "turtlesim/srv/Spawn", place]
        started.append(ExecuteProcess(cmd=spawn, output="log"))
    shared = ["--board", board, "--remove-board"] if board else []
    topics = ("cmd_vel", "pose")
    started.append(
        Node(
            package="llfsm",
            executable="llfsm",
            name="wall",
            arguments=["run", "--ros", machine, "-v", "--transport", transport, *shared],
            remappings=[(f"turtle1/{topic}", f"{turtle}/{topic}") for topic in topics],
            output="screen",
        )
    )
    return started
