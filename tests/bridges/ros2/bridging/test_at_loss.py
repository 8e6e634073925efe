"""A relay's `at_loss` is sent when the process is killed that commands its slot, and only then."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from llfsm.bridges.ros2.bridging._relays import LossWatch
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.transport import Notifier
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3

CMD = Slot("cmd", Twist)
RELAY = {"slot": "cmd", "type": "geometry_msgs/msg/Twist", "direction": "to_ros"}
STOP = Twist()
LOSS = {"at_loss": {"linear": {"x": 0}}}
PROGRAM = """
import sys
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
board = Whiteboard("test", directory=sys.argv[1], create=False)
board.add_message(Slot("cmd", Twist), Twist(Vector3(x=1.0)))
print("added", flush=True)
sys.stdin.read()
"""
Commands = Callable[[], "subprocess.Popen[str]"]


@pytest.fixture
def commander(board, tmp_path) -> Iterator[Commands]:
    """Start a process that commands the slot and goes on; returns once it has done so."""
    running: list[subprocess.Popen[str]] = []

    def start() -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(tmp_path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        running.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "added\n"
        return process

    yield start
    for process in running:
        process.kill()
        process.communicate()


class HandTimer:
    """A timer whose next action is done when the test says so."""

    def __init__(self) -> None:
        self.actions: list[Callable[[], object]] = []

    def call_later(self, seconds: float, do: Callable[[], object]) -> None:
        self.actions.append(do)

    def run(self, times: int) -> None:
        for _ in range(times):
            self.actions.pop()()


@pytest.fixture
def driven(peer, types, seen):
    got = seen()
    twist = types.message("geometry_msgs/msg/Twist")
    peer.node("robot").subscription("cmd", twist, lambda a: got(a.decode().linear.x), Qos(depth=99))
    return got


def test_it_is_sent_when_the_process_is_killed(start, board, commander, driven):
    start(relay=[RELAY | LOSS])
    process = commander()
    driven.wait(lambda got: got == [1.0])
    process.kill()
    driven.wait(lambda got: got == [1.0, 0.0])
    assert board[CMD].get() == STOP


def test_it_is_sent_for_one_that_died_before(start, commander, driven):
    process = commander()
    process.kill()
    process.wait()
    start(relay=[RELAY | LOSS])
    driven.wait(lambda got: got == [0.0])


def test_it_replaces_no_message_of_a_process_that_lives(board, commander):
    """Neither the commander's own, nor one that came after its death, and before it was noticed."""
    slot, timer = board[CMD], HandTimer()
    link = BridgeLink("cmd", "->", "/cmd", "geometry_msgs/msg/Twist", Notifier(print))
    process = commander()
    LossWatch(slot, STOP, CMD.encoder.encode(STOP), link, timer)
    timer.run(times=3)
    assert slot.get() == Twist(Vector3(x=1.0))
    process.kill()
    process.wait()
    timer.run(times=1)  # after the second look at the same message it would be replaced
    slot.add(Twist(Vector3(x=2.0)))
    timer.run(times=3)
    assert slot.get() == Twist(Vector3(x=2.0))
    assert slot.count == 2
