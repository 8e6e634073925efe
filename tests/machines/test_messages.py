"""Machines that wait for a message, or publish one."""

from __future__ import annotations

import pytest

from llfsm.machines import NoMessageError, PublishOnce, WaitForMessage
from llfsm.runtime import Arrangement, DefinitionError, ExecutionError, Machine, ManualClock, Reason
from llfsm.whiteboard import Slot
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.std_msgs import Int32

LEVEL = Slot("level", Int32)


def load(machine: type[Machine]) -> Arrangement:
    board = LocalBoard()
    board.add_message(LEVEL, Int32(9))  # from before it begins
    return Arrangement([machine], whiteboard=board, clock=ManualClock())


def post(arrangement: Arrangement, value: int) -> None:
    assert arrangement.whiteboard is not None
    arrangement.whiteboard.add_message(LEVEL, Int32(value))


def test_a_message_is_waited_for_that_is_new_and_good() -> None:
    arrangement = load(WaitForMessage(LEVEL, when=lambda message: message.data > 5))
    assert arrangement.run(max_rounds=5) is Reason.MAX_ROUNDS
    arrangement = load(WaitForMessage(LEVEL, when=lambda message: message.data > 5))
    arrangement.round()
    post(arrangement, 3)
    arrangement.round()
    assert "WAITING" in arrangement.states().values()
    post(arrangement, 7)
    assert arrangement.run(max_rounds=5) is Reason.ACCEPTING


def test_a_message_that_does_not_come_is_a_failure() -> None:
    with pytest.raises(ExecutionError, match="level: no message within 250 ms") as raised:
        load(WaitForMessage(LEVEL, 250)).run(max_rounds=1000)
    assert isinstance(raised.value.__cause__, NoMessageError)
    with pytest.raises(DefinitionError, match="timeout_ms is 0; it must be above 0"):
        WaitForMessage(LEVEL, 0)


@pytest.mark.parametrize("message", [Int32(4), lambda machine: Int32(len(machine.name))])
def test_a_message_is_published_once(message: object) -> None:
    arrangement = load(PublishOnce(LEVEL, message, name="Four"))  # type: ignore[arg-type]
    assert arrangement.run(max_rounds=50) is Reason.ACCEPTING
    board = arrangement.whiteboard
    assert board is not None
    assert (board[LEVEL].count, board[LEVEL].get()) == (2, Int32(4))
