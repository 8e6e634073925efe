"""The values that `every` lists are those that a board accepts, or else the type is refused."""

from __future__ import annotations

import enum
import re
from typing import Annotated, Any, Literal, get_args, get_origin

import msgspec
import pytest
from hypothesis import HealthCheck, example, given, reject, settings
from hypothesis import strategies as st

from llfsm.runtime import Machine, Sensor, State
from llfsm.runtime._values import freeze
from llfsm.runtime.verification import DomainError, every, explore, reachable
from llfsm.runtime.verification.domains import domain_of
from llfsm.whiteboard import Message, MessageTypeError, Slot
from thoroughness import examples


class Colour(enum.Enum):
    RED = "red"
    GREEN = "green"
    AMBER = "green"  # noqa: PIE796, another name for it


class Gear(enum.IntEnum):
    PARK = 0
    DRIVE = 2


class Side(enum.Flag):
    LEFT = 1
    RIGHT = 4


class Bump(enum.IntFlag, boundary=enum.STRICT):
    FRONT = 1
    BACK = 2


class Wide(enum.Flag):
    """Half of BOTH is no value in all versions of Python."""

    ONE = 1
    BOTH = 6


class Lenient(enum.Flag, boundary=enum.CONFORM):
    A = 1
    C = 4


class Open(enum.IntFlag):
    A = 1


class Ejecting(enum.Flag, boundary=enum.EJECT):
    A = 1


class Guessing(enum.Enum):
    UP = 1
    DOWN = 2

    @classmethod
    def _missing_(cls, value: object) -> Guessing:
        return cls.UP


class Pair(Message):
    on: bool = False
    colour: Colour = Colour.RED


class Even(Message):
    one: bool = False
    two: bool = False

    def __post_init__(self) -> None:
        if self.one is not self.two:
            raise ValueError("both or none")


small = st.integers(-3, 8)
ranges = st.builds(
    lambda low, high, step, closed: Annotated[
        int,
        msgspec.Meta(
            ge=low if closed else None,
            gt=None if closed else low,
            le=high if closed else None,
            lt=None if closed else high,
            multiple_of=step,
        ),
    ],
    small,
    small,
    st.sampled_from([None, 1, 2, 3]),
    st.booleans(),
)
simple = ranges | st.sampled_from([
    *(bool, None, Colour, Gear, Side, Bump, Wide, Lenient, Open, Ejecting, Guessing, Pair, Even),
    *(Literal["red", 2, None], Literal[-1], Literal["a", "b"]),
    *(int, str, float, tuple[bool, ...], frozenset[bool]),
])  # fmt: skip


def _joined(one: Any, other: Any) -> Any:
    """Make a union; not of two literals, or a tuple, with which msgspec 0.22 may crash."""
    try:
        made = one | other
    except TypeError:  # of two texts or Nones
        reject()
    origins = [get_origin(each) for each in get_args(made)]
    if origins.count(Literal) > 1 or tuple in origins:
        reject()
    return made


kinds = st.recursive(
    simple,
    lambda inner: (
        st.builds(_joined, inner, inner) | st.builds(lambda *each: tuple[each], inner, inner)
    ),  # type: ignore[valid-type]
    max_leaves=4,
)
atoms = small | st.sampled_from([True, False, None, "red", "green", "a", "b", "", 0.0, 2**40])
wired = st.recursive(atoms, lambda inner: st.lists(inner, max_size=2), max_leaves=4)
"""What another process may write into a field: a message there is a list of its fields."""


@settings(max_examples=examples(150), suppress_health_check=list(HealthCheck), deadline=None)
@given(kinds, st.lists(wired, min_size=10, max_size=40))
@example(Side, [0, 1, 4, 5, 2])
@example(Bump, [0, 1, 2, 3, 4, -1])
@example(Pair, [[True, "green"], [True, "amber"], []])
def test_every_lists_what_a_board_accepts(kind: Any, written: list[Any]) -> None:
    try:
        holder: Any = type(Message)("Holder", (Message,), {"__annotations__": {"x": kind}})
        slot = Slot("held", holder)
    except (MessageTypeError, TypeError):
        reject()
    try:
        listed = every(holder)
    except DomainError as error:
        named = re.match(r"every\(Holder(\.x.*)?\)", str(error))
        assert named, error  # noqa: PT017, as only a type that is refused has one
        return
    keys = {freeze(each) for each in listed}
    assert len(keys) == len(listed)
    for each in listed:
        assert freeze(slot.decoder.decode(slot.encoder.encode(each))) in keys
    for value in written:
        try:
            read = slot.decoder.decode(msgspec.msgpack.encode([value]))
        except msgspec.ValidationError:
            continue
        assert freeze(read) in keys


every_range, another_range = (Annotated[int, msgspec.Meta(ge=0, le=n)] for n in (3, 5))


class Wrong(Message):
    level: Annotated[int, msgspec.Meta(ge=0, le=3)] = -1


class Node(Message):
    next: Node | None = None


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Open, "Open accepts any number: declare it with boundary=enum.STRICT"),
        (Ejecting, "Ejecting accepts any number"),
        (Guessing, r"Guessing\._missing_ may accept more than its members"),
        (Wrong, r"Wrong\.level\): its default -1 is not of its type"),
        (Node, "contains itself"),
        (every_range | another_range, "an int of two ranges"),
        (tuple[float, bool], "the type float has too many values"),
    ],
)
def test_a_type_that_accepts_more_than_can_be_listed_is_refused(kind: Any, message: str) -> None:
    with pytest.raises(DomainError, match=message):
        every(kind)


class Bumper(Message):
    hit: Side = Side(0)


def test_all_sides_at_once_and_none_are_in_a_domain() -> None:
    """They were left out, and what follows from them was not found."""

    class Guard(Machine):
        bumper = Sensor(Slot("bumper", Bumper), default=Bumper(Side.LEFT), domain=every(Bumper))
        FREE, STUCK, LOOSE = State(), State(), State()
        FREE.to(STUCK, when=lambda self: self.bumper.hit == Side.LEFT | Side.RIGHT)
        STUCK.to(LOOSE, when=lambda self: not self.bumper.hit)

    space = explore(Guard, period_ms=10, properties=[reachable(lambda v: v.Guard.state == "LOOSE")])
    assert space.verdicts[0].holds
    assert [each.hit.value for each in domain_of(Slot("b", Bumper), {"hit": "every"})] == [
        0,
        1,
        4,
        5,
    ]
