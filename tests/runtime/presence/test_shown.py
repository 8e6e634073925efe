"""What a program shows of a board: of one host, or of all; and whose machines it asks."""

from __future__ import annotations

import subprocess
import sys

import pytest

from llfsm.runtime.presence.hosts import NO_DAEMON, FleetReader, Shown
from llfsm.whiteboard import Board, Whiteboard
from llfsm.whiteboard.messages.llfsm import (
    HOSTS,
    MIRROR,
    Hosts,
    MirrorStatus,
    Viewer,
    status_slot,
    viewer_slot,
)

STATUSES = [status_slot(name).name for name in ("Wall", "robot7/Wall")]


OPERATOR = MirrorStatus(name="operator", fleet=("robot*",))
DAEMON = f"""
import sys
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import MIRROR, MirrorStatus
Whiteboard(sys.argv[1]).add_message(MIRROR, {OPERATOR!r})
"""


@pytest.fixture
def board() -> Board:
    """The board of an operator, as its daemon leaves it: this process, which lives."""
    board = Whiteboard.local("operators")
    board.add_message(MIRROR, OPERATOR)
    return board


def asked(board: Board) -> set[str]:
    slots = map(viewer_slot, ("", "robot7", "robot8"))
    return {slot.name for slot in slots if board.get_message(slot) is not None}


def test_the_host_of_each_machine_that_is_shown_is_asked(board: Board) -> None:
    Shown(board).ask(Viewer(1), STATUSES)
    assert asked(board) == {"llfsm/viewer", "llfsm/viewer/robot7/"}


def test_of_one_host_no_other_is_asked(board: Board) -> None:
    Shown(board, "robot8").ask(Viewer(1), STATUSES)
    assert asked(board) == {"llfsm/viewer/robot8/"}


def test_without_a_daemon_there_are_no_other_hosts() -> None:
    board = Whiteboard.local("alone")
    Shown(board).ask(Viewer(1), STATUSES)
    assert asked(board) == {"llfsm/viewer"}


@pytest.mark.parametrize(
    ("host", "slots"),
    [("", {"pose", "robot7/pose", "robot8/pose"}), ("robot7", {"robot7/pose"}),
     ("operator", {"pose"})],
)  # fmt: skip
def test_slots_of_one_host_are_shown_or_all(board: Board, host: str, slots: set[str]) -> None:
    shown = Shown(board, host)
    assert {each for each in ("pose", "robot7/pose", "robot8/pose") if shown.has(each)} == slots


def test_why_a_host_cannot_be_read(board: Board) -> None:
    def problem(host: str) -> str:
        return FleetReader(board, host).problem()

    assert problem("operator") == ""
    assert problem("yard") == "the `fleet` of this host does not list 'yard'"
    assert problem("robot7") == "no host 'robot7' can be reached; there are: none with a name"
    board.add_message(HOSTS, Hosts(("operator", "robot7")))
    assert problem("robot7") == ""


def test_a_daemon_may_be_started_later() -> None:
    board = Whiteboard.local("later")
    shown = Shown(board, "robot7")
    assert shown.fleet is not None
    assert "no daemon mirrors this whiteboard" in shown.fleet.problem()
    board.add_message(MIRROR, OPERATOR)
    board.add_message(HOSTS, Hosts(("robot7",)))
    shown.look()
    assert shown.fleet.problem() == ""


def test_the_end_of_the_daemon_is_noticed(board_name: str) -> None:
    with (
        Whiteboard(board_name) as board,
        FleetReader(board, "robot7", silent_s=0) as reader,
    ):
        board.add_message(HOSTS, Hosts(("operator", "robot7")))
        board.add_message(MIRROR, OPERATOR)
        reader.look()
        assert reader.problem() == "", "it may be slow: its process runs"
        assert reader.hosts() == ("operator", "robot7")
        subprocess.run([sys.executable, "-c", DAEMON, board_name], check=True)
        reader.look()
        assert (reader.problem(), reader.hosts()) == (NO_DAEMON, ())
        board.add_message(MIRROR, OPERATOR)
        reader.look()
        assert reader.problem() == ""
