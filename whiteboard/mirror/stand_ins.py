"""Messages that stand in for those of a machine of another host of which nothing arrives any more.

The guard of a host that hears nothing of such a machine stops the robot there. It cannot know
whether the machine lives and others hear it. So its message must not enter their boards, and must
give way to the machine's own once that is heard again.

So before it adds one, it notes on the board which message of which slot that will be. While that
is noted, the daemon takes it for the message in whose place it is: it has the same version, so
only newer ones of the other host enter. It is never sent. When the machine is heard again, guards
strike the note out. Then the daemon lets the stand-in be just older than the message that it
replaced, and asks the others for that.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress

from llfsm.whiteboard.board import Board
from llfsm.whiteboard.errors import MessageError, SlotError, WhiteboardError
from llfsm.whiteboard.messages.llfsm import STAND_INS, StandIn, StandIns
from llfsm.whiteboard.mirror.batches import Version


def note_stand_in(board: Board, slot: str, count: int, machine: str) -> None:
    """Note that the message number `count` of a slot, which is added next, is a stand-in.

    On a board without room for the note, the message is like all others: the robot stops anyway.
    """
    with suppress(WhiteboardError):
        _replace(board, (StandIn(slot, count, machine),), ())


def strike_out(board: Board, machines: Iterable[str]) -> None:
    """Strike out what is noted for machines that are heard again."""
    with suppress(WhiteboardError):
        _replace(board, (), machines)


def noted_machines(board: Board) -> set[str]:
    """Return the machines for which something is noted."""
    return {each.machine for each in _noted(board)}


def stand_ins(board: Board) -> set[tuple[str, int]]:
    """Return the slots with stand-ins, each with the number of the message."""
    return {(each.slot, each.count) for each in _noted(board)}


def version_below(replaced: Version) -> Version:
    """Make the version of a message that gives way to one with the version `replaced`."""
    return Version(max(replaced.time - 1, 0), replaced.host)


def _noted(board: Board) -> tuple[StandIn, ...]:
    try:
        latest = board[STAND_INS].get()
    except WhiteboardError:  # another process may write anything
        return ()
    return () if latest is None else latest.noted


def _replace(board: Board, new: tuple[StandIn, ...], struck_out: Iterable[str]) -> None:
    bound = board[STAND_INS]
    while True:
        sample = bound.sample()
        noted = () if sample is None else sample.message.noted
        kept = (each for each in noted if each.machine not in struck_out)
        latest = StandIns((*(each for each in kept if _is_current(board, each)), *new))
        if bound.add_after(latest, 0 if sample is None else sample.count):
            return


def _is_current(board: Board, noted: StandIn) -> bool:
    """Check that a stand-in is its slot's latest message, or the next one."""
    try:
        return board.present(board.find(noted.slot)).count <= noted.count
    except (SlotError, MessageError):  # its name was given up
        return False
