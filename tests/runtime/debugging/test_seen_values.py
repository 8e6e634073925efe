"""What is shown of an evaluated transition is what its guard saw, whatever came after it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.runtime.debugging import Debugger
from llfsm.runtime.debugging.causes import sight_of
from llfsm.whiteboard import Whiteboard


@dataclass
class Arm:
    """What a machine may have as a variable."""

    angle: float = 85.0
    joints: list[Any] = field(default_factory=list)


class Span(NamedTuple):
    """Have a method that is named as the state's clock."""

    begin: float = 10.0
    parts: list[Any] = []  # noqa: RUF012  a tuple that holds what changes

    def after(self, time: float) -> bool:
        """Compare a time."""
        return time > self.begin


COUNT = 0


class Changing(Machine):
    """Change in its Internal all that its guards saw."""

    arm: Arm = Arm()
    grid: list[list[int]] = [[0, 0], [0, 0]]  # noqa: RUF012  each machine gets its own
    found: dict[str, list[int]] = {"a": [1]}  # noqa: RUF012
    span: Span = Span()
    plain: list[int] = [1]  # noqa: RUF012

    go = State()
    end = State()

    go.to(end, when=lambda self: self.arm.angle > 90)
    go.to(end, when=lambda self: len(self.arm.joints) > 0)
    go.to(end, when=lambda self: self.grid[0][0] > 0)
    go.to(end, when=lambda self: self.found["a"][0] > 1)
    go.to(end, when=lambda self: len(self.span.parts) > 0)
    go.to(end, when=lambda self: self.span.after(5))
    go.to(end, when=lambda self: self.after_ms(500))
    go.to(end, when=lambda _: COUNT > 0)
    go.to(end, when=lambda self: len(self.plain) > 1)

    @go.internal
    def change(self) -> None:
        """Change all."""
        global COUNT
        COUNT += 1
        self.arm.angle += 10
        self.arm.joints.append(1)
        self.grid[0][0] += 1
        self.found["a"][0] += 1
        self.span.parts.append(1)
        self.plain.append(2)


class Counting(Machine):
    """Change a variable in the guard between two others."""

    n: int = 3

    go = State()
    end = State()

    def count(self) -> bool:
        """Count what was asked."""
        self.n += 1
        return False

    go.to(end, when=lambda self: self.n > 5)
    go.to(end, when=lambda self: self.count())
    go.to(end, when=lambda self: self.n > 3)


def seen(machine: type[Machine], how: str) -> list[tuple[bool | None, str]]:
    """Return what is shown after a turn that is seen by a debugger, or by a sample."""
    arrangement = Arrangement([machine], whiteboard=Whiteboard.local(), clock=ManualClock())
    turns = Debugger.of(arrangement).turns
    if how == "debugged":
        arrangement.attach(turns)
    else:
        turns.sample()
    arrangement.round()
    sight = sight_of(arrangement, machine.__name__, turns, 0)
    causes = sight.causes if sight.before is None else sight.before.causes
    return [(cause.value, cause.seen) for cause in causes]


@pytest.mark.parametrize("how", ["debugged", "sampled"])
def test_it_is_shown_what_guards_saw_and_not_what_came_after(
    how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "COUNT", 0)
    assert seen(Changing, how) == [
        (False, "arm.angle=85 > 90"),
        (False, "len(arm.joints)=0 > 0"),
        (False, "grid[0][0]=0 > 0"),
        (False, "found['a'][0]=1 > 1"),
        (False, "len(span.parts)=0 > 0"),
        (False, "span.after(5)=False"),
        (False, "0 ms > 500 ms"),
        (False, "COUNT=1 > 0 (as it is now)"),  # a module's values are not kept
        (False, "len(plain)=1 > 1"),
    ]


@pytest.mark.parametrize("how", ["debugged", "sampled"])
def test_a_guard_may_change_what_the_next_one_sees(how: str) -> None:
    assert seen(Counting, how) == [
        (False, "n=3 > 5"),
        (False, "self.count()"),
        (True, "n=4 > 3"),
    ]


DATA = st.recursive(
    st.integers() | st.text(max_size=3),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(st.text(max_size=2), inner, max_size=3),
        st.builds(Arm, st.floats(), st.lists(inner, max_size=3)),
        st.builds(Span, st.floats(), st.lists(inner, max_size=3)),
    ),
    max_leaves=10,
)


def spoil(value: Any, seen: set[int]) -> None:
    """Change all that can be changed in a value."""
    if id(value) in seen:
        return
    seen.add(id(value))
    parts = [*value.values()] if isinstance(value, dict) else value
    if isinstance(value, Arm):
        parts = value.joints
    if isinstance(parts, list | tuple):
        for each in parts:
            spoil(each, seen)
    if isinstance(value, Arm):
        value.angle = -7.5
    elif isinstance(value, list):
        value.append("spoiled")
    elif isinstance(value, dict):
        value["spoiled"] = 1


@given(DATA)
def test_data_of_any_depth_are_kept(value: Any) -> None:
    class Holding(Machine):
        data: Any = None
        go = State()
        end = State()
        go.to(end, when=lambda self: self.data is None)

        @go.internal
        def change(self) -> None:
            spoil(self.data, set())

    arrangement = Arrangement([Holding], whiteboard=Whiteboard.local(), clock=ManualClock())
    turns = Debugger.of(arrangement).turns
    arrangement.attach(turns)
    arrangement.machine("Holding").data = value
    before = repr(value)
    arrangement.round()
    turn = turns.of("Holding")
    assert turn is not None
    assert repr(turn.transitions[0].attributes["data"]) == before
