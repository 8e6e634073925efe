"""Start turtlesim, the bridge, and a machine that keeps the turtle away from the walls.

ros2 launch llfsm wall.launch.py
"""

from launch import LaunchDescription
from launch.actions import ExecuteProcess, Shutdown
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage


def generate_launch_description() -> LaunchDescription:
    """Return what to start; all ends when the turtle's window is closed."""
    return LaunchDescription(
        [
            Node(package="turtlesim", executable="turtlesim_node", on_exit=Shutdown()),
            _llfsm("bridge", "turtlesim", "--quiet"),
            _llfsm("run", "RosWallTurttleBot", "-v"),
        ]
    )


def _llfsm(*arguments: str) -> ExecuteProcess:
    """Start an llfsm command: no Node, which would be given arguments of ROS."""
    program = ExecutableInPackage(package="llfsm", executable="llfsm")
    return ExecuteProcess(cmd=[program, *arguments], output="screen")
