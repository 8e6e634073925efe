"""Fleets in virtual time: hosts that read what few others add, behind routers that may be cut off.

The hosts are those of ``simulation.py``: the real code, whose boards are checked after each step.
Each router serves a site of `SITE` hosts, and the routers reach each other. A host reads the
folder of the next host of its site and that of one at another site. Run as a program, this prints
what a host sends and receives and a router forwards, and how soon all agree after a partition::

    python examples/mirror/fleets.py 10 100 1000
"""

from __future__ import annotations

import itertools
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from llfsm.whiteboard.mirror.peers import Packet
from llfsm.whiteboard.mirror.settings import Settings
from simulation import MS, TICK_NS, Host, World, sizes

SITE = 10
SLOTS, RATE = 2, 20  # of each host, which adds to each slot so often a second
PAYLOAD = bytes(64)
_SETTLE_MS, _MEASURE_MS = 2500.0, 500.0
_CUT_MS = 1010.0  # it ends just after the heartbeats, for which all wait then
_PATIENCE_MS = 10_000.0


class Fleet(World):
    """Hosts at sites, with a router for each."""

    def __init__(
        self, hosts: int, folder: Path, *, delay_ms: tuple[float, float] = (5.0, 20.0)
    ) -> None:
        self.up: Counter[str] = Counter()
        """Messages and bytes that hosts have sent to their routers, one for all who read them."""
        self.down: Counter[str] = Counter()
        """Those that hosts have received."""
        self.forwarded: Counter[str] = Counter()
        """Those that routers have received, of hosts and of each other."""
        settings = Settings(eager=False)
        name = "host{0[0]}/slot{0[1]}"
        super().__init__(1, hosts, folder, delay_ms=delay_ms, settings=settings, name=name)
        for host, read in itertools.product(range(hosts), range(2)):
            self.read(host, (self.read_by(host)[read], 0))

    def read_by(self, host: int) -> tuple[int, int]:
        """Return the two hosts whose folders a host reads."""
        count, first = len(self.hosts), host - host % SITE
        near = min(SITE, count - first)
        far = (host + SITE) % count if count > SITE else first + (host + 2) % near
        return first + (host + 1) % near, far

    def send(
        self, sender: Host, kind: str, packet: Packet, deliver: Callable[[Host], object]
    ) -> None:
        """Send data through the routers to all other hosts that receive its group."""
        receivers = [host for host in self.receivers(packet.group) if host is not sender]
        sites = {host.index // SITE for host in receivers} - {sender.index // SITE}
        self._count(len(packet.data), up=1, between=len(sites))
        super().send(sender, kind, packet, deliver)

    def transmit(
        self, sender: Host, to: Host, kind: str, data: bytes, deliver: Callable[[Host], object]
    ) -> bool:
        """Send data to one host through the routers."""
        if kind in ("query", "reply", "end"):  # the others were counted for all receivers
            self._count(len(data), up=1, between=sender.index // SITE != to.index // SITE)
        self.down["messages"] += 1
        self.down["bytes"] += len(data)
        return super().transmit(sender, to, kind, data, deliver)

    def _count(self, size: int, *, up: int, between: int) -> None:
        for counter, number in ((self.up, up), (self.forwarded, up + between)):
            counter["messages"] += number
            counter["bytes"] += number * size

    def connect(self, started: Host | None = None) -> None:
        """Tell a host that it has connected; those behind routers do not notice any of it."""
        if started is not None:
            started.exchange.connect(to_router=True)

    def cut(self, site: int) -> None:
        """Cut the router of a site off from the others; its hosts still reach each other."""
        self.groups = [int(host // SITE == site) for host in range(len(self.hosts))]

    def join(self) -> None:
        """End the partition."""
        self.groups = [0] * len(self.hosts)

    def agrees(self) -> bool:
        """Check that each host has the newest messages of all slots that it reads."""
        return all(
            host.versions.get(name) == self.hosts[of].versions.get(name)
            for host in self.hosts
            for of in self.read_by(host.index)
            for name in (self.slot((of, number)).name for number in range(SLOTS))
        )

    def work(self, ms: float) -> None:
        """Let each host add to its slots at its rate for some time."""
        every = round(1e9 / RATE / TICK_NS)
        for step in range(round(ms * MS / TICK_NS)):
            for host in range(step % every, len(self.hosts), every):  # not all at once
                for number in range(SLOTS):
                    self.add(host, (host, number), PAYLOAD)
            self.run(TICK_NS / MS)


class Row(NamedTuple):
    """A line of the table; traffic is per second."""

    hosts: int
    routers: int
    sent: float
    """Messages of a host."""
    sent_kb: float
    received_kb: float
    router_kb: float
    agree_ms: float
    """From the end of a partition until all agree."""


def measure(hosts: int) -> Row:
    """Run a fleet: connected, at work, with a site cut off, and joined again."""
    with tempfile.TemporaryDirectory() as folder:
        fleet = Fleet(hosts, Path(folder))
        try:
            for host, number in itertools.product(range(hosts), range(SLOTS)):
                fleet.add(host, (host, number), PAYLOAD)
            fleet.run(_SETTLE_MS)
            for counter in (fleet.up, fleet.down, fleet.forwarded):
                counter.clear()
            fleet.work(_MEASURE_MS)
            counted = [Counter(each) for each in (fleet.up, fleet.down, fleet.forwarded)]
            fleet.cut(0)
            fleet.work(_CUT_MS)
            fleet.join()
            joined_ns = fleet.now_ns
            while not fleet.agrees():
                fleet.run(TICK_NS / MS)
                if fleet.now_ns - joined_ns > _PATIENCE_MS * MS:
                    raise AssertionError(f"{hosts} hosts do not agree after a partition")
            agree_ms = (fleet.now_ns - joined_ns) / MS
        finally:
            fleet.close()
    routers = -(-hosts // SITE)
    up, down, forwarded = counted
    per_s = 1000 / _MEASURE_MS
    return Row(
        hosts,
        routers,
        up["messages"] * per_s / hosts,
        up["bytes"] * per_s / hosts / 1000,
        down["bytes"] * per_s / hosts / 1000,
        forwarded["bytes"] * per_s / routers / 1000,
        agree_ms,
    )


def table(sizes: Iterable[int]) -> str:
    """Make the table in docs/concepts/fleets.md."""
    lines = ["hosts routers | sent/s kB/s sent  received | kB/s router | agree ms"]
    for size in sizes:
        row = measure(size)
        lines.append(
            f"{row.hosts:>5} {row.routers:>7} | {row.sent:>6.0f} {row.sent_kb:>9.1f} "
            f"{row.received_kb:>9.1f} | {row.router_kb:>11.1f} | {row.agree_ms:>8.0f}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(sizes() or (2, 10, 100, 1000)))
