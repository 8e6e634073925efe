"""A running bridge on a terminal."""

from __future__ import annotations

import fcntl
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import time

import pyte

from llfsm.bridges.ros2.graph import Role
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import String
from waiting import PATIENCE_S

from .conftest import where


def test_a_terminal_has_a_table_that_changes_and_notices_above_it(
    board, domain, router, peer, types
):
    controller, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 120, 0, 0))
    to_ros = ["--to-ros", "pinpong:std_msgs/msg/String"]
    command = ["bridge", "ros2", *to_ros, *where(board, domain, router)]
    screen = pyte.Screen(120, 24)
    stream = pyte.ByteStream(screen)

    def see(*words):
        until = time.monotonic() + PATIENCE_S
        while not any(line.split()[: len(words)] == list(words) for line in screen.display):
            assert time.monotonic() < until, screen.display
            stream.feed(os.read(controller, 65536))

    with subprocess.Popen(
        [sys.executable, "-m", "llfsm.cli", *command],
        stdin=terminal, stdout=terminal, stderr=terminal,
        env=os.environ | {"TERM": "xterm"},
    ) as process:  # fmt: skip
        try:
            see("pinpong", "->", "/pinpong", "std_msgs/msg/String", "0")
            assert peer.wait_graph(
                lambda graph: bool(graph.ends("/pinpong", Role.PUBLISHER)), PATIENCE_S
            )
            peer.node("odd").subscription("pinpong", types.message("std_msgs/msg/Bool"), print)
            see("/pinpong:", "the", "subscription", "of", "/odd", "has", "type")
            for number in range(2):
                slot = Slot("pinpong", String)
                board.add_message(slot, String(str(number)))
                see("pinpong", "->", "/pinpong", "std_msgs/msg/String", str(number + 1))
            process.send_signal(signal.SIGINT)
            os.close(terminal)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
    os.close(controller)
