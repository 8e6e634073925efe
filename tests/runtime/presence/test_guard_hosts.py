"""Guards of machines whose process cannot be looked up: on another host, or in a container."""

from __future__ import annotations

import os

from driving import DRIVE, GO, SAFE
from llfsm.runtime.presence.guard import Guard
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    MIRROR,
    LastWill,
    MachineStatus,
    MirrorStatus,
    SafeValue,
    status_slot,
    will_slot,
)
from waiting import wait_for

from .wills import is_executed, left, rounds


def test_a_process_that_cannot_be_looked_up_is_judged_by_its_statuses(
    board: Whiteboard, guard: Guard
) -> None:
    """As one in a container that shares the board, whose process ids mean others here."""
    board.add_message(MIRROR, MirrorStatus(pid=1, partition_s=0.5))
    board.add_message(DRIVE, GO)  # by the pid of this process, which is another's there
    left(board, os.getpid(), born=1, namespace=pid_namespace() + 1)
    status = MachineStatus(pid=os.getpid(), born=1, host=host_name(), namespace=pid_namespace() + 1)
    board.add_message(status_slot("Drives"), status)
    guard.look()
    assert board.get_message(DRIVE) == GO
    wait_for(lambda: is_executed(board), "the will is executed", between=rounds(guard))
    assert board.get_message(DRIVE) == SAFE


class Elsewhere:
    """A machine of another host, as this host's daemon, this process, adds its messages."""

    def __init__(self, board: Whiteboard, partition_s: float) -> None:
        self.board = board
        board.add_message(MIRROR, MirrorStatus(pid=os.getpid(), partition_s=partition_s))
        board.add_message(DRIVE, GO)
        left(board, 4711, host="far", born=1)
        status = MachineStatus(pid=4711, born=1, host="far", namespace=pid_namespace())
        board.add_message(status_slot("Drives"), status)


def test_a_host_that_is_silent_for_long_counts_as_dead(board: Whiteboard, guard: Guard) -> None:
    Elsewhere(board, 0.5)
    wait_for(lambda: is_executed(board), "the will is executed", between=rounds(guard))
    assert board.get_message(DRIVE) == SAFE


def test_a_host_that_publishes_statuses_lives(board: Whiteboard, guard: Guard) -> None:
    Elsewhere(board, 1000)
    rounds(guard)()
    assert board.get_message(DRIVE) == GO


def test_a_host_that_is_silent_does_not_stop_what_another_one_commands(
    board: Whiteboard, guard: Guard
) -> None:
    Elsewhere(board, 0.5)
    other = LastWill(
        os.getpid(),
        born(os.getpid()),
        host_name(),
        pid_namespace(),
        (SafeValue("drive", DRIVE.encoder.encode(SAFE)),),
    )
    board.add_message(will_slot("Other"), other)
    wait_for(lambda: is_executed(board), "the will is executed", between=rounds(guard))
    assert board.get_message(DRIVE) == GO


def test_a_will_of_another_host_is_executed_with_the_names_that_its_slots_have_here(
    board: Whiteboard, guard: Guard
) -> None:
    """What the operator calls robot7/drive is drive on robot7, whose guard this is."""
    mirror = MirrorStatus(pid=os.getpid(), partition_s=0.5, name="robot7", fleet=("operator",))
    board.add_message(MIRROR, mirror)
    board.add_message(DRIVE, GO)
    far = {"pid": 4711, "born": 1, "host": "far", "namespace": pid_namespace()}
    values = (SafeValue("robot7/drive", DRIVE.encoder.encode(SAFE)),)
    will = will_slot("operator/Driver")
    board.add_message(will, LastWill(values=values, **far))
    board.add_message(status_slot("operator/Driver"), MachineStatus(**far))
    wait_for(
        lambda: (board.get_message(will) or LastWill(values=(), **far)).state == "executed",
        "the will is executed",
        between=rounds(guard),
    )
    assert board.get_message(DRIVE) == SAFE
