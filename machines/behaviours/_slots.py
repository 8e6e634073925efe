"""The slots of velocities and of the emergency stop, which several behaviours share."""

from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.std_msgs import Bool

CMD_VEL = Slot("cmd_vel", Twist)
"""The velocity that the robot follows."""
INPUT = Slot("cmd_vel/input", Twist)
"""The velocity that a behaviour passes on, changed or not."""
TELEOP = Slot("cmd_vel/teleop", Twist)
AUTONOMY = Slot("cmd_vel/autonomy", Twist)
EMERGENCY = Slot("emergency_stop/active", Bool)
"""True while the robot must not move."""
REST = Twist()
BOOLS = (Bool(False), Bool(True))
"""The domain of a slot with a key or a flag."""
