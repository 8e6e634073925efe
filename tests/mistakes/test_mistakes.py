"""Usual mistakes, each with what is found before anything runs.

The lists grow with every mistake that somebody makes. Each error is a line that names the place,
what is wrong there and, where that is known, what was meant.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from calling import own_logging
from llfsm.cli.machines import find_machine_class
from llfsm.cli.root import main
from llfsm.runtime import Arrangement, ExecutionError, ManualClock
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtlesim import Pose
from own_boards import own_board

HERE = Path(__file__).parent
HEAD = """\
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.turtlesim import Pose
"""
# What the arrangements' machines are.
ROBOT = """
class Driver(Machine):
    drive = Actuator(Slot("cmd_vel", Twist), at_end=Twist())
    speed: float = 1.0
    go = State()
    done = State()

    @go.internal
    def _(self) -> None:
        self.drive(Twist(linear=Vector3(x=self.speed)))

    go.to(done, after_ms=100)


class Boss(Machine):
    driver: str = "Driver"
    watch = State()
    rest = State()

    @watch.to(rest)
    def all_is_well(self) -> bool:
        return self.is_running(self.driver)

    @rest.on_entry
    def _(self) -> None:
        self.suspend("Driver")
"""
# A bundle without a mistake; those with one replace some of its files.
LAMP = {
    "Language": "python",
    "States": "OFF\nON\n",
    "Lamp_Includes.py": "from llfsm.whiteboard import Message, Slot\n"
    "from llfsm.runtime import Actuator, Sensor\n"
    "class Request(Message):\n    wanted: bool = False\n",
    "Lamp_Variables.py": "request = Sensor(Slot('request', Request), default=Request())\n"
    "light = Actuator(Slot('light', Request))\ncount: int = 0\n",
    "State_OFF_OnEntry.py": "light(Request(False))\n",
    "State_OFF_Transition_0.expr": "request.wanted",
    "State_OFF_Transition_0.target": "ON",
    "State_ON_OnEntry.py": "light(Request(wanted=True))\ncount += 1\n",
    "State_ON_Transition_0.expr": "not request.wanted",
    "State_ON_Transition_0.target": "OFF",
}
IN_CLASSES = ("classes.toml", "values.toml", "uses.toml", "code.toml", "time.toml", "missed.toml")
LISTS = (*IN_CLASSES, "bundles.toml", "arrangements.toml", "commands.toml")
PLACE = re.compile(r"[\w./]+:\d+: (error|warning): |no findings")
NOTHING = "no findings\n"
USAGE = ("Usage: ", "Try ")  # how click begins what precedes an error


def write_bundle(folder: Path, files: dict[str, str]) -> None:
    (folder / "Lamp.machine").mkdir()
    for name, text in {**LAMP, **files}.items():
        if text != "missing":
            (folder / "Lamp.machine" / name).write_text(text)


def run_beside(folder: Path, board: str, command: list[str]) -> tuple[int, str]:
    """Return the status and the output of a command beside a module, a bundle and a board."""
    (folder / "robot.py").write_text(HEAD + ROBOT)
    write_bundle(folder, {})
    with Whiteboard(board) as made:
        made.add_message(Slot("cmd_vel", Twist), Twist())
    with own_logging():
        done = CliRunner().invoke(main, [each.replace("{board}", board) for each in command])
    shown = done.output.replace(str(folder), "HERE").replace(board, "BOARD")
    lines = [each for each in shown.splitlines() if each and not each.startswith(USAGE)]
    return done.exit_code, "".join(f"{line}\n" for line in lines)


def listed(name: str) -> list[Any]:
    mistakes = tomllib.loads((HERE / name).read_text())["mistake"]
    return [pytest.param(each, id=each["title"].replace(" ", "_")) for each in mistakes]


def check(*names: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["check", *names])
    return done.exit_code, done.output


def expected(mistake: dict[str, Any]) -> str:
    """Return what is found; from Python 3.14 on, annotations are evaluated when they are used."""
    lazily = mistake.get("finds_from_3_14") if sys.version_info >= (3, 14) else None
    return str(lazily or mistake["finds"])


def assert_found(mistake: dict[str, Any], status: int, output: str) -> None:
    assert output == expected(mistake)
    assert status == (1 if "error: " in output.lower() else 0)


@pytest.mark.parametrize("mistake", [each for name in IN_CLASSES for each in listed(name)])
def test_in_a_class(here: Path, mistake: dict[str, Any]) -> None:
    (here / "robot.py").write_text(HEAD + mistake["code"])
    status, output = check("robot:M")
    if output == NOTHING:
        assert mistake["finds"] == NOTHING
        return
    lines = [line.split(":", 2) for line in output.splitlines()]
    shown = [f"{file}:{int(line) - HEAD.count(chr(10))}:{text}" for file, line, text in lines]
    assert_found(mistake, status, "".join(f"{each}\n" for each in shown))


@pytest.mark.parametrize("mistake", listed("missed.toml"))
def test_what_check_misses_is_reported_with_its_place(here: Path, mistake: dict[str, Any]) -> None:
    """What it fails with names file and line, machine, state and section."""
    (here / "robot.py").write_text(HEAD + mistake["code"])
    board, clock = LocalBoard("robot"), ManualClock()
    board.add_message(Slot("pose", Pose), Pose(x=5.0))
    robot = find_machine_class("robot:M")
    with Arrangement([robot], whiteboard=board, clock=clock) as arrangement:

        def run() -> None:
            for _ in range(5):
                arrangement.round()
                clock.advance(ms=20)

        with pytest.raises(ExecutionError) as failed:
            run()
    error = failed.value
    assert error.line is not None
    what = str(error).rpartition(" (")[0]
    line = error.line - HEAD.count("\n")
    assert f"{Path(str(error.filename)).name}:{line}: {what}\n" == mistake["fails"]


def test_what_has_no_mistake(here: Path) -> None:
    (here / "robot.py").write_text(HEAD + ROBOT)
    (here / "fleet.toml").write_text(
        "machine = [{definition='robot:Driver'}, {definition='robot:Boss'}]"
    )
    write_bundle(here, {})
    assert check("fleet.toml", "Lamp") == (0, "no findings\n")


@pytest.mark.parametrize("mistake", listed("bundles.toml"))
def test_in_a_bundle(here: Path, mistake: dict[str, Any]) -> None:
    write_bundle(here, mistake["files"])
    assert_found(mistake, *check("Lamp"))


@pytest.mark.parametrize("mistake", listed("arrangements.toml"))
def test_in_an_arrangement(here: Path, mistake: dict[str, Any]) -> None:
    (here / "robot.py").write_text(HEAD + ROBOT)
    (here / "fleet.toml").write_text(mistake["code"])
    assert_found(mistake, *check("fleet.toml"))


@pytest.mark.parametrize("mistake", listed("commands.toml"))
def test_in_a_command(here: Path, mistake: dict[str, Any]) -> None:
    with own_board() as board:
        status, output = run_beside(here, board, mistake["command"])
    assert status in (1, 2)
    assert output == mistake["finds"]


def is_found_before_it_runs(mistake: dict[str, Any]) -> bool:
    """Return whether `check` names a place, or a command refuses before it does anything."""
    return mistake["finds"] != NOTHING


def test_there_are_many_and_each_message_is_short() -> None:
    """A message is at most three lines of a terminal, and begins with a place or a command's."""
    mistakes = [param.values[0] for name in LISTS for param in listed(name)]
    assert len(mistakes) >= 345
    assert sum(map(is_found_before_it_runs, mistakes)) >= 0.9 * len(mistakes)
    for mistake in mistakes:
        first, *others = lines = mistake["finds"].splitlines()
        assert first.startswith("Error: ") or PLACE.match(first)
        assert len(others) < 3 or all(map(PLACE.match, others))
        assert all(len(line) < 3 * 100 for line in [*lines, mistake.get("fails", "")])
