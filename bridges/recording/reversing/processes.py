"""Forks that go on as their process would have, and the links between them.

A fork has all of its process but threads, so a checkpoint holds whatever machines' code did. What
the process has opened since its beginning decides whether that is so: a regular file is opened
anew in the fork, at the offset of then; a thread, a child process, a connection or memory that is
shared with others cannot be copied, and no checkpoint is taken.

A link to a fork is a socket: it carries the ends of other links, too, and can be looked at for a
sign without waiting, in the handler of a signal.
"""

from __future__ import annotations

import os
import socket
import stat
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final, NamedTuple

from llfsm.runtime.worker import SIGN, Link, LinkClosedError, framed

_FILES: Final = "/proc/self/fd"
_THREADS: Final = "/proc/self/task"
_MEMORY: Final = "/proc/self/maps"


class OpenFile(NamedTuple):
    """A regular file that a process has open."""

    number: int
    flags: int
    offset: int

    def reopen(self) -> None:
        """Open it anew in this process, at the offset of then: forks share one offset."""
        own = os.open(
            f"{_FILES}/{self.number}", self.flags & ~(os.O_CREAT | os.O_EXCL | os.O_TRUNC)
        )
        os.lseek(own, self.offset, os.SEEK_SET)
        os.dup2(own, self.number, inheritable=os.get_inheritable(self.number))
        os.close(own)


class Origin:
    """The files and shared memory that this process has at its beginning."""

    def __init__(self) -> None:
        self._opened = {*_opened()}
        self._shared = _shared_memory()

    def files(self) -> list[OpenFile] | None:
        """Return the files opened since; None if a fork could not go on as this process would."""
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
    """Yield what identifies open files, connections and the like: number, mode, device, inode."""
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
    """Return the addresses of memory that others can write to."""
    with open(_MEMORY) as file:
        return {line.split()[0] for line in file if line.split()[1][1::2] == "ws"}


class SocketLink(Link):
    """One end of a connection to another process of this program."""

    def __init__(self, end: socket.socket):
        self._end = end
        self._is_receiving = False
        self._links: list[SocketLink] = []  # that came with what was read

    @classmethod
    def pair(cls) -> tuple[SocketLink, SocketLink]:
        """Return both ends of a new connection."""
        ours, theirs = socket.socketpair()
        return cls(ours), cls(theirs)

    def fileno(self) -> int:
        """Return the number of its file."""
        return self._end.fileno()

    def close(self) -> None:
        """Close this end, in this process."""
        self._end.close()

    def send_with(self, message: object, link: SocketLink) -> None:
        """Send a message, and with it the end of another link, which stays open here, too.

        Raise `LinkClosedError`.
        """
        data = framed(message)
        try:
            socket.send_fds(self._end, [data[:1]], [link.fileno()])
            self._end.sendall(data[1:])
        except OSError as error:
            raise LinkClosedError from error

    def receive(self) -> Any:
        """Wait for a message and return it; raise `LinkClosedError`."""
        self._is_receiving = True
        try:
            return super().receive()
        finally:
            self._is_receiving = False

    def receive_with(self) -> tuple[Any, SocketLink | None]:
        """Wait for a message; return it with the link that came with it, if one did."""
        message = self.receive()
        return message, self._links.pop() if self._links else None

    def interrupt(self) -> None:
        """Send a sign: the other end is to pause at once."""
        with suppress(OSError):  # whoever receives finds that it is closed
            self._end.sendall(SIGN)

    def interrupted(self) -> bool:
        """Take a sign if one has come, without waiting; raise `LinkClosedError`.

        A signal's handler may call it, also while this process receives: that skips signs itself.
        """
        if self._is_receiving:
            return False
        try:
            head = self._end.recv(len(SIGN), socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:
            return False
        except OSError as error:
            raise LinkClosedError from error
        if not head:
            raise LinkClosedError
        if head != SIGN:
            return False
        self._exactly(len(SIGN))
        return True

    def _read(self, size: int) -> bytes:
        data, numbers, _, _ = socket.recv_fds(self._end, size, 1)
        self._links += [SocketLink(socket.socket(fileno=number)) for number in numbers]
        return data

    def _write(self, data: bytes) -> None:
        self._end.sendall(data)
