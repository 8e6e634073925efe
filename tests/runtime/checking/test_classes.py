"""Each kind of finding in a machine class, and what must not be one."""

from __future__ import annotations

import importlib.util
import sys
import warnings
from pathlib import Path
from textwrap import indent
from types import ModuleType
from uuid import uuid4

import pytest

import llfsm.machines
from llfsm.runtime import Machine, State, UnreachableStateWarning, define
from llfsm.runtime.checking import check_class
from llfsm.runtime.engine.machine import MachineType

SHIPPED = [
    each for each in llfsm.machines.__all__ if isinstance(vars(llfsm.machines)[each], MachineType)
]
HEAD = """\
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import String
def outside(machine): return machine
class M(Machine):
    A, B = State("A"), State("B")
"""


def imported(file: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"checked_{uuid4().hex}", file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnreachableStateWarning)
        spec.loader.exec_module(module)
    return module


def findings(path: Path, body: str, more: str = "") -> list[tuple[int, str, str]]:
    """Check the last class of a file, by default one with `body`; its lines count from 1."""
    file = path / "machine.py"
    file.write_text(HEAD + indent(body, "    ") + more)
    module = imported(file)
    found = check_class(module.Child if more else module.M)
    assert all(each.file == str(file) for each in found)
    return [(line - HEAD.count("\n"), severity, text) for _, line, severity, text in found]


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("A.to(B)\nC = State('See')", (2, "warning", "no transitions lead to state 'See'")),
        ("C = State()\nA.to(B)", (1, "warning", "no transitions lead to state 'C'")),
        (
            "A.to(B, when=lambda self: True)\nA.to(B, after_ms=1)",
            (2, "error", "state 'A': the transition to 'B' can never fire, the one to 'B' "
             "before it always does"),
        ),
        ("A.to(B)\nn: int = 0", (2, "warning", "variable 'n' is never used")),
        ("A.to(B)\ns = Sensor(Slot('s', String))", (2, "warning", "sensor 's' is never read")),
        (
            "A.to(B)\na = Actuator(Slot('a', String))",
            (2, "warning", "actuator 'a' is never called"),
        ),
        ("A.to(B, when=lambda self: self.ready)", (1, "error", "the machine has no 'ready'")),
        (
            "A.to(B)\n@A.on_entry\ndef _(self):\n    pass\n    self.mispelt()",
            (5, "error", "the machine has no 'mispelt'"),
        ),
        (
            "@A.to(B)\ndef ready(self):\n    self.stopping",
            (1, "error", "this guard returns no value: return True or False"),
        ),
        (
            "@A.to(B)\ndef ready(self):\n    def inner(): return 1\n    return",
            (1, "error", "this guard returns no value: return True or False"),
        ),
        (
            "a = Actuator(Slot('a', String))\n@A.to(B)\ndef f(self):\n"
            "    return self.a(String('x')) > 0",
            (4, "warning", "a guard posts to actuator 'a'"),
        ),
        (
            "A.to(B, when=lambda self: self.suspend('x') == 1)",
            (1, "warning", "a guard makes the request 'suspend'"),
        ),
        (
            "def ask(self): return self.more()\ndef more(self): return self.unload('x')\n"
            "A.to(B, when=lambda self: self.ask())",
            (3, "warning", "a guard makes the request 'unload', through 'ask'"),
        ),
    ],
)  # fmt: skip
def test_each_finding(tmp_path: Path, body: str, expected: tuple[int, str, str]) -> None:
    assert findings(tmp_path, body) == [expected]


@pytest.mark.parametrize("kind", ["int", "'int'"])
def test_a_methods_annotations_may_be_classes_or_texts(tmp_path: Path, kind: str) -> None:
    body = f"A.to(B)\ndef f(self, n: {kind}): return n\n@A.on_entry\ndef _(self): self.f('x')"
    assert findings(tmp_path, body) == [(4, "error", "f: n is int, not str")]


