"""Measure what the ROS 2 bridge adds to Zenoh itself: ten topics at 1 kHz each, in turns.

raw     a Zenoh publisher in one process, Zenoh subscribers in another
in      the same publisher, a bridge, slots: until the message is in its slot
out     slots, a bridge, the same subscribers: until the message is there

Topics take turns, as sensors do: a message each 100 us. Each message carries the time at which it
was made. The exit status is 1 unless every promise is met.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from statistics import median
from struct import unpack_from
from typing import Any, NamedTuple

from measure import Side, wait_for
from table import HEAD, MEDIANS, Row

from llfsm.bridges.ros2.opening import open_router
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.zenoh_transport.endpoints import pack
from llfsm.bridges.ros2.zenoh_transport.graph import data_key
from llfsm.bridges.ros2.zenoh_transport.transport import open_node_session
from llfsm.whiteboard import BoardNotFoundError, Slot, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3

__all__ = ["free_port", "go", "line_of", "ready", "rows", "until_over"]

_TOPICS, _HZ = 10, 1000
_TYPE = "geometry_msgs/msg/Twist"
_GID = b"bench-of-bridges"
_DOMAIN = 77


class Round(NamedTuple):
    """What one round came to, in nanoseconds."""

    latency: float  # the median of all messages
    cpu: float  # of a message, in the process that gets it


class Place(NamedTuple):
    """Where the processes meet."""

    router: str
    board: str
    seconds: float

    def role(self, name: str) -> subprocess.Popen[str]:
        """Start this file as one of the processes."""
        command = [sys.executable, __file__, "--role", name, "--place", json.dumps(self)]
        return subprocess.Popen(command, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def bridge(self, direction: str) -> subprocess.Popen[str]:
        """Start a bridge."""
        relays = [part for n in range(_TOPICS) for part in (direction, f"t{n}:{_TYPE}")]
        where = ["--router", self.router, "--board", self.board, "--domain", str(_DOMAIN)]
        command = [sys.executable, "-m", "llfsm.cli", "bridge", "ros2", "--transport", "zenoh"]
        return subprocess.Popen(
            [*command, *relays, *where, "--quiet"], text=True, stderr=subprocess.PIPE
        )


def _slots(board: Whiteboard) -> list[Any]:
    return [board[Slot(f"t{n}", Twist)] for n in range(_TOPICS)]


def _keys() -> list[str]:
    of = TypeLibrary().message(_TYPE)
    return [data_key(_DOMAIN, f"t{n}", of.dds_name, of.type_hash) for n in range(_TOPICS)]


def _in_turns(seconds: float, send: Callable[[int, Twist], object]) -> None:
    step = 1 / (_HZ * _TOPICS)
    begin = time.monotonic()
    for number in range(int(seconds / step)):
        wait = begin + number * step - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        send(number % _TOPICS, Twist(Vector3(x=float(time.monotonic_ns()))))


def talk(place: Place) -> None:
    """Publish as a ROS node does."""
    session, _ = open_node_session([place.router])
    encode = TypeLibrary().message(_TYPE).encode
    publishers = [session.declare_publisher(key) for key in _keys()]
    ready()

    def send(topic: int, twist: Twist) -> None:
        publishers[topic].put(encode(twist), attachment=pack(1, time.time_ns(), _GID))

    _in_turns(place.seconds, send)
    session.close()


def write(place: Place) -> None:
    """Add to slots, as machines do."""
    with Whiteboard(place.board) as board:
        slots = _slots(board)
        ready()
        _in_turns(place.seconds, lambda topic, twist: slots[topic].add(twist))


def hear(place: Place) -> None:
    """Subscribe without llfsm, and look at nothing but the time in each message."""
    session, _ = open_node_session([place.router])
    latencies: list[float] = []

    def on_sample(sample: Any) -> None:
        data = sample.payload.to_bytes()
        latencies.append(time.monotonic_ns() - unpack_from("<d", data, 4)[0])

    subscribers = [session.declare_subscriber(key, on_sample) for key in _keys()]
    ready()
    before = time.process_time_ns()
    sys.stdin.readline()
    wait_for(lambda: latencies)
    used = time.process_time_ns() - before
    print(json.dumps([median(latencies), used / len(latencies)]), flush=True)
    del subscribers
    session.close()


def ready() -> None:
    print("ready", flush=True)
    sys.stdin.readline()


_ROLES = {"talk": talk, "write": write, "hear": hear}


@contextmanager
def until_over(process: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    try:
        with process:
            yield process
            process.terminate()
    finally:
        process.kill()


def go(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.write("go\n")
    process.stdin.flush()


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def _cpu_ns(process: subprocess.Popen[str]) -> float:
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") * 1e9


def measure(place: Place, sender: str, bridge: str | None, *, hearing: bool) -> Round:
    """Run one round."""
    with ExitStack() as stack:
        board = stack.enter_context(Whiteboard(place.board))
        between = bridge and stack.enter_context(until_over(place.bridge(bridge)))
        if between:
            assert between.stderr is not None
            between.stderr.readline()
        hearer = stack.enter_context(until_over(place.role("hear"))) if hearing else None
        talker = stack.enter_context(until_over(place.role(sender)))
        for process in filter(None, (hearer, talker)):
            line_of(process)
        time.sleep(1)  # until all know of each other
        if hearer:
            go(hearer)
        reader = _Reader(board) if not hearer else None
        before = _cpu_ns(between) if between else 0.0
        go(talker)
        talker.wait()
        time.sleep(0.2)  # for what is still on its way; no process knows that it was the last
        if reader:
            wait_for(lambda: reader.latencies)
        used = _cpu_ns(between) - before if between else 0.0
        if hearer:
            go(hearer)
            return Round(*json.loads(line_of(hearer)))
        assert reader is not None
        return Round(reader.median(), used / sum(slot.count for slot in _slots(board)))


class _Reader:
    """Looks when messages came into their slots, as often as it can."""

    def __init__(self, board: Whiteboard) -> None:
        self._over = threading.Event()
        self.latencies: list[float] = []
        self._thread = threading.Thread(target=self._look, args=(_slots(board),), daemon=True)
        self._thread.start()

    def _look(self, slots: list[Any]) -> None:
        seen = [0] * len(slots)
        while not self._over.wait(0.005):
            for n, slot in enumerate(slots):
                sample = slot.sample()
                if sample is not None and sample.count != seen[n]:
                    seen[n] = sample.count
                    self.latencies.append(sample.stamp_ns - sample.message.linear.x)

    def median(self) -> float:
        self._over.set()
        self._thread.join()
        return median(self.latencies)


def rows(rounds: int, seconds: float) -> Iterator[Row]:
    """Measure all three ways in turns; before several rounds, one more is thrown away."""
    name = f"bench-bridge-{os.getpid()}"
    warm = 1 if rounds > 1 else 0
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    raw: list[Round] = []
    into: list[Round] = []
    out: list[Round] = []
    router = open_router([endpoint])
    try:
        for _ in range(rounds + warm):
            place = Place(endpoint, name, seconds)
            raw.append(measure(place, "talk", None, hearing=True))
            into.append(measure(place, "talk", "--from-ros", hearing=False))
            with suppress(BoardNotFoundError):
                remove_board(name)
            out.append(measure(place, "write", "--to-ros", hearing=True))
            with suppress(BoardNotFoundError):
                remove_board(name)
    finally:
        router.close()
    raw, into, out = raw[warm:], into[warm:], out[warm:]
    for what, ours in (("topic to slot, p50", into), ("slot to topic, p50", out)):
        yield _row(what, [r.latency for r in ours], [r.latency for r in raw], 2.0)
    yield _row("topic to slot, CPU", [r.cpu for r in into], [r.cpu for r in raw], 1.4)


def _row(what: str, ours: list[float], its: list[float], promised: float) -> Row:
    sides = [Side("llfsm", "bridge", ours), Side("raw Zenoh", "subscriber", its)]
    return Row(what, sides, MEDIANS, promised)


def free_port() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def main(
    what: str | None,
    rows: Callable[[int, float], Iterator[Row]],
    roles: dict[str, Callable[[Any], None]],
    place: Callable[..., Any],
) -> int:
    """Print rows, or be the process of a role, as the command line says; return the exit status."""
    parser = argparse.ArgumentParser(description=(what or "").partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=2.0, help="of one round")
    parser.add_argument("--role", choices=roles, help=argparse.SUPPRESS)
    parser.add_argument("--place", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role:
        roles[options.role](place(*json.loads(options.place)))
        return 0
    print(HEAD, flush=True)
    measured = []
    for row in rows(options.rounds, options.seconds):
        print(row.text(), flush=True)
        measured.append(row)
    return 0 if all(row.met for row in measured) else 1


if __name__ == "__main__":
    sys.exit(main(__doc__, rows, _ROLES, Place))
