"""Move as half a second of a command moves the turtle, and answer requests at once."""

from llfsm.machines.common import CMD_VEL
from llfsm.machines.grid_turtle import AHEAD, FIELD, GRIP, GRIPS, Grip
from llfsm.runtime import Actuator, Sensor
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtle_sensor_poster import (
    ANSWER,
    REQUEST,
    TurtlePositionAnswer,
    TurtlePositionRequest,
)
