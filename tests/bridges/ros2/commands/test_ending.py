"""Ctrl-C, as a terminal and `ros2 launch` send it: more than once."""

from __future__ import annotations

import signal
import subprocess

import pytest

from waiting import PATIENCE_S

COMMANDS = {
    "run": (["run", "--ros", "RosBlindTurttleBot", "-v"], "s  0 - RosBlindTurttleBot"),
    "managed": (["run", "--ros", "--lifecycle", "RosBlindTurttleBot"], "RosBlindTurttleBot on"),
    "bridge": (["bridge", "turtlesim"], "bridge: /llfsm_turtlesim_bridge"),
    "turtlesim": (["turtlesim", "--ros"], "Spawning turtle"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_any_number_of_interrupts_ends_as_one_does(run, board, router, domain, command):
    arguments, beginning = COMMANDS[command]
    where = ["--transport", "zenoh", "--router", router, "--domain", str(domain)]
    shared = ["--board", board.name] if command == "bridge" else []
    process = run(*arguments, *where, *shared)
    process.says(beginning)
    for _ in range(round(PATIENCE_S / 0.002)):
        process.process.send_signal(signal.SIGINT)
        try:
            status = process.process.wait(0.002)
        except subprocess.TimeoutExpired:
            continue
        assert status == 0, "".join(process.printed)
        return
    raise AssertionError("it does not end")
