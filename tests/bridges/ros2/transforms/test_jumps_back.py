"""When time jumps back, nothing of the first pass answers for the second."""

from __future__ import annotations

import logging

import pytest

from llfsm.bridges.ros2.errors import FrameLookupError, TransformError
from llfsm.bridges.ros2.transforms import TransformBuffer, TransformListener
from llfsm.whiteboard import Board, Slot, Whiteboard
from llfsm.whiteboard.messages.builtin_interfaces import Time
from llfsm.whiteboard.messages.geometry_msgs import Transform, TransformStamped, Vector3
from llfsm.whiteboard.messages.std_msgs import Header

BASE, ARM, FIXED = (
    Slot(name, TransformStamped) for name in ("tf/base", "tf/arm", "tf_static/camera")
)


def at(second: float, parent: str, child: str, x: float) -> TransformStamped:
    stamp = Time(int(second), round(second % 1 * 1e9))
    return TransformStamped(Header(stamp, parent), child, Transform(Vector3(x=x)))


def answers(frames: TransformBuffer, second: float) -> list[object]:
    found: list[object] = []
    for stamp in (Time(0), Time(int(second))):
        for target, source in (("map", "base"), ("map", "arm"), ("base", "camera")):
            try:
                found.append(frames.lookup(target, source, stamp))
            except TransformError as error:
                found.append(str(error))
    return found


def passed(board: Board, listener: TransformListener, number: int, second: float) -> None:
    """Do what a bag has at a second of its pass."""
    board.add_message(FIXED, at(0, "base", "camera", 0.5))
    board.add_message(BASE, at(second, "map", "base", second + 1000 * number))
    board.add_message(ARM, at(second - 0.3, "base", "arm", 1.0))  # it always comes later
    listener.pull()


@pytest.mark.parametrize("length", [3, 30, 300])
def test_a_second_pass_answers_as_a_first_one(
    length: int, caplog: pytest.LogCaptureFixture
) -> None:
    frames, other = TransformBuffer(), TransformBuffer()
    board, again = Whiteboard.local(), Whiteboard.local()
    listener, second = TransformListener(board, frames), TransformListener(again, other)
    for n in range(length):
        passed(board, listener, 0, 100 + n)
    assert not caplog.records
    for n in range(length):
        passed(board, listener, 1, 100 + n)
        passed(again, second, 1, 100 + n)
        assert answers(frames, 100 + n) == answers(other, 100 + n)
    (warning,) = caplog.records
    assert (warning.levelno, warning.message) == (
        logging.WARNING,
        "Detected jump back in time. Clearing TF buffer.",
    )


def test_what_is_late_is_no_jump() -> None:
    frames, board = TransformBuffer(), Whiteboard.local()
    listener = TransformListener(board, frames)
    for second in (100.0, 101.0, 100.2, 102.0):  # of two publishers
        board.add_message(BASE, at(second, "map", "base", second))
        listener.pull()
    assert frames.lookup("map", "base", Time(101)).transform.translation.x == 101.0


def test_static_frames_stay() -> None:
    frames = TransformBuffer()
    frames.add(at(0, "base", "camera", 0.5), static=True)
    frames.add(at(5, "map", "base", 1.0))
    frames.clear()
    assert frames.lookup("base", "camera").transform.translation.x == 0.5
    assert frames.newest_ns("base") is None
    with pytest.raises(FrameLookupError):
        frames.lookup("nowhere", "base")
