"""Switch the motor off in the very turn that sees the open door, not a round later."""

from llfsm.machines.microwave import DOOR, DOORS, MOTOR, TIME_LEFT, Door, Motor, TimeLeft
from llfsm.runtime import Actuator, Sensor
