"""Whose last will cancels a goal: other slots are left out, and a closed board is an error."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from llfsm.bridges.ros2.bridging._slot_action import SenderWill
from llfsm.whiteboard import BoardClosedError, Sample, Slot, SlotInfo
from llfsm.whiteboard.liveness import this_process
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import WILLS, LastWill, SafeValue, will_slot
from llfsm.whiteboard.messages.std_msgs import Int32

CANCEL = "goal/cancel"


class Closing(LocalBoard):
    """A board that is closed by another thread after its slots were listed."""

    def slots(self) -> Sequence[SlotInfo]:
        found = super().slots()
        self.close()
        return found


def left(board: LocalBoard) -> Sample[LastWill]:
    """Leave a will that cancels goals, and post what only has the name of one."""
    board.add_message(Slot(WILLS + "other", Int32), Int32())
    will = LastWill(*this_process(), (SafeValue(CANCEL, b""),), state="executed")
    board.add_message(will_slot("Machine"), will)
    sample = board[will_slot("Machine")].sample()
    assert sample is not None
    return sample


def test_what_is_no_will_is_left_out() -> None:
    board = LocalBoard()
    will = SenderWill(board, left(board), CANCEL)
    assert will.is_executed
    board.close()
    assert not will.is_executed  # the bridge ends


def test_a_board_that_is_closed_meanwhile_is_no_board_without_wills() -> None:
    board = Closing()
    goal = left(board)
    with pytest.raises(BoardClosedError):
        SenderWill(board, goal, CANCEL)
