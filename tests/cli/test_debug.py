"""`llfsm debug`: machines of its own process are debugged from a prompt."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from llfsm.cli.debug.prompt import LivePrompt
from llfsm.cli.debug.session import Session
from llfsm.cli.machines import parse_arguments
from llfsm.errors import LlfsmError
from llfsm.runtime import ManualClock
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import status_slot
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

from .conftest import MACHINES, Llfsm

BOUNCER = f"{MACHINES}:Bouncer"
DRIVE = Slot("drive", Int32)


@pytest.fixture
def session() -> Iterator[Session]:
    environment = LiveEnvironment(Whiteboard.local(), ManualClock())
    with Session(parse_arguments([BOUNCER], None, (), ()), environment) as session:
        session.wait()
        yield session


def entered(prompt: LivePrompt, *lines: str) -> list[str]:
    return [printed for line in lines for printed in prompt.do(line)]


def test_a_machine_is_stepped_broken_and_explained(session: Session) -> None:
    prompt = LivePrompt(session)
    assert [*prompt.where()] == ["start: round 1, Bouncer in GO"]
    assert entered(prompt, "step", "s round") == [
        "step: turn: round 2, Bouncer in GO",
        "step: round: round 3, Bouncer in GO",
    ]
    assert entered(prompt, "break Bouncer:STOP", "b @pose#9", "clear @pose#9") == [
        *("Bouncer:STOP", "Bouncer:STOP", "@pose#9", "Bouncer:STOP"),
    ]
    assert entered(prompt, 'post pose {"data": 12}', "continue", "why")[:4] == [
        "message 1 of pose",
        "breakpoint Bouncer:STOP: round 4, Bouncer in STOP",
        "it has left GO:",
        "  true   -> STOP  m.pose.data > 9  pose.data=12 > 9",
    ]
    assert entered(prompt, "override Bouncer pose null", "step fire") == [
        "Bouncer: pose is overridden",
        "step: transition: round 5, Bouncer in GO",
    ]
    assert entered(prompt, "show sensors", "sh variables Bouncer", "show machines") == [
        *("pose = Int32(data=0)  (overridden)", "bounces = 1", "Bouncer in GO"),
    ]
    assert entered(prompt, "clear", "release Bouncer pose", "step leave", "pause") == [
        "no breakpoints",
        "Bouncer: pose is released",
        "step: Bouncer left GO: round 6, Bouncer in STOP",
        "step: Bouncer left GO: round 6, Bouncer in STOP",
    ]
    assert entered(prompt, "", "  ") == []
    assert not prompt.over
    assert entered(prompt, "quit") == []
    assert prompt.over


def test_at_a_breakpoint_its_machine_is_shown() -> None:
    """Not the one that has its turn next."""
    machines = parse_arguments([BOUNCER, f"Other={BOUNCER}"], None, (), ())
    environment = LiveEnvironment(Whiteboard.local(), ManualClock())
    with Session(machines, environment) as session:
        prompt = LivePrompt(session)
        found = entered(prompt, 'post pose {"data": 12}', "break Bouncer:STOP", "continue", "why")
        assert found[2:4] == [
            "breakpoint Bouncer:STOP: round 1, Bouncer in STOP, before the turn of Other",
            "it has left GO:",
        ]
        assert entered(prompt, "step")[-1].endswith("round 1, Other in GO") is False


def test_what_the_machines_end_with_is_printed(session: Session) -> None:
    prompt = LivePrompt(session)
    session.arrangement.whiteboard.add_message(Slot("pose", Int32), Int32(data=-1))
    assert entered(prompt, "break Bouncer!", "continue")[1].startswith(
        "breakpoint Bouncer!: machine Bouncer, state GO, Internal: ValueError: behind"
    )
    assert not prompt.over
    (ended,) = entered(prompt, "continue")
    assert ended.startswith("the machines have ended: machine Bouncer, state GO, Internal: Value")
    assert prompt.over


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("whi", "no command 'whi'; did you mean 'why'?"),
        ("step over", "no step 'over'; there are: turn, round, fire, leave"),
        ("step leave Bouncr", "no machine 'Bouncr'"),
        ("break Bouncer:GOO", "no state of Bouncer 'GOO'"),
        ("clear Bouncer:GO", "no breakpoint 'Bouncer:GO'; there are: none"),
        ("why Bouncr", "no machine 'Bouncr'"),
        ("show", "show what? There are: machines, sensors, variables, breakpoints"),
        ("show sensors Bouncr", "no machine 'Bouncr'"),
        ("post pose", "usage: post SLOT MESSAGE"),
        ("post pos {}", "'pos'"),
        ("post pose {dat}", "invalid message"),
        ("override Bouncer pose", "usage: override MACHINE SENSOR MESSAGE"),
        ("override Bouncer pos {}", "Bouncer has no sensor 'pos'"),
        ("release Bouncer", "usage: release MACHINE SENSOR"),
    ],
)
def test_a_line_that_is_wrong_changes_nothing(session: Session, line: str, problem: str) -> None:
    with pytest.raises(LlfsmError) as raised:
        entered(LivePrompt(session), line)
    assert problem in str(raised.value)
    assert session.debugger.paused == "start"
    assert session.debugger.breakpoints == ()


def test_words_are_completed(session: Session) -> None:
    prompt = LivePrompt(session)
    prompt_words = {
        "": {"step", "continue", "why", "quit"},
        "step ": {"turn", "round", "fire", "leave"},
        "st leave ": {"Bouncer"},
        "why ": {"Bouncer"},
        "break ": {"Bouncer:GO", "Bouncer:STOP", "Bouncer!", "@pose"},
        "post ": {"pose", "drive"},
        "show ": {"sensors"},
        "override Bouncer ": {"pose"},
        "override Nobody ": set(),
        "why Bouncer ": set(),
    }
    for before, words in prompt_words.items():
        assert words <= {*prompt.candidates(before)}, before
    assert prompt.candidates("override Nobody ") == prompt.candidates("x ") == []


def test_in_a_terminal(llfsm: Llfsm, board: str, tmp_path: Path) -> None:
    """Words are completed, Ctrl-C pauses, lines are kept, and machines end with the terminal."""
    import pty

    import pyte

    screen = pyte.Screen(100, 40)
    stream = pyte.ByteStream(screen)
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ |= {"TERM": "xterm-256color", "COLUMNS": "100", "XDG_STATE_HOME": str(tmp_path)}
        command = llfsm.command(("debug", BOUNCER, "-b", board))
        os.execv(command[0], command)

    def shows(text: str) -> None:
        def looks() -> bool:  # for the text, with a prompt that takes keys
            if select.select([terminal], [], [], 0)[0]:
                stream.feed(os.read(terminal, 65536))
            prompted = screen.display[screen.cursor.y].strip() == "llfsm>"
            return prompted and any(line.startswith(text) for line in screen.display)

        wait_for(looks, text)

    try:
        shows("start: round 1, Bouncer in GO")
        os.write(terminal, b"br\t Bouncer:S\t\n")
        shows("Bouncer:STOP")
        os.write(terminal, b'override Bou\t po\t{"data": 12}\n')
        shows("Bouncer: pose is overridden")
        os.write(terminal, b"c\n")
        shows("breakpoint Bouncer:STOP: round 2, Bouncer in STOP")
        with Whiteboard(board, create=False) as wb:
            status, drive = wb[status_slot("Bouncer")], wb[DRIVE]
            wait_for(lambda: status.get().paused, "the pause on the board")
            os.write(terminal, b"c\n")
            wait_for(lambda: not status.get().paused, "it runs")
            os.write(terminal, b"\x03")
            shows("interrupt: round")
            os.close(terminal)
            wait_for(lambda: drive.get() == Int32(data=-1), "the value for the end")
        ended = os.waitpid(pid, 0)[1]
        pid = 0
        assert os.waitstatus_to_exitcode(ended) == 128 + signal.SIGHUP
        assert "override" in (tmp_path / "llfsm/history").read_text()
    finally:
        if pid:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
