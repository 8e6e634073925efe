"""No text of others commands the terminal of who looks at it."""

from __future__ import annotations

import ast
import logging
import os
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.cli.console import log_to_console
from llfsm.errors import LlfsmError, one_line, printable
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot
from llfsm.whiteboard.messages.std_msgs import String

from .conftest import Llfsm

EVIL = "\x1b]0;OWNED\x07\x1b]52;c;cm0gLXJmIH4=\x07\x1b[2J\x9b31m\u202e"
PRODUCT = Path(__file__).parents[2] / "src" / "llfsm" / "cli"


def commands_a_terminal(text: str) -> bool:
    return any(
        (ord(each) < 0x20 and each not in "\n\t") or 0x7F <= ord(each) < 0xA0 or each in "\u202e"
        for each in text
    )


@given(st.text())
def test_what_is_printable_commands_nothing_and_stays_else(text: str) -> None:
    assert not commands_a_terminal(printable(text))
    assert printable(printable(text)) == printable(text)
    if not commands_a_terminal(text) and not any(0x202A <= ord(e) < 0x206A for e in text):
        assert printable(text) == text


def evil(kind: Any) -> Any:
    """Make a message with that in all of its texts."""
    fields = {
        each.name: EVIL
        for each in msgspec.structs.fields(kind)
        if each.type is str and each.name not in ("host", "namespace")
    }
    assert len(fields) > 5
    return kind(**fields)


@pytest.fixture
def hostile(board: str) -> str:
    """Return a board on which a machine of this process has such texts, and slots have."""
    status = msgspec.structs.replace(
        evil(MachineStatus),
        pid=os.getpid(),
        born=born(os.getpid()),
        host=host_name(),
        namespace=pid_namespace(),
    )
    with Whiteboard(board) as made:
        made.add_message(status_slot("Evil"), status)
        made.add_message(Slot("s\x9b31m", String), String(EVIL))
        made.add_message(Slot("text", String), String(EVIL))
    return board


@pytest.mark.parametrize(
    "command",
    [
        ("ps", "-b", "BOARD"),
        ("ps", "-a"),
        ("top", "--once", "-b", "BOARD"),
        ("whiteboard", "list"),
        ("whiteboard", "list", "BOARD"),
        ("whiteboard", "get", "text", "-b", "BOARD"),
        ("whiteboard", "get", "s\x9b31m", "-b", "BOARD"),
        ("whiteboard", "get", EVIL.replace("\x1b", "e"), "-b", "BOARD"),
        ("why", "Evil", "-b", "BOARD"),
        ("pause", "-b", "BOARD"),
        ("show", EVIL),
        ("check", EVIL),
    ],
    ids=" ".join,
)
def test_a_command_prints_no_escapes(llfsm: Llfsm, hostile: str, command: tuple[str, ...]) -> None:
    done = llfsm.run(*(each.replace("BOARD", hostile) for each in command))
    assert done.stdout + done.stderr
    assert not commands_a_terminal(done.stdout), done.stdout
    assert not commands_a_terminal(done.stderr), done.stderr


def test_errors_and_logs_have_none(capsys: pytest.CaptureFixture[str]) -> None:
    assert not commands_a_terminal(one_line(LlfsmError(EVIL)))
    logged = logging.getLogger("evil")
    handler = logging.StreamHandler()
    log_to_console(logging.INFO, handler)
    handler.handle(logged.makeRecord("evil", logging.INFO, "", 1, EVIL, (), None))
    assert not commands_a_terminal(capsys.readouterr().err)


def test_there_is_one_way_to_print() -> None:
    """What is a file, and goes to standard output, is printed as it is."""
    found = []
    for file in PRODUCT.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("click.echo", "print"):
                found.append(file.name)
    assert sorted(found) == ["draw.py", "echo.py", "echo.py", "verify.py"]
