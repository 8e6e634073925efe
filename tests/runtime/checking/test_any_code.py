"""Whatever code says, `llfsm check` answers: it has findings or none, and never fails itself."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from random import Random

import pytest

from calling import call
from thoroughness import examples

HEAD = """
from dataclasses import dataclass, field
from enum import Enum
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot

class Mode(Enum):
    IDLE = 1
    RUN = 2

class Near(Message):
    x: float = 0.0

class Note(Message):
    x: float = 0.0
    near: Near | None = None
    names: tuple[str, ...] = ()
    mode: Mode = Mode.IDLE

@dataclass
class Plan:
    steps: list[int] = field(default_factory=list)

class M(Machine):
    note = Sensor(Slot("note", Note))
    other = Sensor(Slot("other", Note), default=Note())
    drive = Actuator(Slot("drive", Note), at_end=Note())
    count: int = 0
    goal: Note | None = None
    word: str = ""
    numbers: list[int] = []
    ages: dict[str, int] = {}
    plan: Plan = Plan()
    a, b = State(), State()
"""
LOCAL = ["x", "y", "one", "two"]
NAMES = ["self", "Note", "Mode", "math", "len", "unknown", "note"]
ATTRIBUTES = [
    *("note", "other", "drive", "count", "goal", "word", "numbers", "ages", "plan", "a", "x"),
    *("near", "names", "mode", "steps", "append", "get", "items", "wait", "after", "after_ms"),
    *("load", "is_running", "suspend_all", "name", "__class__", "missing"),
]
# E stands for an expression, N for a name, A for an attribute, B for a block of statements.
EXPRESSIONS = [
    *("self.A", "self.A", "N", "E.A", "0", "1", "-1", "2.5", "'a'", "b'a'", "None", "True", "..."),
    *("E + E", "E - E", "E * E", "E / E", "E % E", "E ** E", "E // E", "E @ E", "E | E", "E << E"),
    *("E < E", "E == E", "E is E", "E in E", "E not in E", "E < E > E", "E and E", "E or E"),
    *(
        "not E",
        "-E",
        "~E",
        "E(E)",
        "E()",
        "E(*E)",
        "E(**E)",
        "E(E, x=E)",
        "N(E)",
        "self.A(E)",
        "N.A(E)",
    ),
    *("E[E]", "E[E:E]", "E[E, E]", "[E, E]", "(E, E)", "()", "{E}", "{E: E}", "{**E}", "[*E]"),
    *("[E for N in E]", "{E for N in E if E}", "{E: E for N in E}", "sum(E for N in E)"),
    *("E if E else E", "(lambda: E)", "(lambda x, *y: E)", "(N := E)", "f'{E}'", "f'{E!r:>{E}}'"),
    *("Note(x=E)", "Note(E, E)", "range(E)", "zip(E, E)", "enumerate(E)", "int(E)", "Mode(E)"),
]
STATEMENTS = [
    *(
        "E",
        "N.A()",
        "N = N",
        "N = N",
        "self.A = E",
        "self.A += E",
        "N = E",
        "N = N",
        "N = E\n;N = N",
        "self.A.A = E",
    ),
    *("E[E] = E", "del E[E]", "del self.A", "N, N = E", "N, *N = E", "self.A, N = E", "N: int = E"),
    *("if E:B", "if E:B\n;elif E:B\n;else:B", "while E:B", "for N in E:B", "for N, N in E:B"),
    *("for N in E:B\n;else:B", "with E:B", "with E as N:B", "try:B\n;except E:B", "assert E, E"),
    *("try:B\n;finally:B", "try:B\n;except* ValueError:B", "raise E", "raise E from E", "return"),
    *("return E", "pass", "def f(x=E):B", "class C:B", "import math", "import N", "global N"),
    *("match E:\n; case E.A:B", "match E:\n; case [x, *y] if E:B", "match E:\n; case {'a': x}:B"),
    *("match E:\n; case Note(x=x) | Note(x, y):B", "from math import *", "import os.path as x"),
]


class Writer:
    """Write code by chance, with fewer parts the deeper it is."""

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)

    def expression(self, deep: int) -> str:
        forms = EXPRESSIONS if deep else [each for each in EXPRESSIONS[:13] if "E" not in each]
        return self.filled(self.random.choice(forms), deep)

    def filled(self, form: str, deep: int) -> str:
        return re.sub(r"\b[ENA]\b", lambda found: self.part(found[0], deep), form)

    def part(self, kind: str, deep: int) -> str:
        if kind == "E":
            return f"({self.expression(max(deep - 1, 0))})"
        if kind == "A":
            return self.random.choice(ATTRIBUTES)
        return self.random.choice(LOCAL if self.random.random() < 0.8 else NAMES)

    def block(self, deep: int, indent: str) -> str:
        return "".join(
            self.statement(deep, indent) for _ in range(self.random.randint(1, 2 + 2 * deep))
        )

    def statement(self, deep: int, indent: str) -> str:
        form = self.random.choice(STATEMENTS)
        if form.endswith(":B") and not deep:
            form = "N = N"
        lines = []
        for line in form.split("\n"):
            text = indent + line.removeprefix(";")
            if text.endswith(":B"):
                head = text.removesuffix("B")
                inner = " " * (len(text) - len(text.lstrip()) + 1)
                lines.append(self.filled(head, 2) + "\n" + self.block(deep - 1, inner))
            else:
                lines.append(self.filled(text, 2) + "\n")
        return "".join(lines)


def program(seed: int) -> str:
    """Write a machine whose code is correct as to its syntax, at most."""
    while True:
        writer = Writer(seed)
        text = (
            f"{HEAD}\n    @a.on_entry\n    def _(self):\n{writer.block(2, ' ' * 8)}"
            f"\n    @a.internal\n    def _(self):\n{writer.block(2, ' ' * 8)}"
            f"\n    @a.to(b)\n    def ready(self):\n        return {writer.expression(3)}\n"
        )
        try:
            compile(text, "any.py", "exec")
        except SyntaxError:
            seed += 1_000_000
        else:
            return text


def test_the_head_is_a_machine(tmp_path: Path) -> None:
    file = tmp_path / "head.py"
    file.write_text(f"{HEAD}    a.to(b)\n")
    assert [each.name for each in runpy.run_path(str(file))["M"].table.states] == ["a", "b"]


@pytest.mark.filterwarnings("ignore::SyntaxWarning")
@pytest.mark.parametrize("part", range(4))
def test_check_answers_whatever_code_says(tmp_path: Path, part: int) -> None:
    number = examples(40)
    for seed in range(part * number, (part + 1) * number):
        (tmp_path / f"any{seed}.py").write_text(program(seed))
        done = call("check", f"any{seed}.py:M", cwd=tmp_path)
        assert done.returncode in (0, 1), (seed, done.stderr)
        assert f"any{seed}.py:" in done.stdout or "no findings" in done.stdout, (seed, done.stderr)
