"""Behaviours that most robots need, ready to be loaded beside a robot's own machines.

Each is a machine like all others: drawn, watched and proved. Its variables with a default are its
parameters, as in ``CollisionStop(stop_m=0.3)``; its slots are renamed where it is loaded. Velocity
goes from slot to slot: a behaviour reads ``cmd_vel/input`` and posts ``cmd_vel``, and whoever ends
or dies leaves the robot at rest. Their properties are in `llfsm.machines.properties.behaviours`.
"""

from llfsm.machines.behaviours.arbiter import CommandArbiter
from llfsm.machines.behaviours.collision_stop import CollisionStop, ScanCollisionStop
from llfsm.machines.behaviours.emergency_stop import EmergencyStop
from llfsm.machines.behaviours.speed import Ramp, SpeedLimit
from llfsm.machines.behaviours.watches import (
    BatteryLevel,
    BatteryWatch,
    HeartbeatWatch,
    Level,
    StuckWatch,
)

__all__ = [
    "BatteryLevel",
    "BatteryWatch",
    "CollisionStop",
    "CommandArbiter",
    "EmergencyStop",
    "HeartbeatWatch",
    "Level",
    "Ramp",
    "ScanCollisionStop",
    "SpeedLimit",
    "StuckWatch",
]
