"""Properties of the behaviours that most robots need."""

from collections.abc import Mapping
from typing import Any

from llfsm.machines.behaviours import (
    AUTONOMY,
    BATTERY,
    CMD_VEL,
    DOCK,
    EMERGENCY,
    HEARTBEAT,
    INPUT,
    LEVEL,
    POSE,
    RANGE,
    REST,
    TELEOP,
    VELOCITY,
    BatteryLevel,
    BatteryWatch,
    CollisionStop,
    CommandArbiter,
    DockAndCharge,
    EmergencyStop,
    HeartbeatWatch,
    Level,
    Patrol,
    Ramp,
    SpeedLimit,
    StuckWatch,
)
from llfsm.runtime.verification import never, reachable, step
from llfsm.whiteboard.messages.geometry_msgs import (
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Twist,
    Vector3,
)
from llfsm.whiteboard.messages.sensor_msgs import BatteryState, Range
from llfsm.whiteboard.messages.std_msgs import Bool

__all__ = [
    "COLLISION",
    "COMMANDS",
    "DOCKING",
    "LIMIT",
    "PATROL",
    "RAMP",
    "STUCK_WATCH",
    "WATCHES",
    "WORLDS",
    "a_low_robot_docks",
    "back_stays_free",
    "blind_rests",
    "charging_is_reached",
    "critical_is_not_good",
    "each_waypoint_is_reached",
    "emergency_stops",
    "full_speed",
    "held_until_reset",
    "leaves_charged",
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
    "turns_on_the_spot",
    "waypoints_in_order",
]

AHEAD, BACK = Twist(Vector3(x=1.0)), Twist(Vector3(x=-1.0))

COMMANDS = (EmergencyStop, CommandArbiter)
COLLISION = (CollisionStop,)
LIMIT = (SpeedLimit,)
RAMP = (lambda: Ramp(linear_step=0.25),)
WATCHES = (BatteryWatch, HeartbeatWatch)
STUCK_WATCH = (StuckWatch,)
PATROL = (lambda: Patrol(waypoints=((0.0, 0.0), (2.0, 0.0)), rounds=1),)
DOCKING = (DockAndCharge,)


def _pose(x: float, *, back: bool) -> PoseStamped:
    turned = Quaternion(z=1.0, w=0.0) if back else Quaternion()
    return PoseStamped(pose=Pose(Point(x=x), turned))


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
    PATROL: {POSE: tuple(_pose(x, back=back) for x in (0.0, 1.0, 2.0) for back in (False, True))},
    DOCKING: {
        LEVEL: tuple(map(BatteryLevel, Level)),
        BATTERY: (BatteryState(percentage=0.5), BatteryState(percentage=1.0)),
    },
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

# Going round, and going home

blind_rests = never(lambda v: v.Patrol.pose is None and v[AUTONOMY] != REST)
turns_on_the_spot = never(lambda v: v.Patrol.state == "TURN" and v[AUTONOMY].linear.x != 0)
waypoints_in_order = step(
    lambda before, after: (
        before.Patrol.target == after.Patrol.target or before.Patrol.state == "AT_WAYPOINT"
    )
)
each_waypoint_is_reached = reachable(lambda v: v.Patrol.state == "DONE")
a_low_robot_docks = step(
    lambda before, after: (
        (before.DockAndCharge.state, after.DockAndCharge.state) != ("WORKING", "WORKING")
        or after.DockAndCharge.level.level not in (Level.LOW, Level.CRITICAL)
    )
)
leaves_charged = step(
    lambda before, after: (
        (before.DockAndCharge.state, after.DockAndCharge.state) != ("CHARGING", "WORKING")
        or after.DockAndCharge.battery.percentage >= 0.95
    )
)
charging_is_reached = reachable(
    lambda v: v.DockAndCharge.state == "CHARGING" and v[DOCK].data and v.DockAndCharge.docked.data
)
