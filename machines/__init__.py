"""The machines that ship, under the names by which ``llfsm run`` finds them.

Four re-create the example machines of clfsm, odd spellings included. The others are case studies of
what ``llfsm verify`` proves; their properties are in `llfsm.machines.properties`. `Sequence` and
the like make machines of machines.
"""

from llfsm.machines.blind_turtle import RosBlindTurttleBot
from llfsm.machines.combinators import Cooldown as Cooldown
from llfsm.machines.combinators import Fallback as Fallback
from llfsm.machines.combinators import Parallel as Parallel
from llfsm.machines.combinators import Repeat as Repeat
from llfsm.machines.combinators import Retry as Retry
from llfsm.machines.combinators import Sequence as Sequence
from llfsm.machines.combinators import Timeout as Timeout
from llfsm.machines.combinators import TookTooLongError as TookTooLongError
from llfsm.machines.combinators import While as While
from llfsm.machines.grid_turtle import GridTurtle
from llfsm.machines.infusion_pump import InfusionAlarm, InfusionPump
from llfsm.machines.microwave import OvenAlarm, OvenCooker, OvenLamp, OvenTimer, SafeOvenCooker
from llfsm.machines.mine_pump import MineAlarm, MinePump, MineWatch
from llfsm.machines.ping_pong import RosPingPong
from llfsm.machines.press import PressHands, PressRam
from llfsm.machines.suspend_resume import TurtleSuspendResume
from llfsm.machines.wall_turtle import RosWallTurttleBot

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
