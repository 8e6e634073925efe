"""Relay ten topics at 1 kHz each for long, and account for every message.

Three times, each with processes of its own: a router, a bridge, and one that sends numbers.

in, all      topic to slot, the relays keep 1000 messages: every one is added to its slot
in, newest   topic to slot as relays are by default: what is missing was overtaken by a newer one
out          slot to topic: what the bridge sends arrives, whole and in order

What has to hold besides: no number is older than one before it, the last one arrives, and the
bridge takes no more memory, threads or files at the end than after a third of the time. The exit
status is 1 if something does not hold.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from use import Use

from free_ports import free_endpoint
from llfsm.bridges.ros2.graph import Graph, Role
from llfsm.bridges.ros2.opening import open_router
from llfsm.bridges.ros2.qos import Qos
from llfsm.bridges.ros2.transport import SerializedMessage
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport
from llfsm.whiteboard import BoardNotFoundError, Slot, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3

_TOPICS, _HZ = 10, 1000
_TYPE = "geometry_msgs/msg/Twist"
_DOMAIN = 79
_KEPT = 1000
_PATIENCE_S = 10.0
_LOOK_S = 0.005


class Leg(NamedTuple):
    """One of the three ways."""

    name: str
    direction: str
    sender: str
    depth: int | None = None


_LEGS = [
    Leg("in, all", "from_ros", "publish", _KEPT),
    Leg("in, newest", "from_ros", "publish"),
    Leg("out", "to_ros", "add"),
]


class Place(NamedTuple):
    """Where the processes meet, and for how long."""

    router: str
    board: str
    seconds: float


class Series:
    """The numbers that came by way of one topic."""

    def __init__(self) -> None:
        self.last = -1
        self.sequence = 0
        self.wrong: list[str] = []

    def take(self, number: int) -> None:
        """Look at a number that may be the last one again."""
        if number < self.last:
            self.wrong.append(f"{number} after {self.last}")
        self.last = number

    def arrived(self, arrival: SerializedMessage[Twist]) -> None:
        """Take what the bridge published, which counts its messages."""
        self.sequence += 1
        if arrival.info.sequence != self.sequence:
            self.wrong.append(f"message {arrival.info.sequence} in place of {self.sequence}")
            self.sequence = arrival.info.sequence
        number = int(arrival.decode().linear.x)
        if number == self.last:
            self.wrong.append(f"{number} twice")
        self.take(number)


def _slots(board: Whiteboard) -> list[Any]:
    return [board[Slot(f"t{n}", Twist)] for n in range(_TOPICS)]


def _in_turns(seconds: float, send: Callable[[int, Twist], object]) -> None:
    """Send 0, 1, 2 ... to each topic, on time as far as the machine is able to; tell how many."""
    input()
    begin = time.monotonic()
    for number in itertools.count():
        wait = begin + number / _HZ - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        if time.monotonic() - begin > seconds:
            print(number, flush=True)
            return
        for topic in range(_TOPICS):
            send(topic, Twist(Vector3(x=float(number))))


def publish(place: Place) -> None:
    """Be a node of ROS."""
    of = TypeLibrary().message(_TYPE)
    with (
        ZenohTransport(_DOMAIN, router=[place.router]) as transport,
        transport.node("sender") as node,
    ):
        publishers = [node.publisher(f"t{n}", of) for n in range(_TOPICS)]
        _in_turns(place.seconds, lambda topic, twist: publishers[topic].publish(twist))


def add(place: Place) -> None:
    """Be a machine."""
    with Whiteboard(place.board) as board:
        slots = _slots(board)
        _in_turns(place.seconds, lambda topic, twist: slots[topic].add(twist))


_SENDERS = {"publish": publish, "add": add}


@contextmanager
def _bridge(place: Place, leg: Leg) -> Iterator[int]:
    """Run a bridge until the end of the block; give its process id."""
    depth = f"depth = {leg.depth}\n" if leg.depth else ""
    relays = [
        f'[[relay]]\nslot = "t{n}"\ntype = "{_TYPE}"\ndirection = "{leg.direction}"\n{depth}'
        for n in range(_TOPICS)
    ]
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, "bridge.toml")
        config.write_text("\n".join(relays))
        where = ["--router", place.router, "--board", place.board, "--domain", str(_DOMAIN)]
        command = [sys.executable, "-m", "llfsm.cli", "bridge", "ros2", "--transport", "zenoh"]
        with _process([*command, *where, "--config", str(config), "--quiet"]) as bridge:
            assert bridge.stderr is not None
            bridge.stderr.readline()
            yield bridge.pid
            bridge.terminate()


@contextmanager
def _process(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        try:
            yield process
        finally:
            if process.poll() is None and sys.exc_info()[0] is not None:
                process.kill()


def run(leg: Leg, place: Place) -> tuple[str, list[str]]:
    """Run one of the ways; return what it came to, and what is wrong."""
    series = [Series() for _ in range(_TOPICS)]
    with ExitStack() as stack:
        board = stack.enter_context(Whiteboard(place.board))
        bridge = stack.enter_context(_bridge(place, leg))
        command = [sys.executable, __file__, "--role", leg.sender, "--place", json.dumps(place)]
        sender = stack.enter_context(_process(command))
        transport = stack.enter_context(ZenohTransport(_DOMAIN, router=[place.router]))
        if leg.direction == "to_ros":
            of = TypeLibrary().message(_TYPE)
            node = stack.enter_context(transport.node("witness"))
            for n, each in enumerate(series):
                node.subscription(f"t{n}", of, each.arrived, Qos(depth=_KEPT))
        if not transport.wait_graph(_is_joined, _PATIENCE_S):
            return "", [f"not everybody met within {_PATIENCE_S:g} s"]
        assert sender.stdin is not None
        assert sender.stdout is not None
        print("go", file=sender.stdin, flush=True)
        early, late = _watch(board, leg, series, sender, bridge, place.seconds)
        sent = int(sender.stdout.readline())
        wrong = _come(lambda: all(each.last == sent - 1 for each in series), board, leg, series)
        counts = [slot.count for slot in _slots(board)]
    wrong += [f"t{n}: {w}" for n, each in enumerate(series) for w in each.wrong[:3]]
    wrong += early.grown(late)
    came = [each.sequence for each in series] if leg.direction == "to_ros" else counts
    if leg.depth and min(came) < sent:
        wrong.append(f"of {sent} messages a slot got {min(came)}")
    share = 100 * sum(came) / (sent * _TOPICS)
    reported = (
        f"{leg.name}: {sent / place.seconds:.0f} a second and topic, {share:.2f} % passed on, "
        f"bridge {early.memory_kib / 1024:.1f} to {late.memory_kib / 1024:.1f} MiB"
    )
    return reported, wrong


def _is_joined(graph: Graph) -> bool:
    ends = itertools.product(range(_TOPICS), (Role.PUBLISHER, Role.SUBSCRIPTION))
    return all(graph.ends(f"/t{n}", role) for n, role in ends)


def _watch(
    board: Whiteboard,
    leg: Leg,
    series: list[Series],
    sender: subprocess.Popen[str],
    bridge: int,
    seconds: float,
) -> tuple[Use, Use]:
    """Look until all is sent; return what the bridge took after a third of the time and at last."""
    begin = time.monotonic()
    early: Use | None = None
    lately: deque[Use] = deque(maxlen=6)
    looked = begin
    while sender.poll() is None:
        time.sleep(_LOOK_S)
        _look(board, leg, series)
        now = time.monotonic()
        if now - looked > seconds / 30:
            looked = now
            lately.append(Use.of(bridge))
            if now - begin > seconds / 3:
                early = early or Use.least(lately)
    late = Use.least(lately)
    return early or late, late


def _look(board: Whiteboard, leg: Leg, series: list[Series]) -> None:
    if leg.direction == "from_ros":
        for slot, each in zip(_slots(board), series, strict=True):
            message = slot.get()
            if message is not None:
                each.take(int(message.linear.x))


def _come(
    ready: Callable[[], bool], board: Whiteboard, leg: Leg, series: list[Series]
) -> list[str]:
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        _look(board, leg, series)
        if ready():
            return []
        time.sleep(_LOOK_S)
    return [f"the last ones are {[each.last for each in series]}"]


def soak(seconds: float) -> list[str]:
    """Run all three ways; return what is wrong."""
    wrong = []
    endpoint = free_endpoint()
    router = open_router([endpoint])
    try:
        for leg in _LEGS:
            name = f"soak-relays-{os.getpid()}"
            reported, found = run(leg, Place(endpoint, name, seconds))
            with suppress(BoardNotFoundError):
                remove_board(name)
            print(reported, *found, sep="\n  ", flush=True)
            wrong += found
    finally:
        router.close()
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="of each way")
    parser.add_argument("--role", choices=_SENDERS, help=argparse.SUPPRESS)
    parser.add_argument("--place", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role:
        _SENDERS[options.role](Place(*json.loads(options.place)))
        return 0
    wrong = soak(options.seconds)
    print("something does not hold" if wrong else "all held")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
