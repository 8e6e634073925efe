"""Properties of the mine pump."""

from llfsm.machines.mine_pump import (
    EVACUATE,
    PUMP,
    PUMP_FAILURE,
    MineAlarm,
    MinePump,
    MineWatch,
    WaterLevel,
)
from llfsm.runtime.verification import leads_to, never, reachable, step

__all__ = [
    "MINE",
    "failure_calls",
    "failure_is_found",
    "gas_rings",
    "high_water_is_pumped",
    "methane_stops_pump",
    "never_dry",
    "ringing_calls",
]

MINE = (MinePump, MineWatch, MineAlarm)

methane_stops_pump = never(lambda v: v.MinePump.gas.methane and v[PUMP].on)
never_dry = never(lambda v: v.MinePump.water.level is WaterLevel.LOW and v[PUMP].on)
gas_rings = never(
    lambda v: (
        (v.MineAlarm.gas.methane or v.MineAlarm.gas.carbon_monoxide)
        and v.MineAlarm.state == "QUIET"
    )
)
high_water_is_pumped = step(
    lambda before, after: (
        after.MinePump.water.level is not WaterLevel.HIGH
        or (before.MinePump.state, after.MinePump.state) != ("ON", "OFF")
    )
)
"""Whatever the operator wishes."""

ringing_calls = step(
    lambda before, after: (
        (before.MineAlarm.state, after.MineAlarm.state) != ("QUIET", "RINGING")
        or after[EVACUATE].now
    )
)
failure_calls = leads_to(
    lambda v: v[PUMP_FAILURE].failed, lambda v: v[EVACUATE].now, within_ms=1000
)
failure_is_found = reachable(lambda v: v[PUMP_FAILURE].failed)
