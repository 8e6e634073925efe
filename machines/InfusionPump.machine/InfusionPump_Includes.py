"""Infuse at the basal rate, with boluses of five seconds at least thirty seconds apart."""

from llfsm.machines.infusion_pump import (
    DRUG,
    FAULT,
    FAULTS,
    PANEL,
    PANELS,
    Drug,
    Fault,
    Key,
    Panel,
    Rate,
)
from llfsm.runtime import Actuator, Sensor
