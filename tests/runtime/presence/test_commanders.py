"""Several processes that post to one slot, or have machines of one name, report it once."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

import pytest

from commanding import Alone, Wall
from llfsm.runtime import ActuatorTakenError, Arrangement, LoadError
from llfsm.runtime.presence.slot_ownership import contested_slots, described
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    Bell,
    Commander,
    Commanders,
    MachineStatus,
    status_slot,
)
from waiting import wait_for

from .claims import CLAIMS, Process, commanders


def test_both_processes_are_warned_once_and_tools_show_it(
    board: Whiteboard, process: Callable[[], Process]
) -> None:
    first, second = process(), process()
    assert first.start("Wall", "Wall") == "loaded"
    second.ask("Wall", "Blind")
    pids = [first.popen.pid, second.popen.pid]
    expected = f"cmd has two commanders: Wall (pid {pids[0]}), Blind (pid {pids[1]})"
    assert second.line() == expected
    assert second.line() == "loaded"
    assert first.line() == expected
    contested = contested_slots(board)
    assert [described(slot, each) for slot, each in contested.items()] == [expected]
    third = process()
    line = third.start("Alone", "Third")
    assert line.endswith(f"Third (pid {third.popen.pid}, exclusive)")
    for each in (first, second):
        assert each.line().startswith("cmd has three commanders: ")
    third.end(signal.SIGKILL)
    first.end(signal.SIGKILL)
    assert contested_slots(board) == {}
    assert "commanders" not in second.end()


def test_machines_of_one_arrangement_may_share_a_slot(caplog: pytest.LogCaptureFixture) -> None:
    board = Whiteboard.local()
    with Arrangement([Wall, Wall], whiteboard=board) as arrangement:
        assert commanders(board) == ["Wall", "Wall.0"]
        assert contested_slots(board) == {}
        arrangement.run(max_rounds=3)
    assert not caplog.records


def test_more_machines_than_can_be_listed_may_share_a_slot(
    caplog: pytest.LogCaptureFixture,
) -> None:
    board = Whiteboard.local()
    with Arrangement(500 * [Wall], whiteboard=board) as arrangement:
        listed = commanders(board)
        assert 20 < len(listed) < 500
        with pytest.raises(LoadError, match="cannot claim 'cmd' exclusively"):
            arrangement.load(Alone, name="AsLongAsTheOthers")
        arrangement.run(max_rounds=2)
    assert commanders(board) == []
    assert not caplog.records


def test_one_that_wants_to_be_alone_is_warned_of_another_in_its_arrangement(
    caplog: pytest.LogCaptureFixture,
) -> None:
    board = Whiteboard.local()
    with Arrangement([Wall, Alone], whiteboard=board):
        assert [*contested_slots(board)] == ["cmd"]
    pid = os.getpid()
    assert [record.getMessage() for record in caplog.records] == [
        f"cmd has two commanders: Wall (pid {pid}), Alone (pid {pid}, exclusive)"
    ]


def test_a_claim_that_a_mirror_replaced_is_written_again(
    board: Whiteboard, process: Callable[[], Process]
) -> None:
    """The newest message of all hosts replaces the others, so two hosts' claims do at first."""
    first, second = process(), process()
    assert first.start("Wall", "First") == "loaded"
    mine = board.get_message(CLAIMS).commanders[0]
    pid = second.popen.pid
    other = Commander("Other", pid, born(pid), host_name(), pid_namespace(), 0)
    board.add_message(CLAIMS, Commanders("cmd", (other,)))
    wait_for(lambda: board.get_message(CLAIMS).commanders == (other, mine), "both are listed")
    assert first.line().startswith("cmd has two commanders: Other ")


def test_a_commander_of_another_host_lives_while_its_machines_are_published() -> None:
    board = Whiteboard.local()
    there = Commander("There", 1, 2, "elsewhere", 0, 3, exclusive=True)
    board.add_message(CLAIMS, Commanders("cmd", (there,)))
    board.add_message(status_slot("There"), MachineStatus("a", pid=1, born=2, host="elsewhere"))
    with Arrangement(whiteboard=board) as arrangement:
        with pytest.raises(ActuatorTakenError, match=r"There \(pid 1 on elsewhere, exclusive\)"):
            arrangement.load(Alone)
        gone = MachineStatus("a", loaded=False, pid=1, born=2, host="elsewhere")
        board.add_message(status_slot("There"), gone)
        arrangement.load(Alone)


# Machines of one name


def test_both_processes_report_a_machine_of_the_same_name_once(
    board: Whiteboard, process: Callable[[], Process]
) -> None:
    first, second = process(), process()
    assert first.start("Idle", "Wall") == "loaded"
    wait_for(lambda: board[status_slot("Wall")].count, "the first is published")
    assert second.start("Idle", "Wall") == "loaded"
    assert second.line() == (
        f"process {first.popen.pid} runs a machine Wall on this whiteboard, too; "
        f"this one is published as Wall.0"
    )
    assert first.line() == (
        f"process {second.popen.pid} runs a machine Wall on this whiteboard, too; "
        f"it is published as Wall.0"
    )
    board.add_message(BELL, Bell("Nobody"))
    beat = board[status_slot("Wall.0")].count
    wait_for(lambda: board[status_slot("Wall.0")].count > beat + 2, "they go on")
    assert first.end() == ""
    assert second.end() == ""


def test_a_commander_has_the_name_that_is_published(
    board: Whiteboard, process: Callable[[], Process]
) -> None:
    first, second = process(), process()
    assert first.start("Wall", "Wall") == "loaded"
    wait_for(lambda: board[status_slot("Wall")].count, "the first is published")
    second.ask("Wall", "Wall")
    wait_for(lambda: commanders(board) == ["Wall", "Wall.0"], "the claim has its name")
    assert [each.machine for each in contested_slots(board)["cmd"]] == ["Wall", "Wall.0"]
