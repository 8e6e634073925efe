"""Another process that is asked: methods of an object there are called from here.

Code of machines may run for ever or end its process, a module can be imported anew in a new process
only, and a moment of machines lasts only in a fork of their process. All of these are asked alike:

* A message is a pickle behind its length. An empty one is no message, but a sign to pause, for
  processes that look for one while they work. Both ends are the same program of the same user.
* A call is the name of a method with its arguments. The answer is what the method returned, or the
  exception that it raised, which is raised again here.
* The end of the stream is the end of the process at its other end. So a worker ends with the
  process that started it, whatever its code does at that time.

A :class:`Worker` is a new interpreter behind pipes, which every system has. The processes of
:mod:`llfsm.bridges.recording.reversing` are forks; their links are sockets, which can be sent, too.
"""

from __future__ import annotations

import os
import pickle
import queue
import struct
import subprocess
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import IO, Any, Final, Self

from llfsm.errors import LlfsmError

_SIZE: Final = struct.Struct("<I")
SIGN: Final = _SIZE.pack(0)
"""The message without content."""


class LinkClosedError(Exception):
    """The process at the other end has ended."""


class WorkerError(LlfsmError):
    """A worker has ended, or was ended because its code did not return."""


class Link(ABC):
    """One end of a connection to another process."""

    @abstractmethod
    def _read(self, size: int) -> bytes:
        """Wait for at most so many bytes; return none at the end."""

    @abstractmethod
    def _write(self, data: bytes) -> None:
        """Send all of these bytes."""

    def send(self, message: object) -> None:
        """Send a message; raise `LinkClosedError`."""
        try:
            self._write(framed(message))
        except OSError as error:
            raise LinkClosedError from error

    def receive(self) -> Any:
        """Wait for a message and return it; raise `LinkClosedError`.

        Signs are skipped: a process that waits here is paused.
        """
        try:
            while (head := self._exactly(_SIZE.size)) == SIGN:
                pass
            return pickle.loads(self._exactly(*_SIZE.unpack(head)))
        except OSError as error:
            raise LinkClosedError from error

    def _exactly(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            part = self._read(size - len(data))
            if not part:
                raise LinkClosedError
            data += part
        return bytes(data)


def framed(message: object) -> bytes:
    """Return a message as it is sent."""
    data = pickle.dumps(message)
    return _SIZE.pack(len(data)) + data


def call(target: object, name: str, *arguments: Any) -> Any:
    """Call a method, and return its result as it can be sent: of an iterator, a list."""
    found = getattr(target, name)(*arguments)
    return [*found] if isinstance(found, Iterator) else found


def sendable(error: Exception) -> Exception:
    """Return an error, or one with its text if it cannot be made again from its arguments."""
    with suppress(Exception):
        if str(pickle.loads(pickle.dumps(error))) == str(error):
            return error
    return LlfsmError(str(error))


class Worker:
    """A new process, for the object that `make` is to make there.

    `doing` says in errors what its code does, as "importing lamp". Nothing that the code prints is
    an answer: it goes to standard error. Leaving the ``with`` block ends the process.
    """

    def __init__(self, doing: str):
        self._doing = doing
        self._process = subprocess.Popen(
            # -B: no compiled files beside those that are being edited
            [sys.executable, "-B", "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._link = _Pipes(self._process.stdout, self._process.stdin)
        self._is_late = False
        self.has_ended = False
        """True once the process was killed or found to have ended."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def make(self, make: Callable[..., object], *arguments: Any, patience_s: float) -> None:
        """Make the object whose methods are called; raise as `call` does.

        `make` is found in the process by its module and name, as pickles find it.
        """
        self._ask((make, *arguments), patience_s)

    def call(self, name: str, *arguments: Any, patience_s: float) -> Any:
        """Call a method of the object there; raise here the `LlfsmError` or `OSError` it raises.

        Raise `WorkerError` if the process has ended, as it does if the call takes longer than
        `patience_s` seconds.
        """
        return self._ask((name, *arguments), patience_s)

    def kill(self) -> None:
        """End the process; a call in another thread raises `WorkerError`."""
        self.has_ended = True
        self._process.kill()

    def close(self) -> None:
        """End the process, and wait until it has ended; no thread may be in a call."""
        self.kill()
        self._process.wait()
        for file in (self._process.stdin, self._process.stdout):
            assert file is not None
            with suppress(OSError):  # what was not sent before it ended
                file.close()

    def _ask(self, message: tuple[Any, ...], patience_s: float) -> Any:
        timer = threading.Timer(patience_s, self._give_up)  # Windows cannot wait for pipes
        timer.start()
        try:
            self._link.send(message)
            answer = self._link.receive()
        except LinkClosedError:
            self.has_ended = True
            late = f"does not return for {patience_s:g} s"
            how = late if self._is_late else "has ended its process"
            raise WorkerError(f"{self._doing} {how}") from None
        finally:
            timer.cancel()
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _give_up(self) -> None:
        self._is_late = True
        self.kill()


class _Pipes(Link):
    def __init__(self, reader: IO[bytes], writer: IO[bytes]):
        self._reader = reader
        self._writer = writer

    def _read(self, size: int) -> bytes:
        return self._reader.read(size)

    def _write(self, data: bytes) -> None:
        self._writer.write(data)
        self._writer.flush()


def _serve() -> None:
    """Answer the process that has started this one, until that ends."""
    reader, writer = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    link = _Pipes(reader, writer)
    asked: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()

    def read() -> None:
        with suppress(LinkClosedError):
            while True:
                asked.put(link.receive())
        os._exit(0)  # also while machines' code runs in the main thread

    threading.Thread(target=read, daemon=True).start()
    target: object = None
    while True:
        what, *arguments = asked.get()
        answer: object = None
        try:
            if isinstance(what, str):
                answer = call(target, what, *arguments)
            else:
                target = what(*arguments)
        except (LlfsmError, OSError) as error:  # any other is a fault of this program
            answer = sendable(error)
        link.send(answer)


if __name__ == "__main__":
    _serve()
