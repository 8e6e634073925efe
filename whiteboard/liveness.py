"""Find out whether a process still runs, by a message that it has left.

A process id is not enough: the system reuses ids, and each container counts its own. So a process
is named by its id, the time at which it started, its host and its PID namespace. One that cannot be
looked up, as it is elsewhere, is judged by the age of its messages, by whoever reads them.
"""

from __future__ import annotations

import os
import socket
import time
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from llfsm.whiteboard.slots import Sample


@cache
def host_name() -> str:
    """Return this host's name in its network."""
    return socket.gethostname()


@cache
def pid_namespace() -> int:
    """Return the number of the PID namespace in which this process looks up other processes."""
    try:
        return os.stat("/proc/self/ns/pid").st_ino
    except OSError:  # not Linux
        return 0


class Process(Protocol):
    """Names a process of any host; messages that processes leave have these fields."""

    @property
    def pid(self) -> int:
        """Its id in its PID namespace."""

    @property
    def born(self) -> int:
        """The time at which it started, as from `born`."""

    @property
    def host(self) -> str:
        """The name of its host."""

    @property
    def namespace(self) -> int:
        """The number of its PID namespace."""


def identity(process: Process) -> tuple[str, int, int, int]:
    """Return a key that no other process has: containers may share a host's name and ids."""
    return process.host, process.namespace, process.pid, process.born


def is_local(process: Process) -> bool:
    """Check that this process can look the other one up: on this host, in this PID namespace."""
    return process.host == host_name() and process.namespace == pid_namespace()


def this_process() -> tuple[int, int, str, int]:
    """Return this process's id, start, host and namespace, in the order of fields of messages."""
    pid = os.getpid()
    return pid, born(pid), host_name(), pid_namespace()


def process_text(process: Process, word: str = "pid") -> str:
    """Describe a process for people: its id after `word`, and its place if that is not here."""
    if is_local(process):
        return f"{word} {process.pid}"
    here = process.host == host_name()
    return f"{word} {process.pid} {'in another PID namespace' if here else f'on {process.host}'}"


def born(pid: int) -> int:
    """Look up the start of a process, in clock ticks since boot; 0 if it does not run."""
    return _own_start(pid) if pid == os.getpid() else _look_up(pid)


def _look_up(pid: int) -> int:
    state, *fields = _fields(pid)
    return 0 if state == b"Z" else int(fields[18])


class Program:
    """The place where a process's stack begins: it changes when it executes another program.

    The file in which the system says it stays open, as opening it costs most of a look. It is that
    of this process only, also when another one has its id.
    """

    def __init__(self, pid: int) -> None:
        self._file: int | None = None
        with suppress(OSError, OverflowError):  # no such process, or too many files
            self._file = os.open(f"/proc/{pid}/stat", os.O_RDONLY | os.O_CLOEXEC)

    def look(self) -> int:
        """Look it up; 0 for a process that does not run, and for those of other users."""
        data = b""
        if self._file is not None:
            with suppress(OSError):  # it has ended
                data = os.pread(self._file, 4096, 0)
        return int(_parsed(data)[25])

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def _fields(pid: int) -> list[bytes]:
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            return _parsed(file.read())
    except OSError:
        return _parsed(b"")


def _parsed(stat: bytes) -> list[bytes]:
    """Split the system's line about a process, from the third field on: its state.

    The start time is the 22nd, the start of the stack the 28th; all are 0 if it does not run.
    """
    # The second field is the name, in parentheses, which may contain anything.
    return stat.rpartition(b")")[2].split() or [b"0"] * 26


_own_start = cache(_look_up)  # a process asks for its own at each claim of a slot
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_own_start.cache_clear)  # whose id an ancestor may have had


def lives(pid: int, started: int) -> bool:
    """Check that the process that started at `started` (see `born`) still runs."""
    return started != 0 and born(pid) == started


def is_alive(process: Process, *, elsewhere: bool) -> bool:
    """Check that a process still runs; `elsewhere` is the answer where it cannot be looked up.

    That is on another host, and in another PID namespace, as of a container. The caller decides it
    by what else it knows, such as the age of the process's latest message.
    """
    if is_local(process):
        return lives(process.pid, process.born)
    return elsewhere and process.born != 0


def writer_lives(sample: Sample[Any], *, surely: bool = False) -> bool:
    """Check that the process that added a message still runs.

    A process with the same id that started after the message was added is a different one. Starts
    are known to a tick of ten milliseconds: one in the same tick counts, unless it must `surely` be
    the one.
    """
    started = born(sample.writer)
    if started == 0:
        return False
    ticks_per_s = os.sysconf("SC_CLK_TCK")  # here, as Windows has no such function
    # Start times include the time in which the host was suspended, stamps do not.
    suspended_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()
    return (started + surely) * 1_000_000_000 // ticks_per_s <= sample.stamp_ns + suspended_ns
