"""Names in the fragments of a bundle: which are the machine's, a state's, or a section's own."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Arrangement, BundleError, ManualClock
from llfsm.runtime.bundles import load_bundle

from .conftest import Write, run


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
