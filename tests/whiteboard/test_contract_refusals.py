"""The refusals of a board, and its end; the same for every kind."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Annotated

import msgspec
import pytest

from llfsm.whiteboard import (
    Board,
    BoardClosedError,
    Message,
    MessageFieldError,
    MessageTooLargeError,
    Slot,
    SlotTypeError,
)

OpenBoard = Callable[[], Board]


class Point(Message, type_name="test/Point"):
    x: float = 0.0
    y: float = 0.0


class Path(Message):
    name: str = ""
    start: Point = Point()
    points: tuple[Point, ...] = ()
    number: Annotated[int, msgspec.Meta(ge=0, le=9)] = 0


class Plain(Message):
    """Only fields whose values the extension checks itself, without the decoder."""

    ratio: float = 0.0
    number: int = 0
    small: Annotated[int, msgspec.Meta(ge=-3, le=9)] = 0
    flag: bool = False
    text: str = ""
    data: bytes = b""
    point: Point = Point()
    points: tuple[Point, ...] = ()
    texts: tuple[str, ...] = ()
    rows: tuple[tuple[float, ...], ...] = ()
    three: Annotated[tuple[float, ...], msgspec.Meta(min_length=3, max_length=3)] = (0.0,) * 3


class Deep(Message):
    pair: tuple[int, Point] | None = None
    paths: tuple[Path, ...] = ()
    found: frozenset[Point] = frozenset()


POINT = Slot("robot/point", Point)
PLAIN = Slot("plain", Plain)
PATH = Slot("robot/path", Path)


class OtherPoint(Message, type_name="test/Point"):
    x: float = 0.0
    z: int = 0


def test_a_slot_of_another_type_is_refused_with_the_difference(board: Board) -> None:
    board.add_message(POINT, Point(1.0))
    with pytest.raises(SlotTypeError) as raised:
        board[Slot("robot/point", OtherPoint)]
    assert str(raised.value) == (
        "slot 'robot/point' holds test/Point, not our test/Point: "
        "only the board has y (type:number); only ours has z (type:integer)"
    )
    with pytest.raises(SlotTypeError, match="test/Point on the board, Path in ours"):
        board[Slot("robot/point", Path)]
    assert board.get_message(POINT) == Point(1.0)


def test_a_type_that_only_has_another_name_is_another(board: Board) -> None:
    class Renamed(Message, type_name="test/Renamed"):
        x: float = 0.0
        y: float = 0.0

    board.add_message(POINT, Point())
    with pytest.raises(SlotTypeError, match="test/Point on the board, test/Renamed in ours"):
        board.add_message(Slot("robot/point", Renamed), Renamed())


def test_a_message_of_another_class_is_refused(board: Board) -> None:
    class SubPoint(Point):
        pass

    board.add_message(POINT, Point(1.0))
    for wrong in (Path(), SubPoint(), {"x": 1.0}, None):
        name = type(wrong).__qualname__
        with pytest.raises(SlotTypeError, match=f"accepts Point messages, not .*{name}"):
            board[POINT].add(wrong)  # type: ignore[arg-type]
    assert board[POINT].count == 1
    assert board.get_message(POINT) == Point(1.0)


@pytest.mark.parametrize(
    ("path", "where"),
    [
        (Path(name=5), "name"),  # type: ignore[arg-type]
        (Path(name=b"a"), "name"),  # type: ignore[arg-type]
        (Path(start=None), "start"),  # type: ignore[arg-type]
        (Path(start=Path()), "start.x"),  # type: ignore[arg-type]
        (Path(start=Point(x="1")), "start.x"),  # type: ignore[arg-type]
        (Path(points=(Point(), 3)), r"points\[1\]"),  # type: ignore[arg-type]
        (Path(points=3), "points"),  # type: ignore[arg-type]
        (Path(number=True), "number"),
        (Path(number=1.5), "number"),  # type: ignore[arg-type]
        (Path(number=10), "number"),
        (Path(number=-1), "number"),
        (Path(number=2**63), "number"),
    ],
)
def test_a_wrong_value_is_refused_with_its_place(board: Board, path: Path, where: str) -> None:
    board.add_message(PATH, Path("good"))
    with pytest.raises(MessageFieldError, match=f"slot 'robot/path': the Path .*at `{where}`"):
        board.add_message(PATH, path)
    assert board[PATH].count == 1
    assert board.get_message(PATH) == Path("good")


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("ratio", ["1", None, True, b""]),
        ("number", [1.0, "1", None, True]),
        ("small", [10, -4, 2**63, -(2**63), 2**64 - 1, 1.0, False]),
        ("flag", [1, 0.0, None, ""]),
        ("text", [b"", 1, None, ("a",)]),
        ("data", [1, None, (1,)]),
        ("point", [None, 1.0, "x", {"x": 1.0}]),
        ("point.x", [Point(x="1"), Point(x=None)]),  # type: ignore[arg-type]
        ("point.y", [Point(y=b""), Point(y=False)]),  # type: ignore[arg-type]
        ("points", [None, 1, "x", b""]),
        (r"points\[1\]", [(Point(), 3), (Point(), None), (Point(), "", Point())]),
        (r"points\[0\].x", [(Point(x=""),), (Point(x=None), 3)]),  # type: ignore[arg-type]
        (r"texts\[2\]", [("", "a", b""), ("", "", 1), ("", "", ("",))]),
        (r"rows\[1\]", [((), 1.0), ((0.5,), None)]),
        (r"rows\[1\]\[0\]", [((), ("",)), ((), (True,))]),
        ("three", [(), (0.0, 0.0), (0.0,) * 4, None]),
        (r"three\[2\]", [(0.0, 1, "")]),
    ],
)
def test_a_wrong_value_is_refused_by_the_quick_check(
    board: Board, field: str, values: list[object]
) -> None:
    board.add_message(PLAIN, Plain(text="good"))
    for value in values:
        (name,) = (each for each in Plain.__struct_fields__ if re.match(rf"{each}\b", field))
        wrong = msgspec.structs.replace(Plain(), **{name: value})
        with pytest.raises(MessageFieldError, match=f"slot 'plain': the Plain .*at `{field}`"):
            board.add_message(PLAIN, wrong)
    assert board[PLAIN].count == 1
    assert board.get_message(PLAIN) == Plain(text="good")


@pytest.mark.parametrize(
    ("deep", "place"),
    [
        (Deep(pair=(1, Point(y=""))), "pair[1].y"),  # type: ignore[arg-type]
        (Deep(paths=(Path(), Path(points=(Point(x=""),)))), "paths[1].points[0].x"),  # type: ignore[arg-type]
        (Deep(found=frozenset([Point(x="")])), "found[0].x"),  # type: ignore[arg-type]
    ],
)
def test_a_place_is_named_however_deep_it_is(board: Board, deep: Deep, place: str) -> None:
    with pytest.raises(MessageFieldError, match=re.escape(f"at `{place}`")):
        board.add_message(Slot("deep", Deep), deep)


@pytest.mark.parametrize(
    "plain",
    [
        Plain(ratio=1),
        Plain(number=2**64 - 1),
        Plain(number=-(2**63)),
        Plain(small=9),
        Plain(small=-3),
        Plain(text="\0", data=b"\0"),
        Plain(point=Point(x=-(2**53))),
        Plain(points=(Point(1, 2), Point())),
        Plain(texts=("", "\0"), rows=((), (1, 0.5), ()), three=(1, 2.0, 3)),
    ],
    ids=repr,
)
def test_a_right_value_at_the_edge_is_taken(board: Board, plain: Plain) -> None:
    board.add_message(PLAIN, plain)
    assert board.get_message(PLAIN) == plain


@pytest.mark.parametrize(
    "value", ["\ud800", object(), 2**64, lambda: 0], ids=["surrogate", "object", "int", "function"]
)
def test_what_cannot_be_encoded_is_refused(board: Board, value: object) -> None:
    with pytest.raises(MessageFieldError, match="slot 'robot/path': the Path was not added"):
        board.add_message(PATH, Path(name=value))  # type: ignore[arg-type]
    assert board[PATH].count == 0


def test_an_interrupt_is_no_wrong_field(board: Board) -> None:
    armed = False

    class Interrupting(Message):
        maybe: int | None = None  # a union: the decoder, and so __post_init__, is asked

        def __post_init__(self) -> None:
            if armed:
                raise KeyboardInterrupt

    slot = Slot("interrupting", Interrupting)
    message = Interrupting()
    board.add_message(slot, message)
    armed = True
    with pytest.raises(KeyboardInterrupt):
        board.add_message(slot, message)
    armed = False
    assert board.add_message(slot, message) == 2


def test_a_message_that_is_too_large_is_refused_with_both_sizes(board: Board) -> None:
    slot = Slot("small", Path, capacity=64)
    size = len(msgspec.msgpack.encode(Path("")))
    fits = Path("é" * 10 + "a" * (64 - size - 20))
    assert len(msgspec.msgpack.encode(fits)) in (64, 65)
    while len(msgspec.msgpack.encode(fits)) > 64:
        fits = Path(fits.name[:-1])
    board.add_message(slot, fits)
    for extra in (1, 2, 7, 8, 9, 1000, 100_000):
        large = Path(fits.name + "b" * extra)
        length = len(msgspec.msgpack.encode(large))
        with pytest.raises(MessageTooLargeError, match=rf"takes {length} bytes.* holds 64\b"):
            board.add_message(slot, large)
        assert board[slot].count == 1
        assert board.get_message(slot) == fits
    assert board.add_message(slot, Path("again")) == 2


# ---- The end --------------------------------------------------------------------------------

USES: dict[str, Callable[[Board], object]] = {
    "add": lambda board: board.add_message(POINT, Point()),
    "get": lambda board: board.get_message(POINT),
    "count": lambda board: board[POINT].count,
    "sample": lambda board: board[POINT].sample(),
    "wait": lambda board: board[POINT].wait(after=0, timeout=0),
    "bind": lambda board: board[PATH],
    "slots": lambda board: board.slots(),
}


@pytest.mark.parametrize("use", USES)
def test_a_closed_board_says_so(board: Board, use: str) -> None:
    board.add_message(POINT, Point())
    assert board.get_message(POINT) == Point()
    assert board.alive
    board.close()
    board.close()
    assert not board.alive
    with pytest.raises(BoardClosedError, match="closed"):
        USES[use](board)


def test_leaving_the_context_closes(board: Board) -> None:
    with board as entered:
        assert entered is board
        assert board.alive
    assert not board.alive


def test_removing_is_seen_by_every_handle(open_board: OpenBoard) -> None:
    one, other = open_board(), open_board()
    assert one.alive
    assert other.alive
    one.remove()
    assert not one.alive
    assert not other.alive
    one.remove()
    other.remove()


class Line(Message):
    start: Point = Point()


class Wide(Message):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


def test_another_message_within_a_message_is_refused(board: Board) -> None:
    """Also a larger one, of which the reader would take only the beginning."""
    slot = board[Slot("line", Line)]
    with pytest.raises(MessageFieldError, match="start"):
        slot.add(Line(Wide(1.0, 2.0, 3.0)))  # type: ignore[arg-type]
    assert slot.count == 0


def test_the_capacity_is_as_given(board: Board) -> None:
    assert board[Slot("odd", Line, capacity=37)].capacity == 37
