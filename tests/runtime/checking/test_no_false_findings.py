"""Machines without a mistake have no findings, whatever their code does."""

from __future__ import annotations

import importlib.util
import sys
import tempfile
import textwrap
from pathlib import Path
from random import Random

from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.runtime import Machine
from llfsm.runtime.checking import check_bundle, check_class
from thoroughness import examples

INCLUDES = """\
import math
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.turtlesim import Pose
class Level(Message):
    value: int | None = None
    names: tuple[str, ...] | None = None
LIMIT = 7
"""
DECLARED = """\
pose = Sensor(Slot("pose", Pose))
goal = Sensor(Slot("goal", Vector3), default=Vector3())
level = Sensor(Slot("level", Level), default=Level(), domain=[Level(), Level(1), None])
drive = Actuator(Slot("drive", Twist), at_end=Twist())
count: int = 0
speed: float = 1
label: str = "a"
on: bool = False
best: tuple[float, ...] = ()
maybe: int | None = None
"""
USED = "@count, @speed, @label, @on, @best, @maybe, @pose, @goal, @level"  # so that none is unused

# Code as a bundle has it, with @ before what belongs to the machine; {b}, {i}, {f} and {s} stand
# for expressions that are a bool, an int, a float and a str, {body} for statements.
BOOLS = [
    "@on", "@pose is not None", "@pose is not None and @pose.x > {f}", "not {b}", "({b} or {b})",
    "({b} and {b})", "{i} < {i}", "{f} >= {i} > -9", "@label == {s}", "bool(@label)", "@stopping",
    "@after_ms(10)", "isinstance(@maybe, int)", "{s} in ('a', 'b')", "any(x > {f} for x in @best)",
    "@state_name != {s} + '!'", "@maybe is None", "@goal != Vector3(x={f})", "hasattr(@pose, 'x')",
    "(p := @pose) is not None and p.theta > {f}", "math.isclose({f}, {f})", "callable(@drive)",
    "@level.value is not None and @level.value > {i}", "'a' in (@level.names or ())",
    "@count > 1 and @count < 5", "@label != 'a' and @label != 'b'", "0 < {f} < 9",
]  # fmt: skip
INTS = [
    "@count", "3", "-1", "len(@label)", "int({f})", "({i} + {i})", "max({i}, {i})", "LIMIT",
    "({i} if {b} else {i})", "(@maybe or 1)", "({i} % 5)", "len(@best)", "@number_of_machines",
    "abs({i})", "round({f})", "(({b}) + {i})", "(@level.value or 0)", "len(@label * 2)",
    "sum([1, 2])", "sorted(@best)[0].__hash__()",
]  # fmt: skip
FLOATS = [
    "@speed", "0.5", "{i}", "@goal.x", "float({i})", "math.sin({f})", "({f} * {f})", "-{f}",
    "(@pose.x if @pose is not None else 0.0)", "sum(@best)", "math.pi", "({i} / 2)",
    "(@best[0] if @best else {f})", "getattr(@pose, 'x', 0.0)", "max(@best, default={f})",
]  # fmt: skip
STRINGS = [
    "@label", "'a'", "str({i})", "f'%s {@count!r:>3}'", "@label.upper()", "('a' + {s})",
    "@label[1:]", "@state_name", "'%s' % {f}", "('x' if {b} else {s})",
]  # fmt: skip
STATEMENTS = [
    "@count = {i}", "@count += {i}", "@speed = {f}", "@label = {s}", "@on = {b}", "@maybe = None",
    "@maybe = {i}", "@best = (*@best, {f})", "@best = tuple(x for x in @best if x > {f})",
    "@drive(Twist(linear=Vector3(x={f}, y={i})))", "@drive(Twist())", "pass",
    "command = Twist(angular=Vector3(0.0, 0.0, {f}))\n@drive(command)",
    "if {b}:\n    {body}", "if {b}:\n    {body}\nelse:\n    {body}",
    "for each in range(3):\n    {body}",
    "seen = @pose\nif seen is not None:\n    @speed = seen.theta",
    "try:\n    {body}\nexcept ValueError as error:\n    @label = str(error)",
    "match @pose:\n    case Pose(x=x):\n        @speed = x\n    case None:\n        {body}",
    "key = lambda x: x + {f}\n@best = tuple(sorted(@best, key=key))",
    "found = None\nfor each in @best:\n    found = each\nif found is not None:\n    @speed = found",
    "def twice(x: float) -> float:\n    return 2 * x\n@speed = twice({f})",
    "left, right = {i}, {s}\n@count, @label = left, right",
    "x = {i}\nx = {s}\n@label = x", "while {b}:\n    break", "with memoryview(b''):\n    {body}",
    "if {b}:\n    value = {f}\nelse:\n    value = 0.5\n@speed = value",
    "try:\n    value = float({s})\nexcept ValueError:\n    value = 0.5\n@speed = value",
    "value = None\nif {b}:\n    value = {f}\nif value is not None:\n    @speed = value",
    "ok = {b}\nif ok:\n    value = {f}\nif ok:\n    @speed = value",
    "while True:\n    value = {f}\n    if {b}:\n        break\n@speed = value",
    "match @count:\n    case 0:\n        x = 1\n    case _:\n        x = {f}\n@speed = x",
    "for each in range(3):\n    last = each\n@count = last",
    "if @count == 1:\n    value = {f}\nelif @count != 1:\n    value = 1.5\n@speed = value",
    "items = list(@best)\nitems.append({f})\nitems.sort()\n@best = tuple(items)",
    "if @pose is None:\n    {body}\nelse:\n    @speed = @pose.x",
    "if (found := @level.value) is not None:\n    @count = found + 1",
    "if not @pose:\n    {body}\nelif @pose.x > {f}:\n    {body}", "print({s} + 'x', [{i}] + [2])",
]  # fmt: skip
KINDS = {"{b}": BOOLS, "{i}": INTS, "{f}": FLOATS, "{s}": STRINGS, "{body}": STATEMENTS}
SIMPLEST = {"{b}": "@on", "{i}": "1", "{f}": "0.5", "{s}": "'a'", "{body}": "pass"}
SECTIONS = {"on_entry": "OnEntry", "on_exit": "OnExit", "internal": "Internal"}


