"""Messages and boards go through `multiprocessing`, whatever their class was made from."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.whiteboard import Message, Slot, Whiteboard
from llfsm.whiteboard.message import type_from_schema
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.std_msgs import Int32

NUMBER = Slot("number", Int32)


class Own(Message):
    number: int = 0


def made_here() -> Message:
    class Inner(Message):
        number: int = 0
        own: Own = Own()

    return Inner(3, Own(4))


MESSAGES: list[Any] = [
    Own(5),
    Twist(Vector3(x=2.0)),
    made_here(),
    TypeLibrary().message("sensor_msgs/msg/LaserScan").message(ranges=(1.0, 2.0)),
    type_from_schema(Slot("own", Own).schema)(number=6),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, pickle])
def test_a_message_is_the_same_again(message: Message, again: Any) -> None:
    found = pickle.loads(pickle.dumps(message)) if again is pickle else again(message)
    assert (found, type(found)) == (message, type(message))


# The class of the first is in a module that the other process lacks.
@pytest.mark.parametrize("message", MESSAGES[1:], ids=lambda message: type(message).__name__)
def test_another_process_reads_it(message: Message, tmp_path: Path) -> None:
    file = tmp_path / "message"
    file.write_bytes(pickle.dumps(message))
    code = "import pickle, sys; print(repr(pickle.load(open(sys.argv[1], 'rb'))))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(file)], text=True, capture_output=True, check=True
    )
    assert done.stdout.rstrip() == repr(message)


def add_one(board: Whiteboard, queue: Any) -> None:
    """Add to a board in another process."""
    queue.put(board.add_message(NUMBER, Int32(data=7)))


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_a_board_goes_to_another_process(tmp_path: Path, method: str) -> None:
    pytest.importorskip("llfsm.whiteboard._shm", reason="the extension is hidden")
    context = multiprocessing.get_context(method)
    with Whiteboard("board", directory=tmp_path) as board:
        board.add_message(NUMBER, Int32(data=1))
        queue = context.Queue()
        process = context.Process(target=add_one, args=(board, queue))
        process.start()
        assert queue.get() == 2
        process.join()
        assert board.get_message(NUMBER) == Int32(data=7)
