"""The slot and the commands that drive a turtle, and the guard by which these machines end."""

from llfsm.runtime import Machine
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3

__all__ = ["CMD_VEL", "stopping", "twist"]

CMD_VEL = Slot("turtle1/cmd_vel", Twist)


def twist(linear_x: float, angular_z: float) -> Twist:
    """Make a command to drive ahead at `linear_x` m/s and turn at `angular_z` rad/s."""
    return Twist(linear=Vector3(x=linear_x), angular=Vector3(z=angular_z))


def stopping(machine: Machine) -> bool:
    """True when the arrangement is ending: the guard of every state's transition to END."""
    return machine.stopping
