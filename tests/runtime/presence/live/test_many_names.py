"""Machines whose names come and go leave room on their board."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from types import new_class
from typing import Literal

import pytest

from llfsm.runtime import Actuator, Arrangement, ManualClock
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.state import State
from llfsm.runtime.presence.guard import Guard
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.runtime.presence.published import vacate_dead
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.liveness import host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    LastWill,
    MachineStatus,
    definition_slot,
    request_slot,
    status_slot,
    variables_slot,
    will_slot,
)
from llfsm.whiteboard.messages.std_msgs import Bool
from llfsm.whiteboard.poller import BoardPoller
from own_boards import own_board

from .machines import Clock, ask, status_of

MANY = 40


class Stops(Machine):
    stop = Actuator(Slot("stop", Bool), at_failure=Bool(True))
    on: bool = False
    a = State()
    a.to(a, when=lambda m: False)


@pytest.fixture
def board() -> Iterator[Whiteboard]:
    with own_board() as name, Whiteboard(name) as board:
        yield board


def machine(number: int) -> type[Machine]:
    return new_class(f"Machine{number}", (Stops,))


def run(board: Whiteboard, *numbers: int) -> None:
    clock = ManualClock()
    environment = LiveEnvironment(board, clock)
    Arrangement(map(machine, numbers), environment=environment).run(max_rounds=2)


def test_names_one_after_the_other_take_the_room_of_one(board: Whiteboard) -> None:
    """Also for those who look on: a directory, a guard, and a page or recorder."""
    directory, guard, poller = Directory(board), Guard(board), BoardPoller(board)
    handle, sizes = type(board[Stops.stop.slot]), {}
    for number in range(MANY):
        run(board, number)
        assert board.get_message(status_slot(f"Machine{number}")).loaded is False
        definition = board.get_message(definition_slot(f"Machine{number}"))
        assert [state.name for state in definition.states] == ["a"]
        for look in (directory.machines, guard.look, poller.poll):
            look()
        if number in (2, MANY - 1):
            gc.collect()
            handles = sum(type(each) is handle for each in gc.get_objects())
            size = board.path.stat().st_size
            sizes[number] = len(board.slots()), size, len(poller.slots), handles
    assert sizes[MANY - 1] == sizes[2]
    assert not any(f"/Machine{MANY - 2}" in info.name for info in board.slots())


def leave(board: Whiteboard, name: str, state: Literal["left", "executed"]) -> None:
    """Leave what a killed process leaves, and what a guard has made of its will."""
    process = (2**22 + 1, 1, host_name(), pid_namespace())  # beyond all pids
    pid, started, host, namespace = process
    status = MachineStatus("a", pid=pid, born=started, host=host, namespace=namespace)
    board.add_message(status_slot(name), status)
    board.add_message(will_slot(name), LastWill(*process, (), 0, state))
    for slot in (definition_slot, request_slot, variables_slot):
        board[slot(name)].reserve()


def test_names_of_the_dead_are_used_again_when_they_died_long_ago(board: Whiteboard) -> None:
    def slots(name: str) -> int:
        return sum(info.name.endswith(f"/{name}") for info in board.slots())

    leave(board, "Executed", "executed")
    leave(board, "Left", "left")
    run(board, 0)
    assert (slots("Executed"), slots("Left")) == (5, 5)
    vacate_dead(board, after_s=0)
    run(board, 1, 2, 3)
    # Nobody needed room for variables; and a guard has still to execute one of the wills.
    assert (slots("Executed"), slots("Left")) == (1, 2)
    assert board.get_message(will_slot("Left")).state == "left"


def test_a_machine_that_runs_keeps_its_name_whoever_gives_it_up(board: Whiteboard) -> None:
    def look(sleeps: int) -> None:
        clock.advance(s=1)  # its status is due again
        if sleeps == 3:
            for slot in (status_slot, request_slot):
                board.vacate(slot("Stops"))
        if sleeps == 5:
            run(board, 1)  # would take what is vacant
        if sleeps == 6:
            assert status_of(board, "Stops").loaded
            ask(board, "Stops", "suspend")

    clock = Clock(look)
    arrangement = Arrangement([Stops], environment=LiveEnvironment(board, clock))
    arrangement.run(max_rounds=10)
    assert arrangement.is_suspended("Stops")
