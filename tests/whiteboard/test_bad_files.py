"""A damaged or truncated file gives an error of ours: no crash, no hang, no surprise."""

from __future__ import annotations

import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from llfsm.whiteboard import BoardCorruptError, BoardPermissionError, Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Vector3
from llfsm.whiteboard.messages.std_msgs import Int64, String

# Where things are, by llfsm_whiteboard.h.
END, LOCKS, SLOTS = 40, 128, 448
HEADER = SLOTS + 8 * 4096
WORD, BLOCKS, NAME = 64, 128, 128 + 8 * 256  # of a slot record
RECORD = NAME + 256  # its texts follow
BLOCK, BUFFER, BUFFERS = 64, 32, 4

Overwrite = tuple[int, bytes]
Damage = Overwrite | tuple[int, None]
"""Bytes to put at an offset; None to cut the file there."""

PROBER = """
import signal, sys
from pathlib import Path
from llfsm.whiteboard import Slot, Whiteboard, WhiteboardError
from llfsm.whiteboard.messages.geometry_msgs import Vector3
from llfsm.whiteboard.messages.std_msgs import Int64, String
from llfsm.whiteboard.shared import boards

directory = Path(sys.argv[1])
path, sound = directory / "llfsm.bad", (directory / "sound").read_bytes()
MESSAGES = {
    Slot("number", Int64): Int64(-5),
    Slot("place", Vector3): Vector3(1.0, 2.0, 3.0),
    Slot("empty", String): String("first"),
    Slot("new", String): String("new"),
}
met = set()

def attempt(action):
    try:
        return action()
    except WhiteboardError as error:
        assert str(error)
        met.add(type(error).__name__)

def use(board):
    attempt(board.slots)
    for slot, message in MESSAGES.items():
        bound = attempt(lambda: board[slot])
        if bound is None:
            continue
        attempt(bound.get)
        attempt(bound.sample)
        attempt(lambda: bound.wait(after=0, timeout=0))
        count = attempt(lambda: bound.add(message))
        if count is not None and (sample := attempt(bound.sample)) is not None:
            assert sample[:2] == (message, count), (slot, sample, count)
    attempt(board.slots)

for line in sys.stdin:
    offset, data = line.split()
    offset = int(offset)
    if data == "cut":
        path.write_bytes(sound[:offset])
    else:
        data = bytes.fromhex(data)
        path.write_bytes(sound[:offset] + data + sound[offset + len(data):])
    signal.alarm(20)  # a hang, also one in C, becomes a death by SIGALRM
    try:
        if (board := attempt(lambda: Whiteboard("bad", directory=directory))) is not None:
            use(board)
            board.close()
        boards(directory)
        print("good", flush=True)
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", flush=True)
    signal.alarm(0)
print(*met)
"""


@pytest.fixture
def directory() -> Iterator[Path]:
    """Return a temporary directory in memory: the tests write thousands of files."""
    with tempfile.TemporaryDirectory(prefix="llfsm-test-", dir="/dev/shm") as name:
        yield Path(name)


@pytest.fixture
def sound(directory: Path) -> bytes:
    """Make a board that two writers have used, and return its file's bytes."""
    number, place = Slot("number", Int64, 16), Slot("place", Vector3, 40)
    with (
        Whiteboard("sound", directory=directory) as one,
        Whiteboard("sound", directory=directory) as two,
    ):
        for i in range(3):
            one.add_message(number, Int64(i))
            two.add_message(number, Int64(100 + i))
            two.add_message(place, Vector3(float(i)))
        one[Slot("empty", String, 24)]
        one.path.rename(directory / "sound")
    data = (directory / "sound").read_bytes()
    assert data.startswith(b"LLWBOARD")
    assert data[get(data, SLOTS) :].startswith(b"LLWBSLOT")
    assert data[get(data, get(data, SLOTS) + BLOCKS) :].startswith(b"LLWBBLCK")
    return data


def get(data: bytes, offset: int) -> int:
    return int(struct.unpack_from("<Q", data, offset)[0])


def put(offset: int, value: int) -> Overwrite:
    return offset, struct.pack("<Q", value % 2**64)


def flips(sound: bytes, offsets: Iterable[int]) -> Iterator[Overwrite]:
    for offset in sorted(set(offsets)):
        for mask in (0x01, 0x80, 0xFF):
            yield offset, bytes([sound[offset] ^ mask])


