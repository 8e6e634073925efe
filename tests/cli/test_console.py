"""Where commands log to."""

from __future__ import annotations

import logging
import sys

import pytest

from calling import own_logging
from llfsm.cli.console import log_machines, log_to_console

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
