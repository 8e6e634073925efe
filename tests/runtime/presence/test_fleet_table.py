"""The table of a fleet's hosts, from what their daemons leave on this host's board."""

from __future__ import annotations

import math
import time

import pytest

from llfsm.runtime.presence.hosts import NO_DAEMON, FleetTable, HostRow
from llfsm.whiteboard import Board, Whiteboard
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import (
    HOSTS,
    MIRROR,
    Hosts,
    HostSummary,
    MirrorStatus,
    summary_slot,
)

HOUR_NS = 3_600_000_000_000


@pytest.fixture
def board() -> Board:
    """The board of an operator, with two robots there."""
    board = Whiteboard.local("operators")
    board.add_message(MIRROR, MirrorStatus(name="operator", fleet=("robot*",)))
    board.add_message(HOSTS, Hosts(("operator", "robot7", "robot8")))
    return board


def publish(board: Board, host: str, *, ahead_s: float = 0.0, troubled: int = 0) -> None:
    sent_ns = time.time_ns() + round(ahead_s * 1e9)
    board.add_message(summary_slot(host), HostSummary(sent_ns=sent_ns, troubled=troubled))


def table_of(board: Board) -> FleetTable:
    """Return the hosts of a fleet; how old summaries are depends on this machine's load."""
    return FleetTable(board, silent_s=math.inf)


def rows(table: FleetTable) -> dict[str, HostRow]:
    table.look()
    return {row.name: row for row in table.rows()}


def test_each_host_has_a_row_and_its_worst_trouble(board: Board) -> None:
    publish(board, "")
    publish(board, "robot7", troubled=1)
    with table_of(board) as table:
        found = rows(table)
        assert {name: row.trouble for name, row in found.items()} == {
            "operator": "", "robot7": "failed", "robot8": "",
        }  # fmt: skip
        assert [row.is_own for row in found.values()] == [True, False, False]
        assert found["robot8"].contact_ns is None, "it has published nothing"
        board.add_message(HOSTS, Hosts(("operator", "robot8")))
        assert rows(table)["robot7"].trouble == "lost"
        board.add_message(HOSTS, Hosts(("operator", "robot7", "robot8")))
        assert rows(table)["robot7"].trouble == "failed"


def test_a_host_that_was_seen_before_is_lost(board: Board) -> None:
    publish(board, "robot7")
    publish(board, "robot9", troubled=1)
    publish(board, "yard")  # of a host whose slots have no name here
    with table_of(board) as table:
        known = {name: row.trouble for name, row in rows(table).items()}
    assert known == {"operator": "", "robot7": "", "robot8": "", "robot9": "lost"}


def test_a_host_that_is_silent_is_lost(board: Board) -> None:
    publish(board, "robot7")
    with table_of(board) as table:
        assert rows(table)["robot7"].trouble == ""
    with FleetTable(board, silent_s=0) as table:
        assert rows(table)["robot7"].trouble == "lost"
        assert rows(table)["robot8"].trouble == "", "it may be older than summaries"


def test_a_host_is_not_silent_because_nobody_has_read_it() -> None:
    past_ns = HOUR_NS
    board = LocalBoard("operators", now_ns=lambda: time.monotonic_ns() - past_ns)
    publish(board, "robot7")
    past_ns = 0
    board.add_message(MIRROR, MirrorStatus(name="operator", fleet=("robot*",)))
    board.add_message(HOSTS, Hosts(("operator", "robot7")))
    with FleetTable(board, silent_s=HOUR_NS // 2 / 1e9) as table:
        row = rows(table)["robot7"]
    assert row.trouble == ""
    assert row.contact_ns is not None
    assert time.monotonic_ns() - row.contact_ns >= HOUR_NS


def test_the_lead_of_a_clock_is_that_of_the_fastest_message(board: Board) -> None:
    """But not of the first one, which may have waited for a reader."""
    with table_of(board) as table:
        publish(board, "robot7", ahead_s=500)
        assert rows(table)["robot7"].lead_s is None
        for delay_s in (60, 0, 30):
            publish(board, "robot7", ahead_s=100 - delay_s)
            table.look()
        lead_s = rows(table)["robot7"].lead_s
        assert lead_s is not None
        assert 90 < lead_s <= 100
        assert rows(table)["robot7"].trouble == "clock"
        for _ in range(10):
            publish(board, "robot7", ahead_s=-100)
            table.look()
        lead_s = rows(table)["robot7"].lead_s
        assert lead_s is not None
        assert lead_s <= -100, "what it was is forgotten"


def test_only_the_hosts_and_their_summaries_are_read(board: Board) -> None:
    with table_of(board) as table:
        table.look()
        summaries = {summary_slot(host).name for host in ("", "robot7", "robot8")}
        assert board.read_slots() - {MIRROR.name} == {HOSTS.name, *summaries}
    assert board.read_slots() == {MIRROR.name}


def test_without_a_daemon_there_are_no_hosts() -> None:
    board = Whiteboard.local("alone")
    with table_of(board) as table:
        assert table.problem() == NO_DAEMON
        assert table.rows() == []
        board.add_message(MIRROR, MirrorStatus(name="operator", fleet=("robot*",)))
        board.add_message(HOSTS, Hosts(("operator", "robot7", "yard")))
        assert [*rows(table)] == ["operator", "robot7"], "the yard has no name here"
        assert table.problem() == ""
        board.add_message(MIRROR, MirrorStatus(name="robot7", fleet=("operator",)))
        assert [row.is_own for row in rows(table).values()] == [False, True]
