"""Groups of commands that are imported when they are called."""

from __future__ import annotations

import importlib
import json
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator

import click
import pytest
from click.testing import CliRunner

import llfsm.cli
from llfsm.cli.root import LazyGroup, main


def rows(group: LazyGroup, path: tuple[str, ...] = ()) -> Iterator[tuple[str, str, str]]:
    """Yield each row of a group's table and of those below it: path, place and short help."""
    for name, (place, text) in group.table.items():
        yield " ".join((*path, name)), place, text
        command = resolved(place)
        if isinstance(command, LazyGroup):
            yield from rows(command, (*path, name))


def resolved(place: str) -> click.Command:
    module, _, attribute = place.partition(":")
    return getattr(importlib.import_module(module), attribute)


ROWS = list(rows(main))


@pytest.mark.parametrize(("path", "place", "text"), ROWS, ids=[path for path, _, _ in ROWS])
def test_every_row_names_a_command(path: str, place: str, text: str) -> None:
    command = resolved(place)
    assert isinstance(command, click.Command)
    assert command.name == path.split()[-1]
    assert command.help
    assert text.endswith(".")
    assert len(text) < 60


def test_every_command_is_in_a_table() -> None:
    named = {id(resolved(place)) for _, place, _ in ROWS} | {id(main)}
    modules = [
        importlib.import_module(found.name)
        for found in pkgutil.walk_packages(llfsm.cli.__path__, "llfsm.cli.")
        if not found.name.endswith("__main__")
    ]
    defined = {
        f"{module.__name__}:{name}"
        for module in modules
        for name, value in vars(module).items()
        if isinstance(value, click.Command) and id(value) not in named
    }
    assert len(modules) > 30
    assert not defined


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
    printed, modules = json.loads(done.stdout)
    return printed, set(modules)


@pytest.mark.parametrize(
    ("group", "named"),
    [
        ((), "bridge      Connect a whiteboard"),
        (("bridge",), "gusimplewhiteboard  Relay slots"),
        (("whiteboard",), "daemon  Mirror a whiteboard"),
    ],
)
def test_help_names_the_commands_and_imports_none(group: tuple[str, ...], named: str) -> None:
    printed, modules = modules_after(*group, "--help")
    assert named in printed
    assert not {name for name in modules if name.startswith("llfsm.bridges")}


def test_a_command_is_imported_when_it_is_called() -> None:
    printed, modules = modules_after("bridge", "gusimplewhiteboard", "--help")
    assert printed.startswith("Usage: main bridge gusimplewhiteboard [OPTIONS] [FILE.toml]")
    assert "llfsm.cli.bridge.gusimplewhiteboard" in modules
    assert "llfsm.bridges.turtlesim" not in modules


@pytest.mark.parametrize("group", [(), ("bridge",)])
def test_no_such_command(group: tuple[str, ...]) -> None:
    assert "Error: no command 'none'" in modules_after(*group, "none")[0]


def test_the_help_of_run_shows_ten_options_and_all_of_them_when_asked() -> None:
    command = resolved("llfsm.cli.run.command:run")
    few, many = (
        CliRunner().invoke(main, ["run", how]).output.partition("Options:")[2]
        for how in ("--help", "--help-all")
    )
    options = [each for each in command.params if isinstance(each, click.Option)]
    shown = [each for each in options if re.search(rf"^  .*{each.opts[0]}\b", few, re.M)]
    assert len(shown) == 11  # and `--help-all`
    for option in options:
        assert re.search(rf"^ +.*{option.opts[-1]}\b", many, re.M), option.opts


def test_the_first_commands_are_those_to_begin_with() -> None:
    text = CliRunner().invoke(main, ["--help"]).output
    first = text.partition("Begin:")[2].partition("\n\n")[0].split("\n")[1:]
    assert [line.split()[0] for line in first][:3] == ["demo", "new", "run"]
    assert len(first) == 8
    for name in main.list_commands(click.Context(main)):
        assert len(re.findall(rf"^  {name} ", text, re.M)) == 1
