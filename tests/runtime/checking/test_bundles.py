"""Each kind of finding in a bundle: all files are read, whatever is wrong in one."""

from __future__ import annotations

from pathlib import Path

import pytest

from llfsm.runtime import BundleError
from llfsm.runtime.bundles import (
    UNTRANSLATED,
    import_bundle,
    load_bundle,
    read_bundle,
    write_bundle,
)
from llfsm.runtime.checking import check_bundle

PLAIN = {
    "Language": "python",
    "States": "A\nB\n",
    "State_A_OnEntry.py": "n += 1\n",
    "State_A_Transition_0.target": "B",
    "State_A_Transition_0.expr": "n > 0\n",
    "State_B_OnEntry.py": "\n",
    "M_Variables.py": "n: int = 0\n",
}
PORTS = """\
from llfsm.runtime import Actuator, Sensor
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import String
"""


def findings(path: Path, files: dict[str, str]) -> list[tuple[str, int, str, str]]:
    """Check the plain bundle with other files."""
    folder = path / "M.machine"
    folder.mkdir()
    for name, text in (PLAIN | files).items():
        (folder / name).write_text(text)
    found = check_bundle(folder)
    return [(Path(file).name, line, severity, text) for file, line, severity, text in found]


def test_the_plain_bundle_has_none(tmp_path: Path) -> None:
    assert findings(tmp_path, {}) == []


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"States": "A\nB\nC", "State_C_OnEntry.py": ""},
         ("States", 3, "warning", "no transitions lead to state 'C'")),
        ({"State_A_Transition_0.expr": " true ", "State_A_Transition_1.target": "A"},
         ("State_A_Transition_1.target", 1, "error", "state 'A': the transition to 'A' can never "
          "fire, the one to 'B' before it always does")),
        ({"State_A_Transition_0.expr": "(True)", "State_A_Transition_1.target": "A",
          "State_A_Transition_1.expr": "n > 1"},
         ("State_A_Transition_1.expr", 1, "error", "state 'A': the transition to 'A' can never "
          "fire, the one to 'B' before it always does")),
        ({"M_Variables.py": "n: int = 0\n\nm: int = 0\n"},
         ("M_Variables.py", 3, "warning", "variable 'm' is never used")),
        ({"State_A_Variables.py": "n: int = 0\n"},
         ("M_Variables.py", 1, "warning", "variable 'n' is never used")),
        ({"M_Includes.py": PORTS, "M_Variables.py": "n: int = 0\ns = Sensor(Slot('s', String))"},
         ("M_Variables.py", 2, "warning", "sensor 's' is never read")),
        ({"M_Includes.py": PORTS, "M_Variables.py": "n: int = 0\na = Actuator(Slot('a', String))"},
         ("M_Variables.py", 2, "warning", "actuator 'a' is never called")),
        ({"M_Includes.py": PORTS, "M_Variables.py": "n: int = 0\na = Actuator(Slot('a', String))",
          "State_A_Transition_0.expr": "n > 0 and a(String('x')) > 0"},
         ("State_A_Transition_0.expr", 1, "warning", "a guard posts to actuator 'a'")),
        ({"State_A_Transition_0.expr": "suspend('X') == 0"},
         ("State_A_Transition_0.expr", 1, "warning", "a guard makes the request 'suspend'")),
        ({"State_A_Transition_0.expr": "ask()", "M_Methods.py": "def ask(): return load('X') > 0"},
         ("State_A_Transition_0.expr", 1, "warning",
          "a guard makes the request 'load', through 'ask'")),
        ({"M_Methods.py": "def ask(name): return n"},
         ("M_Methods.py", 1, "warning", "the parameter 'name' hides what every machine has")),
        ({"M_Variables.py": "n: int = 0\nname: str = ''"},
         ("M_Variables.py", 2, "error", "'name' would hide what every machine has; rename it")),
        ({"State_A_OnExit.py": "\nn = self.mispelt"},
         ("State_A_OnExit.py", 2, "error", "the machine has no 'mispelt'")),
        ({"State_A_OnExit.py": "\nafter = 1"},
         ("State_A_OnExit.py", 2, "error",
          "'after' is what every machine has: it cannot be assigned")),
        ({"State_A_OnExit.py": "UNTRANSLATED"},
         ("State_A_OnExit.py", 1, "error",
          "this C++ is not translated yet: write the Python, and delete UNTRANSLATED")),
        ({"M_Includes.py": "\nimport no_such_module_anywhere"},
         ("M_Includes.py", 2, "error",
          "ModuleNotFoundError: No module named 'no_such_module_anywhere'")),
        ({"State_A_OnExit.py": "yield 1"},
         ("State_A_OnExit.py", 1, "error",
          "a machine runs each section to its end: no yield, no await")),
        ({"State_A_Transition_0.expr": "n = 1"},
         ("State_A_Transition_0.expr", 1, "error", "not a single expression")),
        ({"Language": "lisp"},
         ("Language", 1, "error", "the language 'lisp' is unknown; known: python, c++, objc++")),
        ({"States": "A\nB\nA\n"}, ("States", 3, "error", "state 'A' is listed twice")),
        ({"Language": "c++"},
         ("State_A.h", 1, "error", "it is missing; it gives the targets of state 'A', "
          "which States lists; for a bundle of Python, write python into a file Language")),
    ],
)  # fmt: skip
def test_each_finding(
    tmp_path: Path, files: dict[str, str], expected: tuple[str, int, str, str]
) -> None:
    assert findings(tmp_path, files) == [expected]


