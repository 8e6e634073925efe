"""Drive ahead, stop, and ask for the position; near a wall, back off and turn right."""

from llfsm.runtime import Actuator, Sensor
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.turtle_sensor_poster import (
    ANSWER,
    REQUEST,
    TurtlePositionAnswer,
    TurtlePositionRequest,
)
