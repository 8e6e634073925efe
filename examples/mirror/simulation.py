"""Hosts mirroring a board over a network with delays, losses and partitions, with clock skew.

Everything but the network is the real code; time is virtual and random numbers are seeded, so a run
can be repeated. Each step of 5 ms delivers what is due and runs one tick of every daemon, and then
checks two invariants: no board has gone back to an older message, and a message has one version on
all hosts. Run as a program, it prints how the traffic grows if all hosts read all slots::

    python examples/mirror/simulation.py

and with numbers of hosts, that it does not grow if each reads what two others add.
"""

from __future__ import annotations

import heapq
import itertools
import random
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.message import Message
from llfsm.whiteboard.mirror.batches import Version
from llfsm.whiteboard.mirror.exchange import Exchange
from llfsm.whiteboard.mirror.groups import EVERY_GROUP
from llfsm.whiteboard.mirror.peers import EVERY_HOST, Packet, Query
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.store import FileVersionLog, Store
from llfsm.whiteboard.slots import Slot

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
            self.store,
            self.settings,
            lambda: self.world.now_ns,
            self.read_clock_ns,
            self.is_read,
        )
        self.heartbeat_ns = self.world.now_ns
        self.received: set[str] = set()
        if self.settings.eager:
            self.receive({EVERY_GROUP})
        self.world.connect(self)

    def kill(self) -> None:
        """Kill its daemon; messages on their way to it are lost."""
        if self.version_log is not None:
            self.version_log.close()
            self.version_log = None
            self.receive(set())

    def wall_ns(self, stamp_ns: int) -> int:
        """Convert a stamp of virtual time to the time on its clock."""
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
        changed = self.watch(0)
        if not self.settings.eager:
            self.receive(self.exchange.read(self.board.read_slots()))
        for packet in self.exchange.collect(changed):
            self.world.send(self, "batch", packet, _batch_receiver(packet))
        self.exchange.batches_sent()
        if self.world.now_ns >= self.heartbeat_ns:
            self.heartbeat_ns = self.world.now_ns + HEARTBEAT_NS
            for packet in self.exchange.heartbeats():
                self.world.send(self, "heartbeat", packet, _heartbeat_receiver(packet))
        for query in self.exchange.queries():
            self.world.send_query(self, query)

    def receive(self, groups: set[str]) -> None:
        """Receive these groups, and no others."""
        for group in self.received - groups:
            self.world.readers[group].discard(self)
        for group in groups - self.received:
            if not self.world.receivers(group):
                self.world.begin_sending(group)
            self.world.readers[group].add(self)
        self.received = groups

    def offered(self) -> list[str]:
        """Return the groups for which other hosts may ask it."""
        return [] if self.version_log is None else self.exchange.groups()

    def is_read(self, group: str) -> bool:
        """Check that another host receives a group."""
        return any(host is not self for host in self.world.receivers(group))

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
        settings: Settings | Sequence[Settings] | None = None,
        name: str = "slot{}",
    ) -> None:
        self.random = random.Random(seed)
        self.folder = folder
        self.now_ns = 0
        self.delay_ms = delay_ms
        self.loss = loss
        self.name = name  # of a slot, with its number
        self.versions: dict[tuple[str, bytes], Version] = {}
        self.sent: Counter[str] = Counter()
        self.bytes: Counter[str] = Counter()
        self._numbers = itertools.count(1)
        self._order = itertools.count()
        self._events: list[tuple[int, int, Host, Callable[[Host], object]]] = []
        self._arrivals: dict[tuple[int, int], int] = {}
        self.groups = [0] * hosts  # of hosts that reach each other
        self._connected = list(self.groups)
        self.readers: defaultdict[str, set[Host]] = defaultdict(set)
        self.hosts: list[Host] = []
        settings = settings or Settings()
        chosen = [settings] * hosts if isinstance(settings, Settings) else settings
        skews = [round(self.random.uniform(-skew_ms, skew_ms) * MS) for _ in range(hosts)]
        for index, skew_ns in enumerate(skews):
            self.hosts.append(Host(self, index, skew_ns, chosen[index]))

    def slot(self, number: Any) -> Slot[Numbered]:
        """Make one of the slots, by the number or numbers in its name."""
        return Slot(self.name.format(number), Numbered)

    def add(self, host: int, slot: Any, payload: bytes = b"") -> None:
        """Add a message on a host."""
        self.hosts[host].board.add_message(self.slot(slot), Numbered(next(self._numbers), payload))

    def receivers(self, group: str) -> set[Host]:
        """Return the hosts that receive a group."""
        return self.readers[group] | self.readers[EVERY_GROUP]

    def connect(self, started: Host | None = None) -> None:
        """Tell all hosts that some have connected: one that has started, or after a cut."""
        for host in self.hosts:
            if host.version_log is not None:
                host.exchange.connect()

    def begin_sending(self, group: str) -> None:
        """Tell all hosts that a group is read, which was not."""
        for host in self.hosts:
            if host.version_log is not None:
                host.exchange.begin_sending(group)

    def read(self, host: int, slot: Any) -> Numbered | None:
        """Read a slot on a host, where it counts as read until it is forgotten."""
        return self.hosts[host].board.get_message(self.slot(slot))

    def forget(self, host: int, slot: Any) -> None:
        """Read a slot on a host no more."""
        self.hosts[host].board.forget(self.slot(slot))

    def send(
        self, sender: Host, kind: str, packet: Packet, deliver: Callable[[Host], object]
    ) -> None:
        """Send data to all other hosts that receive its group."""
        for host in sorted(self.receivers(packet.group), key=lambda host: host.index):
            if host is not sender:
                self.transmit(sender, host, kind, packet.data, deliver)

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
        """Send a query to a host, or to all that have its group, and the replies back.

        Each may be lost.
        """
        group = query.source.group

        def reply(host: Host) -> None:
            complete = True
            for data in host.exchange.reply(query.data, group=group):
                complete &= self.transmit(host, sender, "reply", data, _reply_receiver(data, group))
            if complete:
                self.transmit(host, sender, "end", b"", lambda to: to.exchange.end_reply(query))

        asked = [self.hosts[query.source.host]]
        if query.source.host == EVERY_HOST.host:
            asked = [host for host in self.hosts if host is not sender and group in host.offered()]
        for host in asked:
            self.transmit(sender, host, "query", query.data, reply)

    def run(self, ms: float) -> None:
        """Advance the time."""
        end_ns = self.now_ns + round(ms * MS)
        while self.now_ns < end_ns:
            self.now_ns += TICK_NS
            if self.groups != self._connected:
                self._connected = list(self.groups)
                self.connect()
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
        """Check that all boards hold the newest message of each slot."""
        return all(
            host.versions.get(self.slot(number).name) == self.newest(number)
            for host in self.hosts
            for number in range(slots)
        )

    def close(self) -> None:
        """Close the version logs."""
        for host in self.hosts:
            host.kill()


