"""Properties of the behaviours that most robots need."""

from collections.abc import Mapping
from typing import Any

from llfsm.machines.behaviours import (
    AUTONOMY,
    BATTERY,
    CMD_VEL,
    EMERGENCY,
    HEARTBEAT,
    INPUT,
    RANGE,
    REST,
    TELEOP,
    VELOCITY,
    BatteryWatch,
    CollisionStop,
    CommandArbiter,
    EmergencyStop,
    HeartbeatWatch,
    Ramp,
    SpeedLimit,
    StuckWatch,
)
from llfsm.runtime.verification import never, reachable, step
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.sensor_msgs import BatteryState, Range
from llfsm.whiteboard.messages.std_msgs import Bool

__all__ = [
    "COLLISION",
    "COMMANDS",
    "LIMIT",
    "RAMP",
    "STUCK_WATCH",
    "WATCHES",
    "WORLDS",
    "back_stays_free",
    "critical_is_not_good",
    "emergency_stops",
    "full_speed",
    "held_until_reset",
    "level_keeps_its_distance",
    "limit_is_kept",
    "near_slows",
    "near_stops",
    "needs_a_command",
    "passes",
    "person_comes_first",
    "pressed_stops",
    "ramp_is_kept",
    "ready_before_released",
    "silence_is_noticed",
    "stuck_after_a_wait",
    "top_speed_is_reached",
]

AHEAD, BACK = Twist(Vector3(x=1.0)), Twist(Vector3(x=-1.0))

COMMANDS = (EmergencyStop, CommandArbiter)
COLLISION = (CollisionStop,)
LIMIT = (SpeedLimit,)
RAMP = (lambda: Ramp(linear_step=0.25),)
WATCHES = (BatteryWatch, HeartbeatWatch)
STUCK_WATCH = (StuckWatch,)

WORLDS: Mapping[tuple[Any, ...], Mapping[Any, tuple[Any, ...]]] = {
    COMMANDS: {TELEOP: (AHEAD,), AUTONOMY: (BACK,)},
    COLLISION: {
        INPUT: (REST, AHEAD, BACK),
        RANGE: tuple(Range(range=metres) for metres in (0.2, 0.45, 0.6, 1.05, 1.5)),
    },
    LIMIT: {INPUT: (REST, AHEAD, BACK)},
    RAMP: {INPUT: (REST, AHEAD, BACK)},
    WATCHES: {
        BATTERY: tuple(BatteryState(percentage=part) for part in (0.05, 0.12, 0.2, 0.32, 0.5)),
        HEARTBEAT: (Bool(True),),
    },
    STUCK_WATCH: {CMD_VEL: (REST, AHEAD), VELOCITY: (REST, AHEAD)},
}
"""The messages that the sensors may read in a proof, of each arrangement."""

# An emergency stop, and who commands

pressed_stops = never(lambda v: v.EmergencyStop.button.data and not v[EMERGENCY].data)
held_until_reset = step(
    lambda before, after: (
        not before[EMERGENCY].data or after[EMERGENCY].data or not after.EmergencyStop.button.data
    )
)
ready_before_released = step(
    lambda before, after: (
        (before.EmergencyStop.state, after.EmergencyStop.state) != ("STOPPED", "RELEASED")
    )
)
emergency_stops = never(lambda v: v.CommandArbiter.emergency.data and v[CMD_VEL] != REST)
person_comes_first = never(lambda v: v.CommandArbiter.teleop is not None and v[CMD_VEL] == BACK)
passes = reachable(lambda v: v[CMD_VEL] == AHEAD)

# Obstacles

near_stops = never(
    lambda v: (
        (v.CollisionStop.range is None or v.CollisionStop.range.range < 0.4)
        and v[CMD_VEL].linear.x > 0
    )
)
near_slows = never(
    lambda v: (
        (v.CollisionStop.range is None or v.CollisionStop.range.range < 1.0)
        and v[CMD_VEL].linear.x > 0.3
    )
)
back_stays_free = reachable(
    lambda v: v.CollisionStop.state == "STOP" and v[CMD_VEL].linear.x == BACK.linear.x
)
full_speed = reachable(lambda v: v[CMD_VEL] == AHEAD)

# Speed

limit_is_kept = never(lambda v: abs(v[CMD_VEL].linear.x) > 0.5)
ramp_is_kept = step(
    lambda before, after: abs(after[CMD_VEL].linear.x - before[CMD_VEL].linear.x) <= 0.25
)
top_speed_is_reached = reachable(lambda v: v[CMD_VEL] == AHEAD)

# Watches

critical_is_not_good = never(
    lambda v: (
        v.BatteryWatch.battery is not None
        and v.BatteryWatch.battery.percentage < 0.1
        and v.BatteryWatch.state == "GOOD"
    )
)
level_keeps_its_distance = step(
    lambda before, after: (
        (before.BatteryWatch.state, after.BatteryWatch.state) != ("LOW", "GOOD")
        or after.BatteryWatch.battery.percentage >= 0.35
    )
)
silence_is_noticed = never(
    lambda v: v.HeartbeatWatch.heartbeat is None and v.HeartbeatWatch.state == "HEARD"
)
needs_a_command = never(lambda v: v.StuckWatch.command == REST and v.StuckWatch.state == "STUCK")
stuck_after_a_wait = step(
    lambda before, after: (before.StuckWatch.state, after.StuckWatch.state) != ("FREE", "STUCK")
)