def code(kind: str, choose: Random, deep: int = 3) -> str:
    """Return code of a kind, with expressions inside each other at most `deep` deep."""
    text = choose.choice(KINDS[kind])
    for hole, simplest in SIMPLEST.items():
        while hole in text:
            inner = code(hole, choose, deep - 1) if deep else simplest
            before, _, after = text.partition(hole)
            line = before.rpartition("\n")[2]
            indent = line[: len(line) - len(line.lstrip())]
            text = before + inner.replace("\n", f"\n{indent}") + after
    return text


def machine(choose: Random) -> tuple[str, dict[str, str]]:
    """Return the code of a module with a machine class M, and the files of the same bundle."""
    states = [f"S{number}" for number in range(choose.randint(1, 3))]
    lines = ["class M(Machine):", *textwrap.indent(DECLARED, "    ").splitlines()]
    lines += [f"    {state} = State()" for state in states]
    files = {"Language": "python", "States": "\n".join(states), "M_Includes.py": INCLUDES}
    files["M_Variables.py"] = DECLARED
    for number, state in enumerate(states):
        for decorator, section in SECTIONS.items():
            body = "\n".join(code("{body}", choose) for _ in range(choose.randint(0, 2)))
            body += f"\nprint({USED})" if number == 0 and section == "OnEntry" else ""
            files[f"State_{state}_{section}.py"] = body.replace("@", "") + "\n"
            if body:
                lines += [f"    @{state}.{decorator}", "    def _(self) -> None:"]
                lines += textwrap.indent(body.replace("@", "self."), "        ").splitlines()
        others = [each for each in states if each != state] or states  # else after_ms is not anew
        guards = [(code("{b}", choose), choose.choice(others)) for _ in range(choose.randint(0, 2))]
        following = states[(number + 1) % len(states)]  # that all can be reached
        guards = [*(dict(guards) | {"@on": following}).items()]  # asked again, one never fires
        for place, (guard, target) in enumerate(guards):
            files[f"State_{state}_Transition_{place}.expr"] = guard.replace("@", "")
            files[f"State_{state}_Transition_{place}.target"] = target
            text = guard.replace("@", "self.")
            if place % 2:
                lines += [f"    {state}.to({target}, when=lambda self: {text})"]
            else:
                lines += [f"    @{state}.to({target})", "    def guard(self) -> bool:"]
                lines += [f"        return {text}"]
    return INCLUDES + "\n".join(lines) + "\n", files


def imported(file: Path) -> type[Machine]:
    spec = importlib.util.spec_from_file_location("random_machine", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["random_machine"] = module
    spec.loader.exec_module(module)
    found: type[Machine] = module.M
    return found


@settings(max_examples=examples(20))
@given(st.integers(0, 2**32))
def test_random_machines_have_no_findings(seed: int) -> None:
    source, files = machine(Random(seed))
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "module.py").write_text(source)
        assert check_class(imported(Path(name) / "module.py")) == []
        folder = Path(name) / "M.machine"
        folder.mkdir()
        for each, text in files.items():
            (folder / each).write_text(text)
        assert check_bundle(folder) == []