def test_all_files_are_read(tmp_path: Path) -> None:
    files = {
        "State_A_OnEntry.py": "n +=\n",
        "State_A_OnExit.py": "one\nn = two + one\nprint(len('x'))\n",
        "State_A_Transition_0.expr": "three",
        "State_A_Transition_0.target": "Nowhere",
        "State_B_Transition_0.target": "Gone",
        "State_B_OnEntry.py": "[four for n2 in range(3)]",
        "M_Methods.py": "def f(x):\n    return x + five\n",
    }
    found = findings(tmp_path, files)
    assert found == sorted(found)
    assert [(file, line, text) for file, line, _, text in found] == [
        ("M_Methods.py", 2, "nothing is called 'five'"),
        ("State_A_OnEntry.py", 1, "SyntaxError: invalid syntax"),
        ("State_A_OnExit.py", 1, "nothing is called 'one'"),
        ("State_A_OnExit.py", 2, "nothing is called 'one'"),
        ("State_A_OnExit.py", 2, "nothing is called 'two'"),
        ("State_A_Transition_0.expr", 1, "nothing is called 'three'"),
        ("State_A_Transition_0.target", 1, "'Nowhere' is not a state; the states are: A, B"),
        ("State_B_OnEntry.py", 1, "nothing is called 'four'"),
        ("State_B_Transition_0.target", 1, "'Gone' is not a state; the states are: A, B"),
        ("States", 2, "no transitions lead to state 'B'"),
    ]


@pytest.mark.parametrize(
    "declared",
    [
        {"M_Includes.py": "from math import *"},
        {"M_Includes.py": "import ("},
        {"M_Variables.py": "floor: int ="},
        {"M_Methods.py": "def floor("},
        {"State_A_Methods.py": "def floor("},
    ],
)
def test_where_names_cannot_be_told_none_is_unknown(
    tmp_path: Path, declared: dict[str, str]
) -> None:
    found = findings(tmp_path, declared | {"State_A_OnExit.py": "n = floor(n)"})
    assert not [each for each in found if each[0] == "State_A_OnExit.py"]


def test_an_error_does_not_hide_what_a_state_includes(tmp_path: Path) -> None:
    files = {"State_A_OnExit.py": "one", "State_B_Includes.py": "import math",
             "State_B_OnExit.py": "math.floor(two)"}  # fmt: skip
    texts = [text for _, _, _, text in findings(tmp_path, files)]
    assert texts == ["nothing is called 'one'", "nothing is called 'two'"]


