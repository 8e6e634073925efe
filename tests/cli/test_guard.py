"""Every command that guards a whiteboard posts the safe values of a machine that was killed."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from driving import DRIVE, SAFE, Runs, kill
from llfsm.whiteboard import Whiteboard
from waiting import PATIENCE_S, wait_for

from .conftest import Llfsm, wait_for_line

GUARDS = {
    "guard": ("guard", "-b", "BOARD"),
    "daemon": ("whiteboard", "daemon", "-b", "BOARD", "--listen", "tcp/127.0.0.1:0"),
    "bridge ros2": (
        *("bridge", "ros2", "--to-ros", "text:std_msgs/msg/String", "--transport", "zenoh"),
        *("--router", "tcp/127.0.0.1:1", "--domain", "87", "-b", "BOARD"),
    ),
    "view": ("view", "-b", "BOARD", "--no-open", "--port", "0"),
}


@pytest.fixture
def runs(board: str) -> Iterator[Runs]:
    with Whiteboard(board) as shared:
        runs = Runs(shared)
        yield runs
        runs.end()


@pytest.mark.parametrize("which", GUARDS)
@pytest.mark.parametrize("first", ["guard", "machine"])
def test_the_safe_value_of_a_killed_machine_is_posted(
    llfsm: Llfsm, board: str, runs: Runs, which: str, first: str
) -> None:
    command = [board if word == "BOARD" else word for word in GUARDS[which]]
    guard = llfsm.start(*command) if first == "guard" else None
    machine = runs.start()
    kill(machine)
    if guard is None:
        guard = llfsm.start(*command)
    with Whiteboard(board) as shared:
        wait_for(lambda: shared.get_message(DRIVE) == SAFE, "the safe value is posted")
    line = wait_for_line(guard, "died without shutting down")
    assert line == (
        f"Drives: process {machine.pid} died without shutting down; "
        f"posted its safe values to drive, lamp\n"
    )
    guard.send_signal(signal.SIGTERM)
    assert guard.wait(PATIENCE_S) in (0, 128 + signal.SIGTERM)
