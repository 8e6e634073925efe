"""Boards on a file system that is full."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from small_disks import small_disk

RunPython = Callable[..., str]
SCRIPT = """
import os, sys
from llfsm.whiteboard import BoardFullError, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64, String

directory = sys.argv[1]
FULL = "no space left in the file system of the board"

def fill():
    with open(os.path.join(directory, "filler"), "ab") as file:
        try:
            while True:
                os.write(file.fileno(), bytes(4096))
        except OSError:
            pass

def refused(action):
    try:
        action()
    except BoardFullError as error:
        assert FULL in str(error), error
    else:
        raise AssertionError("it was not refused")

def check(board):
    for slot, message in there.items():
        assert board.get_message(slot) == message, slot

# at the making of the board
fill()
refused(lambda: Whiteboard("late", directory=directory))
assert os.listdir(directory) == ["filler"]
os.remove(os.path.join(directory, "filler"))

# at the making of a slot
board = Whiteboard("early", directory=directory)
other = Whiteboard("early", directory=directory)
large = Slot("large", String, capacity=1 << 20)
there = {Slot(f"s{i}", String, capacity=2000): String("x" * 1900) for i in range(3)}
for slot, message in there.items():
    board.add_message(slot, message)
board[large]
reserved = board[Slot("reserved", Int64)]
reserved.reserve()
number = board[Slot("number", Int64)]
number.add(Int64(1))
fill()
made = 0
try:
    for made in range(1000):
        board[Slot(f"more{made}", Int64)]
except BoardFullError as error:
    assert FULL in str(error), error
assert made < 100
check(board), check(other)

def end():  # of what is taken of the file
    with open(board.path, "rb") as file:
        return file.read(48)[40:]

# at the first add of a writer, which needs buffers
taken = end()
refused(lambda: board.add_message(large, String("")))
refused(lambda: other.add_message(large, String("")))
refused(lambda: other.add_message(Slot("s0", String, 2000), String("y")))
refused(board[large].reserve)
assert end() == taken
assert reserved.count == 0
assert reserved.add(Int64(1)) == 1
assert board.get_message(large) is None
check(board), check(other)

# who has its buffers goes on
for slot in there:
    there[slot] = String("z" * 1990)
    board.add_message(slot, there[slot])
check(board), check(other)
for i in range(100):
    assert number.add(Int64(i)) == i + 2

# and all is well once there is room
os.remove(os.path.join(directory, "filler"))
assert board[Slot(f"more{made}", Int64)].add(Int64(5)) == 1
assert other.get_message(Slot(f"more{made}", Int64)) == Int64(5)
assert other.add_message(Slot("s0", String, 2000), String("y")) == 3
assert board.get_message(Slot("s0", String, 2000)) == String("y")
"""


@pytest.fixture(name="small_disk")
def _small_disk(tmp_path: Path) -> Iterator[Path]:
    with small_disk(tmp_path, "128k"):
        yield tmp_path


def test_a_full_file_system(small_disk: Path, run_python: RunPython) -> None:
    # In a process of its own: what this looks for is a death by SIGBUS.
    run_python(SCRIPT, small_disk)
