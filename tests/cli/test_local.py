"""`--local`: one process, which shares nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from calling import call, modules_forgotten
from llfsm.cli.demo.parts import Threads
from llfsm.runtime.engine.errors import ExecutionError
from llfsm.whiteboard import Whiteboard
from waiting import wait_for

FAILING = """
from llfsm.runtime import Machine, State

class Failing(Machine):
    only = State()

    @only.on_entry
    def _(self) -> None:
        raise ValueError("as planned")
"""


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("run", ["--ros", "--record x.mcap", "--will-after 500", "--board b", "--remove-board"]),
        ("demo", ["--ros", "--record x.mcap", "--board b", "--directory ."]),
    ],
)
def test_what_other_processes_do_is_refused(
    command: str, options: list[str], tmp_path: Path
) -> None:
    what = {"run": "RosPingPong", "demo": "wall"}[command]
    for option in options:
        done = call(command, what, "--local", *option.split(), cwd=tmp_path)
        assert done.returncode == 2
        assert f"leave out {option.split()[0]}" in done.stderr


def test_a_part_that_fails_ends_the_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "failing.py").write_text(FAILING)
    monkeypatch.chdir(tmp_path)
    with Whiteboard.local() as board, Threads(board) as threads, modules_forgotten():
        threads.start_machines(["failing.py"])

        def fails() -> bool:
            try:
                threads.wait(0.01)
            except ExecutionError as error:
                return "as planned" in str(error)
            return False

        wait_for(fails, "the machine's error")
