"""What is known of every machine's functions, and which names code binds itself."""

from __future__ import annotations

import ast
from typing import Any

import pytest

from llfsm.runtime import Machine, Sensor, State
from llfsm.runtime.expressions import reads
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool

OTHERS = {"age_ms", "failure", "name", "name_of", "number_of_machines", "state_name", "stopping"}


def test_every_function_of_machines_is_known() -> None:
    """Whoever adds one decides whether it is a question, a request, or reads a clock."""
    known = reads.CLOCK.keys() | reads.QUESTIONS | reads.REQUESTS
    assert known | OTHERS == {name for name in dir(Machine) if name[0] != "_"}
    assert not known & OTHERS


@pytest.mark.parametrize(
    ("text", "bound"),
    [
        ("x = y", {"x"}),
        ("x, (y, *z) = w", {"x", "y", "z"}),
        ("x += 1", set()),
        ("x.y = z[0] = 1", set()),
        ("del x", {"x"}),
        ("for x in y: z = 1", {"x", "z"}),
        ("with x as y: pass", {"y"}),
        ("import a.b, c as d", {"a", "d"}),
        ("from a import b as c, d", {"c", "d"}),
        ("def f(x, y=(z := 1)): w = 1", {"f", "z"}),
        ("class C(b := B): x = 1", {"C", "b"}),
        ("f = lambda x: (y := 1)", {"f"}),
        ("[x for x in y if (z := x)]", {"z"}),
        ("try: pass\nexcept E as e: x = 1", {"e", "x"}),
        ("match x:\n case [a, *b] | {'c': a, **b}: pass\n case C(d) as e: pass", set("abde")),
        ("nonlocal x\nx = 1", set()),
    ],
)
def test_names_are_bound_where_python_binds_them(text: str, bound: set[str]) -> None:
    assert reads.bound_names(ast.parse(text).body) == bound


class Reading(Machine):
    door = Sensor(Slot("door", Bool))
    seen: bool = False
    a = State()

    @property
    def looked(self) -> bool:
        return self.door is not None

    def look(self) -> None:
        self.again()

    def again(self) -> None:
        self.look()
        self.seen = self.looked

    def close(self) -> None:
        self.seen = False


@pytest.mark.parametrize(
    ("code", "may"),
    [
        (lambda self: self.door, True),
        (lambda self: self.looked, True),
        (lambda self: self.look(), True),
        (lambda self: [self.door for _ in "a"], True),
        (lambda self: (lambda: self.look())(), True),
        (lambda self: getattr(self, "do" + "or"), True),
        (lambda self: self.__dict__, True),
        (lambda self: print(self), True),
        (print, True),
        (lambda self: self.close(), False),
        (lambda self: self.suspend_self(), False),
        (lambda self: print(self.seen), False),
    ],
)
def test_whether_code_may_read_a_sensor_is_never_denied_wrongly(code: Any, may: bool) -> None:
    assert reads.may_use(code, Reading, Reading.table.sensors) is may
