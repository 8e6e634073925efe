"""What hides from a state, from code that runs once or from a property: found, and named."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

import pytest

from llfsm.runtime import Machine, Sensor, State, define
from llfsm.runtime.verification import (
    NO_FAILURE,
    Member,
    PredicateError,
    Property,
    UnsupportedError,
    VerificationError,
    always,
    every,
    explore,
    never,
)
from llfsm.whiteboard import Message, Slot


class Switch(Message):
    on: bool = False


SWITCH = Slot("switch", Switch)


def holds(machines: Any, prop: Property) -> bool | None:
    """Return the verdict of one property."""
    (verdict,) = explore(machines, period_ms=10, properties=[prop]).verdicts
    return verdict.holds


def runs(code: Callable[[Any], Any], name: str = "M") -> type[Machine]:
    """Return a machine that runs `code` in each turn, and stays."""
    start = State("START")
    start.internal(code)
    start.to(start, when=lambda self: False)
    return define(name, [start], variables={"n": (Any, 0)})


@pytest.mark.parametrize("made", ["set", "set & {0, 8}", "frozenset"])
def test_code_may_not_depend_on_the_order_of_a_set(made: str) -> None:
    class Queue(Machine):
        sensed = Sensor(SWITCH, domain=every(Switch))
        waiting: Any = None
        first: int = -1
        FILL, FULL, DONE = State(), State(), State()

        @FILL.on_exit
        def _(self) -> None:
            order = [8, 0] if self.sensed.on else [0, 8]
            self.waiting = (frozenset if made == "frozenset" else set)(order)

        @FULL.on_exit
        def _(self) -> None:
            waiting = self.waiting & {0, 8} if "&" in made else self.waiting
            self.first = next(iter(waiting))

        FILL.to(FULL)
        FULL.to(DONE)

    with pytest.raises(VerificationError, match=r"Queue, state FULL, OnExit, .* a set's order"):
        holds(Queue, never(lambda v: v.Queue.first == 8))


def test_code_may_not_ask_about_a_machine_by_the_order_of_a_set() -> None:
    """Run again, it asks what was not asked when it ran first."""

    class Asking(Machine):
        waiting: frozenset[int] = frozenset((0, 8))
        GO = State()

        @GO.internal
        def _(self) -> None:
            if next(iter(self.waiting)) == 8:
                self.suspend("Other")

        GO.to(GO, when=lambda _: False)

    class Other(Machine):
        GO = State()
        GO.to(GO, when=lambda _: False)

    with pytest.raises(VerificationError, match=r"Asking, state GO,.* a set's order"):
        explore([Asking, Other], period_ms=100)


def test_code_may_use_a_set_as_a_set() -> None:
    def run(machine: Any) -> None:
        before = machine.n or {1}
        after = {(each + 1) % 4 for each in before} | (before - {2})
        total = 0
        for each in after:
            total += each
        machine.n = after if sorted(after)[0] < 4 and f"{ {total} }" and len(after) < 4 else {1}

    space = explore(runs(run), period_ms=10)
    assert space.values == {"M.n": 4}


def test_a_set_that_grows_while_it_is_looked_at_fails() -> None:
    def run(machine: Any) -> None:
        for each in machine.n:
            machine.n.add(each + 1)

    machine = runs(lambda m: run(m) if m.n else setattr(m, "n", {1}))
    assert not holds(machine, NO_FAILURE)


class Boxed(Machine):
    box: Any = None
    START = State()

    def __init__(self, box: list[int]):
        super().__init__()
        self.box = box

    @START.internal
    def _(self) -> None:
        self.box[:] = [1]

    START.to(START, when=lambda self: False)


class Pair(tuple[int, ...]):
    """One that has more to it than its parts."""


def test_machines_that_share_a_mutable_value_are_refused() -> None:
    box: list[int] = []
    two = [Member(lambda: Boxed(box), name=name) for name in ("A", "B")]
    with pytest.raises(UnsupportedError, match="A and B share a value that changes"):
        holds(two, NO_FAILURE)


def test_a_tuple_with_more_to_it_than_its_parts_is_refused() -> None:
    def run(machine: Any) -> None:
        pair = Pair()
        pair.hidden = getattr(machine.n, "hidden", 0) + 1  # type: ignore[attr-defined]
        machine.n = pair

    with pytest.raises(
        UnsupportedError, match=r"M.n is a Pair with 'hidden', which is not a field"
    ):
        holds(runs(run), NO_FAILURE)


@pytest.mark.parametrize(
    ("code", "call"),
    [
        (lambda _: os.path.exists("there"), "stat"),
        (lambda _: open(os.devnull).close(), "open"),
        (lambda _: threading.Thread(target=int).start(), "start_"),
    ],
)
def test_calls_that_reach_what_is_beside_the_machines_are_found(
    code: Callable[[Any], Any], call: str
) -> None:
    with pytest.raises(VerificationError, match=rf"M, state START, Internal, calls {call}"):
        holds(runs(code), NO_FAILURE)


def test_code_may_compute_paths() -> None:
    assert holds(runs(lambda _: os.path.normpath(os.path.join("a", "b"))), NO_FAILURE)


START = State("START")
idle = runs(lambda _: None, "A")
STATES = {START}


@pytest.mark.parametrize(
    ("predicate", "message"),
    [
        (lambda v: v.A.state in STATES, "a state of A is looked up in a set or dict"),
        (lambda v: v.A.state in {"START", "STRAT"}, "A has no state 'STRAT'"),
        (lambda v: {"START": 1}[v.A.state], "a state of A is looked up in a set or dict"),
        (lambda v: v.A.state in {"START", START}, "a state of A is looked up in a set or dict"),
        (lambda v: (v.A.state,) in {("STRAT",)}, "a state of A is looked up in a set or dict"),
        (lambda v: v.A.state is START, "compares a state by `is`"),
        (lambda v: START is v.A.state, "compares a state by `is`"),
    ],
)
def test_a_state_is_compared_only_by_what_knows_its_name(
    predicate: Callable[[Any], bool], message: str
) -> None:
    with pytest.raises(PredicateError, match=message):
        holds(idle, never(predicate))


def test_a_state_may_be_in_a_set_of_names() -> None:
    assert holds(idle, always(lambda v: v.A.state in {"START", "Suspended"}))
    assert not holds(idle, always(lambda v: v.A.state not in {"START"}))


def test_what_is_not_the_state_may_be_compared_by_is() -> None:
    assert not holds(idle, always(lambda v: v.A.state == "START" and v.A.n is None))


@pytest.mark.parametrize("name", ["state", "suspended", "accepted", "loaded"])
def test_a_variable_is_not_taken_for_what_every_machine_has(name: str) -> None:
    start = State("START")
    machine = define("M", [start], variables={name: (Any, None)})
    with pytest.raises(PredicateError, match=f"M has '{name}' of its own"):
        holds(machine, never(lambda v: bool(getattr(v.M, name))))