def test_what_is_within_a_class_or_function_is_not_included(tmp_path: Path) -> None:
    includes = """\
from llfsm.runtime import Sensor
from llfsm.whiteboard import Message, Slot


class Level(Message):
    name: str = ""
    n: int = 0
    status: bool = False


def total(values: tuple[int, ...]) -> int:
    suspend = sum(value for value in values)
    return suspend


if total((1,)):
    LEVEL = Slot("level", Level)
"""
    variables = "n: int = 0\nlevel = Sensor(LEVEL, default=Level())\n"
    files = {"M_Includes.py": includes, "M_Variables.py": variables}
    assert findings(tmp_path, files | {"State_B_OnEntry.py": "n = level.n\n"}) == []


def test_sections_are_not_run(tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    section = f"open({str(ran)!r}, 'w')"
    files = {"State_A_OnEntry.py": section, "State_B_OnEntry.py": section}
    assert findings(tmp_path, files) == []
    assert not ran.exists()


def test_every_mark_of_an_import_is_found(tmp_path: Path) -> None:
    lamp = Path(__file__).parents[2] / "data" / "bundles" / "Lamp.machine"
    folder = tmp_path / "Lamp.machine"
    write_bundle(import_bundle(read_bundle(lamp)), folder)
    marks = {
        (str(file), number)
        for file in folder.iterdir()
        for number, line in enumerate(file.read_text().splitlines(), 1)
        if line.startswith(UNTRANSLATED)
    }
    found = {(each.file, each.line) for each in check_bundle(folder) if each.severity == "error"}
    assert found == marks
    assert {"Lamp_Variables.py", "State_On_OnEntry.py"} <= {Path(file).name for file, _ in marks}


def test_a_bundle_of_cpp_is_to_be_imported_first() -> None:
    lamp = Path(__file__).parents[2] / "data" / "bundles" / "Lamp.machine"
    [finding] = check_bundle(lamp)
    assert finding.severity == "error"
    assert "convert it to Python with `llfsm import`" in finding.text


@pytest.mark.parametrize(
    "declared",
    [
        {"M_Variables.py": "x: int = 0\nx: int = 1\n"},
        {"M_Variables.py": "after_ms: int = 0\n"},
        {"M_Variables.py": "table: int = 0\n"},
        {"M_Variables.py": "__x: int = 0\n"},
        {"M_Variables.py": "x = y = 3\n"},
        {"M_Variables.py": "import math\n"},
        {"M_Includes.py": "import math as x\n", "M_Variables.py": "x: int = 0\n"},
        {"M_Includes.py": "import math as suspend\n"},
        {"M_Methods.py": "x = 1\n"},
        {"M_Methods.py": "def f(): pass\ndef f(): pass\n"},
        {"M_Variables.py": "f: int = 0\n", "M_Methods.py": "def f(): pass\n"},
        {"State_A_Variables.py": "x: int = 0\nx: int = 1\n"},
        {"State_A_Variables.py": "x = Sensor(3)\n"},
        {"M_Methods.py": "UNTRANSLATED\n"},
    ],
)
def test_declarations_are_judged_as_when_they_are_loaded(
    tmp_path: Path, declared: dict[str, str]
) -> None:
    """Also beside another error, which keeps the bundle from being loaded at last."""
    broken = declared | {"State_B_OnExit.py": "if (\n"}
    found = {each for each in findings(tmp_path, broken) if each[0] != "State_B_OnExit.py"}
    (tmp_path / "M.machine" / "State_B_OnExit.py").unlink()
    with pytest.raises(BundleError) as raised:
        load_bundle(tmp_path / "M.machine")
    file, line = raised.value.file, raised.value.line
    what = str(raised.value).partition(": ")[2]
    assert (file.name, line or 1, "error", what) in found
