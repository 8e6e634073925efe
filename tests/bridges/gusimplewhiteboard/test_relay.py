"""What is passed on, in which direction, and what is not."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.bridges.gusimplewhiteboard import GuFileError, GuWhiteboard, Relay, find_layout
from llfsm.bridges.gusimplewhiteboard.file import RingPosition
from llfsm.bridges.gusimplewhiteboard.relay import Direction, run
from llfsm.whiteboard import Board, Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Vector3
from llfsm.whiteboard.messages.turtlesim import Color

from .conftest import change

Native = Callable[..., str]
VECTOR = Slot("vector", Vector3)


@pytest.fixture
def board() -> Board:
    return Whiteboard.local()


@pytest.fixture
def relay(foreign: GuWhiteboard, board: Board) -> Callable[..., Relay]:
    def make(direction: Direction = "both", number: int = 12) -> Relay:
        return Relay(foreign, number, board, VECTOR, find_layout("<3d", VECTOR.schema), direction)

    return make


def theirs(foreign: GuWhiteboard, number: int = 12) -> Vector3:
    data, _ = foreign.read(number, 24)
    return Vector3(*struct.unpack("<3d", data))


def test_nothing_is_made_of_nothing(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board
) -> None:
    for direction in ("in", "out", "both"):
        relay(direction).step()
    assert board[VECTOR].count == 0
    assert foreign.position(12) == RingPosition(0, 0)


def test_in(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board, native: Native
) -> None:
    relay_in = relay("in")
    for count in range(1, 6):
        native("add", 12, count, 2, 3)
        for _ in range(3):
            relay_in.step()
        assert board.get_message(VECTOR) == Vector3(count, 2.0, 3.0)
        assert board[VECTOR].count == count
    board.add_message(VECTOR, Vector3(9.0))
    relay_in.step()
    assert foreign.position(12).counter == relay_in.relayed_in == 5
    assert relay_in.relayed_out == 0


def test_out(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board, native: Native
) -> None:
    relay_out = relay("out")
    for count in range(1, 6):
        board.add_message(VECTOR, Vector3(float(count), 2.0, 3.0))
        for _ in range(3):
            relay_out.step()
        assert native("get", 12, 3) == f"{count} 2 3 of {count}\n"
    native("add", 12, 9, 9, 9)
    relay_out.step()
    assert board[VECTOR].count == relay_out.relayed_out == 5
    assert relay_out.relayed_in == 0


def test_both_without_an_echo(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board, native: Native
) -> None:
    both = relay("both")
    for count in range(1, 20, 2):
        native("add", 12, count, 0, 0)
        for _ in range(5):
            both.step()
        assert (board[VECTOR].count, foreign.position(12).counter) == (count, count)
        assert board.get_message(VECTOR) == Vector3(float(count))
        board.add_message(VECTOR, Vector3(count + 1.0))
        for _ in range(5):
            both.step()
        assert (board[VECTOR].count, foreign.position(12).counter) == (count + 1, count + 1)
        assert theirs(foreign) == Vector3(count + 1.0)
    assert (both.relayed_in, both.relayed_out) == (10, 10)


def test_both_sides_at_once_end_alike(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board
) -> None:
    both = relay("both")
    for count in range(10):
        foreign.add(12, struct.pack("<3d", count, 1, 0))
        board.add_message(VECTOR, Vector3(float(count), 2.0))
        for _ in range(5):
            both.step()
        assert board.get_message(VECTOR) == theirs(foreign) == Vector3(float(count), 1.0)
    assert (both.relayed_in, both.relayed_out) == (10, 0)


def test_what_is_there_before_is_relayed(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board
) -> None:
    foreign.add(12, struct.pack("<3d", 1, 2, 3))
    relay("both").step()
    assert board.get_message(VECTOR) == Vector3(1.0, 2.0, 3.0)
    foreign.add(12, struct.pack("<3d", 4, 5, 6))
    again = relay("both")  # as after a restart: which side is newer is not known
    for _ in range(3):
        again.step()
    assert board.get_message(VECTOR) == theirs(foreign) == Vector3(1.0, 2.0, 3.0)


def test_of_many_messages_the_newest_is_relayed(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board
) -> None:
    both = relay("both")
    for count in range(100):
        foreign.add(12, struct.pack("<3d", count, 0, 0))
    both.step()
    assert board.get_message(VECTOR) == Vector3(99.0)
    for count in range(100):
        board.add_message(VECTOR, Vector3(float(count)))
    both.step()
    assert theirs(foreign) == Vector3(99.0)
    assert (both.relayed_in, both.relayed_out) == (1, 1)


def test_a_message_that_is_about_to_be_counted_is_relayed_once(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board
) -> None:
    relay_in = relay("in")
    foreign.message_bytes(12, 1, 24)[:] = struct.pack("<3d", 1, 2, 3)
    change(foreign.path, 4 + 12, b"\1")  # its index
    relay_in.step()
    assert board[VECTOR].count == 0
    change(foreign.path, 4 + 512 + 2 * 12, b"\1")  # its counter
    for _ in range(3):
        relay_in.step()
    assert board[VECTOR].count == 1


def test_a_writer_that_does_not_count_is_relayed_all_the_same(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board
) -> None:
    relay_in = relay("in")
    for value in range(1, 9):
        foreign.message_bytes(12, value % 4, 24)[:] = struct.pack("<3d", value, 0, 0)
        change(foreign.path, 4 + 12, bytes([value % 4]))
        for _ in range(3):
            relay_in.step()
        assert board.get_message(VECTOR) == Vector3(float(value))
        assert board[VECTOR].count == value


def test_a_misfit_is_refused_with_one_warning(
    foreign: GuWhiteboard, board: Board, caplog: pytest.LogCaptureFixture
) -> None:
    color = Slot("color", Color)
    relay = Relay(foreign, 1, board, color, find_layout("<3h", color.schema))

    def add(red: int) -> None:
        foreign.add(1, struct.pack("<3h", red, 2, 3))
        for _ in range(2):
            relay.step()

    with caplog.at_level(logging.WARNING):
        for red in (256, 300, -1):
            add(red)
        assert board[color].count == 0
        assert relay.refused == 3
        assert [record.getMessage() for record in caplog.records] == [
            "1 <-> color: a message was not relayed: Expected `int` <= 255 - at `r`"
        ]
        add(255)
        assert board.get_message(color) == Color(255, 2, 3)
        add(256)
    assert len(caplog.records) == 2


def test_a_misfit_outwards_is_refused_with_one_warning(
    foreign: GuWhiteboard, board: Board, caplog: pytest.LogCaptureFixture
) -> None:
    relay = Relay(foreign, 1, board, VECTOR, find_layout("<3f", VECTOR.schema))
    for _ in range(3):
        board.add_message(VECTOR, Vector3(1e300))
        for _ in range(2):
            relay.step()
    assert (relay.refused, relay.relayed_out, len(caplog.records)) == (3, 0, 1)
    assert foreign.position(1) == RingPosition(0, 0)
    board.add_message(VECTOR, Vector3(0.5))
    relay.step()
    assert relay.relayed_out == 1


def test_a_run_ends_with_the_board_or_the_file(
    relay: Callable[..., Relay], foreign: GuWhiteboard, board: Board, path: Path
) -> None:
    rounds = iter([False, False, True])
    run(foreign, [relay()], lambda: next(rounds), lambda: board.alive)
    assert list(rounds) == []
    path.unlink()
    with pytest.raises(GuFileError, match="was removed or replaced"):
        run(foreign, [relay()], lambda: False, lambda: board.alive)
    board.close()
    run(foreign, [], lambda: False, lambda: board.alive)
