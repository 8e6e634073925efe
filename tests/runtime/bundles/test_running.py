"""Bundles of Python run as classes do, with bare names; what is wrong has a file and a line."""

from __future__ import annotations

import dis
import sys
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from llfsm.runtime import (
    Arrangement,
    BundleError,
    DefinitionError,
    ExecutionError,
    GuardResultError,
    ManualClock,
    Trace,
    VariableError,
)
from llfsm.runtime.bundles import (
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    compile_bundle,
    load_bundle,
    read_bundle,
)
from llfsm.runtime.engine.events import Eval
from llfsm.runtime.engine.layout import MachineLayout, StateBox
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64

Write = Callable[..., Path]


def run(folder: Path, rounds: int = 1, **variables: Any) -> Any:
    machine: Any = load_bundle(folder)(**variables)
    arrangement = Arrangement([machine], clock=ManualClock())
    for _ in range(rounds):
        arrangement.round()
    return machine


# Names


@pytest.mark.parametrize(
    ("code", "n"),
    [
        ("n = 5", 5),
        ("n += 1", 2),
        ("for n in range(4): pass", 3),
        ("n, m = 7, 8", 7),
        ("[n, *rest] = range(3)\nn = len(rest)", 2),
        ("local = n + 1\nn = local * 2", 4),
        ("n = sum(n for n in range(4))", 6),
        ("n = sum(k * n for k in range(4))", 6),
        ("n = [i for i in range(n, 9) if i > n][n]", 3),
        ("n = (lambda n: n * 10)(n + 1)", 20),
        ("n = (lambda k=n: k + n)()", 2),
        ("n = {n: n for n in (9,)}[9]", 9),
        ("def double(n):\n    return n * 2\nn = double(4)", 8),
        ("def grow():\n    n = 50\ngrow()", 1),
        ("def f(k, /, *a, key=n, **kw):\n    return n + key\nn = f(1)", 2),
        ("def f():\n    k = 0\n    def g():\n        nonlocal k\n        k += n\n    g()\n"
         "    return k\nn = f() + 4", 5),
        ("class C:\n    n = 3\n    k = n\n    def f(self):\n        return n\n"
         "n = C.k * 10 + C().f()", 31),
        ("class C:\n    def f(self):\n        return self.n\n    n = 8\nn = C().f()", 8),
        ("if (k := n + 1) > 1: n = k", 2),
        ("n = [j := 4, j][1]\nn = j + [k := i for i in (3,)][0] + k", 10),
        ("match (n, 5):\n    case (1, k): n = k", 5),
        ("match {'a': 1}:\n    case {**rest}: n = len(rest) + 1", 2),
        ("try:\n    1 / 0\nexcept ZeroDivisionError as e:\n    n = len(e.args)", 1),
        ("import math as m2\nn = int(m2.pi)", 3),
        ("n = int(pi)", 3),
        ("n = eval('1 + 1')", 2),
        ("n = f'{n + 1:>{n}}' == '2'", True),
        ("return\nn = 9", 1),
        ("helper(self, 6)", 6),
        ("self.n = 7", 7),
        ("n = twice(twice(n))", 4),
        ("n = len(name) + len(state_name)", 2),
        ("n = int(is_running(name)) + 3", 4),
        ("n = number_of_machines + index_of(name)", 1),
        ("n = int(not stopping) + int(after_ms(0))", 1),
        ("n = 0 if suspend_self() else 9", 9),
    ],
)  # fmt: skip
def test_names(bundle: Write, code: str, n: int) -> None:
    folder = bundle(
        Includes="from math import pi\ndef helper(machine, n):\n    machine.n = n",
        Variables='"""Ours."""\nn: int = 1  # a comment\nm: int = 0',
        Methods="def twice(k: int) -> int:\n    return k * n * 2 if n else 0",
        A_OnEntry=code,
    )
    assert run(folder).n == n


