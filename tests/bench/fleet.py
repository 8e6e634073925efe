"""What a host costs in a fleet behind a router: processor time of its daemon, and bytes.

Each host adds to 50 slots of its own, and reads five of each of two others. Only what is read
travels, so neither figure may depend on how many hosts there are: one fleet is compared with four
of a quarter of its size, so that as many processes share the processors and their caches. The next
adds begin when all that is read has arrived, at most 50 times a second: on a busy machine, this
takes longer, but costs the same. The bytes are those of the hosts' connections, as TCP counts them
in the routers, which run in this process.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from measure import Side
from table import MORE_BYTES, MORE_PERCENT, Row

from llfsm.bridges.ros2.opening import open_router
from llfsm.whiteboard import BoundSlot, Message, Slot, Whiteboard
from llfsm.whiteboard.mirror.zenoh_internals import listeners

__all__ = ["Cost", "cost", "rows"]

_PROMISED = 1.5  # times what a host costs in a fleet of a quarter of the size

_BOARD = "bench"
# On a busy machine, half a second may be too short: a router takes who has given up for connected.
_CLIENT = '{ mode: "client", transport: { unicast: { open_timeout: 5000 } } }'
_FOLDERS = 10
_SLOTS = 5  # in each folder
_READ = 2  # folders, each of another host
_RATE = 50  # adds a second, to each slot, at most
_PATIENCE_S = 60.0
_PAUSE_S = 0.002
_SETTLE_S = 2.5  # from the last connection until hosts announce nothing any more
_TCP_INFO = 256  # bytes, at most
_ACKNOWLEDGED, _RECEIVED = 120, 128  # where struct tcp_info has the numbers of bytes


class Step(Message):
    """One of many."""

    number: int = 0
    data: bytes = bytes(64)


class Cost(NamedTuple):
    """What a host costs, in each second in which 50 messages are added to each of its slots."""

    percent: float
    """Of a core, for its daemon."""
    sent: float
    """Bytes."""
    received: float
    """Bytes."""
    rate: float
    """Adds a second to each slot, as they were."""


def _slots(host: int, folder: int) -> list[Slot[Step]]:
    return [Slot(f"robot{host}/part{folder}/{number}", Step) for number in range(_SLOTS)]


@contextmanager
def _router() -> Iterator[int]:
    """Run a router in this process; yield its port."""
    before = listeners()
    with closing(open_router(["tcp/127.0.0.1:0"])):
        [(_, port)] = listeners() - before
        yield port


@contextmanager
def _daemons(folders: list[Path], ports: list[int]) -> Iterator[list[int]]:
    """Run a daemon beside each board, as many at each router; yield their ids."""
    daemons: list[subprocess.Popen[bytes]] = []
    try:
        for number, folder in enumerate(folders):
            port = ports[number * len(ports) // len(folders)]
            (folder / "client.json5").write_text(_CLIENT)
            (folder / "host.toml").write_text(
                f'listen = []\nconnect = ["tcp/127.0.0.1:{port}"]\neager = false\n'
                'zenoh = "client.json5"\n'
            )
            command = ["whiteboard", "daemon", "-b", _BOARD, "--directory", str(folder)]
            daemons.append(
                subprocess.Popen(
                    [sys.executable, "-m", "llfsm.cli", *command, "--config", folder / "host.toml"],
                    stdout=subprocess.PIPE,
                )
            )
        for daemon in daemons:
            assert daemon.stdout is not None
            daemon.stdout.readline()
        yield [daemon.pid for daemon in daemons]
    finally:  # all at the same time
        for daemon in daemons:
            daemon.terminate()
        for daemon in daemons:
            daemon.communicate()


def _seconds(pid: int) -> float:
    """Return the processor time that a process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _transferred(ports: list[int]) -> tuple[int, int]:
    """Return how many bytes the connections to these ports of this process received and sent."""
    received = sent = 0
    for number in os.listdir("/proc/self/fd"):
        with suppress(OSError), socket.socket(fileno=os.dup(int(number))) as link:
            if link.getsockname()[1] in ports and link.getpeername():
                info = link.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO)
                sent += int.from_bytes(info[_ACKNOWLEDGED : _ACKNOWLEDGED + 8], sys.byteorder)
                received += int.from_bytes(info[_RECEIVED : _RECEIVED + 8], sys.byteorder)
    return received, sent


