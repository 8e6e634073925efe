"""`llfsm top` shows what is on a board, in a terminal and without one."""

from __future__ import annotations

import os
import signal

import pytest
from click.testing import CliRunner

from llfsm.cli.ps import top
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32, String
from waiting import wait_for

from .conftest import Llfsm

NUMBER = Slot("robot/number", Int32)
TEXT = Slot("robot/text", String)


def test_once_reports_machines_and_slots_as_plain_lines(llfsm: Llfsm, board: str) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(NUMBER, Int32(data=7))
        wb.add_message(TEXT, String(data="[red]{x}" + 200 * "long "))
        _ = wb[Slot("robot/empty", String)]
        machine = llfsm.start("run", "RosPingPong", "-q", "-b", board)
        machine.stdout.readline()  # by then it has posted
        done = llfsm.run("top", "-b", board, "--once")
    assert done.returncode == 0, done.stderr
    lines = {line.split()[0]: line for line in done.stdout.splitlines() if line}
    assert f"whiteboard {board}, machines: 1, slots: 4" in done.stdout
    assert "running" in lines["RosPingPong"]
    assert f"pid {machine.pid}" in lines["RosPingPong"]
    assert lines["robot/number"].split() == [
        *("robot/number", "1", "0.0/s"),
        *lines["robot/number"].split()[3:5],
        *("pid", str(os.getpid()), "data:", "7"),
    ]
    assert lines["robot/text"].endswith("data: [red]{x}" + (200 * "long ").rstrip())
    assert lines["robot/empty"].split() == ["robot/empty", "-", "0.0/s", "-"]
    assert "llfsm/" not in done.stdout
    assert "\x1b" not in done.stdout


@pytest.mark.parametrize("end", [b"\x03", signal.SIGTERM])
def test_a_terminal_shows_changes_and_is_itself_again_at_the_end(
    llfsm: Llfsm, board: str, end: bytes | signal.Signals
) -> None:
    import pty

    import pyte

    screen = pyte.Screen(100, 24)
    stream = pyte.ByteStream(screen)
    with Whiteboard(board) as wb:
        wb.add_message(NUMBER, Int32(data=1))
        pid, terminal = pty.fork()
        if pid == 0:
            os.environ |= {"TERM": "xterm-256color", "COLUMNS": "100", "LINES": "24"}
            command = llfsm.command(("top", "-b", board))
            os.execv(command[0], command)
        try:
            for value in (1, 2, 3):
                wb.add_message(NUMBER, Int32(data=value))
                printed = b""

                def shown(value: int = value) -> bool:
                    nonlocal printed
                    printed += os.read(terminal, 65536)
                    stream.feed(printed)
                    printed = b""
                    return any(f"data: {value}" in line for line in screen.display)

                wait_for(shown, f"{value} on the screen")
            if isinstance(end, bytes):
                os.write(terminal, end)
            else:
                os.kill(pid, end)
            rest = b""
            while True:
                try:
                    more = os.read(terminal, 65536)
                except OSError:  # the other side is closed
                    break
                if not more:
                    break
                rest += more
            _, status = os.waitpid(pid, 0)
        finally:
            os.close(terminal)
    assert os.waitstatus_to_exitcode(status) == 0
    assert b"\x1b[?25h" in rest  # the cursor is there,
    assert b"\x1b[?1049l" in rest  # and what was on the screen before


def test_a_board_that_is_removed_ends_it(llfsm: Llfsm, board: str) -> None:
    import pty

    with Whiteboard(board) as wb:
        controller, terminal = pty.openpty()
        pid = os.fork()
        if pid == 0:
            os.dup2(terminal, 0)
            os.dup2(terminal, 1)
            os.dup2(terminal, 2)
            command = llfsm.command(("top", "-b", board))
            os.execv(command[0], command)
        os.close(terminal)
        printed = os.read(controller, 65536)
        wb.remove()
        while True:
            try:
                printed += os.read(controller, 65536)
            except OSError:
                break
        os.close(controller)
        _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == 1
    assert f"Error: the whiteboard '{board}' was removed" in printed.decode()


def test_a_board_that_is_not_there_is_named(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("top", "-b", board)
    assert done.returncode == 1
    assert done.stderr.startswith("Error: ")
    assert board in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_host_that_cannot_be_reached_is_an_error(board: str) -> None:
    with Whiteboard(board):
        done = CliRunner().invoke(top, ["-b", board, "--once", "--host", "robot7"])
    assert (done.exit_code, "no daemon mirrors this whiteboard" in done.output) == (1, True)
