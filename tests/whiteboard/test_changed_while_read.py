"""A board whose file another process changes while it is read: an error, never foreign memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from llfsm.whiteboard import Message, Slot, Whiteboard

CAPACITY = 64


class Blob(Message):
    data: bytes = b""


BLOB = Slot("blob", Blob, CAPACITY)

# Flip one field of the record between its value and another, until the input is closed. Then leave
# it as it was. `random` changes any word of the record and of the buffers instead.
FLIPPER = """
import mmap, os, random, select, struct, sys
path, place, size, other = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
with open(path, "r+b") as file:
    os.truncate(path, max(1 << 20, os.path.getsize(path)))
    board = mmap.mmap(file.fileno(), 0)
good = board[place : place + size]
begin, end = place, place + size
print("flips", flush=True)
while not select.select([0], [], [], 0)[0]:
    for _ in range(500):
        if other == "random":
            begin = random.randrange(place, place + size) // 8 * 8
            end = begin + 8
            before = board[begin:end]
            board[begin:end] = random.choice([os.urandom(8), bytes(8), b"\\xff" * 8])
            board[begin:end] = before
        else:
            board[begin:end] = int(other, 0).to_bytes(size, "little")
            board[begin:end] = good
"""

READER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from test_changed_while_read import BLOB, CAPACITY, Blob
from llfsm.whiteboard import Slot, Whiteboard, WhiteboardError
path, errors = Path(sys.argv[1]), 0
with Whiteboard(path.name.removeprefix("llfsm."), directory=path.parent, create=False) as board:
    handle = board[BLOB]
    print("reads", flush=True)
    sys.stdin.readline()
    for number in range(4_000):
        for look in (
            lambda: [len(info.type_name) for info in board.slots()],
            lambda: [len((board.publisher(Slot("blob", Blob, CAPACITY)).get() or Blob()).data)],
            lambda: [len((handle.get() or Blob()).data)],
            lambda: [handle.add(Blob(b"x" * (number % 40))) * 0],
        ):
            try:
                assert all(length <= 255 for length in look())
            except WhiteboardError:
                errors += 1
print("whole", errors)
"""


def place_of(path: Path) -> tuple[int, int]:
    """Find the record of the only slot, and the end of its buffers, by its magic number."""
    data = path.read_bytes()
    with Whiteboard(path.name.removeprefix("llfsm."), directory=path.parent) as board:
        assert [info.name for info in board.slots()] == ["blob"]
    at = data.index((CAPACITY).to_bytes(8, "little") + BLOB.fingerprint.to_bytes(8, "little")) - 16
    return at, len(data) // 8 * 8


@pytest.mark.parametrize(
    ("field", "size", "other"),
    [
        ("size", 8, "0xffffffffffff"),
        ("capacity", 8, str(2**63 + 96)),
        ("capacity", 8, "1000000"),
        ("type_length", 4, "0xffffffff"),
        ("type_length", 4, "255"),
        ("schema_length", 4, "0xfffff"),
        ("all", 0, "random"),
    ],
)
def test_no_reader_sees_more_than_its_slot(
    tmp_path: Path, field: str, size: int, other: str
) -> None:
    with Whiteboard("flipped", directory=tmp_path) as board:
        board.add_message(BLOB, Blob(b"x" * 20))
        path = board.path
        at, end = place_of(path)
        offset = {"size": 8, "capacity": 16, "type_length": 32, "schema_length": 36}.get(field, 0)
        size = size or end - at
        with subprocess.Popen(
            [sys.executable, "-c", READER, str(path), str(Path(__file__).parent)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as reader:
            assert reader.stdout is not None
            assert reader.stdout.readline() == "reads\n"
            with subprocess.Popen(
                [sys.executable, "-c", FLIPPER, str(path), str(at + offset), str(size), other],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            ) as flipper:
                assert flipper.stdout is not None
                assert flipper.stdout.readline() == "flips\n"
                output, _ = reader.communicate("go\n")
                flipper.communicate("")
        assert (reader.returncode, output.split()[:1]) == (0, ["whole"])
