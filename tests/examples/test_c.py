"""The examples in C and C++ as processes beside Python ones."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.std_msgs import Bool
from llfsm.whiteboard.messages.turtlesim import Pose
from own_boards import own_board
from waiting import PATIENCE_S

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
STRICT = [
    "-O2",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Werror",
    "-I",
    str(ROOT / "whiteboard/include"),
]
CMD_VEL = Slot("turtle1/cmd_vel", Twist)
POSE = Slot("turtle1/pose", Pose)


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    built: dict[str, Path] = {}

    def make(source: str) -> Path:
        if source not in built:
            built[source] = tmp_path_factory.mktemp("built") / Path(source).stem
            variable, compiler, standard = (
                ("CC", "cc", "c11") if source.endswith(".c") else ("CXX", "c++", "c++17")
            )
            command = [*shlex.split(os.environ.get(variable, compiler)), f"-std={standard}"]
            command += [*STRICT, str(EXAMPLES / source), "-o", str(built[source])]
            done = subprocess.run(command, text=True, capture_output=True, check=False)
            assert done.returncode == 0, done.stderr
        return built[source]

    return make


@pytest.fixture
def name() -> Iterator[str]:
    """Name a board; the examples end when it is removed."""
    with own_board() as name:
        yield name


def test_the_schemas_are_those_of_python() -> None:
    done = subprocess.run(
        [sys.executable, EXAMPLES / "schemas.py"], text=True, capture_output=True, check=True
    )
    assert (EXAMPLES / "schemas.h").read_text() == done.stdout


def test_c_gets_what_python_adds_and_adds_what_python_gets(
    build: Callable[[str], Path], name: str
) -> None:
    with Whiteboard(name) as board, subprocess.Popen([build("drive_turtle.c"), name]) as driver:
        commands = board[CMD_VEL]
        ahead, turn = Twist(Vector3(x=2.0)), Twist(Vector3(x=1.0), Vector3(z=2.0))
        for count, (pose, expected) in enumerate(
            [
                (Pose(5.0, 5.0), ahead),
                (Pose(9.5, 5.0), turn),
                (Pose(5.0, 1.0, -2.0), turn),
                (Pose(3, 4), ahead),  # which Python writes as whole numbers
                (Pose(300, 5), turn),
            ],
            1,
        ):
            board.add_message(POSE, pose)
            sample = commands.wait(after=count - 1, timeout=PATIENCE_S)
            assert sample is not None
            assert (sample.message, sample.count, sample.writer) == (expected, count, driver.pid)
        board.remove()
        assert driver.wait(PATIENCE_S) == 0


def test_cpp_prints_what_python_adds(build: Callable[[str], Path], name: str) -> None:
    numbers = [
        0,
        0.5,
        127,
        128,
        255,
        256,
        65536,
        2**40,
        -1,
        -32,
        -33,
        -129,
        -40000,
        -(2**40),
        1e300,
    ]
    with (
        Whiteboard(name) as board,
        subprocess.Popen([build("print_poses.cpp"), name], stdout=-1, text=True) as printer,
    ):
        assert printer.stdout is not None
        for number in numbers:
            board.add_message(POSE, Pose(number, 1.0, -number))
            assert printer.stdout.readline() == f"{number:g} 1 {-number:g}\n"
        board.remove()
        assert printer.wait(PATIENCE_S) == 0


def test_c_drives_the_simulated_turtle(build: Callable[[str], Path], name: str) -> None:
    simulator = [sys.executable, "-m", "llfsm.cli", "turtlesim", "-b", name]
    with (
        Whiteboard(name) as board,
        subprocess.Popen(simulator, stderr=subprocess.DEVNULL) as turtlesim,
        subprocess.Popen([build("drive_turtle.c"), name]) as driver,
        subprocess.Popen([build("print_poses.cpp"), name], stdout=-1, text=True) as printer,
    ):
        assert printer.stdout is not None
        until = time.monotonic() + PATIENCE_S
        x = 0.0
        while x < 6.5:  # it starts at 5.54 and stands still if nobody drives it
            x = float(printer.stdout.readline().split()[0])
            assert time.monotonic() < until
        board.remove()
        assert turtlesim.wait(PATIENCE_S) == 75  # the board is gone
        assert driver.wait(PATIENCE_S) == 0
        printer.stdout.read()
        assert printer.wait(PATIENCE_S) == 0


@pytest.mark.parametrize(
    ("source", "slot"), [("drive_turtle.c", CMD_VEL.name), ("print_poses.cpp", POSE.name)]
)
def test_a_slot_of_another_type_is_refused(
    build: Callable[[str], Path], name: str, source: str, slot: str
) -> None:
    with Whiteboard(name) as board:
        board.add_message(Slot(slot, Bool), Bool(True))
        done = subprocess.run([build(source), name], text=True, capture_output=True, check=False)
    assert done.returncode == 1
    assert done.stderr.endswith(f": {slot}: the slot exists with another schema\n")
