"""Ring for two seconds when the time is up."""

from llfsm.machines.microwave import SOUND, TIME_LEFT, Sound, TimeLeft
from llfsm.runtime import Actuator, Sensor
