"""Let a machine drive a turtle of ROS for long, through a bridge, while processes are killed.

A router, turtlesim as a ROS node, a bridge, RosWallTurttleBot and RosPingPong, each a process of
its own. Every now and then one is killed and started again. What has to hold:

* poses arrive again within ten seconds of each start;
* a bridge that is left alone takes no more memory, threads or files at its end than after a minute;
* when all have ended the graph is empty.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress

from use import Use

from free_ports import free_endpoint
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport
from llfsm.whiteboard import BoardNotFoundError, Slot, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.messages.turtlesim import Pose

_POSE = Slot("turtle1/pose", Pose)
_DOMAIN = 78
_PATIENCE_S = 10.0
_WARM_S = 60.0
_LOOK_S = 5.0
_LOOKS = 6


class Soak:
    """The processes, and what became of them."""

    def __init__(self, board: str, router: str) -> None:
        ros = ["--transport", "zenoh", "--domain", str(_DOMAIN), "--router", router]
        on_board = ["--board", board]
        self._commands = {
            "router": ["router", "--listen", router],
            "simulator": ["turtlesim", "--ros", *ros],
            "bridge": ["bridge", "turtlesim", *ros, *on_board, "--quiet"],
            "wall": ["run", "RosWallTurttleBot", *on_board, "-q"],
            "pingpong": ["run", "RosPingPong", *on_board, "-q"],
        }
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        for name in self._commands:
            self.start(name)

    def start(self, name: str) -> None:
        self.processes[name] = subprocess.Popen(
            [sys.executable, "-m", "llfsm.cli", *self._commands[name]],
            stdout=subprocess.DEVNULL,
        )

    def kill(self, name: str) -> None:
        process = self.processes.pop(name)
        process.kill()
        process.wait()

    def end(self) -> list[str]:
        """End all, the router last; return what is wrong with how they ended."""
        wrong = []
        for name, process in reversed(self.processes.items()):
            process.send_signal(signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                process.wait(_PATIENCE_S)
            if process.poll() != 0:
                wrong.append(f"the {name} ended with {process.poll()}")
                process.kill()
                process.wait()
        return wrong


def _pose_arrives(board: Whiteboard) -> bool:
    slot = board[_POSE]
    return slot.wait(after=slot.count, timeout=_PATIENCE_S) is not None


def soak(seconds: float, faults_s: float, say: Callable[[str], None]) -> list[str]:
    """Run for so long, killing one process every ``faults_s`` seconds; return what is wrong."""
    dice = random.Random(1)
    name, router = f"soak-{os.getpid()}", free_endpoint()
    wrong: list[str] = []
    with Whiteboard(name) as board:
        running = Soak(name, router)
        try:
            begin = fault = bridge_since = time.monotonic()
            warm: Use | None = None
            lately: deque[Use] = deque(maxlen=_LOOKS)
            while not wrong and time.monotonic() < begin + seconds:
                if not _pose_arrives(board):
                    wrong.append(f"no pose within {_PATIENCE_S:g} s")
                time.sleep(_LOOK_S)
                now = time.monotonic()
                use = Use.of(running.processes["bridge"].pid)
                lately.append(use)
                if now - bridge_since > _WARM_S:
                    warm = warm or Use.least(lately)
                    wrong += warm.grown(Use.least(lately))
                say(f"{now - begin:6.0f} s  bridge {use}  pose {board[_POSE].count}")
                if faults_s and now - fault > faults_s:
                    victim = dice.choice(["router", "simulator", "bridge", "wall"])
                    say(f"killing the {victim}")
                    running.kill(victim)
                    running.start(victim)
                    fault = now
                    if victim == "bridge":
                        bridge_since, warm = now, None
                        lately.clear()
            wrong += _end(running, router)
        finally:
            for process in running.processes.values():
                process.kill()
                process.wait()
            with suppress(BoardNotFoundError):
                remove_board(name)
    return wrong


def _end(running: Soak, router: str) -> list[str]:
    """End all but the router, look at the graph, and end that."""
    with ZenohTransport(_DOMAIN, router=[router], notify=lambda _: None) as witness:
        last = running.processes.pop("router")
        wrong = running.end()
        running.processes = {"router": last}
        if not witness.wait_graph(lambda graph: not graph.nodes, _PATIENCE_S):
            wrong.append(f"still on the graph: {witness.graph().nodes}")
    return wrong + running.end()


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--faults", type=float, default=90.0, help="seconds between two; 0: none")
    options = parser.parse_args()
    wrong = soak(options.seconds, options.faults, lambda line: print(line, flush=True))
    print("\n".join(wrong) or "all held")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
