"""Messages between a process and those forked from it, over a socket that also carries sockets."""

from __future__ import annotations

import pickle
import socket
import struct
from contextlib import suppress
from typing import Any, Final

__all__ = ["LinkClosedError", "ProcessLink"]

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
