"""What code keeps outside of its machine's variables is found, also if it seldom shows."""

from __future__ import annotations

import enum
import itertools
import sys
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from llfsm.runtime import Machine, State, define
from llfsm.runtime.verification import UnsupportedError, VerificationError, explore


def runs(code: Callable[[Any], Any]) -> type[Machine]:
    """Return a machine that runs `code` in each turn, and stays."""
    start = State("START")
    start.internal(code)
    start.to(start, when=lambda self: False)
    return define("M", [start])


number = 0
numbers = [0]
bits = array("i", [0])
space = SimpleNamespace(number=0)
ways = itertools.cycle([1, 2])


class Counter:
    def __init__(self) -> None:
        self.number = 0

    def up(self) -> None:
        self.number += 1


class Slim:
    __slots__ = ("number",)

    def __init__(self) -> None:
        self.number = 0


@dataclass
class Box:
    items: dict[str, set[int]] = field(default_factory=dict)


class Log(list[int]):
    """One that may have more to it than its items."""


counter, slim, box, log = Counter(), Slim(), Box(), Log()


class Counting(Machine):
    total: ClassVar[int] = 0
    START = State()

    @START.internal
    def _(self) -> None:
        self.count()

    def count(self) -> None:
        type(self).total += 1

    START.to(START, when=lambda self: False)


def count_global() -> None:
    global number
    number += 1


def make_global() -> None:
    global made
    made = 1  # type: ignore[name-defined]


def count_default(numbers: list[int] = [0], *, other: list[int] = [0]) -> None:  # noqa: B006
    numbers[0] += 1


def count_own() -> None:
    count_own.number = getattr(count_own, "number", 0) + 1  # type: ignore[attr-defined]


def count_around() -> Callable[[Any], None]:
    inner = 0

    def count(_: Any) -> None:
        nonlocal inner
        inner += 1

    return count


def set_log(_: Any) -> None:
    log.total = 1  # type: ignore[attr-defined]


this = sys.modules[__name__]


@pytest.mark.parametrize(
    ("code", "what"),
    [
        (lambda _: count_global(), r"the global .*\.number:"),
        (lambda _: next(count_global for _ in "a")(), r"the global .*\.number:"),
        (lambda _: make_global(), r"the global .*\.made:"),
        (lambda _: numbers.append(0), r"the global .*\.numbers:"),
        (lambda _: bits.append(1), r"the global .*\.bits:"),
        (lambda _: setattr(space, "number", space.number + 1), r"the global .*\.space:"),
        (lambda _: setattr(this, "number", this.number + 1), r"the global .*\.number:"),
        (lambda _: counter.up(), r"the global .*\.counter:"),
        (lambda _: setattr(slim, "number", slim.number + 1), r"the global .*\.slim:"),
        (
            lambda _: box.items.setdefault("a", set()).add(len(box.items)),
            r"the global .*\.box:",
        ),
        (set_log, r"the global .*\.log:"),
        (lambda _: count_default(), "the default of numbers of count_default:"),
        (
            lambda _: partial(count_default, other=[])(),
            "the default of numbers of count_default:",
        ),
        (lambda _: count_own(), r"count_own\.number:"),
        (count_around(), r"inner, a variable around count_around\.<locals>\.count:"),
        (lambda _: setattr(Counter, "n", 1), r"Counter\.n:"),
        (lambda _: next(ways), r"the global .*\.ways, of type cycle:"),
    ],
)
def test_what_code_changes_beside_its_variables_is_named(
    code: Callable[[Any], Any], what: str
) -> None:
    with pytest.raises(UnsupportedError, match=f"^M (changes|uses) {what} "):
        explore(runs(code), period_ms=10)


def test_an_attribute_of_the_class_is_named() -> None:
    with pytest.raises(UnsupportedError, match=r"^Counting changes Counting\.total: "):
        explore(Counting, period_ms=10)


class Sides(enum.Flag):
    LEFT = enum.auto()
    RIGHT = enum.auto()


@lru_cache
def factor(number: int) -> int:
    return number * numbers[0]


def test_what_stays_as_it_is_may_be_used() -> None:
    def code(_: Any) -> None:
        factor(len(log)) + counter.number + space.number + len(box.items) + bits[0]
        assert {Sides.LEFT | Sides.RIGHT: Slim}

    assert explore(runs(code), period_ms=10).complete


def test_a_value_that_contains_itself_is_compared_too() -> None:
    knot: list[Any] = [0]
    knot.append(knot)
    assert explore(runs(lambda _: len(knot)), period_ms=10).complete
    with pytest.raises(UnsupportedError, match="changes knot, a variable around "):
        explore(runs(lambda _: knot.append(1)), period_ms=10)


class Named:
    def __hash__(self) -> int:
        return hash("name")


@pytest.mark.parametrize(
    ("code", "call"), [(lambda _: hash("text"), "hash"), (lambda self: id(self), "id")]
)
def test_numbers_that_differ_in_each_process_are_found(
    code: Callable[[Any], Any], call: str
) -> None:
    with pytest.raises(VerificationError, match=rf"M, state START, Internal, calls {call} \("):
        explore(runs(code), period_ms=10)


def test_code_may_use_what_has_a_hash_as_a_key() -> None:
    assert explore(runs(lambda _: {Named(), Sides.LEFT}), period_ms=10).complete
