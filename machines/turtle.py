"""What the turtle machines share: where they post their commands."""

from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3

__all__ = ["CMD_VEL", "twist"]

CMD_VEL = Slot("turtle1/cmd_vel", Twist)


def twist(linear_x: float, angular_z: float) -> Twist:
    """Return the command to drive at `linear_x` m/s ahead and turn at `angular_z` rad/s."""
    return Twist(linear=Vector3(x=linear_x), angular=Vector3(z=angular_z))
