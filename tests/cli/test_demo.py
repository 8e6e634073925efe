"""`llfsm demo`: what is started ends together, whoever dies first, and leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path
from urllib.request import urlopen

import pytest

from waiting import wait_for

from .conftest import Llfsm, alive, children, exists, stopped, wait_for_line


def start(llfsm: Llfsm, board: str, name: str = "wall") -> subprocess.Popen[str]:
    process = llfsm.start("demo", name, "-b", board, "--picture", "pictures/path")
    wait_for_line(process, "turtle1 at")  # by then machine and simulator are up
    return process


def assert_nothing_left(board: str, pids: list[int]) -> None:
    wait_for(lambda: not any(map(alive, pids)), f"an end of {pids}")
    assert not exists(board)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all_and_leaves_a_picture(
    llfsm: Llfsm, board: str, tmp_path: Path, number: signal.Signals
) -> None:
    process = start(llfsm, board)
    pids = list(children(process.pid).values())
    assert len(pids) == 2
    process.send_signal(number)
    printed = process.stdout.read()
    assert process.wait() == 0
    assert_nothing_left(board, pids)
    for kind in ("svg", "png"):
        assert (tmp_path / "pictures" / f"path.{kind}").stat().st_size > 0
        assert f"path.{kind}" in printed


@pytest.mark.parametrize("victim", ["turtlesim", "run"])
def test_a_killed_process_is_reported_and_all_end(llfsm: Llfsm, board: str, victim: str) -> None:
    process = start(llfsm, board)
    pids = children(process.pid)
    os.kill(pids[victim], signal.SIGKILL)
    printed = process.stdout.read()
    assert process.wait() == 1
    assert "was killed by SIGKILL" in printed
    assert_nothing_left(board, list(pids.values()))


def test_a_killed_demo_takes_its_processes_and_its_board_with_it(llfsm: Llfsm, board: str) -> None:
    process = start(llfsm, board)
    pids = list(children(process.pid).values())
    process.kill()
    assert_nothing_left(board, pids)


def test_it_starts_again_after_all_were_killed(llfsm: Llfsm, board: str) -> None:
    process = start(llfsm, board)
    pids = [process.pid, *children(process.pid).values()]
    for pid in pids:  # or the last would see the end of the first, and remove the board
        os.kill(pid, signal.SIGSTOP)
    wait_for(lambda: all(map(stopped, pids)), "all stand still")
    for pid in pids:
        os.kill(pid, signal.SIGKILL)
    process.wait()
    assert exists(board)
    again = llfsm.run("demo", "wall", "-b", board, "--seconds", "1")
    assert again.returncode == 0
    assert "that an earlier run left" in again.stderr
    assert not exists(board)


def test_a_board_in_use_is_left_alone(llfsm: Llfsm, board: str) -> None:
    process = start(llfsm, board)
    second = llfsm.run("demo", "wall", "-b", board, "--seconds", "1")
    assert second.returncode == 1
    assert "is in use" in second.stderr
    assert process.poll() is None


def test_every_demo_runs(llfsm: Llfsm, board: str) -> None:
    for name, machine in (
        ("blind", "RosBlindTurttleBot: INITIAL"),
        ("suspend", "RosBlindTurttleBot: Suspended"),
        ("pingpong", "RosPingPong: PUBLISH"),
    ):
        process = llfsm.start("demo", name, "-b", board)
        wait_for_line(process, machine)
        process.send_signal(signal.SIGINT)
        assert process.wait() == 0, process.stdout.read()
        assert not exists(board)


def test_the_terminal_shows_machine_position_and_board(llfsm: Llfsm, board: str) -> None:
    """In a real pseudo-terminal, as rendered."""
    import pty

    import pyte

    screen = pyte.Screen(110, 40)
    stream = pyte.ByteStream(screen)
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ |= {"TERM": "xterm-256color", "COLUMNS": "110", "LINES": "40"}
        os.chdir(llfsm.cwd)
        command = [*llfsm.command(("demo", "wall", "-b", board, "--seconds", "30"))]
        os.execv(command[0], command)
    shown = ""
    wanted = (
        "RosWallTurttleBot",
        "STRAIGHT",
        "turtle1 at",
        "turtle1/cmd_vel",
        "linear",
        "simulator",
    )
    try:
        while not all(text in shown for text in wanted):
            stream.feed(os.read(terminal, 65536))
            shown = "\n".join(screen.display)
        os.write(terminal, b"\x03")
        with suppress(OSError):  # EIO: it has closed its end
            while os.read(terminal, 65536):  # else it waits for room for what it prints
                pass
        _, status = os.waitpid(pid, 0)
    finally:
        os.close(terminal)
    assert os.waitstatus_to_exitcode(status) == 0
    assert not exists(board)


def test_a_page_shows_it(llfsm: Llfsm, board: str) -> None:
    process = llfsm.start("demo", "wall", "--view", "-b", board)
    address = wait_for_line(process, "in the browser: http").partition("browser: ")[2].strip()
    answers: list[str] = []

    def answered() -> bool:
        with suppress(OSError), urlopen(address) as answer:
            answers.append(answer.read().decode())
        return bool(answers)

    wait_for(answered, "the page is served")
    assert "<html" in answers[0]
    with urlopen(address.replace("/?", "/about?")) as about:  # the address has the page's token
        assert about.status == 200
    process.send_signal(signal.SIGINT)
    assert process.wait() == 0
    with pytest.raises(OSError, match="refused"):
        urlopen(address)
