"""Names of machines on a whiteboard: each is that of one machine."""

from __future__ import annotations

import os
from typing import Any

import pytest

from llfsm.runtime import Actuator, Arrangement, ManualClock
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Board, BoundSlot, Slot
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot, will_slot
from llfsm.whiteboard.messages.std_msgs import Int32

from .machines import Clock, Idle, Steps, ask, status_of


def test_a_second_arrangement_with_the_same_machine_gets_another_name_there(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 3:
            second = Arrangement([Idle], whiteboard=board, clock=Clock(look_at_both))
            second.run(max_rounds=8)
            assert second.machines[0].name == "Idle"  # the name on the board only is another
        if sleeps == 4:
            assert not status_of(board, "Idle.0").loaded

    def look_at_both(sleeps: int) -> None:
        for name in ("Idle", "Idle.0"):
            assert status_of(board, name).loaded
        assert status_of(board, "Idle.0").suspended is (sleeps > 2)
        assert status_of(board, "Idle").suspended is False
        if sleeps == 2:
            ask(board, "Idle.0", "suspend")

    first = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    first.run(max_rounds=8)
    assert first.machines[0].name == "Idle"
    assert not status_of(board, "Idle").loaded
    assert not first.is_suspended("Idle")


def test_a_name_that_was_left_is_taken_again(board: Board):
    for _ in range(2):
        Arrangement([Idle], whiteboard=board, clock=ManualClock()).run(max_rounds=2)
    assert board.get_message(status_slot("Idle.0")) is None


def test_the_name_of_a_dead_process_is_taken(board: Board):
    pid = 2**22 + 1  # beyond all pids
    dead = MachineStatus("a", pid=pid, born=1, host=host_name(), namespace=pid_namespace())
    board.add_message(status_slot("Idle"), dead)
    Arrangement([Idle], whiteboard=board, clock=ManualClock()).run(max_rounds=2)
    assert status_of(board, "Idle").loaded is False
    assert board.get_message(status_slot("Idle.0")) is None


def test_of_two_that_took_a_name_at_the_same_time_one_gives_way(board: Board):
    parent = os.getppid()
    other = MachineStatus(
        "z", pid=parent, born=born(parent), host=host_name(), namespace=pid_namespace()
    )

    def look(sleeps: int) -> None:
        if sleeps == 3:
            board.add_message(status_slot("Steps"), other)
        if sleeps > 6:  # it has changed meanwhile
            assert status_of(board, "Steps") == other
            assert status_of(board, "Steps.0").state == arrangement.state_name_of("Steps")

    arrangement = Arrangement([Steps], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=20)
    assert status_of(board, "Steps") == other
    assert status_of(board, "Steps.0").loaded is False


def test_a_machine_that_gives_way_leaves_no_will_under_the_name(board: Board):
    class Safe(Steps):
        drive = Actuator(Slot("drive", Int32), at_end=Int32())

    parent = os.getppid()
    other = MachineStatus(
        "z", pid=parent, born=born(parent), host=host_name(), namespace=pid_namespace()
    )

    def look(sleeps: int) -> None:
        if sleeps == 3:
            board.add_message(status_slot("Safe"), other)
        if sleeps > 6:
            given_up, will = (board.get_message(will_slot(name)) for name in ("Safe", "Safe.0"))
            assert given_up is None or given_up.state == "withdrawn"  # the other took its room
            assert will is not None
            assert will.state == "left"

    Arrangement([Safe], whiteboard=board, clock=Clock(look)).run(max_rounds=20)


def test_under_its_new_name_a_machine_has_obeyed_nothing_yet(board: Board):
    parent = os.getppid()
    other = MachineStatus(
        "z", pid=parent, born=born(parent), host=host_name(), namespace=pid_namespace()
    )
    obeyed = []

    def look(sleeps: int) -> None:
        if sleeps == 1:
            ask(board, "Steps", "restart")
        if sleeps == 3:
            assert status_of(board, "Steps").obeyed == 1
            board.add_message(status_slot("Steps"), other)
        status = board.get_message(status_slot("Steps.0"))
        if status is not None:
            obeyed.append(status.obeyed)

    Arrangement([Steps], whiteboard=board, clock=Clock(look)).run(max_rounds=20)
    assert obeyed
    assert set(obeyed) == {0}


def test_white_space_in_a_name_is_no_obstacle(board: Board):
    arrangement = Arrangement(whiteboard=board, clock=ManualClock())
    arrangement.load(Idle, name="two words")
    arrangement.run(max_rounds=2)
    assert status_of(board, "two words") == status_of(board, "two_words")


@pytest.mark.parametrize("names", [("a b", "a_b"), ("x" * 300, "x" * 301), ("\x01", "\x02")])
def test_machines_whose_names_look_alike_there_are_distinguished(names: tuple[str, str]):
    class FiniteBoard(LocalBoard):
        """Refuse to be asked for ever."""

        asked = 0

        def __getitem__(self, slot: Slot[Any]) -> BoundSlot[Any]:
            self.asked += 1
            assert self.asked < 1_000
            return super().__getitem__(slot)

    def look(sleeps: int) -> None:
        machines = Directory(board).machines()
        assert sorted(machine.suspended for machine in machines) == [False, True]

    board = FiniteBoard()
    arrangement = Arrangement(whiteboard=board, clock=Clock(look))
    arrangement.load(Idle, name=names[0])
    arrangement.load_suspended(Idle, name=names[1])
    arrangement.run(max_rounds=3)
