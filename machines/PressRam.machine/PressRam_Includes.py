"""Close while that is permitted, open at the bottom or as soon as it is not."""

from llfsm.machines.press import (
    PERMIT,
    POSITIONS,
    RAM,
    RAM_POSITION,
    Permit,
    Position,
    Ram,
    RamPosition,
    Way,
)
from llfsm.runtime import Actuator, Sensor
