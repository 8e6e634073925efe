"""Bundles of Python run as classes do; an error in their code has a file and a line."""

from __future__ import annotations

import dis
import sys
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from llfsm.runtime import (
    Arrangement,
    BundleError,
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
from llfsm.runtime.engine.table import MachineLayout, StateBox
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64

from .conftest import Write, run


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
