"""What a type checker finds in machines, at the lines of the user's own files."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.cli.root import main
from llfsm.runtime import TypeCheckerError
from llfsm.runtime.bundles import (
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    read_bundle,
)
from llfsm.runtime.checking import check_types
from llfsm.runtime.checking._type_checkers import module_of
from thoroughness import examples

PYTHON = sys.executable
PORTS = "from llfsm.runtime import Actuator, Machine, Sensor, State\n" + (
    "from llfsm.whiteboard import Message, Slot\nclass Level(Message):\n    value: int = 0\n"
)
LAMP = {
    "Language": "python",
    "States": "OFF\nON\n",
    "Lamp_Includes.py": PORTS,
    "Lamp_Variables.py": "level = Sensor(Slot('level', Level))\n"
    "light = Actuator(Slot('light', Level))\nbest: list[int] = []\n",
    "Lamp_Methods.py": "def half(of: int) -> float:\n    return of / 2\n",
    "State_OFF_OnEntry.py": "# long\nfor self in range(3):\n    best.append(\n        'x')\n",
    "State_OFF_Transition_0.expr": "level.value > 0",
    "State_OFF_Transition_0.target": "ON",
    "State_ON_Variables.py": "tries: int = 3\nmore: int = tries\n",
    "State_ON_Includes.py": "from __future__ import annotations\nfrom math import pi\n",
    "State_ON_OnEntry.py": "tries += more\ntries = half(tries)  # type: ignore[assignment]\n"
    "print(f'{tries!r:>{more}}')\nlight(Level(half(1)))\ntries = pi\n",
    "State_ON_Transition_0.expr": " level is None\n",
    "State_ON_Transition_0.target": "OFF",
}
CLASS = """
class M(Machine):
    level = Sensor(Slot("level", Level), default=Level())
    a = State()
    b = State()
    a.to(b, when=lambda self: self.level.value)
    a.to(b, when=lambda self: self.level.value > 0)
    b.to(a, when=lambda self: self.of("x").upper() == "X")

    def of(self, text: str):
        return len(text)

    def unchecked(self):
        return self.of(3)
"""


def write_bundle(folder: Path) -> Path:
    (folder / "Lamp.machine").mkdir()
    for name, text in LAMP.items():
        (folder / "Lamp.machine" / name).write_text(text)
    return folder / "Lamp.machine"


def program(folder: Path, name: str, prints: str, status: int = 0) -> None:
    """Write a program that prints a text and, into a file, its arguments."""
    script = folder / name
    script.write_text(
        f"#!{PYTHON}\nimport sys\n"
        f"open({str(folder / 'arguments')!r}, 'w').write('\\n'.join(sys.argv))\n"
        f"sys.stdout.write({prints!r}.replace('FILE', sys.argv[-1]))\nsys.exit({status})\n"
    )
    script.chmod(0o755)


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder, the only one where programs are found."""
    folder = tmp_path / "programs"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setattr("sys.executable", str(folder / "python"))
    return folder


def test_mypy_finds_what_is_wrong_in_bundles_and_classes(here: Path) -> None:
    write_bundle(here)
    (here / "robot.py").write_text(PORTS + CLASS)
    done = CliRunner().invoke(main, ["check", "--types", "Lamp", "robot.py", "RosPingPong"])
    shown = [line for line in done.output.splitlines() if line.endswith("]")]
    assert shown == [
        'Lamp.machine/State_OFF_OnEntry.py:4: error: Argument 1 to "append" of "list" has '
        'incompatible type "str"; expected "int" [arg-type]',
        'Lamp.machine/State_OFF_Transition_0.expr:1: error: Item "None" of "Level | None" has no '
        'attribute "value" [union-attr]',
        'Lamp.machine/State_ON_OnEntry.py:4: error: Argument 1 to "Level" has incompatible type '
        '"float"; expected "int" [arg-type]',
        "Lamp.machine/State_ON_OnEntry.py:5: error: Incompatible types in assignment (expression "
        'has type "float", variable has type "int") [assignment]',
        'robot.py:10: error: Argument "when" to "to" of "State" has incompatible type '
        '"Callable[[M], int]"; expected "Callable[[M], bool] | None" [arg-type]',
        'robot.py:10: error: Incompatible return value type (got "int", expected "bool") '
        "[return-value]",
        'robot.py:18: error: Argument 1 to "of" of "M" has incompatible type "int"; expected "str" '
        "[arg-type]",
    ]
    assert done.exit_code == 1


