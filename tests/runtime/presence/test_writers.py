"""A process that posts to a machine's slot without a machine is reported, too."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest

import posting
from commanding import CMD, Wall
from forked import Forked
from llfsm.runtime import Arrangement, ManualClock
from llfsm.runtime.presence import slot_ownership as module
from llfsm.runtime.presence.slot_ownership import Claims, contested_slots, described
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

from .claims import Process, commanders

Post = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def post(board: Whiteboard) -> Iterator[Post]:
    """Start processes that post to the slot."""
    started: list[subprocess.Popen[str]] = []

    def start(*pause_s: str) -> subprocess.Popen[str]:
        started.append(
            Forked(
                [sys.executable, posting.__file__, board.name, *pause_s],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        )
        return started[-1]

    yield start
    for each in started:
        each.kill()
        each.communicate()


Wait = Callable[[float], None]


@pytest.fixture
def wait(monkeypatch: pytest.MonkeyPatch) -> Wait:
    """Stop the clock of those who look for other writers; return what lets seconds pass there."""
    now_ns = time.monotonic_ns()

    def pass_(seconds: float) -> None:
        nonlocal now_ns
        now_ns += round(seconds * 1e9)

    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic_ns=lambda: now_ns))
    return pass_


def _add(process: subprocess.Popen[str], times: int) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{times}\n")
    process.stdin.flush()
    assert process.stdout.readline() == "added\n"


def test_both_report_it_once_and_tools_show_it_while_it_posts(
    board: Whiteboard, process: Callable[..., Process], post: Post
) -> None:
    machine = process()
    assert machine.start("Wall", "Wall") == "loaded"
    other = post("0.05")
    assert other.stdout is not None
    expected = f"cmd has two commanders: Wall (pid {machine.popen.pid}), process {other.pid}"
    assert machine.line() == expected
    assert other.stdout.readline() == expected + "\n"
    assert [described(*each) for each in contested_slots(board).items()] == [expected]
    other.kill()
    other.wait()
    assert contested_slots(board) == {}
    again = post("0.05")
    assert machine.line() == expected.replace(str(other.pid), str(again.pid))
    assert machine.end() == ""
    wait_for(lambda: commanders(board) == [], "nobody is listed where no machine posts")
    again.kill()
    printed, _ = again.communicate()
    assert printed.count("commanders") <= 1


def test_who_posts_no_more_is_listed_no_more(board: Whiteboard, post: Post, wait: Wait) -> None:
    claims = Claims(board)
    claims.take("Mine", {CMD: False})
    _add(post(), 4)
    claims.look()
    assert commanders(board) == ["Mine", ""]
    wait(1)
    claims.look()
    assert commanders(board) == ["Mine", ""]
    assert [*contested_slots(board)] == ["cmd"]
    wait(100)
    claims.look()
    assert commanders(board) == ["Mine"]


def test_one_or_two_messages_command_nothing(board: Whiteboard, post: Post, wait: Wait) -> None:
    """A guard adds one where a process has died, and a person one by hand."""
    claims = Claims(board)
    claims.take("Mine", {CMD: False})
    _add(post(), 2)
    claims.look()
    assert commanders(board) == ["Mine"]
    board.add_message(CMD, Int32())
    for _ in range(4):  # this process has a machine that posts there
        board.add_message(CMD, Int32())
    wait(1)
    claims.look()
    assert commanders(board) == ["Mine"]


def test_who_writes_does_not_keep_an_exclusive_machine_from_its_slot(
    board: Whiteboard, post: Post, process: Callable[..., Process]
) -> None:
    """It cannot be told to stop: the machine is loaded, and warned of."""
    other = post("0.05")
    machine = process()
    assert machine.start("Alone", "Alone") == "loaded"
    assert machine.line() == (
        f"cmd has two commanders: Alone (pid {machine.popen.pid}, exclusive), process {other.pid}"
    )


def test_on_a_board_of_one_process_nobody_else_writes() -> None:
    board = Whiteboard.local()
    with Arrangement([Wall], whiteboard=board, clock=ManualClock()) as arrangement:
        for _ in range(4):
            board.add_message(CMD, Int32())
        arrangement.run(max_rounds=2)
    assert contested_slots(board) == {}
