"""What is known of every machine's functions, and which names code binds itself."""

from __future__ import annotations

import ast

import pytest

from llfsm.runtime import Machine
from llfsm.runtime.expressions import reads

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
