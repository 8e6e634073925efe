"""Hosts mirroring a board over a network with delays, losses and partitions, with clock skew.

Everything but the network is the real code; time is virtual and random numbers are seeded. After
each step it is checked that no board has gone back to an older message. Run as a program, it
prints how the traffic grows::

    python -m llfsm.whiteboard.mirror.simulation
"""

from __future__ import annotations

import heapq
import itertools
import random
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from ..local import LocalBoard
from ..message import Message
from ..slots import Slot
from .exchange import Exchange, Query
from .merge import Version
from .settings import Settings
from .store import Store
from .version_log import FileVersionLog

__all__ = ["Host", "World", "table"]

MS = 1_000_000
TICK_NS = 5 * MS
HEARTBEAT_NS = 250 * MS
START_NS = 1_700_000_000_000 * MS


class Numbered(Message, type_name="test/Numbered"):
    """A message with a number of its own."""

    number: int
    payload: bytes = b""


class Host:
    """A host: a board that stays, and a daemon that can be killed."""

    def __init__(self, world: World, index: int, skew_ns: int, settings: Settings) -> None:
        self.world = world
        self.index = index
        self.skew_ns = skew_ns
        self.settings = settings
        self.board = LocalBoard("board", now_ns=lambda: world.now_ns)
        self.path = world.folder / f"llfsm.host{index}"
        self.path.touch()
        self.watch = self.board.watcher()
        self.versions: dict[str, Version] = {}
        self.version_log: FileVersionLog | None = None
        self.start()

    def start(self) -> None:
        """Start its daemon, which reads the version log."""
        self.version_log = FileVersionLog(self.path)
        self.watch = self.board.watcher()
        self.store = Store(self.board, self.index, self.wall_ns, self.version_log, self.horizon_ns)
        self.exchange = Exchange(
            self.store, self.settings, lambda: self.world.now_ns, self.read_clock_ns
        )
        self.heartbeat_ns = self.world.now_ns

    def kill(self) -> None:
        """Kill its daemon; messages on their way to it are lost."""
        if self.version_log is not None:
            self.version_log.close()
            self.version_log = None

    def wall_ns(self, stamp_ns: int) -> int:
        """Return the time on its clock for a stamp."""
        return START_NS + stamp_ns + self.skew_ns

    def read_clock_ns(self) -> int:
        """Return the time on its clock now."""
        return self.wall_ns(self.world.now_ns)

    def horizon_ns(self) -> int:
        """Return the latest time that a version may have now."""
        return self.read_clock_ns() + self.settings.ahead_ns

    def step(self) -> None:
        """Run one tick of the daemon."""
        if self.version_log is None:
            return
        self.check()
        self.exchange.enter_held()
        for data in self.exchange.collect(self.watch(0)):
            self.world.send(self, "batch", data, _batch_receiver(data))
        self.exchange.batches_sent()
        if self.world.now_ns >= self.heartbeat_ns:
            self.heartbeat_ns = self.world.now_ns + HEARTBEAT_NS
            data = self.exchange.heartbeat()
            self.world.send(
                self, "heartbeat", data, lambda host: host.exchange.receive_heartbeat(data)
            )
        for query in self.exchange.queries():
            self.world.send_query(self, query)

    def check(self) -> None:
        """Check that no slot went back, and that each message has one version on all hosts."""
        for info in self.board.slots():
            value = self.store.latest(self.store.cell(info.name))
            if value is None:
                continue
            if value.version < self.versions.get(info.name, value.version):
                raise AssertionError(f"{info.name} on host {self.index} went back")
            self.versions[info.name] = value.version
            known = self.world.versions.setdefault((info.name, value.payload), value.version)
            if known != value.version:
                raise AssertionError(f"{info.name}: one message has two versions")