def test_sections_and_machines_share_only_the_machines_variables(bundle: Write) -> None:
    folder = bundle(
        Variables="log: list[str] = []",
        A_Internal="word = 'x'\nlog.append(word)",
        A_OnExit="log.append(word)",
        expr="len(log) > 1",
    )
    with pytest.raises(BundleError, match=r"State_A_OnExit\.py:1: nothing is called 'word'"):
        load_bundle(folder)
    (folder / "State_A_OnExit.py").write_text("log.append('out')")
    cls: Any = load_bundle(folder)
    one, other = cls(), cls()
    arrangement = Arrangement([one], clock=ManualClock())
    arrangement.round()
    arrangement.round()
    assert (one.log, other.log) == (["x", "x"], [])


def test_a_states_own_names(bundle: Write) -> None:
    folder = bundle(
        Variables="n: int = 1\nseen: list[int] = []",
        A_Includes="from math import tau as n2",
        A_Variables="n: int = 10\nwords: list[str] = []",
        A_Methods="def grow() -> int:\n    n += 1\n    return n",
        A_OnEntry="seen.append(grow())",
        A_Internal="seen.append(grow() + int(n2))",
        B_OnEntry="seen.append(n)",
        expr="n == 12",
    )
    cls: Any = load_bundle(folder)
    machine = cls()
    arrangement = Arrangement([machine], clock=ManualClock())
    for _ in range(3):
        arrangement.round()
    assert machine.seen == [11, 18, 1]
    assert cls(**{"A.n": 3}).__dict__["A.n"] == 3
    (folder / "State_B_OnEntry.py").write_text("seen.append(len(words))")
    with pytest.raises(BundleError, match=r"State_B_OnEntry\.py:1: nothing is called 'words'"):
        load_bundle(folder)


def test_ports(bundle: Write) -> None:
    folder = bundle(
        Includes="from llfsm.runtime import Actuator, Sensor\nfrom llfsm.whiteboard import Slot\n"
        "from llfsm.whiteboard.messages.std_msgs import Int64\nX = Slot('x', Int64)",
        Variables="x = Sensor(X)\ny = Actuator(Slot('y', Int64), at_end=Int64(-1))",
        A_OnExit="y(Int64(x.data + 1))",
        expr="x is not None and x.data == 4",
    )
    board = Whiteboard.local()
    arrangement = Arrangement([load_bundle(folder)], whiteboard=board, clock=ManualClock())
    assert arrangement.round() is False
    board.add_message(Slot("x", Int64), Int64(4))
    assert arrangement.round() is True
    y = Slot("y", Int64)
    assert board.get_message(y) == Int64(5)
    arrangement.end()
    assert board.get_message(y) == Int64(-1)


def test_variables_are_those_of_the_class(bundle: Write) -> None:
    cls = load_bundle(bundle(Variables="count: int\nspeed: float = 2 * 1.5"))
    assert [(v.name, v.type, v.default) for v in cls.table.variables.values()][1:] == [
        ("speed", float, 3.0)
    ]
    with pytest.raises(VariableError, match="needs a value for its variable 'count'"):
        cls()
    with pytest.raises(VariableError, match="count = 'x'"):
        cls(count="x")


def test_message_types_may_be_declared_in_the_includes(bundle: Write) -> None:
    cls = load_bundle(
        bundle(
            Includes="from __future__ import annotations\nfrom llfsm.whiteboard import *\n"
            "class Inner(Message):\n    x: int = 0\n"
            "class Outer(Message):\n    inner: Inner = Inner()\nOUT = Slot('out', Outer)",
            Variables="from_outside: 'Outer' = Outer()",
        )
    )
    assert cls.table.variables["from_outside"].type.__name__ == "Outer"


def test_annotations_are_what_the_bundle_makes_of_them(bundle: Write) -> None:
    """The future that this project's own modules import does not reach a bundle's code."""
    includes = "def f(x: int): pass\nkind = f.__annotations__['x']"
    cls = load_bundle(bundle(Includes=includes, Variables="n: kind = kind(3)"))
    assert cls.table.variables["n"].annotation is int


