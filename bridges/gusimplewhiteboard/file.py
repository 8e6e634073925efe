"""A gusimplewhiteboard of version 2207: a file that its processes map, without any lock.

It has 512 numbered types of messages, each with a ring of four generations of 128 bytes. Whoever
adds fills the generation after the current one, then makes it the current one, then counts. There
must be one writer a type; readers may be many.

A reader that copies a generation is safe until the writer comes round to it, three messages later.
How many came meanwhile, the counter tells, at most one too few: so a copy is whole if the counter
has gone on by one at most. (This asks that a processor's stores are seen in their order, as the
format itself does: x86-64 grants it.)
"""

from __future__ import annotations

import ctypes
import mmap
import os
from pathlib import Path
from typing import NamedTuple

from .errors import GuFileError, GuFormatError

__all__ = ["DEFAULT_PATH", "MESSAGE_SIZE", "TYPES", "GuWhiteboard", "RingPosition"]

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
    """Where a type stands: it changes with every message added."""

    generation: int
    """The current one's number."""
    counter: int
    """Messages added, modulo 2**16."""


class GuWhiteboard:
    """A live gusimplewhiteboard; raise :class:`.GuFileError` if there is none at `path`."""

    def __init__(self, path: str | os.PathLike[str] = DEFAULT_PATH) -> None:
        self.path = Path(path)
        try:
            fd = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)
        except FileNotFoundError:
            raise GuFileError(
                f"{path}: no such file; start what makes the gusimplewhiteboard, or name its file"
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
            what = "nothing was written to it yet; start what makes the gusimplewhiteboard first"
        elif magic != _MAGIC:
            what = f"this is no gusimplewhiteboard: its magic number is {magic:#x}, not {_MAGIC:#x}"
        elif version != _VERSION:
            what = f"this is version {version} of a gusimplewhiteboard; {_VERSION} is supported"
        else:
            return
        raise GuFormatError(f"{self.path}: {what}")

    def close(self) -> None:
        """Let go of the file."""
        del self._file  # which refers to the mapping
        self._map.close()

    @property
    def is_there(self) -> bool:
        """False once the file was removed or replaced: then others no longer see what we do."""
        try:
            return os.path.samestat(self.path.stat(), self._status)
        except OSError:
            return False

    def position(self, number: int) -> RingPosition:
        """Tell where a type stands."""
        return RingPosition(self._file.indexes[number], self._file.event_counters[number])

    def read(self, number: int, size: int) -> tuple[bytes, RingPosition] | None:
        """Copy the current message's first bytes, whole, and tell where the type stood with it.

        None if its writer was so fast that no copy was whole: the next look may be luckier.
        """
        for _ in range(_TRIES):
            counter = self._file.event_counters[number]
            generation = self._file.indexes[number]
            data = bytes(self._bytes(number, generation, size))
            after = self.position(number)
            if (after.counter - counter) % 2**16 <= 1:
                return data, after if after[0] == generation else RingPosition(generation, counter)
        return None

    def add(self, number: int, data: bytes) -> RingPosition:
        """Add a message; bytes beyond its end keep what they were. Return where the type stands."""
        generation, counter = self.position(number)
        generation = (generation + 1) % _GENERATIONS
        self._bytes(number, generation, len(data))[:] = data
        self._file.indexes[number] = generation
        self._file.event_counters[number] = counter + 1
        return RingPosition(generation, (counter + 1) % 2**16)

    def _bytes(self, number: int, generation: int, size: int) -> memoryview:
        generation = generation if generation < _GENERATIONS else 0  # as others read a wrong one
        at = _File.messages.offset + (number * _GENERATIONS + generation) * MESSAGE_SIZE
        return memoryview(self._map)[at : at + size]
