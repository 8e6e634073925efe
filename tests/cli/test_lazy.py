"""Groups of commands that are imported when they are called."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest


def modules_after(*arguments: str) -> tuple[str, set[str]]:
    """Return what `llfsm` says, and which of our modules it has imported."""
    code = """
import json, sys
from click.testing import CliRunner
from llfsm.cli.root import main
said = CliRunner().invoke(main, sys.argv[1:]).output
print(json.dumps([said, [name for name in sys.modules if name.startswith("llfsm.")]]))
"""
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, text=True, capture_output=True, check=True)
    said, modules = json.loads(done.stdout)
    return said, set(modules)


@pytest.mark.parametrize("group", [(), ("bridge",)])
def test_help_names_the_commands_and_imports_none(group: tuple[str, ...]) -> None:
    said, modules = modules_after(*group, "--help")
    named = "gusimplewhiteboard  Relay slots" if group else "bridge      Connect a whiteboard"
    assert named in said
    assert not {name for name in modules if name.startswith("llfsm.bridges")}


def test_a_command_is_imported_when_it_is_called() -> None:
    said, modules = modules_after("bridge", "gusimplewhiteboard", "--help")
    assert said.startswith("Usage: main bridge gusimplewhiteboard [OPTIONS] [FILE.toml]")
    assert "llfsm.cli.bridge.gusimplewhiteboard" in modules
    assert "llfsm.bridges.turtlesim" not in modules


@pytest.mark.parametrize("group", [(), ("bridge",)])
def test_no_such_command(group: tuple[str, ...]) -> None:
    assert "Error: No such command 'none'." in modules_after(*group, "none")[0]
