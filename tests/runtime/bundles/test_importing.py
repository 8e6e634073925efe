"""A bundle of C++ becomes one of Python that means the same, or that says what is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from llfsm.runtime import Arrangement, BundleError, ManualClock
from llfsm.runtime.bundles import (
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    compile_bundle,
    import_bundle,
    load_bundle,
    read_bundle,
    write_bundle,
)


def test_a_bundle(lamp: Path, tmp_path: Path) -> None:
    source = read_bundle(lamp)
    made = import_bundle(source)
    folder = tmp_path / "python" / "Lamp.machine"
    write_bundle(made, folder)
    assert read_bundle(folder) == made
    assert (made.name, made.language, made.suspend) == ("Lamp", "python", "Suspend")
    assert made.layout == source.layout
    states = [(s.name, [t.target for t in s.transitions]) for s in source.states]
    assert [(s.name, [t.target for t in s.transitions]) for s in made.states] == states
    assert (folder / "Lamp_Variables.py").read_text() == (
        "count: int = 0  # times switched on\n"
        "limit: int = 3\n"
        "broken: bool = False  # whether it is\n"
        "UNTRANSLATED  # Status_t\tlamp_status;  # what the lamp says\n"
    )
    assert (folder / "Lamp_Includes.py").read_text().startswith("# #include <iostream>\n")
    expressions = {file.name[6:-5]: file.read_text().strip() for file in folder.glob("*.expr")}
    assert expressions == {
        "InitialPseudoState_Transition_0": "True",
        "Off_Transition_0": "after_ms(500) and (not broken)",
        "Off_Transition_1": "broken",
        "On_Transition_0": "after(0.5)",
        "On_Transition_1": "count >= limit - 1 or broken",
        "Done_Suspending_Transition_0": "UNTRANSLATED  # lamp_status.get().isOff()",
    }
    assert (folder / "State_Off_OnEntry.py").read_text() == (
        "UNTRANSLATED\n# count = 0;\n# lamp(false);\n"
    )
    assert (folder / "State_Done_OnEntry.py").read_text() == "# // nothing to do\n# {\n# }\n"
    assert (folder / "State_On_Variables.py").read_text() == "since: float = 0.0  # when\n"


def test_it_runs_when_all_marks_are_gone(lamp: Path, tmp_path: Path) -> None:
    folder = tmp_path / "python" / "Lamp.machine"
    write_bundle(import_bundle(read_bundle(lamp)), folder)
    by_hand = {
        "Lamp_Variables.py": "count: int = 0\nlimit: int = 3\nbroken: bool = False",
        "State_Off_OnEntry.py": "count = 0",
        "State_Off_OnResume.py": "pass",
        "State_On_OnEntry.py": "count += 1",
        "State_Done_Suspending_Transition_0.expr": "true",
    }
    for name, text in by_hand.items():
        with pytest.raises(BundleError, match=rf"{name}:\d: this C\+\+ is not translated yet"):
            load_bundle(folder)
        (folder / name).write_text(text)
    with pytest.warns(match="Done_Suspending"):
        cls = load_bundle(folder)
    clock = ManualClock()
    arrangement = Arrangement([cls], clock=clock)
    seen = []
    for _ in range(5):
        arrangement.round()
        seen.append(arrangement.state_name_of("Lamp"))
        clock.advance(ms=501)
    assert seen == ["Off", "Off", "On", "On", "Off"]


def imported(variables: str, expression: str, state_variables: str | None = None) -> list[str]:
    """Return the lines of the variables and the expression, imported."""
    own = None if state_variables is None else Fragment(state_variables)
    state = BundleState("A", {}, (BundleTransition("A", Fragment(expression)),), variables=own)
    made = import_bundle(Bundle("M", (state,), "objc++", variables=Fragment(variables)))
    [transition] = made.states[0].transitions
    texts = [made.variables, made.states[0].variables, transition.expression]
    return [line for text in texts if text for line in text.text.splitlines()]


@pytest.mark.parametrize(
    ("cpp", "python"),
    [
        ("unsigned int\tu;\t///< how many", "u: int = 0  # how many"),
        ("std::string name;", 'name_: str = ""'),
        ("const char *\ttext;", 'text: str = ""'),
        ('const char* text = "hello";', "text: str = 'hello'"),
        ("float x = -1;", "x: float = -1.0"),
        ("double x = -1;", "x: float = -1.0"),
        ("int lambda; /* odd */", "lambda_: int = 0  # odd"),
        ("int __x;", "x_: int = 0"),
        ("int a[3];", "UNTRANSLATED  # int a[3];"),
        ("int a, b;", "UNTRANSLATED  # int a, b;"),
        ("int *p;", "UNTRANSLATED  # int *p;"),
        ("char c;", "UNTRANSLATED  # char c;"),
        ("int x = f();", "UNTRANSLATED  # int x = f();"),
        ("static int x;", "UNTRANSLATED  # static int x;"),
        ('#include "x.h"', 'UNTRANSLATED  # #include "x.h"'),
    ],
)
def test_variables(cpp: str, python: str) -> None:
    assert imported(f"// do not change manually!\n{cpp}\n", "true") == [python, "True"]


def test_names_that_mean_something_else_are_changed_everywhere() -> None:
    assert imported("int status;\nint status_;", "status < status_") == [
        "status_: int = 0", "status__: int = 0", "status_ < status__"
    ]  # fmt: skip


def test_a_states_variable_hides_the_machines() -> None:
    assert imported("int x;", "x", "bool x;")[1:] == ["x: bool = False", "x"]
    assert imported("int x;", "x > 0", "Status_t x;")[-1] == "UNTRANSLATED  # x > 0"
    assert imported("int x;", "x > 0", "int x[2];")[-1] == "UNTRANSLATED  # x > 0"


def test_what_is_imported_compiles() -> None:
    state = BundleState(
        "A",
        {"OnEntry": Fragment("{\n\tusing namespace std;\n\t// no\n}\n")},
        (BundleTransition("B", Fragment("after(1) && !ok")), BundleTransition("B")),
    )
    source = Bundle("M", (state, BundleState("B")), "c++", variables=Fragment("bool ok;"))
    cls = compile_bundle(import_bundle(source))
    assert [t.label for t in cls.table.initial.transitions] == ["after(1) and (not ok)", "true"]
    assert not cls.table.initial.sections


def test_a_bundle_of_python_is_refused() -> None:
    with pytest.raises(BundleError, match="already a Python bundle"):
        import_bundle(Bundle("M", (BundleState("A"),)))
