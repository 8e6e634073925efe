"""The command as a process, between a program in C and a whiteboard."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from calling import call
from forked import Forked
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.turtlesim import Pose
from own_boards import own_board
from waiting import PATIENCE_S, rest_of, wait_for

Native = Callable[..., str]
CMD_VEL = Slot("turtle1/cmd_vel", Twist)
POSE = Slot("turtle1/pose", Pose)

PLAN = """\
file = "guwhiteboard"
period_ms = 1.0

[[relay]] # what the machines of clfsm say
number = 12
slot = "turtle1/cmd_vel"
type = "geometry_msgs/Twist"
layout = "<2d"
fields = ["linear.x", "angular.z"]
direction = "in"

[[relay]]
number = 13
slot = "turtle1/pose"
type = "turtlesim/Pose"
layout = "structures:CPose"
direction = "out"
"""

STRUCTURES = """\
import ctypes


class CPose(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in ("x", "y", "theta")]
"""


@pytest.fixture
def board() -> Iterator[str]:
    with own_board() as name:
        yield name


BRIDGE = ["bridge", "gusimplewhiteboard"]


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "llfsm.cli", *BRIDGE, *map(str, arguments)]


def refusal(folder: Path, *arguments: object) -> tuple[int, str]:
    done = call(*BRIDGE, *map(str, arguments), cwd=folder)
    return done.returncode, done.stderr


def test_it_relays_both_ways_until_it_is_ended(native: Native, tmp_path: Path, board: str) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "structures.py").write_text(STRUCTURES)
    native("add", 12, 1.5, -1)
    arguments = command("plan.toml", "-b", board)
    with Forked(arguments, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as bridge:
        assert bridge.stderr is not None
        assert bridge.stderr.readline() == f"guwhiteboard <-> {board}: 2 relayed\n"
        with Whiteboard(board) as wb:
            first = wb[CMD_VEL].wait(after=0, timeout=PATIENCE_S)
            assert first is not None
            assert first.message == Twist(Vector3(x=1.5), Vector3(z=-1.0))
            assert first.writer == bridge.pid
            native("add", 12, 2, 0)
            second = wb[CMD_VEL].wait(after=1, timeout=PATIENCE_S)
            assert second is not None
            assert second.message == Twist(Vector3(x=2.0))
            for x in (1.0, 2.0):
                wb.add_message(POSE, Pose(x, 5.0, 0.25, 9.0))
                wait_for(lambda x=x: native("get", 13, 3) == f"{x:g} 5 0.25 of {x:g}\n")
            bridge.send_signal(signal.SIGTERM)
            printed = rest_of(bridge)
            assert bridge.returncode == 0
    assert printed == (
        "12 -> turtle1/cmd_vel: 2 in, 0 out, 0 refused\n"
        "13 <- turtle1/pose: 0 in, 2 out, 0 refused\n"
    )


def test_flags_and_the_end_of_the_file(
    native: Native, tmp_path: Path, board: str, path: Path
) -> None:
    relay = ("--both", 5, "turtle1/cmd_vel", "geometry_msgs/Twist", "6d")
    arguments = command("--file", path, "-b", board, "--period-ms", 1, *relay)
    with Forked(arguments, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as bridge:
        assert bridge.stderr is not None
        bridge.stderr.readline()
        with Whiteboard(board) as wb:
            wb.add_message(CMD_VEL, Twist(Vector3(1.0, 2.0, 3.0), Vector3(4.0, 5.0, 6.0)))
            wait_for(lambda: native("get", 5, 6) == "1 2 3 4 5 6 of 1\n")
        path.unlink()
        printed = rest_of(bridge)
    assert bridge.returncode == 1
    assert printed.startswith("5 <-> turtle1/cmd_vel: 0 in, 1 out, 0 refused\n")
    assert printed.endswith("guwhiteboard: the file was removed or replaced; start again\n")


def test_it_ends_with_the_board(native: Native, tmp_path: Path, board: str, path: Path) -> None:
    relay = ("--in", 5, "turtle1/cmd_vel", "geometry_msgs/Twist", "6d")
    arguments = command("--file", path, "-b", board, *relay)
    with Forked(arguments, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as bridge:
        assert bridge.stderr is not None
        bridge.stderr.readline()
        remove_board(board)
        assert bridge.wait(PATIENCE_S) == 0


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("number = 12", "number = 512", 5, "relay[0].number: Expected `int` <= 511"),
        ("number = 13", "number = 12", 13, "relay[1].number: 12 is relayed twice"),
        ('"turtle1/pose"', '"turtle1/cmd_vel"', 14, "turtle1/cmd_vel is relayed twice"),
        ('"turtle1/pose"', '"a b"', 14, "'a b' is not a valid slot name"),
        ('"turtlesim/Pose"', '"turtlesim/Posse"', 15, "no message type 'turtlesim/Posse'"),
        ('"<2d"', '"<3d"', 8, "'<3d' has 3 values for 2 fields: linear.x, angular.z"),
        ("angular.z", "angular.w", 8, "geometry_msgs/msg/Twist has no field 'angular.w'"),
        ("structures:CPose", "structures:CPosse", 16, "no ctypes structure 'structures:CPosse'"),
        ('"out"', '"up"', 17, "relay[1].direction: Invalid enum value 'up'"),
        ("period_ms = 1.0", "period_ms = 0", 2, "period_ms: Expected `float` > 0.0"),
        ("slot = ", "slots = ", 6, "there is no key 'slots' here"),
    ],
)
def test_an_error_in_the_file_has_its_line(
    native: Native, tmp_path: Path, board: str, old: str, new: str, line: int, what: str
) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace(old, new, 1))
    (tmp_path / "structures.py").write_text(STRUCTURES)
    status, printed = refusal(tmp_path, "plan.toml", "-b", board)
    assert status == 1
    assert printed.startswith(f"Error: plan.toml:{line}: ")
    assert what in printed


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ((), "nothing to relay: a [[relay]] in FILE.toml, or --in, --out, --both"),
        (("--in", "512", "s", "std_msgs/Bool", "?"), "512 is not in the range 0<=x<=511"),
        (("--in", "1", "s", "std_msgs/Bool", "d"), "'d' cannot hold data"),
        (("--in", "1", "s", "std_msgs/Bool"), "requires 4 arguments"),
        (("--period-ms", "0"), "0.0 is not in the range x>0"),
        (("no.toml",), "'no.toml' does not exist"),
    ],
)
def test_wrong_usage(tmp_path: Path, arguments: tuple[str, ...], what: str) -> None:
    status, printed = refusal(tmp_path, *arguments)
    assert status == 2
    assert what in printed


def test_no_gusimplewhiteboard(tmp_path: Path, board: str) -> None:
    relay = ("--in", 1, "s", "std_msgs/Bool", "?")
    status, printed = refusal(tmp_path, "--file", "none", "-b", board, *relay)
    assert (status, printed) == (
        1,
        "Error: none: no such file; start the process that creates the gusimplewhiteboard, or "
        "name its file\n",
    )


def test_a_slot_of_another_type(native: Native, tmp_path: Path, board: str, path: Path) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(POSE, Pose())
    relay = ("--in", 1, POSE.name, "geometry_msgs/Twist", "6d")
    status, printed = refusal(tmp_path, "--file", path, "-b", board, *relay)
    assert status == 1
    assert "slot 'turtle1/pose' holds turtlesim/msg/Pose" in printed
