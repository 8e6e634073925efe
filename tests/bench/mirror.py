"""From an add on one host to a get on another, beside Zenoh alone from a put to its callback.

Both have two processes with a connection by TCP on this machine between them. The end is when the
message is on the other board, by its stamp there, or when the callback begins: a plain one, as in
Zenoh's own examples. Nobody looks on, as who looks all the time takes a processor from those who
work. One message at a time, of 256 bytes, on an idle board.
"""

from __future__ import annotations

import json
import mmap
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path

from measure import Subject, counts, wait_for

from llfsm.whiteboard import BoundSlot, Message, Slot, Whiteboard

__all__ = ["beside", "samplers", "spaced"]


class Bulk(Message):
    """A message of some size."""

    number: int = 0
    data: bytes = bytes(250)


_BULK = Slot("bulk", Bulk)

_RECEIVER = """
import json, mmap, struct, sys, time, zenoh
with open(sys.argv[2], "r+b") as file:
    shown = mmap.mmap(file.fileno(), 16)
config = zenoh.Config()
for key, value in json.loads(sys.argv[1]).items():
    config.insert_json5(key, json.dumps(value))
with zenoh.open(config) as session:
    def hear(sample):
        now = time.monotonic_ns()
        shown[:] = sample.payload.to_bytes()[:8] + struct.pack("<Q", now)
    subscriber = session.declare_subscriber("bench", hear)
    print("ready", flush=True)
    sys.stdin.read()
"""


def _endpoint() -> str:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


@contextmanager
def _process(*command: str) -> Iterator[None]:
    """Run a process that says when it is ready."""
    with subprocess.Popen(
        [sys.executable, *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        try:
            yield
        finally:
            process.terminate()


def _daemon(folder: str, *options: str) -> AbstractContextManager[None]:
    command = ("-m", "llfsm.cli", "whiteboard", "daemon", "-b", "bench", "--directory")
    return _process(*command, folder, *options)


@contextmanager
def _mirrored() -> Iterator[Callable[[], float]]:
    with ExitStack() as stack:
        folders = [stack.enter_context(tempfile.TemporaryDirectory(dir="/dev/shm")) for _ in "ab"]
        here, there = [
            stack.enter_context(Whiteboard("bench", directory=folder)) for folder in folders
        ]
        here.add_message(_BULK, Bulk())
        endpoint = _endpoint()
        stack.enter_context(_daemon(folders[0], "--listen", endpoint))
        stack.enter_context(_daemon(folders[1], "--listen", _endpoint(), "--connect", endpoint))
        begins, arrives = here[_BULK], there[_BULK]
        wait_for(lambda: arrives.count > 0)

        def sample() -> float:
            before, begin_ns = arrives.count, time.monotonic_ns()
            begins.add(Bulk(before))
            wait_for(lambda: arrives.count > before)
            arrived = arrives.sample()
            assert arrived is not None
            return arrived.stamp_ns - begin_ns

        yield sample


@contextmanager
def _raw() -> Iterator[Callable[[], float]]:
    import zenoh

    with ExitStack() as stack:
        file = stack.enter_context(tempfile.NamedTemporaryFile(dir="/dev/shm"))
        Path(file.name).write_bytes(bytes(16))
        shown = mmap.mmap(file.fileno(), 16)
        endpoint = _endpoint()
        settings = {
            "mode": "peer",
            "scouting/multicast/enabled": False,
            "listen/endpoints": [endpoint],
            "transport/shared_memory/enabled": False,  # not used; the killed one would leave it
        }
        stack.enter_context(_process("-c", _RECEIVER, json.dumps(settings), file.name))
        config = zenoh.Config()
        settings |= {"listen/endpoints": [], "connect/endpoints": [endpoint]}
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        session = stack.enter_context(zenoh.open(config))
        publisher = session.declare_publisher("bench", express=True)
        number = 0

        def sample() -> float:
            nonlocal number
            number += 1
            head = number.to_bytes(8, "little")
            begin_ns = time.monotonic_ns()
            publisher.put(head + bytes(248))
            wait_for(lambda: shown[:8] == head)
            return int.from_bytes(shown[8:], "little") - begin_ns

        def met() -> bool:
            publisher.put(b"\xff" * 8)
            return shown[:8] != bytes(8)

        wait_for(met)
        yield sample


@contextmanager
def beside() -> Iterator[tuple[dict[str, object], dict[str, object]]]:
    """Yield the names `slot` and `message`, of a board with a daemon and of one without."""
    with ExitStack() as stack:
        folders = [stack.enter_context(tempfile.TemporaryDirectory(dir="/dev/shm")) for _ in "ab"]
        boards = [stack.enter_context(Whiteboard("bench", directory=f)) for f in folders]
        # With a host that reads, so that what is added has to leave.
        endpoint, there = _endpoint(), stack.enter_context(tempfile.TemporaryDirectory())
        stack.enter_context(_daemon(folders[0], "--listen", endpoint))
        stack.enter_context(_daemon(there, "--listen", _endpoint(), "--connect", endpoint))
        other = stack.enter_context(Whiteboard("bench", directory=there))
        for board in boards:
            board.add_message(_BULK, Bulk())
        wait_for(lambda: other.get_message(_BULK))
        mirrored, alone = ({"slot": board[_BULK], "message": Bulk()} for board in boards)
        yield mirrored, alone


def used(call: str, names: dict[str, object]) -> Subject:
    """Time a get or an add of the slot."""
    slot = names["slot"]
    assert isinstance(slot, BoundSlot)
    return Subject(call, names, proof=counts(lambda: slot.count, int("add" in call)))


def spaced(names: dict[str, object]) -> Callable[[], float]:
    """Return what times one add: before each, the daemon has had the time to fall asleep.

    It sends every 5 ms at most, and sleeps then for want of anything to send.
    """
    slot, message = names["slot"], names["message"]
    assert isinstance(slot, BoundSlot)

    def sample() -> float:
        time.sleep(0.012)
        begin_ns = time.perf_counter_ns()
        slot.add(message)
        return time.perf_counter_ns() - begin_ns

    return sample


@contextmanager
def samplers() -> Iterator[tuple[Callable[[], float], Callable[[], float]]]:
    """Open both; each call of a sampler sends one message and returns the nanoseconds it took."""
    with _mirrored() as ours, _raw() as theirs:
        yield ours, theirs
