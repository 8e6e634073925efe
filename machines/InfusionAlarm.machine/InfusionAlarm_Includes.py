"""Ring from a fault, or the start, until there is none and the nurse presses stop."""

from llfsm.machines.infusion_pump import BELL, FAULT, FAULTS, PANEL, PANELS, AlarmBell, Fault, Key, Panel
from llfsm.runtime import Actuator, Sensor
