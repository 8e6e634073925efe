"""A command whose board has gone says so, and its status is not that of a success."""

from __future__ import annotations

import pytest

from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot
from llfsm.whiteboard.messages.std_msgs import Int32
from llfsm.whiteboard.messages.turtlesim import Pose
from waiting import wait_for

from .conftest import Llfsm

POSE = Slot("turtle1/pose", Pose)
RUN = ("run", "RosWallTurttleBot", "-q")


@pytest.mark.parametrize(
    ("command", "slot"),
    [
        (RUN, status_slot("RosWallTurttleBot")),
        ((*RUN, "-n"), status_slot("RosWallTurttleBot")),
        (("turtlesim",), POSE),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_the_removal_is_an_error(
    llfsm: Llfsm, board: str, command: tuple[str, ...], slot: Slot[MachineStatus] | Slot[Pose]
) -> None:
    with Whiteboard(board) as made:
        made.add_message(Slot("x", Int32), Int32())
        process = llfsm.start(*command, "-b", board)
        wait_for(lambda: made.get_message(slot) is not None, "it runs")
        made.remove()
    printed = process.stdout.read()
    assert f"Error: the whiteboard {board!r} was removed" in printed
    assert "RemoveIPC=no" in printed
    assert "starts again" not in printed
    assert process.wait() == 75


def test_an_end_that_was_asked_for_is_none(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as made:
        process = llfsm.start(*RUN, "-b", board)
        wait_for(lambda: made.get_message(status_slot("RosWallTurttleBot")) is not None, "it runs")
        process.terminate()
        assert "was removed" not in process.stdout.read()
        assert process.wait() == 0