def _step(number: int, own: list[BoundSlot[Step]], read: list[BoundSlot[Step]]) -> None:
    """Add to all slots, and wait until what is read has arrived."""
    step = Step(number)
    for slot in own:
        slot.add(step)
    end = time.monotonic() + _PATIENCE_S
    for slot in read:
        while (arrived := slot.get()) is None or arrived.number != number:
            if time.monotonic() > end:
                raise TimeoutError(f"message {number} did not arrive within {_PATIENCE_S:g} s")
            time.sleep(_PAUSE_S)


def cost(fleets: int, hosts: int, seconds: float) -> Cost:
    """Let each host of some fleets add to its slots for so long; return what one of them costs.

    The time is that of a machine that keeps to the rate; another one takes longer.
    """
    steps = max(1, round(seconds * _RATE))
    with ExitStack() as stack:
        new = tempfile.TemporaryDirectory
        folders = [Path(stack.enter_context(new(dir="/dev/shm"))) for _ in range(fleets * hosts)]
        boards = [stack.enter_context(Whiteboard(_BOARD, directory=f)) for f in folders]
        ports = [stack.enter_context(_router()) for _ in range(fleets)]
        pids = stack.enter_context(_daemons(folders, ports))
        own, read = [], []
        for number, board in enumerate(boards):
            host = number % hosts
            own += [board[slot] for folder in range(_FOLDERS) for slot in _slots(host, folder)]
            for folder in range(_READ):
                other = (host + 1 + folder % (hosts - 1)) % hosts
                read += [board[slot] for slot in _slots(other, folder)]
        _step(0, own, read)
        time.sleep(_SETTLE_S)
        before, begin = [sum(map(_seconds, pids)), *_transferred(ports)], time.monotonic()
        for number in range(steps):
            time.sleep(max(0.0, begin + number / _RATE - time.monotonic()))
            _step(1 + number, own, read)
        rate = steps / (time.monotonic() - begin)
        after = [sum(map(_seconds, pids)), *_transferred(ports)]
        each = _RATE / steps / len(boards)
        used, received, sent = [(b - a) * each for a, b in zip(before, after, strict=True)]
        return Cost(100 * used, sent, received, rate)


def rows(seconds: float) -> Iterator[Row]:
    """Compare a fleet of eight with four of two."""
    many, few = (cost(fleets, 8 // fleets, seconds) for fleets in (1, 4))
    for what, ours, theirs, score in (
        ("a host of 8: part of a core", many.percent, few.percent, MORE_PERCENT),
        ("  bytes sent in a second", many.sent, few.sent, MORE_BYTES),
        ("  bytes received in a second", many.received, few.received, MORE_BYTES),
    ):
        sides = [Side("llfsm", "fleet.py", [ours]), Side("a host of 2", "fleet.py", [theirs])]
        yield Row(what, sides, score, _PROMISED)


def main() -> int:
    """Compare one fleet with four small ones; the exit status is 1 if a host costs more in it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hosts", type=int, default=32, help="a multiple of 4; at least 8")
    parser.add_argument("--seconds", type=float, default=10, help="at 50 adds a second")
    options = parser.parse_args()
    print("hosts  % of a core  bytes/s sent  received   adds/s")
    costs = []
    for fleets in (4, 1):
        costs.append(cost(fleets, options.hosts // fleets, options.seconds))
        percent, sent, received, rate = costs[-1]
        print(
            f"{options.hosts // fleets:5} {percent:12.1f} {sent:13.0f} {received:9.0f} {rate:8.1f}",
            flush=True,
        )
    few, many = costs
    ratios = [theirs / ours for theirs, ours in zip(many[:3], few[:3], strict=True)]
    print("ratio {:12.2f} {:13.2f} {:9.2f}".format(*ratios), f"  at most {_PROMISED:g}")
    return 0 if max(ratios) <= _PROMISED else 1


if __name__ == "__main__":
    sys.exit(main())
