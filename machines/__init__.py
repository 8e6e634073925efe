"""The machines that ship, under the names by which ``llfsm run`` finds them.

Four re-create the example machines of clfsm, odd spellings included. The others are case studies of
what ``llfsm verify`` proves; their properties are in `llfsm.machines.properties`. `Sequence` and
the like make machines of machines. `EmergencyStop` and its neighbours are what most robots need.
"""

from llfsm.machines.behaviours import (
    BatteryWatch,
    CollisionStop,
    CommandArbiter,
    DockAndCharge,
    EmergencyStop,
    HeartbeatWatch,
    Patrol,
    Ramp,
    ScanCollisionStop,
    SpeedLimit,
    StuckWatch,
)
from llfsm.machines.blind_turtle import RosBlindTurttleBot
from llfsm.machines.calls import CallAction, CallFailedError, CallService
from llfsm.machines.combinators import (
    Cooldown,
    Fallback,
    Parallel,
    Repeat,
    Retry,
    Sequence,
    Timeout,
    TookTooLongError,
    While,
)
from llfsm.machines.grid_turtle import GridTurtle
from llfsm.machines.infusion_pump import InfusionAlarm, InfusionPump
from llfsm.machines.microwave import OvenAlarm, OvenCooker, OvenLamp, OvenTimer, SafeOvenCooker
from llfsm.machines.mine_pump import MineAlarm, MinePump, MineWatch
from llfsm.machines.ping_pong import RosPingPong
from llfsm.machines.press import PressHands, PressRam
from llfsm.machines.suspend_resume import TurtleSuspendResume
from llfsm.machines.wall_turtle import RosWallTurttleBot

__all__ = [
    "BatteryWatch",
    "CallAction",
    "CallFailedError",
    "CallService",
    "CollisionStop",
    "CommandArbiter",
    "Cooldown",
    "DockAndCharge",
    "EmergencyStop",
    "Fallback",
    "GridTurtle",
    "HeartbeatWatch",
    "InfusionAlarm",
    "InfusionPump",
    "MineAlarm",
    "MinePump",
    "MineWatch",
    "OvenAlarm",
    "OvenCooker",
    "OvenLamp",
    "OvenTimer",
    "Parallel",
    "Patrol",
    "PressHands",
    "PressRam",
    "Ramp",
    "Repeat",
    "Retry",
    "RosBlindTurttleBot",
    "RosPingPong",
    "RosWallTurttleBot",
    "SafeOvenCooker",
    "ScanCollisionStop",
    "Sequence",
    "SpeedLimit",
    "StuckWatch",
    "Timeout",
    "TookTooLongError",
    "TurtleSuspendResume",
    "While",
]
