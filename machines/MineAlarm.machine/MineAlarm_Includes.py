"""Call for evacuation at critical gas or when the pump fails, for a second at least."""

from llfsm.machines.mine_pump import EVACUATE, GAS, GASES, PUMP_FAILURE, Evacuate, Gas, PumpFailure
from llfsm.runtime import Actuator, Sensor
