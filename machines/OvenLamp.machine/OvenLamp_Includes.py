"""Light the oven while it cooks or its door is open."""

from llfsm.machines.microwave import DOOR, DOORS, LAMP, TIME_LEFT, Door, Lamp, TimeLeft
from llfsm.runtime import Actuator, Sensor
