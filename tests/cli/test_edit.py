"""`llfsm edit` opens machines, and reports what it cannot open; the page has tests of its own."""

from __future__ import annotations

import re
from pathlib import Path

import httpx
import pytest

from calling import call
from llfsm.cli.view import TOKEN_VARIABLE

from ..bridges.view.conftest import Process


def test_there_is_no_bundle(tmp_path: Path) -> None:
    done = call("edit", "Patrol", "--no-open", cwd=tmp_path)
    assert done.returncode == 2
    assert "no bundle 'Patrol'; make one with: llfsm new Patrol" in done.stderr


def test_the_token_is_empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, " ")
    call("new", "Patrol", "--bundle", cwd=tmp_path)
    done = call("edit", "Patrol", "--no-open", "--port", "0", cwd=tmp_path)
    assert done.returncode == 1
    assert f"${TOKEN_VARIABLE} is empty" in done.stderr


def test_a_bundle_is_opened_and_left_as_it_was(tmp_path: Path) -> None:
    call("new", "Patrol", "--bundle", cwd=tmp_path)
    folder = tmp_path / "Patrol.machine"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    process = Process("edit", "Patrol", "--no-open", "--port", "0", cwd=tmp_path)
    printed = process.line()
    found = re.fullmatch(
        rf"llfsm edit: {folder} at (http://127\.0\.0\.1:\d+/)(\?token=\S+)\n", printed
    )
    assert found, printed
    answer = httpx.get(f"{found[1]}about{found[2]}", trust_env=False, verify=False)
    assert answer.json()["title"] == "Patrol"
    assert process.end() == (0, "")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


PLAN = """\
[[machine]]
definition = "Patrol"
[[machine]]
definition = "Patrol"
[[machine]]
definition = "guard.py:Guard"
[[machine]]
definition = "broken.py:Broken"
[[machine]]
definition = "Nowhere"
name = "Lost"
"""
GUARD = """\
from llfsm.runtime import Machine, State
class Guard(Machine):
    WATCH = State()
"""


def test_an_arrangement_is_opened_also_if_not_all_of_its_machines_can_be(tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    robot.mkdir()
    call("new", "Patrol", "--bundle", cwd=robot)
    (robot / "robot.toml").write_text(PLAN)
    (robot / "guard.py").write_text(GUARD)
    (robot / "broken.py").write_text("class Broken(:\n")
    process = Process("edit", "robot/robot.toml", "--no-open", "--port", "0", cwd=tmp_path)
    printed = process.line()
    found = re.fullmatch(
        rf"llfsm edit: {robot / 'robot.toml'} at (http://127\.0\.0\.1:\d+/)(\?token=\S+)\n", printed
    )
    assert found, printed
    about = httpx.get(f"{found[1]}about{found[2]}", trust_env=False, verify=False).json()
    problems = {each["name"]: each["problem"] for each in about["machines"]}
    assert list(problems) == ["Patrol", "Patrol.0", "Guard", "Broken", "Lost"]
    assert [name for name, problem in problems.items() if not problem] == [
        "Patrol", "Patrol.0", "Guard"
    ]  # fmt: skip
    assert problems["Broken"] == f"{robot / 'broken.py'}:1: SyntaxError: invalid syntax"
    assert problems["Lost"].startswith("no machine 'Nowhere'")
    assert process.end() == (0, "")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "robot.toml: cannot be read: No such file"),
        ("[[machine]]\n", "robot.toml:1: machine[0]: Object missing required"),
    ],
)
def test_there_is_no_arrangement(tmp_path: Path, text: str | None, says: str) -> None:
    if text is not None:
        (tmp_path / "robot.toml").write_text(text)
    done = call("edit", "robot.toml", "--no-open", cwd=tmp_path)
    assert done.returncode != 0
    assert says in done.stderr
