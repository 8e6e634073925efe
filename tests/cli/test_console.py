"""Where commands log to, and how one ends by a signal."""

from __future__ import annotations

import logging
import signal
import sys

import pytest

from calling import own_logging
from llfsm.cli.console import log_machines, log_to_console
from waiting import wait_for

from .conftest import Llfsm, wait_for_line

Capture = pytest.CaptureFixture[str]


def log_all() -> None:
    for level in (logging.DEBUG, logging.INFO, logging.WARNING):
        logging.getLogger("somebody").log(level, "a %s", logging.getLevelName(level))


@pytest.mark.parametrize(
    ("level", "printed"),
    [(logging.INFO, "a INFO\na WARNING\n"), (logging.WARNING, "a WARNING\n")],
)
def test_texts_go_to_standard_error(level: int, printed: str, capsys: Capture) -> None:
    with own_logging():
        log_to_console(level)
        log_all()
    assert capsys.readouterr() == ("", printed)


def test_a_handler_is_used_instead(capsys: Capture) -> None:
    with own_logging():
        log_to_console(logging.INFO, logging.StreamHandler(sys.stdout))
        log_all()
    assert capsys.readouterr() == ("a INFO\na WARNING\n", "")


def test_only_problems_of_machines_go_to_standard_error(capsys: Capture) -> None:
    with own_logging():
        log_machines(is_on=True)
        log_all()
    assert capsys.readouterr() == ("a INFO\n", "a WARNING\n")


def test_nothing_is_printed_if_it_is_off(capsys: Capture) -> None:
    with own_logging():
        log_machines(is_on=False)
        log_all()
    assert capsys.readouterr() == ("", "")


SLOW = """
import tempfile, threading
with tempfile.TemporaryDirectory(dir=".") as folder:
    print("made", flush=True)
    threading.Event().wait()
"""


def test_sigterm_ends_a_command_as_ctrl_c_does_and_leaves_no_file(llfsm: Llfsm) -> None:
    (llfsm.cwd / "slow.py").write_text(SLOW)
    before = {*llfsm.cwd.iterdir()}
    process = llfsm.start("check", "slow:M")
    wait_for_line(process, "made")
    process.terminate()
    assert process.wait() == 128 + signal.SIGTERM
    assert {each for each in llfsm.cwd.iterdir() if each.name != "__pycache__"} == before


ENDLESS = """
from llfsm.runtime import Machine, State


class M(Machine):
    n: int = 0
    a = State(final=False)

    @a.internal
    def _(self) -> None:
        if not self.n:
            open("runs", "w").close()
        self.n += 1
"""


def test_sigterm_is_no_error_of_code_that_is_explored(llfsm: Llfsm) -> None:
    (llfsm.cwd / "endless.py").write_text(ENDLESS)
    process = llfsm.start("verify", "endless:M")
    wait_for((llfsm.cwd / "runs").exists, "it is explored")
    process.terminate()
    assert "interrupted" in process.stdout.read()
    process.wait()
