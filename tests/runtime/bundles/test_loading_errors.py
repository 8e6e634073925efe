"""What is wrong in a bundle of Python is an error when it is loaded, with a file and a line."""

from __future__ import annotations

from pathlib import Path

import pytest

from llfsm.runtime import BundleError, DefinitionError
from llfsm.runtime.bundles import load_bundle

from .conftest import Write


@pytest.mark.parametrize(
    ("texts", "printed"),
    [
        # names
        ({"A_OnEntry": "\nm = cuont"}, r"A_OnEntry\.py:2: nothing is called 'cuont'"),
        ({"expr": "cuont > 1"}, r"_0\.expr:1: nothing is called 'cuont'"),
        ({"Methods": "def f() -> None:\n    g()"}, r"M_Methods\.py:2: nothing is called 'g'"),
        ({"A_OnEntry": "stopping = True"}, "'stopping' is what every machine has: it cannot be as"),
        ({"A_OnEntry": "x = 1\ndel n"}, r"A_OnEntry\.py:2: 'n' is .* deleted"),
        ({"A_OnEntry": "n: int = 3"}, "'n' is a variable of the machine: it cannot be declared"),
        ({"A_OnEntry": "(n := 3)"}, "'n' is a variable of the machine: .* assigned by :="),
        ({"A_OnEntry": "import n"}, "it cannot be imported"),
        ({"A_OnEntry": "from os import path as n"}, "it cannot be imported"),
        ({"A_OnEntry": "def n(): pass"}, "it cannot be the name of a function"),
        ({"A_OnEntry": "class n: pass"}, "it cannot be the name of a class"),
        ({"A_OnEntry": "try: pass\nexcept OSError as n: pass"}, ":2: .* be bound by except"),
        ({"A_OnEntry": "match 1:\n    case n: pass"}, ":2: .*bound by a pattern"),
        ({"A_OnEntry": "match 1:\n    case [*n]: pass"}, ":2: .*bound by a pattern"),
        ({"A_OnEntry": "match 1:\n    case {**n}: pass"}, ":2: .*bound by a pattern"),
        ({"A_OnEntry": "global k"}, "machines share no variables: leave out `global`"),
        ({"A_OnEntry": "def f():\n    nonlocal n"}, ":2: .*leave out `nonlocal`"),
        ({"A_OnEntry": "s = 1"}, "'s' is a sensor: it cannot be assigned"),
        ({"A_OnEntry": "a = 1"}, "'a' is an actuator: it cannot be assigned"),
        ({"A_OnEntry": "f = 1", "Methods": "def f(): pass"}, "'f' is a function of the machine"),
        ({"Includes": "from os import name"}, r"M_Includes\.py: 'name' is what every"),
        ({"A_Includes": "from math import pi as n"}, r"A_Includes\.py: 'n' is a var"),
        # declarations
        ({"Variables": "x: int = 0\nx: int = 1"}, r"M_Variables\.py:2: 'x' is declared twice"),
        ({"Variables": "table: int = 0"}, "'table' would hide what every machine has; rename it"),
        ({"Variables": "_seat: int = 0"}, "'_seat' would hide"),
        ({"Variables": "status: int = 0"}, "'status' would hide what every machine has"),
        ({"Variables": "__x: int = 0"}, "'__x' would hide"),
        ({"Variables": "Sensor: int = 0"}, "'Sensor' is in the includes already"),
        ({"Variables": "x = 3"}, "'x' is not a Sensor or an Actuator.* x: int = 3"),
        ({"Variables": "x = y = 3"}, "only variables can be declared here"),
        ({"Variables": "x: int = 1\nprint(x)"}, r"M_Variables\.py:2: only variables can"),
        ({"Variables": "x: int = undefined"}, r"M_Variables\.py:1: nothing is called 'undefined'"),
        ({"Variables": "x: int = int('y')"}, r"M_Variables\.py:1: ValueError: invalid literal"),
        ({"A_Variables": "x: int"}, r"State_A_Variables\.py:1: 'x' needs a value"),
        ({"A_Variables": "x: int = 1\nx: int = 2"}, ":2: 'x' is declared twice"),
        ({"A_Variables": "x = Sensor(X)"}, "can be declared here, as name: type = value"),
        ({"Methods": "x = 1"}, r"M_Methods\.py:1: only functions can be declared here"),
        ({"Methods": "def n(): pass"}, "'n' is declared twice"),
        ({"Methods": "def f(k=n): pass"}, "variable of the machine: it does not exist before"),
        ({"Methods": "def f(): pass\ndef f(): pass"}, r"M_Methods\.py:2: 'f' is declared twice"),
        ({"Methods": "@undefined\ndef f(): pass"}, "nothing is called 'undefined'"),
        # code
        ({"A_OnEntry": "x = 1\nx = ="}, r"A_OnEntry\.py:2: SyntaxError: invalid syntax"),
        ({"A_OnEntry": "x = 1\nbreak"}, r"A_OnEntry\.py:2: SyntaxError: 'break' outside loop"),
        ({"A_OnEntry": "yield 1"}, "no yield, no await"),
        ({"A_OnEntry": "await after_ms(1)"}, "SyntaxError: 'await' outside async function"),
        ({"A_OnEntry": "\0"}, r"A_OnEntry\.py.*SyntaxError"),
        ({"expr": "n >"}, r"_0\.expr:1: SyntaxError"),
        ({"expr": "n = 3"}, r"_0\.expr:1: not a single expression"),
        ({"expr": "n == 3\nn == 4"}, r"_0\.expr:1: not a single expression"),
        ({"expr": "# nothing"}, r"_0\.expr:1: not a single expression"),
        ({"expr": "UNTRANSLATED  # x->y"}, r"_0\.expr:1: this C\+\+ is not translated yet"),
        ({"A_OnEntry": "UNTRANSLATED"}, r"A_OnEntry\.py:1: this C\+\+ is not translated"),
        ({"Methods": "UNTRANSLATED"}, r"M_Methods\.py:1: this C\+\+ is not translated"),
        ({"Variables": "x: UNTRANSLATED"}, r"M_Variables\.py:1: this C\+\+ is not translated"),
        ({"Includes": "import sys\n\n1 / 0"}, r"M_Includes\.py:3: ZeroDivisionError: division"),
        ({"Includes": "import no_such_module_at_all"}, r"M_Includes\.py:1: ModuleNotFoundError"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_reported_with_file_and_line(
    bundle: Write, texts: dict[str, str], printed: str
) -> None:
    ours = {
        "Includes": "from llfsm.runtime import Actuator, Sensor\n"
        "from llfsm.whiteboard import Slot\n"
        "from llfsm.whiteboard.messages.std_msgs import Int64\nX = Slot('x', Int64)",
        "Variables": "n: int = 0\ns = Sensor(X)\na = Actuator(X)",
    }
    with pytest.raises(BundleError, match=printed):
        load_bundle(bundle(**{**ours, **texts}))


def test_contradictions_are_those_of_a_class(bundle: Write) -> None:
    folder = bundle(
        {"State_A_Transition_1.target": "A", "State_A_Transition_1.expr": "false"}, expr="true"
    )
    with pytest.raises(BundleError, match="nothing is called 'false'"):
        load_bundle(folder)
    (folder / "State_A_Transition_1.expr").write_text("stopping")
    with pytest.raises(DefinitionError, match="can never fire"):
        load_bundle(folder)


def test_a_bundle_of_cpp_does_not_run(lamp: Path) -> None:
    with pytest.raises(BundleError, match=r"Lamp\.machine: this is a C\+\+ bundle.*llfsm import"):
        load_bundle(lamp)