def probe(directory: Path, damages: Iterable[Damage]) -> set[str]:
    """Let a process meet each damage, and another one go on if it dies; return what it raised."""
    bad, met = [], set()
    pending = list(damages)[::-1]
    while pending:
        with subprocess.Popen(
            [sys.executable, "-c", PROBER, str(directory)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            answer = "good\n"
            while pending and answer:
                offset, data = pending.pop()
                damage = f"{offset} {'cut' if data is None else data.hex()}"
                process.stdin.write(damage + "\n")
                answer = process.stdout.readline()
                if answer != "good\n":
                    bad.append((damage, answer or f"ended with {process.wait()}"))
            process.stdin.close()
            met.update(process.stdout.read().split())
    assert bad == []
    return met


def test_damage_in_the_header(sound: bytes, directory: Path) -> None:
    used = [offset for offset in range(HEADER) if sound[offset]]
    met = probe(directory, flips(sound, [*range(LOCKS + 480), *used, HEADER - 8, HEADER - 1]))
    assert met >= {"BoardCorruptError", "BoardPermissionError"}


@pytest.mark.parametrize("slot", [0, 1], ids=["number", "place"])
def test_damage_in_a_slot_record(slot: int, sound: bytes, directory: Path) -> None:
    record = get(sound, SLOTS + 8 * slot)
    texts = range(record + RECORD, record + get(sound, record + 8))
    assert sound[texts.start :].startswith((b"std_msgs/msg/Int64\0{", b"geometry_msgs"))
    assert sound[record + NAME :].startswith((b"number\0", b"place\0"))
    used = [offset for offset in range(record, record + RECORD) if sound[offset]]
    static = range(record, record + BLOCKS + 24)
    met = probe(directory, flips(sound, [*static, *used, *texts]))
    assert met >= {"BoardCorruptError"}


@pytest.mark.parametrize("writer", [0, 1])
def test_damage_in_buffers(writer: int, sound: bytes, directory: Path) -> None:
    block = get(sound, get(sound, SLOTS) + BLOCKS + 8 * writer)
    met = probe(directory, flips(sound, range(block, block + BLOCK + BUFFERS * 64)))
    assert "BoardCorruptError" in met
    assert ("MessageUnreadableError" in met) == (writer == 1)  # who wrote the latest message


def test_offsets_and_words_that_lead_astray(sound: bytes, directory: Path) -> None:
    records = [get(sound, SLOTS + 8 * slot) for slot in range(3)]
    blocks = [get(sound, record + BLOCKS + 8 * writer) for record in records for writer in (0, 1)]
    edges = [0, HEADER, *records, *blocks, get(sound, END), len(sound)]
    edges += [1 << bits for bits in (12, 20, 31, 32, 40, 45, 46, 47, 63)] + [-1]
    offsets = {edge + extra for edge in edges for extra in (-64, -8, -1, 0, 1, 8, 64)}
    places = [END, SLOTS, SLOTS + 16, SLOTS + 24, records[0] + BLOCKS, records[0] + BLOCKS + 8]
    damages = [put(place, offset) for place in places for offset in offsets]
    for count in (0, 1, 6, 2**47, 2**48 - 1):
        for writer in (0, 1, 2, 255, 256, 4095):
            for buffer in (0, 3, 4, 15):
                damages.append(put(records[0] + WORD, count << 16 | writer << 4 | buffer))
    assert "BoardCorruptError" in probe(directory, damages)


def test_an_offset_to_the_wrong_place_is_noticed_at_the_opening(
    sound: bytes, directory: Path
) -> None:
    number, place = get(sound, SLOTS), get(sound, SLOTS + 8)
    mine, others = get(sound, number + BLOCKS), get(sound, number + BLOCKS + 8)
    elsewhere, end = get(sound, place + BLOCKS + 8), get(sound, END)
    path = directory / "llfsm.astray"
    for offset, data in [
        put(END, HEADER),  # the next record would overwrite another
        put(END, end - 64),
        put(END, end + 8),
        put(SLOTS, mine),
        put(SLOTS, number + 64),
        put(SLOTS + 8, end),
        put(number + BLOCKS, others),
        put(number + BLOCKS + 8, elsewhere),
        put(number + BLOCKS, place),
        put(number + BLOCKS + 16, mine),
    ]:
        path.write_bytes(sound[:offset] + data + sound[offset + len(data) :])
        with pytest.raises(BoardCorruptError):
            Whiteboard("astray", directory=directory)


def test_truncation(sound: bytes, directory: Path) -> None:
    records = [get(sound, SLOTS + 8 * slot) for slot in range(3)]
    block = get(sound, records[0] + BLOCKS)
    edges = {0, 8, 32, END, LOCKS, SLOTS, HEADER, get(sound, END), len(sound)}
    edges.update(range(0, len(sound), 4096))
    for record in records:
        edges |= {record, record + WORD, record + BLOCKS, record + RECORD}
        edges.add(record + get(sound, record + 8))
    edges |= {block + size for size in (0, 32, BLOCK, BLOCK + BUFFER, BLOCK + BUFFERS * 64)}
    lengths = {edge + extra for edge in edges for extra in (-8, -1, 0, 1, 8)}
    met = probe(directory, [(n, None) for n in sorted(lengths) if 0 <= n <= len(sound)])
    assert met >= {"BoardCorruptError", "BoardPermissionError"}


@pytest.mark.parametrize("byte", [b"\0", b"\xff", b"a"])
def test_noise(byte: bytes, sound: bytes, directory: Path) -> None:
    path = directory / "llfsm.noise"
    path.write_bytes(byte * len(sound))
    with pytest.raises(BoardPermissionError, match=r"llfsm\.noise: not a whiteboard of this user"):
        Whiteboard("noise", directory=directory)
    path.write_bytes(sound[:8] + byte * (len(sound) - 8))
    with pytest.raises(BoardCorruptError, match=r"llfsm\.noise: damaged; end its processes"):
        Whiteboard("noise", directory=directory)