def test_without_a_type_checker(here: Path, programs: Path) -> None:
    done = CliRunner().invoke(main, ["check", "--types", "RosPingPong"])
    assert done.exit_code == 1
    assert done.output == (
        "Error: no type checker is installed: install mypy or pyright, as by `pip install mypy`\n"
    )


def test_pyright_where_mypy_is_not(tmp_path: Path, programs: Path) -> None:
    """The form is that of pyright 1.1.414."""
    folder = write_bundle(tmp_path)
    lines = module_of(read_bundle(folder)).text.splitlines()
    line = next(number for number, text in enumerate(lines) if "append('x')" in text)
    column = lines[line].index("'x'")
    printed = {
        "file": "FILE",
        "severity": "error",
        "message": 'Argument of type "str" cannot be assigned\n\xa0\xa0"str" is not "int"',
        "rule": "reportArgumentType",
        "range": {
            "start": {"line": line, "character": column},
            "end": {"line": line, "character": column + 3},
        },
    }
    known = {"file": "FILE", "severity": "information", "message": "nothing"}
    program(programs, "pyright", json.dumps({"generalDiagnostics": [printed, known]}), 1)
    expected = 'Argument of type "str" cannot be assigned: "str" is not "int" [reportArgumentType]'
    assert check_types([folder]) == [(str(folder / "State_OFF_OnEntry.py"), 4, "error", expected)]


def test_mypy_has_the_users_configuration(here: Path, programs: Path) -> None:
    program(programs, "mypy", "")
    folder = write_bundle(here)

    def settings() -> list[str]:
        assert check_types([folder]) == []
        arguments = (programs / "arguments").read_text().splitlines()
        return [each for each in arguments if each.startswith("--config-file=")]

    assert len(settings()) == 1
    (here / "pyproject.toml").write_text("[tool.ruff]\n")
    assert len(settings()) == 1
    (here / "pyproject.toml").write_text("[tool.mypy]\nstrict = true\n")
    assert settings() == []


def test_a_type_checker_that_does_not_work(tmp_path: Path, programs: Path) -> None:
    program(programs, "mypy", "one\nmypy: no such option\n", 2)
    with pytest.raises(TypeCheckerError) as caught:
        check_types([write_bundle(tmp_path)])
    assert str(caught.value) == (
        f"{programs / 'mypy'} ended with status 2: mypy: no such option; "
        f"run it by itself to see why"
    )


def test_a_bundle_that_cannot_be_read_is_left_out(tmp_path: Path, programs: Path) -> None:
    folder = write_bundle(tmp_path)
    (folder / "State_ON_OnEntry.py").write_text("light(\n")
    assert check_types([folder]) == []


@settings(max_examples=examples(15))
@given(st.lists(st.tuples(st.integers(0, 3), st.booleans(), st.booleans()), min_size=1))
def test_each_statement_has_its_place(kinds: list[tuple[int, bool, bool]]) -> None:
    """Each number stands at its own line, however many lines stand before and within it."""
    lines: list[str] = []
    expected = {}
    for number, (blank, nested, split) in enumerate(kinds):
        lines += [""] * blank
        if nested:
            lines.append("if count:")
        if split:
            lines.append("    " * nested + "print(")
        mark = f"{1000 + number}"
        lines.append("    " * (nested or split) + mark + ")" * split)
        expected[mark] = len(lines)
    section = Fragment("\n".join(lines) + "\n", Path("entry.py"))
    guard = Fragment("count > 7777", Path("guard.expr"))
    state = BundleState("A", {"OnEntry": section}, (BundleTransition("A", guard),))
    module = module_of(Bundle("B", (state,), variables=Fragment("count: int = 0")))
    found = {}
    for number, line in enumerate(module.text.splitlines(), 1):
        for mark in expected:
            if mark in line:
                place = module.place(number, line.index(mark))
                assert place.file == "entry.py"
                found[mark] = place.line
        if "7777" in line:
            assert module.place(number, line.index("7777")) == ("guard.expr", 1)
    assert found == expected
