"""`--directory`: whiteboards in another folder, as those of another host."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from llfsm.cli.root import main
from llfsm.whiteboard.board_files import board_files


def llfsm(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


def commands(group: click.Group, path: str = "llfsm") -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from commands(command, f"{path} {name}")
        else:
            yield f"{path} {name}", command


def test_every_command_that_takes_a_board_has_it() -> None:
    taking = {}
    for path, command in commands(main):
        options = {option for each in command.params for option in each.opts}
        if "--board" in options:
            taking[path] = {"--directory", "--group"} <= options
    assert len(taking) > 12
    assert [path for path, has in taking.items() if not has] == []


def test_boards_of_one_name_in_two_folders(tmp_path: Path) -> None:
    for host in ("one", "two"):
        (tmp_path / host).mkdir()
        text = f'{{"data": "{host}"}}'
        at = ("--directory", str(tmp_path / host))
        added = llfsm("whiteboard", "add", "s", text, "--type", "std_msgs/String", "-b", "b", *at)
        assert (added.exit_code, added.output) == (0, "message 1 of s\n")
    for host in ("one", "two"):
        at = ("--directory", str(tmp_path / host))
        assert llfsm("whiteboard", "get", "s", "-b", "b", *at).output == f'{{"data": "{host}"}}\n'
        assert llfsm("whiteboard", "list", *at).output == "b  not in use\n"
        assert llfsm("ps", "-a", *at).output.startswith("no machine runs on a whiteboard of this")
    assert llfsm("whiteboard", "rm", "b", "--directory", str(tmp_path / "one")).exit_code == 0
    assert not board_files(tmp_path / "one")
    assert board_files(tmp_path / "two")


def test_a_board_of_a_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WHITEBOARD_GROUP", "")  # which the option changes
    at = ("-b", "b", "--directory", str(tmp_path), "--group", str(os.getegid()))
    added = llfsm("whiteboard", "add", "s", "{}", "--type", "std_msgs/String", *at)
    assert (added.exit_code, added.output) == (0, "message 1 of s\n")
    assert (tmp_path / "llfsm.b").stat().st_mode & 0o777 == 0o660
    (tmp_path / "llfsm.b").chmod(0o600)
    refused = llfsm("whiteboard", "get", "s", *at)
    assert refused.exit_code == 1
    assert "--group" in refused.output
    monkeypatch.setenv("WHITEBOARD_GROUP", "")
    assert llfsm("whiteboard", "get", "s", *at[:-2]).output == '{"data": ""}\n'
    unknown = llfsm("whiteboard", "list", "--group", "robotz")
    assert "no group of this host is called 'robotz'" in unknown.output


def test_machines_run_on_a_board_there(tmp_path: Path, here: Path) -> None:
    (here / "mine.py").write_text(
        "from llfsm.runtime import Machine, State\n"
        "class M(Machine):\n    a = State()\n    b = State()\n    a.to(b)\n"
    )
    done = llfsm("run", "mine.py", "-q", "-v", "-b", "b", "--directory", str(tmp_path))
    assert done.exit_code == 0
    assert [name for name, _ in board_files(tmp_path)] == ["b"]
    assert done.output.splitlines() == [
        "m  0 s  0 - M                    - a",
        "m  0 s  1 - M                    - b",
    ]
    timed = llfsm("run", "mine.py", "-q", "-vt", "-b", "b", "--directory", str(tmp_path))
    first, second = timed.output.splitlines()[:2]
    assert first == "  0.000000 m  0 s  0 - M                    - a"
    assert second.endswith(" m  0 s  1 - M                    - b")
    assert float(second.split()[0]) > 0


@pytest.mark.parametrize("endpoint", ["tcp/256.1.1.1:7447", "nonsense"])
def test_a_daemon_that_cannot_start_leaves_no_board(tmp_path: Path, endpoint: str) -> None:
    at = ("-b", "b", "--directory", str(tmp_path))
    done = llfsm("whiteboard", "daemon", *at, "--listen", endpoint)
    assert done.exit_code != 0
    assert not board_files(tmp_path)