def test_include_folders_are_searched(bundle: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = bundle(
        {"IncludePath": "lib\n$LLFSM_TEST_FOLDER/more\n"},
        Includes="import llfsm_test_helper, llfsm_test_other",
        Variables="n: int = llfsm_test_helper.n + llfsm_test_other.n",
    )
    monkeypatch.setattr("sys.path", [*sys.path])
    monkeypatch.setenv("LLFSM_TEST_FOLDER", str(folder))
    for where, name, text in (("lib", "helper", "n = 40"), ("more", "other", "n = 2")):
        (folder / where).mkdir()
        (folder / where / f"llfsm_test_{name}.py").write_text(text)
    assert load_bundle(folder).table.variables["n"].default == 42


# Transitions


@pytest.mark.parametrize(
    ("expr", "label", "after_ms", "guarded"),
    [
        ("after_ms(1000)", "after_ms(1000)", 1000, False),
        ("  after_ms(2.5)\n", "after_ms(2.5)", 2.5, False),
        ("after(2)", "after(2)", 2000, False),
        ("after_ms(10) and n > 0", "after_ms(10) and n > 0", 10, True),
        ("after_ms(10) and n > 0 and n < 9", "after_ms(10) and n > 0 and n < 9", 10, True),
        ("n > 0 and after_ms(10)", "n > 0 and after_ms(10)", None, True),
        ("after_ms(n)", "after_ms(n)", None, True),
        ("timeout(10_000)", "timeout(10_000)", None, True),
        ("after_ms(10) or n > 0", "after_ms(10) or n > 0", None, True),
        ("n > 0  # soon", "n > 0", None, True),
        ("any(map(lambda k: k > 0, [n]))", "any(map(lambda k: k > 0, [n]))", None, True),
        ("true", "true", None, False),
        ("True\n", "true", None, False),
    ],
)
def test_transitions(
    bundle: Write, expr: str, label: str, after_ms: float | None, guarded: bool
) -> None:
    folder = bundle(Variables="n: int = 1", expr=expr)
    [transition] = load_bundle(folder).table.states[0].transitions
    assert (transition.label, transition.after_ms) == (label, after_ms)
    assert transition.expression == (label if guarded else None)
    assert transition.location == (str(folder / "State_A_Transition_0.expr"), 1)
    clock = ManualClock()
    arrangement = Arrangement([load_bundle(folder)], clock=clock)
    arrangement.round()
    clock.advance(ms=2001)
    arrangement.round()
    assert arrangement.state_name_of("M") == "B" if arrangement.machines else True


def test_a_missing_expression_always_fires(bundle: Write) -> None:
    folder = bundle()
    (folder / "State_A_Transition_0.expr").unlink()
    [transition] = load_bundle(folder).table.states[0].transitions
    assert (transition.label, transition.unconditional) == ("true", True)


def test_evaluations_are_labelled_by_the_expression(bundle: Write) -> None:
    trace = Trace()
    folder = bundle(Variables="n: int = 1", expr="n  >  0")
    Arrangement([load_bundle(folder)], clock=ManualClock(), observers=[trace]).round()
    [label] = [event.label for event in trace if isinstance(event, Eval)]
    assert label == "n  >  0"


def test_the_table_knows_path_and_layout(bundle: Write, tmp_path: Path) -> None:
    folder = bundle({"SuspendState": "B"}, Includes='"""Do it."""')
    link = tmp_path / "link" / "M.machine"
    link.parent.mkdir()
    link.symlink_to(folder)
    cls = load_bundle(link)
    assert (cls.__name__, cls.__doc__, cls.table.path) == ("M", "Do it.", str(folder))
    assert cls.table.layout is None
    assert cls.table.suspend is not None
    assert cls.table.suspend.name == "B"
    layout = MachineLayout({"A": StateBox(1.0, 2.0, 3.0, 4.0)})
    assert compile_bundle(replace(read_bundle(folder), layout=layout)).table.layout is layout


def test_the_same_folder_fills_its_hole(bundle: Write) -> None:
    folder = bundle()
    arrangement = Arrangement([load_bundle(folder), load_bundle(folder)], clock=ManualClock())
    assert [machine.name for machine in arrangement.machines] == ["M", "M.0"]
    arrangement.unload("M")
    assert arrangement.load(load_bundle(folder)) == 0


def test_without_a_folder() -> None:
    states = (
        BundleState(
            "A",
            {"OnEntry": Fragment("n = 2")},
            (BundleTransition("B", Fragment("n == 2")), BundleTransition("B")),
        ),
        BundleState("B"),
    )
    cls = compile_bundle(Bundle("M", states, variables=Fragment("n: int = 0")))
    assert Arrangement([cls], clock=ManualClock()).round() is True
    assert "M" not in sys.modules
    with pytest.raises(BundleError, match=r"^nothing is called 'x'"):
        compile_bundle(Bundle("M", states, variables=Fragment("n: int = x")))


# Errors while running


def test_an_error_names_the_real_file_and_line(bundle: Write) -> None:
    folder = bundle(
        Variables="n: int = 0", Methods="# one\n\ndef fail() -> None:\n    n / n\n",
        A_OnEntry="# one\nn = 0\nfail()\n",
    )  # fmt: skip
    with pytest.raises(ExecutionError) as caught:
        run(folder)
    error = caught.value
    assert (error.filename, error.line) == (str(folder / "State_A_OnEntry.py"), 3)
    assert (error.state, error.step) == ("A", "OnEntry")
    frames = traceback.extract_tb(error.__cause__.__traceback__)  # type: ignore[union-attr]
    assert [(Path(f.filename).name, f.lineno, f.name, f.line) for f in frames[-2:]] == [
        ("State_A_OnEntry.py", 3, "OnEntry", "fail()"),
        ("M_Methods.py", 4, "fail", "n / n"),
    ]


def test_errors_in_expressions(bundle: Write) -> None:
    folder = bundle(Variables="n: int = 0", expr="1 / n > 2")
    with pytest.raises(ExecutionError, match=r"transition 1 / n > 2: .*_0\.expr:1\)"):
        run(folder)
    (folder / "State_A_Transition_0.expr").write_text("n")
    with pytest.raises(GuardResultError, match=r"transition n: the guard returned 0.*_0\.expr:1\)"):
        run(folder)


# Errors when it is loaded


@pytest.mark.parametrize(
    ("texts", "said"),
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
        ({"Methods": "def f(k=n): pass"}, "'n' is a variable of the machine: there is none before"),
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
def test_what_is_wrong_is_said_with_file_and_line(
    bundle: Write, texts: dict[str, str], said: str
) -> None:
    ours = {
        "Includes": "from llfsm.runtime import Actuator, Sensor\n"
        "from llfsm.whiteboard import Slot\n"
        "from llfsm.whiteboard.messages.std_msgs import Int64\nX = Slot('x', Int64)",
        "Variables": "n: int = 0\ns = Sensor(X)\na = Actuator(X)",
    }
    with pytest.raises(BundleError, match=said):
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


def test_a_section_is_compiled_as_a_method_is(bundle: Write) -> None:
    """So that it costs the same: the same instructions, one by one."""

    class Twin:
        n: int
        s: Any
        move: Any

        def method(self) -> None:
            for k in range(self.n):
                if self.s.data > k and not self.stopping:  # type: ignore[attr-defined]
                    self.n += 1
            self.move(self.n, lambda n: n + self.n)

    folder = bundle(
        Variables="n: int = 0\ns: object = None",
        Methods="def move(n, k) -> None: pass",
        A_OnEntry="for k in range(n):\n    if s.data > k and not stopping:\n        n += 1\n"
        "move(n, lambda n: n + self.n)",
    )
    section = load_bundle(folder).table.states[0].sections["OnEntry"]
    ours = [(i.opname, i.arg) for i in dis.get_instructions(section)]
    assert ours == [(i.opname, i.arg) for i in dis.get_instructions(Twin.method)]
