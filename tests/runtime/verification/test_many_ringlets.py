"""Where each state is a ringlet of its own, the work grows as the states do; memory bounds it."""

from __future__ import annotations

import time
from typing import Any

import pytest

from llfsm.runtime import Machine, Sensor, State, define
from llfsm.runtime.verification import Space, VerificationError, _tables, every, explore, never
from llfsm.whiteboard import Message, Slot


class Key(Message):
    up: bool = False
    down: bool = False


def stepper(top: int) -> type[Machine]:
    """Make a machine whose position a key moves up to `top` and down to 0."""
    moves = State("MOVES")

    @moves.internal
    def move(self: Any) -> None:
        if self.key.up and self.pos < top:
            self.pos += 1
        elif self.key.down and self.pos > 0:
            self.pos -= 1

    moves.to(moves, when=lambda self: False)
    key = Sensor(Slot("key", Key), default=Key(), domain=every(Key))
    return define("Stepper", [moves], variables={"pos": (int, 0)}, attributes={"key": key})


def explored(top: int, **how: Any) -> Space:
    return explore(stepper(top), period_ms=10, **how)


@pytest.mark.parametrize("spread", [_tables.SPREAD, False], ids=["as built", "packed tight"])
def test_each_ringlet_of_a_counter_is_run_once(
    monkeypatch: pytest.MonkeyPatch, spread: bool
) -> None:
    """There are 4 keys for each position and for the state before the first turn."""
    monkeypatch.setattr(_tables, "SPREAD", spread)
    space = explored(2000)
    assert (space.states, space.depth, space.ringlets) == (2002, 2000, 4 * 2002)
    assert space.repeated == 1000, "a sample, as most of them are alike"


def test_the_tables_of_a_counter_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    if not _tables.SPREAD:
        pytest.skip("without the extension, fields grow to twice their size")
    made: list[Any] = []
    real = _tables.Packing.__init__

    def count(self: Any, sizes: Any) -> None:
        made.append(sizes)
        real(self, sizes)

    monkeypatch.setattr(_tables.Packing, "__init__", count)
    assert explored(1000).states == 1002
    assert len(made) == 1


def test_all_ringlets_are_run_again_if_there_are_few() -> None:
    space = explored(100)
    assert space.repeated == space.ringlets == 4 * 102


def test_what_seldom_does_something_else_is_in_the_sample() -> None:
    """One ringlet of 5,000 fires a transition, and reads a clock."""
    counts, ends = State("COUNTS"), State("ENDS")

    @counts.internal
    def count(self: Any) -> None:
        self.n += 1

    @counts.on_exit
    def leave(self: Any) -> None:
        self.n = min(0, time.monotonic_ns())

    counts.to(ends, when=lambda self: self.n == 5000)
    machine = define("M", [counts, ends], variables={"n": (int, 0)})
    with pytest.raises(VerificationError, match="OnExit, calls monotonic_ns"):
        explore(machine, period_ms=10)


def test_many_small_counters_have_an_end() -> None:
    """There is no limit for the values of one machine: 40 to the power of 3 here."""

    class Go(Message):
        which: bool = False

    turns = State("TURNS")

    @turns.internal
    def turn(self: Any) -> None:
        name = "x" if self.go.which else "y"
        setattr(self, name, (getattr(self, name) + 1) % 240)

    turns.to(turns, when=lambda self: False)
    go = Sensor(Slot("go", Go), default=Go(), domain=every(Go))
    variables = {"x": (int, 0), "y": (int, 0)}
    two = define("Two", [turns], variables=variables, attributes={"go": go})
    space = explore(two, period_ms=10)
    assert space.complete
    assert space.states == 240 * 240 + 1


def test_an_exploration_ends_before_memory_does(monkeypatch: pytest.MonkeyPatch) -> None:
    where = "llfsm.runtime.verification._deciding."
    monkeypatch.setattr(where + "_LOOK_S", 0.0)
    looks = iter([False] * 300)
    monkeypatch.setattr(where + "is_memory_short", lambda: next(looks, True))
    space = explored(10**9, properties=[never(lambda v: v.Stepper.pos < 0)])
    assert (space.complete, space.cut, space.short_of_memory) == (False, True, True)
    assert space.verdicts[0].holds is None
    [hint] = space.hints()
    assert hint.startswith("Stepper.pos has had 301 values")


def test_memory_that_cannot_be_had_ends_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise MemoryError

    monkeypatch.setattr("llfsm.runtime.verification._deciding.Decisions.goes_on", fail)
    space = explored(9)
    assert (space.complete, space.cut, space.short_of_memory) == (False, True, True)
