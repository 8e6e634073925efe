"""The machines that ship, under the names by which ``llfsm run`` finds them.

Four re-create the example machines of clfsm, odd spellings included. The others are case studies of
what ``llfsm verify`` proves; their properties are in `llfsm.machines.properties`. `Sequence` and
the like make machines of machines. `EmergencyStop` and its neighbours are what most robots need;
`NavigateTo`, `MoveGripper` and theirs send goals to Navigation2 and to controllers.
"""

from llfsm.machines.arms import FollowJointTrajectory, MoveGripper
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
from llfsm.machines.lifecycle import LifecycleBringUp
from llfsm.machines.messages import NoMessageError, PublishOnce, WaitForMessage
from llfsm.machines.microwave import OvenAlarm, OvenCooker, OvenLamp, OvenTimer, SafeOvenCooker
from llfsm.machines.mine_pump import MineAlarm, MinePump, MineWatch
from llfsm.machines.mission_queue import MissionQueue
from llfsm.machines.nav2 import (
    AssistedTeleop,
    BackUp,
    ClearCostmaps,
    Dock,
    DriveOnHeading,
    FollowWaypoints,
    NavigateTo,
    Spin,
    Undock,
)
from llfsm.machines.ping_pong import RosPingPong
from llfsm.machines.press import PressHands, PressRam
from llfsm.machines.stand_ins import (
    BackUpStandIn,
    ClearCostmapsStandIn,
    DockStandIn,
    DriveOnHeadingStandIn,
    NavigateToStandIn,
    SpinStandIn,
    UndockStandIn,
)
from llfsm.machines.suspend_resume import TurtleSuspendResume
from llfsm.machines.wall_turtle import RosWallTurttleBot

__all__ = [
    "AssistedTeleop",
    "BackUp",
    "BackUpStandIn",
    "BatteryWatch",
    "CallAction",
    "CallFailedError",
    "CallService",
    "ClearCostmaps",
    "ClearCostmapsStandIn",
    "CollisionStop",
    "CommandArbiter",
    "Cooldown",
    "Dock",
    "DockAndCharge",
    "DockStandIn",
    "DriveOnHeading",
    "DriveOnHeadingStandIn",
    "EmergencyStop",
    "Fallback",
    "FollowJointTrajectory",
    "FollowWaypoints",
    "GridTurtle",
    "HeartbeatWatch",
    "InfusionAlarm",
    "InfusionPump",
    "LifecycleBringUp",
    "MineAlarm",
    "MinePump",
    "MineWatch",
    "MissionQueue",
    "MoveGripper",
    "NavigateTo",
    "NavigateToStandIn",
    "NoMessageError",
    "OvenAlarm",
    "OvenCooker",
    "OvenLamp",
    "OvenTimer",
    "Parallel",
    "Patrol",
    "PressHands",
    "PressRam",
    "PublishOnce",
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
    "Spin",
    "SpinStandIn",
    "StuckWatch",
    "Timeout",
    "TookTooLongError",
    "TurtleSuspendResume",
    "Undock",
    "UndockStandIn",
    "WaitForMessage",
    "While",
]
