"""The machines that ship, by the names under which ``llfsm run`` knows them.

They re-create the machines of the system that this project follows, odd spellings included.
"""

from .blind_turtle import RosBlindTurttleBot
from .ping_pong import RosPingPong
from .suspend_resume import TurtleSuspendResume
from .wall_turtle import RosWallTurttleBot

__all__ = ["RosBlindTurttleBot", "RosPingPong", "RosWallTurttleBot", "TurtleSuspendResume"]