@pytest.mark.skipif(sys.version_info < (3, 14), reason="annotations are evaluated at once")
@pytest.mark.parametrize(
    ("call", "expected"), [("f(1)", []), ("f()", [(2, "error", "f is called as f(n)")])]
)
def test_what_only_type_checkers_import_is_left_alone(
    tmp_path: Path, call: str, expected: list[tuple[int, str, str]]
) -> None:
    body = (
        f"@A.to(B)\ndef ready(self) -> Unknown: return self.{call}\n"
        "def f(self, n: Unknown) -> Unknown: return n\n"
    )
    assert findings(tmp_path, body) == expected


@pytest.mark.parametrize(
    "body",
    [
        "A.to(B, when=outside)\nn: int = 0",  # outside may use it
        "n: int = 0\nA.to(B, when=lambda self: outside(self))",
        "A.to(B)\na = Actuator(Slot('a', String), at_end=String('bye'))",
        "A.to(B)\n@A.on_entry\ndef _(self): self.set = 1\n@B.on_entry\ndef _(self): self.set",
        "A.to(B)\n@property\ndef p(self): return 1\n@A.on_entry\ndef _(self): self.p",
        "A.to(B)\n@A.on_entry\ndef _(self): [lambda self: self.other]",
        "A.to(B)\n@A.on_entry\ndef _(self): self.after(1), self.name, self.stopping, self.A",
        "A.to(B, when=lambda self: True, after_ms=5)\nA.to(A, after_ms=9)",
        "A.to(B, when=lambda self: self.n > 0); A.to(B, when=lambda self: self.n < 0)\nn: int = 0",
        "@A.to(B)\ndef later(self): raise NotImplementedError",
        "A.to(B)\n@A.on_entry\ndef _(self): self.resume_self()",
        "A.to(B)\ndef __getattr__(self, name): return 1\n@A.on_entry\ndef _(self): self.any",
    ],
)
def test_no_finding(tmp_path: Path, body: str) -> None:
    assert findings(tmp_path, body) == []


def test_what_is_inherited_is_checked_where_it_is_declared(tmp_path: Path) -> None:
    body = "A.to(B)\nn: int = 0\n"
    assert findings(tmp_path, body, more="class Child(M): pass\n") == []
    assert len(findings(tmp_path, body)) == 1


def test_what_a_hidden_method_sets_is_there(tmp_path: Path) -> None:
    body = "A.to(B)\ndef f(self): self.set = 1\n"
    child = "class Child(M):\n  def f(self): super().f(); self.set\n"
    assert findings(tmp_path, body, more=child) == []


def test_a_machine_without_a_file() -> None:
    a = State("A")
    c = State("C")
    a.on_entry(eval("lambda self: self.there_is_no_source"))
    a.to(a, when=eval("lambda self: 1"))
    with pytest.warns(UnreachableStateWarning):
        machine = define("Made", [a, c], variables={"n": (int, 0)})
    [finding] = check_class(machine)
    assert finding.text == "no transitions lead to state 'C'"


@pytest.mark.parametrize("name", SHIPPED)
def test_the_machines_that_ship_have_none(name: str) -> None:
    machine = getattr(llfsm.machines, name)
    assert issubclass(machine, Machine)
    assert check_class(machine) == []


def calls_to_check(path: Path, states: int) -> int:
    """Return how many functions are called to check a machine of that many states."""
    body = "".join(
        f"S{n} = State()\nA.to(S{n}, when=lambda self: self.after_ms({n}))\n"
        f"@S{n}.on_entry\ndef _(self):\n    print({n})\n"
        f"@S{n}.to(A)\ndef back(self) -> bool:\n    return self.after({n})\n"
        for n in range(states)
    )
    file = path / f"of_{states}_states.py"
    file.write_text(HEAD + indent(body, "    ") + "    A.to(B)\n")
    machine = imported(file).M
    calls = 0

    def count(_: object, event: str, __: object) -> None:
        nonlocal calls
        calls += event == "call"

    sys.setprofile(count)
    try:
        assert check_class(machine) == []
    finally:
        sys.setprofile(None)
    return calls


def test_checking_takes_as_long_as_the_machine_is_large(tmp_path: Path) -> None:
    assert calls_to_check(tmp_path, 60) < 5 * calls_to_check(tmp_path, 15)
