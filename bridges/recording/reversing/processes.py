"""Messages between a process and those forked from it, over a socket that also carries sockets.

Whether a process can be copied by a fork, so that the copy can go on as the process would have.

What it has opened since a beginning matters. A regular file is opened anew in the copy, at the
place where it was read or written. A thread, a child process, a connection or memory that is shared
with others cannot be copied.
"""

from __future__ import annotations

import os
import pickle
import socket
import stat
import struct
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final, NamedTuple

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


_HEAD: Final = struct.Struct("<cI")
_MESSAGE, _INTERRUPT = b"m", b"i"


class LinkClosedError(Exception):
    """The process at the other end has ended."""


class ProcessLink:
    """One end of a connection; what is sent is pickled, as both ends are the same program."""

    def __init__(self, end: socket.socket):
        self._end = end
        self._is_receiving = False

    @classmethod
    def pair(cls) -> tuple[ProcessLink, ProcessLink]:
        """Return both ends of a new connection."""
        ours, theirs = socket.socketpair()
        return cls(ours), cls(theirs)

    def fileno(self) -> int:
        """Return the number of its file."""
        return self._end.fileno()

    def close(self) -> None:
        """Close this end, in this process."""
        self._end.close()

    def send(self, message: object, link: ProcessLink | None = None) -> None:
        """Send a message, and with it the end of another connection, which stays open here, too.

        Raise `LinkClosedError`.
        """
        data = pickle.dumps(message)
        head = _HEAD.pack(_MESSAGE, len(data))
        try:
            if link is None:
                self._end.sendall(head + data)
            else:
                socket.send_fds(self._end, [head], [link.fileno()])
                self._end.sendall(data)
        except OSError as error:
            raise LinkClosedError from error

    def interrupt(self) -> None:
        """Let the other end know that it is to pause, at once."""
        with suppress(OSError):  # whoever receives finds that it is closed
            self._end.sendall(_HEAD.pack(_INTERRUPT, 0))

    def receive(self) -> tuple[Any, ProcessLink | None]:
        """Wait for a message, and return it, with a connection's end; raise `LinkClosedError`.

        Interrupts are left out: whoever waits here is paused.
        """
        self._is_receiving = True
        try:
            while True:
                head, numbers, _, _ = socket.recv_fds(self._end, _HEAD.size, 1)
                link = ProcessLink(socket.socket(fileno=numbers[0])) if numbers else None
                kind, size = _HEAD.unpack(head + self._exactly(_HEAD.size - len(head)))
                if kind == _MESSAGE:
                    return pickle.loads(self._exactly(size)), link
        except OSError as error:
            raise LinkClosedError from error
        finally:
            self._is_receiving = False

    def _exactly(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            part = self._end.recv(size - len(data))
            if not part:
                raise LinkClosedError
            data += part
        return bytes(data)

    def interrupted(self) -> bool:
        """Return whether an interrupt has come, without waiting; raise `LinkClosedError`.

        It may be called by a signal's handler, also while this process receives: then it has not.
        """
        if self._is_receiving:
            return False
        try:
            kind = self._end.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:
            return False
        except OSError as error:
            raise LinkClosedError from error
        if not kind:
            raise LinkClosedError
        if kind != _INTERRUPT:
            return False
        self._exactly(_HEAD.size)
        return True
