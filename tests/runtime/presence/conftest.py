"""Whiteboards in shared memory, and what uses them: processes with machines, guards."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator

import pytest

from driving import Runs
from llfsm.runtime.presence.guard import Guard
from llfsm.whiteboard import Whiteboard
from own_boards import own_board

from .claims import Process
from .workers import Processes


@pytest.fixture
def board_name() -> Iterator[str]:
    with own_board() as name:
        yield name


@pytest.fixture
def board(board_name: str) -> Iterator[Whiteboard]:
    with Whiteboard(board_name) as board:
        yield board


@pytest.fixture
def processes(board: Whiteboard) -> Iterator[Processes]:
    processes = Processes(board)
    yield processes
    processes.end()


@pytest.fixture
def process(board: Whiteboard) -> Iterator[Callable[..., Process]]:
    """Start processes on the board and see that they have ended."""
    started: list[Process] = []

    def start(*command: str) -> Process:
        started.append(Process(board.name, *command))
        return started[-1]

    yield start
    for each in started:
        each.end(signal.SIGKILL)


@pytest.fixture
def runs(board: Whiteboard) -> Iterator[Runs]:
    runs = Runs(board)
    yield runs
    runs.end()


@pytest.fixture
def guard(board: Whiteboard) -> Iterator[Guard]:
    guard = Guard(board)
    yield guard
    guard.close()
