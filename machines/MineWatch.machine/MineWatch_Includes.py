"""Report a failure if the pump does not lower high water within five seconds."""

from llfsm.machines.mine_pump import (
    PUMP,
    PUMP_FAILURE,
    WATER,
    WATERS,
    Pump,
    PumpFailure,
    Water,
    WaterLevel,
)
from llfsm.runtime import Actuator, Sensor
