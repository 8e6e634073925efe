"""`llfsm run` of bundles, by path and by name."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from llfsm import machines

from .conftest import Llfsm, wait_for_line


def write(folder: Path, entry: str, **files: str) -> None:
    """Write a bundle that runs `entry` once."""
    folder.mkdir(parents=True)
    (folder / "Language").write_text("python")
    (folder / "States").write_text("A")
    (folder / "State_A_OnEntry.py").write_text(entry)
    for name, text in files.items():
        (folder / f"{folder.stem}_{name}.py").write_text(text)


@pytest.mark.parametrize(
    "name", ["robots/Mine.machine", "robots/Mine.machine/", "robots/Mine", "./robots/Mine"]
)
def test_by_path(llfsm: Llfsm, board: str, name: str) -> None:
    write(llfsm.cwd / "robots" / "Mine.machine", "print(name, n)", Variables="n: int = 1")
    done = llfsm.run("run", name, "Mine:n=5", "-q", "-b", board)
    assert (done.returncode, done.stdout, done.stderr) == (0, "Mine 5\n", "")
    assert llfsm.run("run", str(llfsm.cwd / name), "-q", "-b", board).stdout == "Mine 1\n"


def test_by_name_before_those_that_ship(llfsm: Llfsm, board: str) -> None:
    write(llfsm.cwd / "RosPingPong.machine", "print('mine')")
    assert llfsm.run("run", "RosPingPong", "-q", "-b", board).stdout == "mine\n"
    assert llfsm.run("run", "RosPingPong.machine", "-q", "-b", board).stdout == "mine\n"


def test_the_path_is_reported(llfsm: Llfsm, board: str) -> None:
    write(llfsm.cwd / "M.machine", "pass")
    done = llfsm.run("run", "M", "-q", "-vv", "-b", board)
    assert str(llfsm.cwd / "M.machine")[:30] in done.stderr


def test_code_loads_bundles_beside_it_and_in_the_current_folder(llfsm: Llfsm, board: str) -> None:
    write(llfsm.cwd / "robots" / "Boss.machine", "load('Near')\nload('Here')")
    write(llfsm.cwd / "robots" / "Near.machine", "print(name)")
    write(llfsm.cwd / "Here.machine", "print(name)")
    done = llfsm.run("run", "robots/Boss", "-q", "-b", board)
    assert (done.returncode, done.stdout) == (0, "Near\nHere\n")


@pytest.mark.parametrize(
    ("name", "entry", "status", "printed"),
    [
        ("Other.machine", "pass", 2, "no machine 'Other.machine'; those that ship: "),
        ("M", "\n1 / 0", 1, "M.machine/State_A_OnEntry.py:2)"),
        ("M", "\nx", 1, "M.machine/State_A_OnEntry.py:2: nothing is called 'x'"),
        ("M", "load('Nobody')", 1, "no machine 'Nobody'"),
        ("", "pass", 2, "no machine ''"),
        (".", "pass", 2, "no machine '.'"),
    ],
)
def test_bad_input_is_one_clear_error(
    llfsm: Llfsm, board: str, name: str, entry: str, status: int, printed: str
) -> None:
    write(llfsm.cwd / "M.machine", entry)
    done = llfsm.run("run", name, "-q", "-b", board)
    assert done.returncode == status
    assert printed in done.stderr
    assert "Traceback" not in done.stderr


def test_of_a_copied_bundle_the_files_are_renamed(llfsm: Llfsm, tmp_path: Path) -> None:
    shipped = Path(machines.__file__).parent / "RosPingPong.machine"
    copy = tmp_path / "my own" / "Ping.machine"
    shutil.copytree(shipped, copy)
    refused = llfsm.run("run", str(copy), "--local")
    assert refused.returncode == 1
    error = refused.stderr.splitlines()[-1]
    assert "RosPingPong_Variables.py: this is a file of a machine RosPingPong" in error
    command = error.partition("rename the files, too: ")[2]
    subprocess.run(["sh", "-c", command], check=True)
    done = llfsm.start("run", str(copy), "--local", "-v")
    wait_for_line(done, "PUBLISH")
