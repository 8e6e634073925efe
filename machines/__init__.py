"""The machines that ship, under the names by which ``llfsm run`` finds them.

They re-create the example machines of clfsm, odd spellings included.
"""

from .blind_turtle import RosBlindTurttleBot
from .ping_pong import RosPingPong
from .suspend_resume import TurtleSuspendResume
from .wall_turtle import RosWallTurttleBot

__all__ = ["RosBlindTurttleBot", "RosPingPong", "RosWallTurttleBot", "TurtleSuspendResume"]
