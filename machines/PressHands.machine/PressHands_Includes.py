"""The two-hand control: permit a stroke while both buttons are held, pressed together."""

from llfsm.machines.press import ALL_HANDS, HANDS, PERMIT, Hands, Permit
from llfsm.runtime import Actuator, Sensor
