"""Machines on another host's board are listed and controlled from this one."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from free_ports import free_endpoint
from llfsm.runtime import Arrangement, Machine, State, UnknownMachineError
from llfsm.runtime.presence.remote import Directory, RemoteMachine
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import BELL, Bell
from llfsm.whiteboard.mirror.daemon import daemon
from llfsm.whiteboard.mirror.settings import Settings
from waiting import wait_for


class Worker(Machine):
    WORK = State()
    NEVER = State()
    ASLEEP = State(suspend=True)
    WORK.to(NEVER, when=lambda m: False)


@pytest.fixture
def boards(tmp_path: Path) -> Iterator[list[Whiteboard]]:
    """Two boards, mirrored."""
    endpoint = free_endpoint()
    made = []
    with ExitStack() as stack:
        for name, settings in (
            ("here", Settings(listen=(endpoint,))),
            ("there", Settings(listen=(), connect=(endpoint,))),
        ):
            (tmp_path / name).mkdir()
            board = stack.enter_context(Whiteboard("both", directory=tmp_path / name))
            mirror = stack.enter_context(daemon(board, settings))
            thread = threading.Thread(target=mirror.run)
            thread.start()
            stack.callback(thread.join)
            stack.callback(board.add_message, BELL, Bell())  # which wakes it
            stack.callback(mirror.stop)
            made.append(board)
        yield made


def test_a_machine_of_another_host_is_found_suspended_and_resumed(
    boards: list[Whiteboard],
) -> None:
    here, there = boards
    arrangement = Arrangement([Worker], whiteboard=there, idle_us=1000)
    thread = threading.Thread(target=arrangement.run)
    thread.start()
    try:
        directory = Directory(here, host="another host")

        def found() -> RemoteMachine | None:
            try:
                return directory.find("Worker")
            except UnknownMachineError:
                return None

        wait_for(found)
        machine = directory.find("Worker")
        for _ in range(3):
            machine.request("restart")
            machine.request("suspend")
            wait_for(lambda: directory.find("Worker").suspended)
            assert directory.find("Worker").state == "ASLEEP"
            directory.find("Worker").request("resume")
            wait_for(lambda: not directory.find("Worker").suspended)
        assert [m.name for m in directory.machines()] == ["Worker"]
        machine.request("stop")
        wait_for(lambda: not thread.is_alive())
        wait_for(lambda: directory.machines() == [])
    finally:
        arrangement.stop("SIGTERM")
        thread.join()
