"""Drive ahead for a second, turn right for a second, and repeat."""

from llfsm.runtime import Actuator
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
