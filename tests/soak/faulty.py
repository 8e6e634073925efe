"""A machine that drives a turtle in a circle until it is asked to fail, in one of many ways."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.std_msgs import String

__all__ = ["CIRCLE", "FAULT", "Drive"]

FAULT = Slot("fault", String)
"""What to do, and the id of the process that is to do it."""
CIRCLE = Twist(linear=Vector3(x=1.0), angular=Vector3(z=1.0))


def _recurse() -> None:
    _recurse()


def _hold() -> None:
    """Hold the interpreter's lock in C."""
    ctypes.PyDLL(None).sleep(60)


def _wait_for_itself() -> None:
    lock = threading.Lock()
    with lock:
        lock.acquire()


def _use_no_memory() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (1 << 26, 1 << 26))
    bytearray(1 << 30)


def _use_no_files() -> None:
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
    open(os.devnull).close()


def _fork_and_die() -> None:
    """Leave a process that has everything open."""
    if os.fork() == 0:
        os.execvp("sleep", ["sleep", "5"])
    os.kill(os.getpid(), signal.SIGKILL)


def _die_in_a_thread() -> None:
    threading.Thread(target=ctypes.string_at, args=(0,)).start()


def _raise(error: type[BaseException]) -> Callable[[], None]:
    def fail() -> None:
        raise error("as it was asked to")

    return fail


DEEDS: dict[str, Callable[[], object]] = {
    "segfault": lambda: ctypes.string_at(0),
    "segfault in a thread": _die_in_a_thread,
    "abort": os.abort,
    "exit 0": lambda: os._exit(0),
    "exit 1": lambda: os._exit(1),
    "sys.exit": lambda: sys.exit(3),
    "raise": _raise(ValueError),
    "interrupt": _raise(KeyboardInterrupt),
    "leave": _raise(GeneratorExit),
    "recursion": _recurse,
    "no memory": _use_no_memory,
    "no files": _use_no_files,
    "exec": lambda: os.execvp("sleep", ["sleep", "5"]),
    "fork": _fork_and_die,
    "loop": lambda: [None for _ in iter(int, 1)],
    "sleep": lambda: threading.Event().wait(60),
    "deadlock": _wait_for_itself,
    "wait for a child": lambda: subprocess.run(["sleep", "5"], check=False),
    "hold the lock": _hold,
}


class Drive(Machine):
    """Drive, and do what is asked."""

    fault = Sensor(FAULT)
    drive = Actuator(Slot("turtle1/cmd_vel", Twist), at_end=Twist(), at_suspend=Twist())
    go, asleep, end = State(final=False), State(suspend=True), State()

    @go.internal
    def _(self) -> None:
        self.drive(CIRCLE)
        deed, _, pid = ("" if self.fault is None else self.fault.data).partition(":")
        if pid == str(os.getpid()) and deed in DEEDS:
            DEEDS[deed]()

    @go.to(end)
    def is_asked_to_end(self) -> bool:
        return self.fault is not None and self.fault.data == f"end:{os.getpid()}"