class World:
    """The hosts, the messages between them, and the time."""

    def __init__(
        self,
        seed: int,
        hosts: int,
        folder: Path,
        *,
        delay_ms: tuple[float, float] = (0.1, 2.0),
        loss: float = 0.0,
        skew_ms: float = 0.0,
        settings: Settings | None = None,
    ) -> None:
        self.random = random.Random(seed)
        self.folder = folder
        self.now_ns = 0
        self.delay_ms = delay_ms
        self.loss = loss
        self.versions: dict[tuple[str, bytes], Version] = {}
        self.sent: Counter[str] = Counter()
        self.bytes: Counter[str] = Counter()
        self._numbers = itertools.count(1)
        self._order = itertools.count()
        self._events: list[tuple[int, int, Host, Callable[[Host], object]]] = []
        self._arrivals: dict[tuple[int, int], int] = {}
        self.groups = [0] * hosts
        chosen = settings or Settings()
        self.hosts = [
            Host(self, i, round(self.random.uniform(-skew_ms, skew_ms) * MS), chosen)
            for i in range(hosts)
        ]

    def slot(self, number: int) -> Slot[Numbered]:
        """Return one of the slots."""
        return Slot(f"slot{number}", Numbered)

    def add(self, host: int, slot: int, payload: bytes = b"") -> None:
        """Add a message on a host."""
        self.hosts[host].board.add_message(self.slot(slot), Numbered(next(self._numbers), payload))

    def send(self, sender: Host, kind: str, data: bytes, deliver: Callable[[Host], object]) -> None:
        """Send data to all other hosts."""
        for host in self.hosts:
            if host is not sender:
                self.transmit(sender, host, kind, data, deliver)

    def transmit(
        self, sender: Host, to: Host, kind: str, data: bytes, deliver: Callable[[Host], object]
    ) -> bool:
        """Send data to one host, in order; return False if it is lost."""
        self.sent[kind] += 1
        self.bytes[kind] += len(data)
        if self.groups[sender.index] != self.groups[to.index] or self.random.random() < self.loss:
            return False
        due_ns = self.now_ns + round(self.random.uniform(*self.delay_ms) * MS)
        due_ns = max(due_ns, self._arrivals.get((sender.index, to.index), 0))
        self._arrivals[sender.index, to.index] = due_ns
        heapq.heappush(self._events, (due_ns, next(self._order), to, deliver))
        return True

    def send_query(self, sender: Host, query: Query) -> None:
        """Send a query to a host and the reply back; either may be lost."""

        def reply(host: Host) -> None:
            complete = True
            for data in host.exchange.reply(query.data):
                complete &= self.transmit(host, sender, "reply", data, _reply_receiver(data))
            if complete:
                self.transmit(host, sender, "end", b"", lambda to: to.exchange.end_reply(query))

        host = self.hosts[query.source.host]
        self.transmit(sender, host, "query", query.data, reply)

    def run(self, ms: float) -> None:
        """Advance the time."""
        end_ns = self.now_ns + round(ms * MS)
        while self.now_ns < end_ns:
            self.now_ns += TICK_NS
            while self._events and self._events[0][0] <= self.now_ns:
                _, _, host, deliver = heapq.heappop(self._events)
                if host.version_log is not None:
                    deliver(host)
                    host.check()
            for host in self.hosts:
                host.step()

    def newest(self, slot: int) -> Version | None:
        """Return the newest version of any message of a slot."""
        name = self.slot(slot).name
        return max((v for (s, _), v in self.versions.items() if s == name), default=None)

    def is_settled(self, slots: int) -> bool:
        """Return whether all boards hold the newest message of each slot."""
        return all(
            host.versions.get(self.slot(number).name) == self.newest(number)
            for host in self.hosts
            for number in range(slots)
        )

    def close(self) -> None:
        """Close the version logs."""
        for host in self.hosts:
            host.kill()


def _batch_receiver(data: bytes) -> Callable[[Host], object]:
    return lambda host: host.exchange.receive_batch(data)


def _reply_receiver(data: bytes) -> Callable[[Host], object]:
    return lambda host: host.exchange.receive_reply(data)


_LINE = "{:>5} {:>5} {:>9} | {:>10} {:>9} {:>9} {:>10}"


def traffic(hosts: int, slots: int, rate: int, seconds: float = 0.5) -> str:
    """Return one line of the table: each host adds 64 bytes to each slot `rate` times a second."""
    with tempfile.TemporaryDirectory() as folder:
        world = World(1, hosts, Path(folder))
        try:
            for host, slot in itertools.product(range(hosts), range(slots)):
                world.add(host, slot, bytes(64))
            world.run(1000)  # connect, and agree
            world.sent.clear()
            world.bytes.clear()
            steps = round(seconds * 1e9 / TICK_NS)
            for step in range(steps):
                due = int((step + 1) * rate * seconds / steps) - int(step * rate * seconds / steps)
                for host, slot, _ in itertools.product(range(hosts), range(slots), range(due)):
                    world.add(host, slot, bytes(64))
                world.run(TICK_NS / MS)
        finally:
            world.close()
        messages, size = world.sent.total() / seconds, world.bytes.total() / seconds
        values = hosts * slots * rate
        return _LINE.format(
            hosts,
            slots,
            rate,
            values,
            f"{messages / hosts / (hosts - 1):.0f}",
            f"{messages / hosts:.0f}",
            f"{size / hosts / 1000:.0f}",
        )


ROWS = [(2, 1, 0), (2, 1, 10), (2, 1, 1000), (2, 50, 10), (2, 50, 200), (3, 50, 200), (6, 50, 10)]


def table() -> str:
    """Return the table in docs/hosts.md."""
    heads = "hosts", "slots", "adds/s", "adds/s all", "msgs/link", "msgs/host", "kB/s host"
    return "\n".join([_LINE.format(*heads), *(traffic(*row) for row in ROWS)])


if __name__ == "__main__":
    print(table())
