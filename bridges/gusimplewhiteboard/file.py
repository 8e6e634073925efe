"""A gusimplewhiteboard of version 2207: a file that its processes map, without locks.

It has 512 numbered types of messages, each with a ring of four generations of 128 bytes. A writer
fills the generation after the current one, makes it the current one, then increments the counter.
Each type must have one writer; it may have many readers.

A reader's copy of a generation is safe until the writer reaches that generation again, three
messages later. The counter shows how many were added during the copy, at most one too few: so a
copy is whole if the counter has increased by at most one. (This requires that stores become visible
in their order, as the format itself does; x86-64 guarantees it.)
"""

from __future__ import annotations

import ctypes
import mmap
import os
from pathlib import Path
from typing import NamedTuple

from llfsm.bridges.gusimplewhiteboard.errors import GuFileError, GuFormatError

DEFAULT_PATH = "/tmp/whiteboard"
TYPES = 512
MESSAGE_SIZE = 128
_GENERATIONS = 4
_VERSION = 2207
_MAGIC = 0xFEEDA11DEADBEEF6
_TRIES = 10


class _File(ctypes.LittleEndianStructure):
    _fields_ = (
        ("version", ctypes.c_uint16),
        ("eventcount", ctypes.c_uint16),
        ("indexes", ctypes.c_uint8 * TYPES),
        ("event_counters", ctypes.c_uint16 * TYPES),
        ("_unused", ctypes.c_uint8 * 12),
        ("messages", ctypes.c_uint8 * MESSAGE_SIZE * _GENERATIONS * TYPES),
        ("magic", ctypes.c_uint64),
        ("_unused2", ctypes.c_uint64),
    )


class RingPosition(NamedTuple):
    """The position of a type's writer; it changes with every message added."""

    generation: int
    """The number of the current generation."""
    counter: int
    """Messages added, modulo 2**16."""


class GuWhiteboard:
    """An open gusimplewhiteboard; raise :class:`.GuFileError` if `path` is not one."""

    def __init__(self, path: str | os.PathLike[str] = DEFAULT_PATH) -> None:
        self.path = Path(path)
        try:
            fd = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)
        except FileNotFoundError:
            raise GuFileError(
                f"{path}: no such file; start the process that creates the gusimplewhiteboard, or "
                f"name its file"
            ) from None
        except OSError as error:
            raise GuFileError(f"{path}: {error.strerror}") from error
        try:
            self._status = os.fstat(fd)
            if self._status.st_size != ctypes.sizeof(_File):
                raise GuFormatError(
                    f"{path}: {self._status.st_size} bytes, but a gusimplewhiteboard of version "
                    f"{_VERSION} has {ctypes.sizeof(_File)}"
                )
            self._map = mmap.mmap(fd, ctypes.sizeof(_File))
        finally:
            os.close(fd)
        self._file = _File.from_buffer(self._map)
        try:
            self._check()
        except GuFormatError:
            self.close()
            raise

    def _check(self) -> None:
        version, magic = self._file.version, self._file.magic
        if magic == int.from_bytes(_MAGIC.to_bytes(8, "little"), "big"):
            what = "it was written by a big-endian machine; only little-endian ones are supported"
        elif magic == version == 0:
            what = "it is empty; start the process that creates the gusimplewhiteboard first"
        elif magic != _MAGIC:
            what = f"not a gusimplewhiteboard: its magic number is {magic:#x}, not {_MAGIC:#x}"
        elif version != _VERSION:
            what = f"this is version {version} of a gusimplewhiteboard; {_VERSION} is supported"
        else:
            return
        raise GuFormatError(f"{self.path}: {what}")

    def close(self) -> None:
        """Close the file."""
        del self._file  # which refers to the mapping
        self._map.close()

    @property
    def is_there(self) -> bool:
        """False once the file was removed or replaced, so that other processes use another one."""
        try:
            return os.path.samestat(self.path.stat(), self._status)
        except OSError:
            return False

    def position(self, number: int) -> RingPosition:
        """Return the current position of a type."""
        return RingPosition(self._file.indexes[number], self._file.event_counters[number])

    def read(self, number: int, size: int) -> tuple[bytes, RingPosition] | None:
        """Copy the first bytes of the current message; return them with its position.

        Return None if the writer was so fast that no copy was whole; a later read may succeed.
        """
        for _ in range(_TRIES):
            counter = self._file.event_counters[number]
            generation = self._file.indexes[number]
            data = bytes(self.message_bytes(number, generation, size))
            after = self.position(number)
            if (after.counter - counter) % 2**16 <= 1:
                return data, after if after[0] == generation else RingPosition(generation, counter)
        return None

    def add(self, number: int, data: bytes) -> RingPosition:
        """Add a message and return its position; bytes beyond its end keep their values."""
        generation, counter = self.position(number)
        generation = (generation + 1) % _GENERATIONS
        self.message_bytes(number, generation, len(data))[:] = data
        self._file.indexes[number] = generation
        self._file.event_counters[number] = counter + 1
        return RingPosition(generation, (counter + 1) % 2**16)

    def message_bytes(self, number: int, generation: int, size: int) -> memoryview:
        """Return a view of the first bytes of a generation."""
        generation = generation if generation < _GENERATIONS else 0  # as clfsm reads an invalid one
        at = _File.messages.offset + (number * _GENERATIONS + generation) * MESSAGE_SIZE
        return memoryview(self._map)[at : at + size]
