"""Measure what a message takes from topic to topic, through a bridge and a slot between them.

raw      a Zenoh publisher in one process, a Zenoh subscriber in another
bridge   the same publisher, a bridge with two relays of one slot, the same subscriber
relay    the same, with a process between them that puts what it gets, and does nothing else

Publisher and subscriber send and receive as rmw_zenoh configures every node of ROS.
Through a bridge, a message goes twice the way. A small one may be no more than 0.4 ms later than
raw. A large one takes its time on each way, whoever relays it. It may take half longer than raw; a
bare relay beside it shows how much of that is the way.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from statistics import median
from struct import pack_into, unpack_from
from subprocess import PIPE, Popen
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from bridge import free_port, go, line_of, main, ready, until_over
from measure import Side, wait_for
from table import ADDED_MS, MEDIANS, Row

from llfsm.bridges.ros2.opening import open_router
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.zenoh_transport.endpoints import pack
from llfsm.bridges.ros2.zenoh_transport.graph import data_key
from llfsm.bridges.ros2.zenoh_transport.transport import open_node_session
from llfsm.whiteboard import BoardNotFoundError
from llfsm.whiteboard.board_files import remove_board

__all__ = ["rows"]

_GID = b"bench-of-bridges"
_DOMAIN = 78
_AS_RMW_ZENOH = {"ZENOH_CONFIG_OVERRIDE": "transport/link/tx/queue/size/data=2"}
_STAMP, _STAMP_AT = "<iI", 4  # a header's stamp, behind the encapsulation of the message


class Load(NamedTuple):
    """What is sent, and how often."""

    type_name: str
    hz: float
    fields: dict[str, Any]


_WAYS = {"raw": "raw Zenoh", "relay": "a bare relay", "bridge": "llfsm"}
_LARGE = "a cloud of 1 MB"
LOADS = {
    "Odometry": Load("nav_msgs/msg/Odometry", 100, {}),
    _LARGE: Load(
        "sensor_msgs/msg/PointCloud2",
        20,
        {"width": 62_500, "height": 1, "point_step": 16, "row_step": 10**6, "data": bytes(10**6)},
    ),
}


class Place(NamedTuple):
    """Where the processes meet, and what they send."""

    router: str
    board: str
    seconds: float
    load: str
    way: str  # of _WAYS

    def role(self, name: str) -> Popen[str]:
        """Start this file as one of the processes."""
        command = [sys.executable, __file__, "--role", name, "--place", json.dumps(self)]
        environment = os.environ | _AS_RMW_ZENOH
        return Popen(command, text=True, env=environment, stdin=PIPE, stdout=PIPE)

    def bridge(self, folder: Path) -> Popen[str]:
        """Start a bridge from the topic `in` to `out`."""
        relay = '[[relay]]\nslot = "s"\ntype = "{}"\ntopic = "/{}"\ndirection = "{}"\n'
        of = LOADS[self.load].type_name
        file = folder / "bridge.toml"
        ways = (("in", "from_ros"), ("out", "to_ros"))
        file.write_text("".join(relay.format(of, topic, way) for topic, way in ways))
        where = ["--router", self.router, "--board", self.board, "--domain", str(_DOMAIN)]
        command = [sys.executable, "-m", "llfsm.cli", "bridge", "ros2", "--transport", "zenoh"]
        return Popen([*command, "--config", str(file), *where, "--quiet"], text=True, stderr=PIPE)

    def key(self, topic: str) -> str:
        """Return the key of a topic with the type of the load."""
        of = TypeLibrary().message(LOADS[self.load].type_name)
        return data_key(_DOMAIN, topic, of.dds_name, of.type_hash)


def talk(place: Place) -> None:
    """Publish as a ROS node does, each message with the time."""
    load = LOADS[place.load]
    session, _ = open_node_session([place.router])
    of = TypeLibrary().message(load.type_name)
    data = bytearray(of.encode(of.message(**load.fields)))
    publisher = session.declare_publisher(place.key("in"))
    ready()
    begin = time.monotonic()
    for number in range(int(place.seconds * load.hz)):
        time.sleep(max(0.0, begin + number / load.hz - time.monotonic()))
        pack_into(_STAMP, data, _STAMP_AT, *divmod(time.monotonic_ns(), 10**9))
        publisher.put(bytes(data), attachment=pack(number + 1, time.time_ns(), _GID))
    session.close()


def hear(place: Place) -> None:
    """Subscribe without llfsm, and look at nothing but the time in each message."""
    session, _ = open_node_session([place.router])
    latencies: list[float] = []

    def on_sample(sample: Any) -> None:
        second, ns = unpack_from(_STAMP, sample.payload.to_bytes(), _STAMP_AT)
        latencies.append(time.monotonic_ns() - second * 10**9 - ns)

    subscriber = session.declare_subscriber(
        place.key("in" if place.way == "raw" else "out"), on_sample
    )
    ready()
    wait_for(lambda: latencies)
    print(json.dumps(median(latencies)), flush=True)
    del subscriber
    session.close()


def relay(place: Place) -> None:
    """Put what is received, without llfsm, and look at nothing."""
    session, _ = open_node_session([place.router])
    publisher = session.declare_publisher(place.key("out"))

    def on_sample(sample: Any) -> None:
        publisher.put(sample.payload, attachment=sample.attachment)

    subscriber = session.declare_subscriber(place.key("in"), on_sample)
    ready()
    del subscriber
    session.close()


_ROLES = {"talk": talk, "hear": hear, "relay": relay}


def measure(place: Place, folder: Path) -> float:
    """Return the median latency of one round, in nanoseconds."""
    with ExitStack() as stack:
        if place.way == "bridge":
            between = stack.enter_context(until_over(place.bridge(folder)))
            assert between.stderr is not None
            while "bridge: " not in between.stderr.readline():
                pass
        elif place.way == "relay":
            line_of(stack.enter_context(until_over(place.role("relay"))))
        hearer = stack.enter_context(until_over(place.role("hear")))
        talker = stack.enter_context(until_over(place.role("talk")))
        for process in (hearer, talker):
            line_of(process)
        time.sleep(1)  # until all know of each other
        go(talker)
        talker.wait()
        time.sleep(0.2)  # for what is still on its way; no process knows that it was the last
        go(hearer)
        return float(line_of(hearer))


def rows(rounds: int, seconds: float) -> Iterator[Row]:
    """Measure both ways in turns; before several rounds, one more is thrown away."""
    warm = 1 if rounds > 1 else 0
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = open_router([endpoint])
    board = f"bench-through-{os.getpid()}"
    try:
        for load, ways in (("Odometry", ("raw", "bridge")), (_LARGE, ("raw", "relay", "bridge"))):
            found: dict[str, list[float]] = {way: [] for way in ways}
            for _ in range(rounds + warm):
                for way in ways:
                    place = Place(endpoint, board, seconds, load, way)
                    with TemporaryDirectory() as folder:
                        found[way].append(measure(place, Path(folder)))
                    with suppress(BoardNotFoundError):
                        remove_board(board)
            side = {way: Side(_WAYS[way], way, found[way][warm:]) for way in ways}
            what = f"{load}, topic to topic, p50"
            if load == _LARGE:
                yield Row(what, [side["bridge"], side["raw"]], MEDIANS, 1.5)
                yield Row("  and by a bare relay", [side["bridge"], side["relay"]], MEDIANS, None)
            else:
                yield Row(what, [side["bridge"], side["raw"]], ADDED_MS, 0.4)
    finally:
        router.close()


if __name__ == "__main__":
    sys.exit(main(__doc__, rows, _ROLES, Place))
