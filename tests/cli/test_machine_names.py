"""Machines are found however people name them, and a name that is wrong gets the one meant."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from llfsm.cli.machines import MachineImportError, find_machine_class

ONE = """
from llfsm.runtime import Machine, State

class {name}(Machine):
    a = State()
"""


def write(file: Path, text: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)


@pytest.mark.parametrize(
    "name",
    ["rover", "rover.py", "./rover.py", "rover:Rover", "rover.py:Rover", "{here}/rover.py:Rover"],
)
def test_a_module_in_the_current_folder(here: Path, name: str) -> None:
    write(here / "rover.py", ONE.format(name="Rover"))
    assert find_machine_class(name.format(here=here)).table.path == "rover:Rover"


@pytest.mark.parametrize("name", ["robots/rover.py:Rover", "robots/rover"])
def test_a_file_in_another_folder_imports_its_neighbours(here: Path, name: str) -> None:
    write(here / "robots" / "parts.py", "WHEELS = 4\n")
    write(here / "robots" / "rover.py", "from parts import WHEELS\n" + ONE.format(name="Rover"))
    assert find_machine_class(name).table.path == "rover:Rover"


def test_a_file_of_a_package_may_import_relatively(here: Path) -> None:
    write(here / "src" / "fleet" / "__init__.py", "")
    write(here / "src" / "fleet" / "parts.py", "WHEELS = 4\n")
    text = "from .parts import WHEELS\n" + ONE.format(name="Rover")
    write(here / "src" / "fleet" / "rover.py", text)
    assert find_machine_class("src/fleet/rover.py").table.path == "fleet.rover:Rover"


def test_a_machine_that_ships_comes_before_a_file(here: Path) -> None:
    write(here / "RosPingPong.py", ONE.format(name="Mine"))
    assert find_machine_class("RosPingPong").table.path == "llfsm.machines.ping_pong:RosPingPong"


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("two", "two: name one machine, as two:CLASS; there are: First, Second"),
        ("none.py", "none.py: name one machine, as none.py:CLASS; there are: none"),
        ("two:Frist", "has no 'Frist'; its machines: First, Second; did you mean 'First'?"),
        ("absent.py:M", "absent.py:M: there is no file absent.py"),
        ("absent:M", "absent:M: there is no module 'absent'"),
        ("tow", "a bundle, as path/to/Name.machine; did you mean 'two'?"),
        ("Lmap", "did you mean 'Lamp'?"),
        ("RosPingPon", "did you mean 'RosPingPong'?"),
        ("my-robot.py", "'my-robot' cannot be imported; a module's name has letters, digits"),
        ("json.py", "another module is called json, too: "),
        ("none.py:sys", "is not a machine class"),
    ],
)
def test_the_error_names_what_was_meant(here: Path, name: str, error: str) -> None:
    write(here / "two.py", ONE.format(name="First") + ONE.format(name="Second"))
    write(here / "none.py", "import sys\nfrom llfsm.machines import RosPingPong\n")
    write(here / "my-robot.py", ONE.format(name="Robot"))
    write(here / "json.py", ONE.format(name="Robot"))
    (here / "Lamp.machine").mkdir()
    with pytest.raises(click.UsageError) as caught:
        find_machine_class(name)
    assert error in caught.value.message


@pytest.mark.parametrize(
    ("declaration", "error"),
    [
        (
            "@a.on_enter\n    def _(self): pass",
            "AttributeError: 'State' object has no attribute 'on_enter'; did you mean 'on_entry'",
        ),
        ("a.to('b')", "state 'a': a transition leads to a State, not to 'b'"),
        ("a.on_entry(3)", "state 'a': OnEntry must be a plain function of the machine, not 3"),
        ("a.to(a, after_ms=-1)", "state 'a': a transition waits for a time of 0 or more, not -1"),
        (
            "@a.on_exit\n    async def off(self): pass",
            "state 'a': OnExit must be a plain function of the machine, "
            "not 'off', which is async or yields",
        ),
    ],
)
def test_a_wrong_declaration_is_one_line_with_its_state(
    here: Path, declaration: str, error: str
) -> None:
    write(here / "wrong.py", ONE.format(name="Wrong") + f"    {declaration}\n")
    with pytest.raises(MachineImportError) as caught:
        find_machine_class("wrong.py")
    assert caught.value.file == str(here / "wrong.py")
    assert caught.value.line == 6
    assert error in str(caught.value)
    assert "\n" not in str(caught.value)
