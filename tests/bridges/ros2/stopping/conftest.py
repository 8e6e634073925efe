"""A machine that drives a robot through a bridge, each in a process of its own where that is real.

The robot subscribes to `cmd_vel`: in this process through a transport in memory or rclpy; over
Zenoh it is the independent peer in its process.
"""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest

import wheels
from forked import Forked
from llfsm.bridges.ros2.graph import Role
from llfsm.runtime.presence.guard import GuardThread
from llfsm.whiteboard import BoardNotFoundError, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.messages.llfsm import status_slot, will_slot
from llfsm.whiteboard.messages.std_msgs import String
from memory_transport import MemoryWorld
from ros_domains import own_domains
from stopping_robot import TWIST, Robot, memory_bridge, memory_robot, subscribe
from waiting import PATIENCE_S, wait_for
from wheels import CMD_VEL, CUE, LAMP

HERE = Path(__file__).parent
PEER, HASHES = HERE.parent / "zenoh_transport" / "peer.py", "data/ros2/type_hashes.json"
LLFSM = [sys.executable, "-m", "llfsm.cli"]
DOMAIN = own_domains()[-1]


class Processes:
    """Processes that end with the test, if not before."""

    def __init__(self) -> None:
        self._stack = ExitStack()

    def start(self, command: list[str], **options: Any) -> subprocess.Popen[str]:
        process = self._stack.enter_context(Forked(command, text=True, **options))
        self._stack.callback(process.kill)
        return process

    def end(self) -> None:
        self._stack.close()


class Rig:
    """A whiteboard, a bridge that guards it, and a robot; machines are started on it."""

    def __init__(self, name: str, board: Whiteboard, robot: Robot, processes: Processes) -> None:
        self.name = name
        self.board = board
        self.robot = robot
        self.processes = processes
        self.bridge: int = os.getpid()
        """The process of the bridge."""

    def drive(self, *options: str, env: dict[str, str] | None = None) -> subprocess.Popen[str]:
        """Start the machine's process, and wait until the robot moves."""
        process = self.processes.start(
            [*LLFSM, "run", "-q", "wheels:Wheels", "-b", self.board.name, *options],
            env=os.environ | {"PYTHONPATH": str(Path(wheels.__file__).parent)} | (env or {}),
            stderr=subprocess.PIPE,
        )
        self.robot.moves_on()
        return process

    def cue(self, what: str) -> None:
        self.board.add_message(CUE, String(what))

    @property
    def lamp(self) -> str:
        return self.board.get_message(LAMP).data

    @property
    def commander(self) -> int:
        """The process whose command is the latest."""
        return self.board[CMD_VEL].sample().writer

    @property
    def will(self) -> str:
        return self.board.get_message(will_slot("Wheels")).state

    @property
    def silent_ms(self) -> float:
        """How long no status had been published when the latest command was."""
        status = self.board[status_slot("Wheels")].sample()
        return (self.board[CMD_VEL].sample().stamp_ns - status.stamp_ns) / 1e6


@pytest.fixture
def processes() -> Iterator[Processes]:
    processes = Processes()
    yield processes
    processes.end()


def zenoh_robot(robot: Robot, processes: Processes, router: str) -> subprocess.Popen[str]:
    """Start an independent ROS 2 node in a process of its own."""
    hashes = HERE.parents[2] / HASHES
    peer = processes.start(
        [sys.executable, str(PEER), router.rpartition(":")[2], str(DOMAIN), str(hashes)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert peer.stdin is not None
    peer.stdin.write(json.dumps(["subscriber", f"/{CMD_VEL.name}", None]) + "\n")
    peer.stdin.flush()
    ready = threading.Event()

    def listen() -> None:
        assert peer.stdout is not None
        with suppress(ValueError):  # the pipe was closed
            for line in peer.stdout:
                kind, *values = json.loads(line)
                if kind == "message":
                    robot(values[0])
                ready.set()

    threading.Thread(target=listen, daemon=True).start()
    wait_for(ready.is_set, "the robot subscribes")
    return peer


def bridge_process(
    board: Whiteboard, processes: Processes, transport: str, *where: str, **options: Any
) -> subprocess.Popen[str]:
    relay = ("--to-ros", f"{CMD_VEL.name}:{TWIST}")
    place = ("-b", board.name, "--transport", transport, "--domain", str(DOMAIN), *where)
    process = processes.start(
        [*LLFSM, "bridge", "ros2", *relay, *place, "-q"], stderr=subprocess.PIPE, **options
    )
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("bridge: "):
            break
    return process


@pytest.fixture(scope="module")
def new_board() -> Iterator[Callable[[str], Whiteboard]]:
    numbers = itertools.count()
    with ExitStack() as stack:

        def make(what: str) -> Whiteboard:
            name = f"{what}-{os.getpid()}-{next(numbers)}"
            board = stack.enter_context(Whiteboard(name))

            def remove() -> None:
                with suppress(BoardNotFoundError):
                    remove_board(name)

            stack.callback(remove)
            return board

        yield make


@pytest.fixture(scope="module", params=["memory", "zenoh", "rclpy"])
def shared_rig(
    request: pytest.FixtureRequest, new_board: Callable[[str], Whiteboard]
) -> Iterator[Rig]:
    """Run a bridge for all tests of a module."""
    kind = request.param
    if kind == "rclpy" and importlib.util.find_spec("rclpy") is None:
        pytest.skip("rclpy cannot be imported: no ROS 2 environment is sourced")
    board, robot, lasting = new_board(kind), Robot(), Processes()
    rig = Rig(kind, board, robot, lasting)
    with ExitStack() as stack:
        stack.callback(lasting.end)
        if kind == "memory":
            memory = MemoryWorld()
            memory_robot(memory, robot, stack)
            memory_bridge(board, memory, stack)
            stack.enter_context(GuardThread(board.name))
        elif kind == "zenoh":
            router = request.getfixturevalue("router")
            rig.bridge = bridge_process(board, lasting, "zenoh", "--router", router).pid
            zenoh_robot(robot, lasting, router)
        else:
            from llfsm.bridges.ros2.rclpy_transport.transport import RclpyTransport

            request.getfixturevalue("middleware")
            rig.bridge = bridge_process(board, lasting, "rclpy").pid
            peer = stack.enter_context(RclpyTransport(DOMAIN, notify=lambda _: None))
            subscribe(peer, robot)
            peer.wait_graph(
                lambda graph: bool(graph.ends(f"/{CMD_VEL.name}", Role.PUBLISHER)), PATIENCE_S
            )
        yield rig


@pytest.fixture
def rig(shared_rig: Rig, processes: Processes) -> Rig:
    """Return the rig with no machine on it."""
    shared_rig.processes = processes
    return shared_rig
