"""What of the check against a real ROS can be tested without one: its rows on recorded answers."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from ros.with_ros import ROWS, Outcome, main, table, try_row

TWO = "/turtlesim\n/llfsm_bridge\n"
BAG_INFO = (
    "Topic information: Topic: /turtle1/pose | Type: turtlesim/msg/Pose | Count: 3 | "
    "Serialization Format: cdr\n"
)
DIED = (
    "[llfsm-2] m  0 s  1 - RosWallTurttleBot - STRAIGHT\n"
    "[ERROR] [llfsm-2]: process has died [pid 7, exit code 1, cmd 'llfsm run'].\n"
)
LIFECYCLE = ["inactive [2]", "active [3]", "inactive [2]", "unconfigured [1]", "finalized [4]"]


class Process:
    def __init__(self, prints: str, statuses: list[int]) -> None:
        self._prints, self._statuses = prints, statuses

    def output(self) -> str:
        return self._prints

    def interrupt(self, times: int = 1) -> int:
        return self._statuses[times] if times < len(self._statuses) else 0


class Answers:
    """A world in which commands print what is set for their beginning, and time is counted."""

    def __init__(self, folder: Path, **answers: Any) -> None:
        self.folder = folder
        self._answers = answers
        self._time = 0.0
        self._lists = 0
        self.started: list[tuple[str, ...]] = []

    def ros2(self, *arguments: str) -> str:
        what = "_".join(arguments[:2])
        if what == "param_list":
            seconds = self._answers["seconds"]
            self._time += seconds[bool(self.started)]
        answer = self._answers.get(what, "")
        return answer.pop(0) if isinstance(answer, list) else answer

    def start(self, *command: str) -> Process:
        self.started.append(command)
        prints = self._answers.get("_".join(command[:2]), "")
        return Process(prints, self._answers.get("statuses", []))

    def ros_options(self) -> tuple[str, ...]:
        return "--domain", "98"

    def now(self) -> float:
        return self._time

    def sleep(self, seconds: float) -> None:
        self._time += seconds


PARAMETERS = {"node_list": TWO, "param_list": "background_r relays./out.rate"}
GOOD: dict[str, list[dict[str, Any]]] = {
    "param list": [PARAMETERS | {"seconds": (2.0, 2.3)}],
    "actions": [{"node_list": TWO, "action_send_goal": "Goal finished with status: SUCCEEDED"}],
    "clock": [
        {"node_list": TWO, "topic_echo": "clock:\n nanosec: 3", "llfsm_run": "0 - RosPingPong"}
    ],
    "at_loss": [{"node_list": TWO, "ros2_topic": "linear:\n  x: 1.0\n---\nlinear:\n  x: -1.0"}],
    "lifecycle": [{"node_list": "/wheels", "lifecycle_get": LIFECYCLE}],
    "launch": [{"ros2_launch": "1 - STRAIGHT", "statuses": [0, 1, 1]}],
    "bags": [{"bag_info": BAG_INFO, "ros2_topic": "theta: 0.1"}],
}
BAD: dict[str, list[dict[str, Any]]] = {
    "param list": [
        PARAMETERS | {"seconds": (2.0, 11.4)},
        PARAMETERS | {"seconds": (2.0, 2.0), "param_list": "background_r"},
        PARAMETERS | {"seconds": (2.0, 2.0), "node_list": "/turtlesim"},
    ],
    "actions": [{"node_list": TWO, "action_send_goal": "ABORTED"}],
    "clock": [
        {"node_list": TWO, "topic_echo": "no publisher", "llfsm_run": "RosPingPong"},
        {"node_list": TWO, "topic_echo": "nanosec: 3", "llfsm_run": "waiting for a time"},
    ],
    "at_loss": [{"node_list": TWO, "ros2_topic": "linear:\n  x: 1.0\n---\n"}],
    "lifecycle": [{"node_list": "/wheels", "lifecycle_get": "unconfigured [1]"}],
    "launch": [
        {"ros2_launch": "1 - STRAIGHT", "statuses": [0, 0, -2]},
        {"ros2_launch": DIED, "statuses": [0, 1, 1]},
    ],
    "bags": [
        {"bag_info": "/turtle1/pose", "ros2_topic": "theta: 0.1"},
        {"bag_info": BAG_INFO, "ros2_topic": ""},
    ],
}


def cases(of: dict[str, list[dict[str, Any]]]) -> list[Any]:
    return [pytest.param(row, a, id=f"{row} {n}") for row in of for n, a in enumerate(of[row])]


def copied(answers: dict[str, Any]) -> dict[str, Any]:
    return {key: [*value] if key == "lifecycle_get" and isinstance(value, list) else value
            for key, value in answers.items()}  # fmt: skip


def test_every_row_has_answers_of_both_kinds() -> None:
    assert set(GOOD) == set(BAD) == set(ROWS)


@pytest.mark.parametrize(("row", "answers"), cases(GOOD))
def test_a_row_holds(row: str, answers: dict[str, Any], tmp_path: Path) -> None:
    outcome = try_row(row, Answers(tmp_path, **copied(answers)))
    assert outcome.holds, outcome.seen


@pytest.mark.parametrize(("row", "answers"), cases(BAD))
def test_a_row_does_not_hold(row: str, answers: dict[str, Any], tmp_path: Path) -> None:
    outcome = try_row(row, Answers(tmp_path, **copied(answers)))
    assert not outcome.holds
    assert outcome.seen


def test_the_commands_of_llfsm_are_such(tmp_path: Path) -> None:
    """Each that a row starts names options that the command has."""
    from click import Command, Context

    from llfsm.cli.root import main as root

    for row, answers in GOOD.items():
        world = Answers(tmp_path, **copied(answers[0]))
        try_row(row, world)
        for name, *arguments in world.started:
            command: Any = root
            context = Context(root)
            while name == "llfsm" and arguments and hasattr(command, "get_command"):
                command = command.get_command(context, arguments.pop(0))
            if name == "llfsm":
                assert isinstance(command, Command)
                known = {option for param in command.params for option in param.opts}
                assert {a for a in arguments if a.startswith("--")} <= known, (row, arguments)


def test_the_table_has_a_line_for_each_row() -> None:
    found = table([Outcome("clock", True, "it is published"), Outcome("bags", False, "no file")])
    assert found.splitlines()[2:] == [
        "| clock | yes | it is published |",
        "| bags | NO | no file |",
    ]


def test_without_ros_it_says_what_to_do(monkeypatch, capsys) -> None:
    monkeypatch.setenv("PATH", "")
    assert main(["clock"]) == 2
    assert "source a ROS environment first" in capsys.readouterr().err


def test_an_unknown_row_is_refused(capsys) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["colck"])
    assert refused.value.code == 2
    assert "no row 'colck'; there are: param list, actions" in capsys.readouterr().err


def test_its_processes_end_with_the_row(monkeypatch, tmp_path, capsys) -> None:
    """The real shell, with a `ros2 launch` that would run for ever."""
    fake = tmp_path / "ros2"
    fake.write_text(
        f"#!/bin/sh\necho $$ >> {tmp_path}/pids\necho $* >> {tmp_path}/commands\n"
        "[ $1 = launch ] && echo STRAIGHT && exec sleep 1000\n"
    )
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    assert main(["launch"]) == 0
    assert "| launch | yes | one SIGINT and two end with -2 |" in capsys.readouterr().out
    assert (tmp_path / "commands").read_text().splitlines()[-1] == "daemon stop"
    for pid in map(int, (tmp_path / "pids").read_text().split()):
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
