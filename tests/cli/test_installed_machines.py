"""Machines of installed packages: found by name, extended, and told apart."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from .conftest import Llfsm

MODULE = '''\
from llfsm.runtime import Machine, State


class Palletize(Machine):
    """Stack boxes."""

    boxes: int = 2

    STACK = State()
    DONE = State()
    STACK.to(DONE)

    @STACK.on_entry
    def _(self) -> None:
        print(f"stacks {self.boxes}")
'''


def install(folder: Path, package: str, text: str = MODULE) -> None:
    """Put a package into a folder as pip does."""
    (folder / f"{package}.py").write_text(text)
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    entry = f"[llfsm.machines]\nPalletize = {package}:Palletize\n"
    (info / "entry_points.txt").write_text(entry)


@pytest.fixture
def site(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a folder in which packages are installed."""
    folder = tmp_path_factory.mktemp("site")
    monkeypatch.setenv("PYTHONPATH", str(folder))
    return folder


def test_it_is_run_checked_and_extended_by_its_name(llfsm: Llfsm, site: Path, board: str) -> None:
    install(site, "acme_machines")
    done = llfsm.run_apart("run", "Palletize", "Palletize:boxes=3", "-q", "-b", board)
    assert (done.returncode, done.stdout) == (0, "stacks 3\n"), done.stderr
    assert llfsm.run_apart("check", "Palletize").stdout == "no findings\n"
    done = llfsm.run_apart("new", "Stacker", "--from", "Palletize")
    assert done.returncode == 0, done.stderr
    text = (llfsm.cwd / "stacker.py").read_text()
    assert "from acme_machines import Palletize" in text
    assert "class Stacker(Palletize):" in text
    assert "# boxes: int = 2" in text
    done = llfsm.run_apart("run", "stacker:Stacker", "-q", "-b", board)
    assert (done.returncode, done.stdout) == (0, "stacks 2\n"), done.stderr


def test_a_module_in_the_folder_comes_first(llfsm: Llfsm, site: Path) -> None:
    install(site, "acme_machines")
    (llfsm.cwd / "Palletize.py").write_text(MODULE.replace("boxes: int", "crates: int"))
    done = llfsm.run_apart("check", "Palletize")
    assert "Palletize.py" in done.stdout  # the local one has findings


def test_packages_are_looked_for_only_if_that_is_needed(llfsm: Llfsm) -> None:
    """It costs as much as all else that a command does at its start."""
    (llfsm.cwd / "mine.py").write_text(MODULE)
    code = """
import sys
from llfsm.cli.machines import find_machine_class
for name in ("Patrol", "mine.py", "mine", "mine:Palletize"):
    find_machine_class(name)
print("importlib.metadata" in sys.modules)
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=llfsm.cwd, capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_a_name_of_two_packages_is_an_error_that_names_both(llfsm: Llfsm, site: Path) -> None:
    install(site, "acme_machines")
    install(site, "other_machines")
    done = llfsm.run_apart("check", "Palletize")
    assert done.returncode == 2
    assert "acme_machines:Palletize or other_machines:Palletize" in done.stderr


def test_a_wrong_name_has_those_that_are_installed(llfsm: Llfsm, site: Path) -> None:
    install(site, "acme_machines")
    done = llfsm.run_apart("check", "Paletize")
    assert "of installed packages: Palletize;" in done.stderr
    assert "did you mean 'Palletize'?" in done.stderr


def test_a_package_that_is_broken_names_the_place(llfsm: Llfsm, site: Path) -> None:
    install(site, "acme_machines", "import nothing_like_it\n")
    done = llfsm.run_apart("run", "Palletize")
    assert done.returncode != 0
    assert "nothing_like_it" in done.stderr
    assert "acme_machines.py" in done.stderr
    assert "Traceback" not in done.stderr


def test_one_that_ships_is_extended(llfsm: Llfsm) -> None:
    assert llfsm.run("new", "Rounds", "--from", "Patrol").returncode == 0
    text = (llfsm.cwd / "rounds.py").read_text()
    assert "from llfsm.machines import Patrol" in text
    assert "@Patrol.LOST.on_entry" in text
    assert llfsm.run("check", "rounds:Rounds").stdout == "no findings\n"


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("Mine", "--from", "Nobody"), "no machine 'Nobody'"),
        (("Mine", "--from", "Patrol", "--bundle"), "--from makes a class: leave --bundle out"),
        (("Mine", "--from", "M.machine"), "it is no class of a module; see llfsm convert"),
    ],
)
def test_what_cannot_be_extended(llfsm: Llfsm, arguments: tuple[str, ...], error: str) -> None:
    folder = llfsm.cwd / "M.machine"
    folder.mkdir()
    (folder / "Language").write_text("python")
    (folder / "States").write_text("A")
    (folder / "State_A_OnEntry.py").write_text("")
    done = llfsm.run("new", *arguments)
    assert done.returncode == 2
    assert error in done.stderr
    assert not (llfsm.cwd / "mine.py").exists()
