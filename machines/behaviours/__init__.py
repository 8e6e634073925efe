"""Behaviours that most robots need, ready to be loaded beside a robot's own machines.

Each is a machine like all others: drawn, watched and proved. Its variables with a default are its
parameters, as in ``CollisionStop(stop_m=0.3)``; its slots are renamed where it is loaded. Velocity
goes from slot to slot: a behaviour reads ``cmd_vel/input`` and posts ``cmd_vel``, and whoever ends
or dies leaves the robot at rest. Their properties are in `llfsm.machines.properties.behaviours`.
"""

from llfsm.machines.behaviours._arbiter import CommandArbiter
from llfsm.machines.behaviours._collision_stop import RANGE, SCAN, CollisionStop, ScanCollisionStop
from llfsm.machines.behaviours._docking import DOCK, DOCK_FAILED, DOCKED, DockAndCharge
from llfsm.machines.behaviours._emergency_stop import BUTTON, RESET, EmergencyStop
from llfsm.machines.behaviours._patrol import POSE, Patrol
from llfsm.machines.behaviours._slots import (
    AUTONOMY,
    BOOLS,
    CMD_VEL,
    EMERGENCY,
    INPUT,
    REST,
    TELEOP,
)
from llfsm.machines.behaviours._speed import Ramp, SpeedLimit
from llfsm.machines.behaviours._watches import (
    ALIVE,
    BATTERY,
    HEARTBEAT,
    LEVEL,
    STUCK,
    VELOCITY,
    BatteryLevel,
    BatteryWatch,
    HeartbeatWatch,
    Level,
    StuckWatch,
)

__all__ = [
    "ALIVE",
    "AUTONOMY",
    "BATTERY",
    "BOOLS",
    "BUTTON",
    "CMD_VEL",
    "DOCK",
    "DOCKED",
    "DOCK_FAILED",
    "EMERGENCY",
    "HEARTBEAT",
    "INPUT",
    "LEVEL",
    "POSE",
    "RANGE",
    "RESET",
    "REST",
    "SCAN",
    "STUCK",
    "TELEOP",
    "VELOCITY",
    "BatteryLevel",
    "BatteryWatch",
    "CollisionStop",
    "CommandArbiter",
    "DockAndCharge",
    "EmergencyStop",
    "HeartbeatWatch",
    "Level",
    "Patrol",
    "Ramp",
    "ScanCollisionStop",
    "SpeedLimit",
    "StuckWatch",
]
