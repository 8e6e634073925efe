"""Breakpoints of a bundle that another one calls are set before that."""

from __future__ import annotations

from pathlib import Path

import pytest

from llfsm.runtime.bundles import Bundle, BundleState, BundleTransition, Fragment, write_bundle

from .conftest import Llfsm
from .dap_client import client


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a bundle that calls another one, and a third that nobody names."""
    over = BundleState("B")
    always = (BundleTransition("B", Fragment("True\n")),)
    for name, code in (
        ("Helper", "pass\n"),
        ("Caller", 'call_machine("Helper", detached=True)\n'),
        ("Other", "pass\n"),
    ):
        first = BundleState("A", {"OnEntry": Fragment(code)}, always)
        write_bundle(Bundle(name, (first, over)), tmp_path / f"{name}.machine")
    return tmp_path


def test_the_command_line_and_a_file_have_them(llfsm: Llfsm, folder: Path, board: str) -> None:
    how = ("debug", str(folder / "Caller.machine"), "-b", board)
    done = llfsm.run(*how, "--break", "Helper:B", entered="continue\nquit\n")
    assert "breakpoint Helper:B: round 2, Helper in B" in done.stdout, done.stderr
    done = llfsm.run(*how, "--break", "Other:B", entered="quit\n")
    assert "no machine 'Other'; there are: Caller, Helper" in done.stderr
    file = folder / "plan.toml"
    text = 'break = ["%s:B"]\n[[machine]]\ndefinition = "Caller"\n'
    for name, status in (("Helper", 0), ("Other", 1)):
        file.write_text(text % name)
        assert llfsm.run("check", str(file)).returncode == status


def test_an_editor_has_them(folder: Path, board: str) -> None:
    with client() as editor:
        editor.begin(board, str(folder / "Caller.machine"))
        path = str(folder / "Helper.machine" / "State_A_OnEntry.py")
        (found,) = editor.ask("setBreakpoints", source={"path": path}, breakpoints=[{"line": 1}])[
            "breakpoints"
        ]
        assert (found["verified"], found["message"]) == (True, "Helper:A")
        editor.ask("configurationDone")
        assert editor.event("stopped")["text"] == "breakpoint Helper:A"
        editor.ask("disconnect")
