"""Last wills on a whiteboard, and looks of a guard."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from driving import DRIVE, SAFE
from llfsm.runtime.presence.guard import Guard
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import LastWill, SafeValue, will_slot

WILL = will_slot("Drives")


def is_executed(board: Whiteboard) -> bool:
    will = board.get_message(WILL)
    return will is not None and will.state == "executed"


def rounds(guard: Guard) -> Callable[[], None]:
    def look() -> None:
        guard.look()
        guard.wait(0)

    return look


def left(board: Whiteboard, pid: int, host: str = "", **fields: object) -> object:
    """Leave a will for the slot `drive` as a process would, and return its sample."""
    safe = (SafeValue("drive", DRIVE.encoder.encode(SAFE)),)
    will = LastWill(pid, born(pid), host or host_name(), pid_namespace(), safe)
    board.add_message(WILL, msgspec.structs.replace(will, **fields))
    return board[WILL].sample()
