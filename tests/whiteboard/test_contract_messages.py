"""Any message comes back from every kind of board as it was added."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from typing import Annotated, Literal

import msgspec
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from llfsm.whiteboard import Board, Message, Slot
from thoroughness import examples
from waiting import PATIENCE_S

OpenBoard = Callable[[], Board]


class Colour(enum.Enum):
    RED = "red"
    GREEN = "green"


class Level(enum.IntEnum):
    LOW = -1
    HIGH = 7


class Inner(Message):
    number: int = 0
    ratio: float = 0.0
    text: str = ""


class Rich(Message):
    flag: bool
    number: int
    unsigned: Annotated[int, msgspec.Meta(ge=0)]
    ratio: float
    text: str
    data: bytes
    inner: Inner
    maybe: Inner | None
    few: int | str | None
    many: tuple[Inner, ...]
    pair: tuple[bool, tuple[bytes, float]]
    some: frozenset[str]
    colour: Colour
    level: Level
    mode: Literal["auto", "manual", 3]
    nothing: None


RICH = Slot("rich", Rich, capacity=1 << 16)
INT64 = st.integers(-(2**63), 2**63 - 1)
INNER = st.builds(Inner, number=INT64, ratio=st.floats(), text=st.text(max_size=40))
RICHES = st.builds(
    Rich,
    flag=st.booleans(),
    number=st.integers(-(2**63), 2**64 - 1),
    unsigned=st.integers(0, 2**64 - 1),
    ratio=st.floats() | st.sampled_from([math.inf, -math.inf, math.nan, -0.0, 5e-324]),
    text=st.text(),
    data=st.binary(max_size=300),
    inner=INNER,
    maybe=st.none() | INNER,
    few=st.none() | INT64 | st.text(),
    many=st.lists(INNER, max_size=5).map(tuple),
    pair=st.tuples(st.booleans(), st.tuples(st.binary(), st.floats())),
    some=st.frozensets(st.text(max_size=5), max_size=5),
    colour=st.sampled_from(Colour),
    level=st.sampled_from(Level),
    mode=st.sampled_from(["auto", "manual", 3]),
    nothing=st.none(),
)


@settings(
    max_examples=examples(40),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(message=RICHES)
def test_any_message_is_read_as_it_was_added(open_board: OpenBoard, message: Rich) -> None:
    board = open_board()
    count = board.add_message(RICH, message)
    sample = board[RICH].wait(after=count - 1, timeout=PATIENCE_S)
    assert sample is not None
    # repr distinguishes 0.0 from -0.0, nan from nothing, and 1 from 1.0 and True
    read, added = (
        repr((msgspec.structs.replace(rich, some=frozenset()), sorted(rich.some)))
        for rich in (sample.message, message)
    )
    assert read == added
    assert type(sample.message) is Rich