def _batch_receiver(packet: Packet) -> Callable[[Host], object]:
    return lambda host: host.exchange.receive_batch(packet.data, group=packet.group)


def _heartbeat_receiver(packet: Packet) -> Callable[[Host], object]:
    return lambda host: host.exchange.receive_heartbeat(packet.data, group=packet.group)


def _reply_receiver(data: bytes, group: str) -> Callable[[Host], object]:
    return lambda host: host.exchange.receive_reply(data, group=group)


_LINE = "{:>5} {:>5} {:>9} | {:>10} {:>9} {:>9} {:>10}"
_FLEET_LINE = "{:>5} {:>5} {:>9} | {:>10} {:>9} {:>10}"


def traffic(hosts: int, slots: int, rate: int, seconds: float = 0.5) -> str:
    """Measure one line of the table: each host adds 64 bytes to each slot `rate` times a second."""
    with tempfile.TemporaryDirectory() as folder:
        world = World(1, hosts, Path(folder))
        adds = list(itertools.product(range(hosts), range(slots)))
        messages, size = _measure(world, adds, rate, seconds)
    messages, size = messages / hosts, size / hosts
    values = f"{messages / (hosts - 1):.0f}", f"{messages:.0f}", f"{size / 1000:.0f}"
    return _LINE.format(hosts, slots, rate, hosts * slots * rate, *values)


def fleet(hosts: int, slots: int, rate: int, seconds: float = 0.5) -> tuple[float, float]:
    """Measure messages and bytes of a host a second, if each reads the slots of two others.

    Each host adds to slots of its own, in a folder, and none is eager.
    """
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(eager=False)
        world = World(1, hosts, Path(folder), settings=settings, name="host{0[0]}/slot{0[1]}")
        adds = [(host, (host, slot)) for host in range(hosts) for slot in range(slots)]
        for host, ahead in itertools.product(range(hosts), (1, 2)):
            world.read(host, ((host + ahead) % hosts, 0))
        messages, size = _measure(world, adds, rate, seconds)
    return messages / hosts, size / hosts


def _measure(
    world: World, adds: list[tuple[int, Any]], rate: int, seconds: float
) -> tuple[float, float]:
    """Count the messages and bytes that all hosts send in a second, once they agree."""
    try:
        for host, slot in adds:
            world.add(host, slot, bytes(64))
        world.run(2500)  # connect, announce what there is, and agree
        world.sent.clear()
        world.bytes.clear()
        steps = round(seconds * 1e9 / TICK_NS)
        for step in range(steps):
            due = int((step + 1) * rate * seconds / steps) - int(step * rate * seconds / steps)
            for (host, slot), _ in itertools.product(adds, range(due)):
                world.add(host, slot, bytes(64))
            world.run(TICK_NS / MS)
    finally:
        world.close()
    return world.sent.total() / seconds, world.bytes.total() / seconds


ROWS = [(2, 1, 0), (2, 1, 10), (2, 1, 1000), (2, 50, 10), (2, 50, 200), (3, 50, 200), (6, 50, 10)]
_FLEET_SLOTS, _FLEET_RATE = 2, 20


def table() -> str:
    """Make the first table in docs/how-to/hosts.md."""
    heads = "hosts", "slots", "adds/s", "adds/s all", "msgs/link", "msgs/host", "kB/s host"
    return "\n".join([_LINE.format(*heads), *(traffic(*row) for row in ROWS)])


def fleet_table(sizes: Iterable[int]) -> str:
    """Make the second one: hosts that read the slots of two others."""
    lines = [_FLEET_LINE.format("hosts", "slots", "adds/s", "adds/s all", "msgs/host", "kB/s host")]
    for hosts in sizes:
        messages, size = fleet(hosts, _FLEET_SLOTS, _FLEET_RATE)
        added = hosts * _FLEET_SLOTS * _FLEET_RATE
        values = hosts, _FLEET_SLOTS, _FLEET_RATE, added, f"{messages:.0f}", f"{size / 1000:.1f}"
        lines.append(_FLEET_LINE.format(*values))
    return "\n".join(lines)


def sizes() -> list[int]:
    """Read the numbers of hosts from the command line; end with one line for a wrong one."""
    for word in sys.argv[1:]:
        if not word.isdecimal() or int(word) < 2:
            sys.exit(f"{word!r} is not a number of hosts: a fleet has 2 or more")
    return [int(word) for word in sys.argv[1:]]


if __name__ == "__main__":
    hosts = sizes()
    print(fleet_table(hosts) if hosts else table())
