"""The file of a gusimplewhiteboard, beside a program in C that knows only the documented layout."""

from __future__ import annotations

import os
import struct
import subprocess
from collections.abc import Callable, Iterable
from itertools import repeat
from pathlib import Path

import pytest

from llfsm.bridges.gusimplewhiteboard import GuFileError, GuFormatError, GuWhiteboard
from llfsm.bridges.gusimplewhiteboard.file import RingPosition

from .conftest import change

Native = Callable[..., str]
SIZE = 263712
MAGIC_AT = 263696


def test_a_message_of_theirs_is_read(foreign: GuWhiteboard, native: Native) -> None:
    assert foreign.position(511) == RingPosition(0, 0)
    for count in range(1, 10):
        native("add", 511, count, -count)
        data, mark = foreign.read(511, 16)
        assert struct.unpack("<2d", data) == (count, -count)
        assert mark == foreign.position(511) == RingPosition(count % 4, count)
    assert foreign.position(510) == foreign.position(0) == RingPosition(0, 0)


def test_they_read_a_message_of_ours(foreign: GuWhiteboard, native: Native) -> None:
    for count in range(1, 10):
        mark = foreign.add(7, struct.pack("<3d", count, 0.5, -1))
        assert mark == foreign.position(7)
        assert native("get", 7, 3) == f"{count} 0.5 -1 of {count}\n"


def test_adds_of_both_take_turns(foreign: GuWhiteboard, native: Native) -> None:
    for count in range(1, 12, 2):
        foreign.add(3, struct.pack("<d", count))
        native("add", 3, count + 1)
        data, mark = foreign.read(3, 8)
        assert struct.unpack("<d", data) == (count + 1,)
        assert mark.counter == count + 1


def test_the_bytes_are_where_the_documents_say(foreign: GuWhiteboard, path: Path) -> None:
    before = path.read_bytes()
    foreign.add(100, b"hello")
    after = path.read_bytes()
    changed = {at for at in range(SIZE) if before[at] != after[at]}
    message = 1552 + (100 * 4 + 1) * 128
    assert changed == {4 + 100, 516 + 2 * 100, *range(message, message + 5)}


def test_the_counter_wraps(foreign: GuWhiteboard, path: Path) -> None:
    with path.open("r+b") as file:
        file.seek(516 + 2 * 9)
        file.write(b"\xff\xff")
    assert foreign.add(9, b"x") == RingPosition(1, 0) == foreign.position(9)
    assert foreign.read(9, 1) == (b"x", RingPosition(1, 0))


def test_a_wrong_generation_is_read_as_the_first(foreign: GuWhiteboard, path: Path) -> None:
    with path.open("r+b") as file:
        file.seek(4 + 9)
        file.write(b"\xff")
        file.seek(1552 + 9 * 4 * 128)
        file.write(b"first")
    assert foreign.read(9, 5) == (b"first", RingPosition(255, 0))


def test_no_copy_is_torn(
    foreign: GuWhiteboard, native_program: Path, native: Native, path: Path
) -> None:
    """Beside a writer that never pauses, each message that is read is one that was written."""
    with subprocess.Popen(
        [native_program, path, "flood", "5"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as flood:
        assert flood.stdin is not None
        assert flood.stdout is not None
        flood.stdout.readline()
        whole = 0
        for _ in range(20_000):
            found = foreign.read(5, 128)
            if found is not None:
                words = struct.unpack("<16Q", found[0])
                assert len(set(words)) == 1
                whole += words[0] > 0
        flood.stdin.close()
    found = foreign.read(5, 128)
    assert found is not None
    assert len(set(struct.unpack("<16Q", found[0]))) == 1
    assert found[1] == foreign.position(5)


class BusyWriter(GuWhiteboard):
    """A gusimplewhiteboard in which a writer adds so many messages during each copy."""

    def __init__(self, writer: GuWhiteboard, adds: Iterable[int]) -> None:
        super().__init__(writer.path)
        self._writer = writer
        self._adds = iter(adds)

    def message_bytes(self, number: int, generation: int, size: int) -> memoryview:
        data = bytes(super().message_bytes(number, generation, size))
        for _ in range(next(self._adds)):
            self._writer.add(number, b"other")
        return memoryview(data)


def test_a_copy_is_refused_if_the_writer_may_have_come_round(foreign: GuWhiteboard) -> None:
    """With one message during the copy it is whole; with two the third may have been begun."""
    foreign.add(5, b"first")
    found = BusyWriter(foreign, [2, 2, 1]).read(5, 5)
    assert found == (b"other", RingPosition((1 + 4) % 4, 5))
    assert foreign.position(5) == RingPosition((1 + 5) % 4, 6)


def test_a_read_gives_up_at_last(foreign: GuWhiteboard) -> None:
    assert BusyWriter(foreign, repeat(2)).read(5, 5) is None


# ---- What is refused ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("damage", "what"),
    [
        (lambda path: change(path, 0, b"\x06\x00"), "this is version 6 of a gusimplewhiteboard"),
        (lambda path: change(path, MAGIC_AT, b"\x00" * 8), "its magic number is 0x0, not 0xfeed"),
        (
            lambda path: change(path, MAGIC_AT, bytes.fromhex("feeda11deadbeef6")),
            "big-endian machine",
        ),
        (lambda path: path.write_bytes(bytes(SIZE)), "it is empty"),
        (lambda path: os.truncate(path, SIZE - 1), "263711 bytes, .* version 2207 has 263712"),
        (lambda path: os.truncate(path, 0), "0 bytes"),
        (lambda path: path.write_bytes(bytes(2 * SIZE)), f"{2 * SIZE} bytes"),
    ],
    ids=["version", "magic", "byte order", "fresh", "short", "empty", "long"],
)
def test_another_format(
    native: Native, path: Path, damage: Callable[[Path], object], what: str
) -> None:
    damage(path)
    before = path.read_bytes()
    with pytest.raises(GuFormatError, match=rf"guwhiteboard: .*{what}"):
        GuWhiteboard(path)
    assert path.read_bytes() == before


def test_no_file(path: Path) -> None:
    with pytest.raises(GuFileError, match="no such file; start the process"):
        GuWhiteboard(path)
    path.mkdir()
    with pytest.raises(GuFileError, match="Is a directory"):
        GuWhiteboard(path)
    path.rmdir()
    os.mkfifo(path)
    with pytest.raises(GuFormatError, match="0 bytes"):
        GuWhiteboard(path)


def test_a_file_that_was_replaced_is_no_longer_there(foreign: GuWhiteboard, path: Path) -> None:
    assert foreign.is_there
    data = path.read_bytes()
    path.unlink()
    assert not foreign.is_there
    path.write_bytes(data)
    assert not foreign.is_there
