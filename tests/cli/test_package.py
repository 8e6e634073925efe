"""`llfsm package`: the package's entry point runs what the command was given."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from free_ports import free_endpoint
from llfsm.bridges.ros2.opening import open_router

from .conftest import Llfsm

CLASS = """
from llfsm.runtime import Machine, State

class Mine(Machine):
    n: int = 1
    A = State()

    @A.on_entry
    def _(self):
        print(self.name, self.n)
"""


@pytest.fixture(scope="module")
def ros() -> Iterator[list[str]]:
    """Return the options of a ROS graph that has a router."""
    endpoint = free_endpoint()
    session = open_router([endpoint])
    yield ["--transport", "zenoh", "--router", endpoint]
    session.close()


def run_entry(
    package: Path, *arguments: str, quiet: bool = True
) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(package), str(package.parent)])
    return subprocess.run(
        [sys.executable, "-m", f"{package.name}.run", *(["-q"] * quiet), *arguments],
        env=os.environ | {"PYTHONPATH": path},
        cwd="/",
        text=True,
        capture_output=True,
        check=False,
    )


def write_bundle(folder: Path, entry: str) -> None:
    folder.mkdir(parents=True)
    (folder / "Language").write_text("python")
    (folder / "States").write_text("A")
    (folder / f"{folder.stem}_Variables.py").write_text("n: int = 1")
    (folder / "State_A_OnEntry.py").write_text(entry)


@pytest.mark.parametrize("name", ["robots/Mine", "robots/Mine.machine", "my_robot:Mine"])
def test_what_is_packaged_runs(llfsm: Llfsm, board: str, name: str, ros: list[str]) -> None:
    write_bundle(llfsm.cwd / "robots" / "Mine.machine", "print(name, n)")
    (llfsm.cwd / "my_robot.py").write_text(CLASS)
    done = llfsm.run("package", name)
    assert (done.returncode, done.stdout) == (0, "wrote mine: ros2 run mine mine\n")
    ran = run_entry(llfsm.cwd / "mine", "-b", board, *ros)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "Mine 1\n", "")


def test_a_package_does_not_hide_the_module_of_its_machine(
    llfsm: Llfsm, board: str, ros: list[str]
) -> None:
    (llfsm.cwd / "mine.py").write_text(CLASS)
    done = llfsm.run("package", "mine.py:Mine")
    assert done.stdout == "wrote mine_machine: ros2 run mine_machine mine_machine\n"
    ran = run_entry(llfsm.cwd / "mine_machine", "-b", board, *ros)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "Mine 1\n", "")


def test_it_is_a_node_with_the_arguments_of_ros(llfsm: Llfsm, ros: list[str]) -> None:
    write_bundle(llfsm.cwd / "Mine.machine", "print(name, n)")
    assert llfsm.run("package", "Mine", "--output", "src").returncode == 0
    package = llfsm.cwd / "src" / "mine"
    at = ["--ros-args", "-r", "__ns:=/left", "--", "Mine:n=5", "--domain", "77"]
    ran = run_entry(package, *ros, *at, "--ros-args", "-p", "a:=1", quiet=False)
    assert (ran.returncode, ran.stdout) == (0, "Mine 5\n")
    assert ran.stderr.endswith(": Mine on ROS domain 77 as /left/mine\n")


def test_one_that_ships(llfsm: Llfsm, board: str) -> None:
    assert llfsm.run("package", "RosPingPong", "-o", "src").returncode == 0
    ran = run_entry(llfsm.cwd / "src" / "ros_ping_pong", "RosPingPong:count=x", "-b", board)
    assert ran.returncode == 2
    assert "Usage: ros_ping_pong run" in ran.stderr  # it was found, and so was its variable
    assert "'RosPingPong:count=x': Expected `int`" in ran.stderr


@pytest.mark.parametrize(
    ("arguments", "status", "printed"),
    [
        (["Nobody"], 2, "no machine 'Nobody'; those that ship: "),
        (["my_robot:Mine"], 2, "there is no module 'my_robot'"),
        (["Broken"], 1, "State_A_OnEntry.py:1: nothing is called 'x'"),
        (["Good", "-o", "Good.machine/States"], 2, "is a file"),
    ],
)
def test_what_cannot_be_packaged(
    llfsm: Llfsm, arguments: list[str], status: int, printed: str
) -> None:
    write_bundle(llfsm.cwd / "Broken.machine", "x")
    write_bundle(llfsm.cwd / "Good.machine", "pass")
    done = llfsm.run("package", *arguments)
    assert done.returncode == status
    assert printed in done.stderr
    assert sorted(os.listdir(llfsm.cwd)) == ["Broken.machine", "Good.machine"]


def test_the_bundles_that_states_run_come_along(llfsm: Llfsm, ros: list[str]) -> None:
    for name in ("Outer", "Inner", "Innermost", "Other"):
        write_bundle(llfsm.cwd / f"{name}.machine", "print(name)")
    (llfsm.cwd / "Outer.machine" / "State_A_Runs").write_text("Inner\n")
    (llfsm.cwd / "Inner.machine" / "State_A_Runs").write_text("Innermost\n")
    assert llfsm.run("package", "Outer").returncode == 0
    made = {each.name for each in (llfsm.cwd / "outer" / "outer").glob("*.machine")}
    assert made == {"Outer.machine", "Inner.machine", "Innermost.machine"}
    ended = run_entry(llfsm.cwd / "outer", *ros)
    assert ended.stdout.split() == ["Outer", "Outer/Inner", "Outer/Inner/Innermost"]


def test_a_package_is_not_overwritten(llfsm: Llfsm) -> None:
    write_bundle(llfsm.cwd / "Good.machine", "pass")
    assert llfsm.run("package", "Good").returncode == 0
    done = llfsm.run("package", "Good")
    assert done.returncode == 1
    assert done.stderr == "Error: good is there already: remove it, or write to another folder\n"


def test_no_code_of_a_bundle_is_run(llfsm: Llfsm) -> None:
    bundle = llfsm.cwd / "Mine.machine"
    write_bundle(bundle, "pass")
    code = "import pathlib\npathlib.Path('ran').touch()\nraise SystemExit\n"
    (bundle / "Mine_Includes.py").write_text(code)
    assert llfsm.run("package", "Mine").returncode == 0
    assert not (llfsm.cwd / "ran").exists()


def test_a_link_in_a_bundle_is_not_followed(llfsm: Llfsm) -> None:
    bundle = llfsm.cwd / "Mine.machine"
    write_bundle(bundle, "pass")
    (llfsm.cwd / "secret").write_text("pass  # a secret")
    (bundle / "State_A_OnExit.py").symlink_to(llfsm.cwd / "secret")
    done = llfsm.run("package", "Mine")
    assert done.returncode == 1
    assert "State_A_OnExit.py: a link out of the bundle" in done.stderr
    assert not (llfsm.cwd / "mine").exists()


def test_a_bundle_that_cannot_run_is_not_packaged(llfsm: Llfsm) -> None:
    bundle = llfsm.cwd / "Mine.machine"
    write_bundle(bundle, "if:")
    done = llfsm.run("package", "Mine")
    assert (done.returncode, "State_A_OnEntry.py:1: SyntaxError" in done.stderr) == (1, True)
    (bundle / "Language").write_text("c++")
    assert llfsm.run("package", "Mine").returncode == 1
