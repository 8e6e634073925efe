"""Switch the motor on while there is time left and the door is shut."""

from llfsm.machines.microwave import DOOR, DOORS, MOTOR, TIME_LEFT, Door, Motor, TimeLeft
from llfsm.runtime import Actuator, Sensor
