"""Properties of the turtle machines."""

from typing import Any

from llfsm.machines.blind_turtle import RosBlindTurttleBot
from llfsm.machines.common import CMD_VEL
from llfsm.machines.grid_turtle import FIELD, GridTurtle
from llfsm.machines.ping_pong import PINPONG, RosPingPong
from llfsm.machines.suspend_resume import TurtleSuspendResume
from llfsm.machines.wall_turtle import RosWallTurttleBot
from llfsm.runtime.verification import leads_to, never, reachable, step
from llfsm.whiteboard.messages.geometry_msgs import Twist

__all__ = [
    "BLIND",
    "HELD",
    "PING_PONG",
    "WALL",
    "counts",
    "drives_or_turns",
    "ends_at_rest",
    "held_at_rest",
    "holds",
    "leaves_wall",
    "lets_go",
    "meets_wall",
    "never_rests_at_wall",
]

BLIND = (RosBlindTurttleBot,)
HELD = (RosBlindTurttleBot, TurtleSuspendResume)
PING_PONG = (RosPingPong,)
WALL = (RosWallTurttleBot, GridTurtle)


def at_wall(v: Any) -> bool:
    """True if the turtle touches a wall."""
    return v.GridTurtle.x in (0, FIELD) or v.GridTurtle.y in (0, FIELD)


drives_or_turns = never(lambda v: v[CMD_VEL].linear.x != 0 and v[CMD_VEL].angular.z != 0)
ends_at_rest = never(lambda v: not v.RosBlindTurttleBot.loaded and v[CMD_VEL] != Twist())
held_at_rest = never(lambda v: v.RosBlindTurttleBot.suspended and v[CMD_VEL] != Twist())
holds = never(
    lambda v: v.TurtleSuspendResume.state == "HOLD" and not v.RosBlindTurttleBot.suspended
)
lets_go = reachable(lambda v: v.TurtleSuspendResume.state == "WATCH")
counts = step(
    lambda before, after: (
        (before.RosPingPong.state, after.RosPingPong.state) != ("PUBLISH", "WAIT_AND_COUNT")
        or after[PINPONG].data == f"hello world {after.RosPingPong.count}"
    )
)
"""The count grows for ever: give `abstract` for it."""

never_rests_at_wall = leads_to(
    lambda v: at_wall(v) and v[CMD_VEL] == Twist(),
    lambda v: v[CMD_VEL] != Twist(),
    within_ms=4000,
)
leaves_wall = leads_to(at_wall, lambda v: not at_wall(v))
meets_wall = reachable(at_wall)
