"""The machines that ship, under the names by which ``llfsm run`` finds them.

Four re-create the example machines of clfsm, odd spellings included. The others are case studies of
what ``llfsm verify`` proves; their properties are in `llfsm.machines.properties`.
"""

from .blind_turtle import RosBlindTurttleBot
from .grid_turtle import GridTurtle
from .infusion_pump import InfusionAlarm, InfusionPump
from .microwave import OvenAlarm, OvenCooker, OvenLamp, OvenTimer, SafeOvenCooker
from .mine_pump import MineAlarm, MinePump, MineWatch
from .ping_pong import RosPingPong
from .press import PressHands, PressRam
from .suspend_resume import TurtleSuspendResume
from .wall_turtle import RosWallTurttleBot

__all__ = [
    "GridTurtle",
    "InfusionAlarm",
    "InfusionPump",
    "MineAlarm",
    "MinePump",
    "MineWatch",
    "OvenAlarm",
    "OvenCooker",
    "OvenLamp",
    "OvenTimer",
    "PressHands",
    "PressRam",
    "RosBlindTurttleBot",
    "RosPingPong",
    "RosWallTurttleBot",
    "SafeOvenCooker",
    "TurtleSuspendResume",
]
