"""A robot: what its topic `cmd_vel` has brought, through a bridge in memory or any other.

Importable from every test: `from stopping_robot import Robot`.
"""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import msgspec

from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.transport import Transport
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.whiteboard import Whiteboard
from memory_transport import MemoryTransport, MemoryWorld
from waiting import wait_for
from wheels import CMD_VEL

__all__ = ["TWIST", "Command", "Robot", "memory_bridge", "memory_robot", "report", "subscribe"]

TWIST = "geometry_msgs/msg/Twist"
STRICT = os.environ.get("LLFSM_TIMES") == "check"
"""Whether to check the times in docs/how-to/safety.md: for `make safety`, which runs no others."""


def report(what: str, took_s: float, within_s: float) -> None:
    """Print how long it took until the robot stopped, and check that if nothing else runs."""
    print(f"\n{what:58} {took_s * 1e3:5.0f} ms, at most {within_s * 1e3:.0f}", end="")
    assert took_s <= within_s or not STRICT


class Command(NamedTuple):
    """What arrived at the robot."""

    time_s: float
    speed: float


class Robot:
    """It goes on with the last command that it was given, as robots do."""

    def __init__(self) -> None:
        self.got: list[Command] = []

    def __call__(self, speed: float) -> None:
        self.got.append(Command(time.monotonic(), speed))

    @property
    def speed(self) -> float:
        return self.got[-1].speed if self.got else 0.0

    def moves_on(self) -> None:
        """Wait until it gets one more command to move."""
        before = len(self.got)
        wait_for(lambda: any(each.speed for each in self.got[before:]), "the robot moves")

    def stopped_after(self, since_s: float) -> float:
        """Wait until it has stopped; return the seconds from `since_s` until it did."""

        def stops() -> bool:
            late = [each for each in self.got if each.time_s >= since_s]
            return bool(late) and late[-1].speed == 0

        wait_for(stops, "the robot stops")
        return self.first_stop(since_s) - since_s

    def first_stop(self, since_s: float) -> float:
        """Return when it stopped, and see that it has not moved any more."""
        late = [each for each in self.got if each.time_s >= since_s]
        stop = next(each for each in late if each.speed == 0)
        assert not any(each.speed for each in late[late.index(stop) :]), late
        return stop.time_s


def subscribe(transport: Transport, robot: Robot) -> None:
    """Let the robot get what is published on its topic."""
    of = TypeLibrary().message(TWIST)
    node = transport.node("robot")
    node.subscription(CMD_VEL.name, of, lambda each: robot(each.decode().linear.x))


def memory_robot(memory: MemoryWorld, robot: Robot, stack: ExitStack) -> None:
    """Start the robot's node in this process."""
    subscribe(stack.enter_context(MemoryTransport(memory, notify=lambda _: None)), robot)


def memory_bridge(board: Whiteboard, memory: MemoryWorld, stack: ExitStack) -> None:
    """Run a bridge in this process."""
    relay = {"slot": CMD_VEL.name, "type": TWIST, "direction": "to_ros"}
    plan, faults = make_plan(msgspec.convert({"relay": [relay]}, BridgeConfig), Path(), [])
    assert not faults
    transport = stack.enter_context(MemoryTransport(memory, notify=lambda _: None))
    stack.callback(Bridge(plan, board, transport).close)
