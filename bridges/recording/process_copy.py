"""Whether a process can be copied by a fork, so that the copy can go on as the process would have.

What it has opened since a beginning matters. A regular file is opened anew in the copy, at the
place where it was read or written. A thread, a child process, a connection or memory that is shared
with others cannot be copied.
"""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Final, NamedTuple

__all__ = ["OpenFile", "Origin"]

_FILES: Final = "/proc/self/fd"
_THREADS: Final = "/proc/self/task"
_MEMORY: Final = "/proc/self/maps"


class OpenFile(NamedTuple):
    """A regular file that a process has open."""

    number: int
    flags: int
    offset: int

    def reopen(self) -> None:
        """Open it anew in this process, at the place of then, as the copies share their place."""
        own = os.open(
            f"{_FILES}/{self.number}", self.flags & ~(os.O_CREAT | os.O_EXCL | os.O_TRUNC)
        )
        os.lseek(own, self.offset, os.SEEK_SET)
        os.dup2(own, self.number, inheritable=os.get_inheritable(self.number))
        os.close(own)


class Origin:
    """What this process has at its beginning."""

    def __init__(self) -> None:
        self._opened = {*_opened()}
        self._shared = _shared_memory()

    def files(self) -> list[OpenFile] | None:
        """Return the files opened since; None if the process cannot be copied."""
        if threading.active_count() > 1 or len(os.listdir(_THREADS)) > 1 or _has_children():
            return None
        if not _shared_memory() <= self._shared:
            return None
        found = []
        for number, mode, *file in _opened():
            if (number, mode, *file) in self._opened or stat.S_ISCHR(mode):
                continue
            if not stat.S_ISREG(mode):
                return None
            offset = os.lseek(number, 0, os.SEEK_CUR)
            found.append(OpenFile(number, _flags(number), offset))
        return found


def _opened() -> Iterator[tuple[int, int, int, int]]:
    """Return what identifies open files, connections and the like."""
    for name in os.listdir(_FILES):
        with suppress(OSError):  # what has listed them is closed
            status = os.fstat(int(name))
            yield int(name), status.st_mode, status.st_dev, status.st_ino


def _flags(number: int) -> int:
    import fcntl  # which Windows lacks

    return fcntl.fcntl(number, fcntl.F_GETFL)


def _has_children() -> bool:
    with suppress(ChildProcessError):
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        return True
    return False


def _shared_memory() -> set[str]:
    """Return the places of memory that others can write to."""
    with open(_MEMORY) as file:
        return {line.split()[0] for line in file if line.split()[1][1::2] == "ws"}
