"""A machine that drives, and fails in every way that tests ask for.

`llfsm run wheels:Wheels` runs it, or, on a board in a folder, `wheels.py DIRECTORY BOARD`.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable

from llfsm.runtime import Actuator, Arrangement, Machine, Sensor, State
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.std_msgs import String

__all__ = ["CMD_VEL", "CUE", "LAMP", "Wheels"]

CMD_VEL, LAMP, CUE = Slot("cmd_vel", Twist), Slot("lamp", String), Slot("cue", String)
LIBC = ctypes.PyDLL(None)
"""Calls to it hold the interpreter's lock."""


def spin() -> None:
    while True:
        pass


def fail() -> None:
    raise ValueError("the wheel fell off")


def crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def hold() -> None:
    LIBC.usleep(2_000_000)


DO: dict[str, Callable[[], object]] = {
    "spin": spin,
    "sleep": lambda: time.sleep(3600),
    "hold": hold,
    "fail": fail,
    "crash": crash,
}


class Wheels(Machine):
    """Drive, faster at every turn, until the slot `cue` has what to do; the lamp says why it ended.

    It takes no notice of being asked to stop.
    """

    wheels = Actuator(CMD_VEL, at_end=Twist())
    lamp = Actuator(
        LAMP,
        at_end=String("ended"),
        at_suspend=String("suspended"),
        at_failure=String("failed"),
    )
    cue = Sensor(CUE, default=String(), since_start=True)
    speed: float = 0.0
    followed: bool = False

    driving = State()
    parked = State()

    def move(self) -> None:
        self.speed += 1.0
        self.wheels(Twist(Vector3(self.speed)))

    @driving.on_entry
    def _(self) -> None:
        self.lamp(String("on"))

    @driving.internal
    def _(self) -> None:
        if self.cue.data != "coast":
            self.move()
        if self.cue.data in DO and not self.followed:
            self.followed = True
            DO[self.cue.data]()
        while self.cue.data == "post":
            self.move()
            time.sleep(0.001)

    driving.to(parked, when=lambda m: m.cue.data == "end")


if __name__ == "__main__":
    with Whiteboard(sys.argv[2], directory=sys.argv[1]) as board:
        Arrangement([Wheels], whiteboard=board).run()
