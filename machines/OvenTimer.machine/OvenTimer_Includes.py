"""Count the minutes: up at each press of the button, down while the door is shut."""

from llfsm.machines.microwave import BUTTON, BUTTONS, DOOR, DOORS, TIME_LEFT, Button, Door, TimeLeft
from llfsm.runtime import Actuator, Sensor
