"""Pump from high to low water, or as the operator wishes, but never with methane."""

from llfsm.machines.mine_pump import (
    GAS,
    GASES,
    OPERATOR,
    PUMP,
    WATER,
    WATERS,
    WISHES,
    Gas,
    Operator,
    Pump,
    Water,
    WaterLevel,
    Wish,
)
from llfsm.runtime import Actuator, Sensor
