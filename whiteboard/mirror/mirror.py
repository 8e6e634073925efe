"""A mirrored board: the exchange and the network, in a loop that waits on the board.

One thread runs the loop: it waits for changes of the board, and sends them at most every 5 ms, so
that changes in between travel together. The network's threads apply what arrives, and may send
queries. What the loop offers to others, it offers before it looks whether anybody reads it: a
message that is withheld because nobody reads it is asked for by whoever begins to.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field

from llfsm.whiteboard.board import Board
from llfsm.whiteboard.errors import WhiteboardError
from llfsm.whiteboard.messages.llfsm import HOSTS, Folders, Hosts, MirrorStatus, folders_slot
from llfsm.whiteboard.mirror.exchange import Exchange
from llfsm.whiteboard.mirror.groups import EVERY_GROUP
from llfsm.whiteboard.mirror.keeper import Keeper
from llfsm.whiteboard.mirror.naming import Naming
from llfsm.whiteboard.mirror.network import Network
from llfsm.whiteboard.mirror.peers import EVERY_HOST, Packet, Query
from llfsm.whiteboard.mirror.settings import Settings, matcher
from llfsm.whiteboard.mirror.store import Store, VersionLog

_TICK_S = 0.005  # between two batches: changes in between travel together
_HEARTBEAT_S = 0.25
_STATUS_S = 1.0
_SETTLE_S = 0.02  # from a connection to knowing the other host's subscriptions
_READ_S = 1.0  # between two looks for slots that are read no more, of processes that were killed
_ASK_S = 0.25  # between two queries for all, until there is a reply
_FOREIGN_S = 1.0  # between two hellos while hosts are there with which nothing is exchanged


@dataclass(eq=False)
class Mirror:
    """Mirrors one board, of any kind, until it is closed; hosts find each other by its name.

    The id `host` of this one is random by default. For `mode`, see :class:`.Network`.
    """

    board: Board
    settings: Settings
    versions: VersionLog
    _: KW_ONLY
    host: int = field(default_factory=lambda: secrets.randbits(63))
    keeper: Keeper | None = None
    mode: str = "peer"

    def __post_init__(self) -> None:
        board, host, settings = self.board, self.host, self.settings
        self._naming = Naming(settings.as_, settings.fleet)
        self._watch = board.watcher()
        ahead_ns = settings.ahead_ns
        horizon_ns = lambda: time.time_ns() + ahead_ns  # noqa: E731
        self._store = store = Store(board, host, _wall_ns, self.versions, horizon_ns)
        self._network = Network(board.name, host, settings, self.mode)
        self.listens = self._network.listens
        """The endpoints where other hosts reach this one."""
        self._exchange = Exchange(
            store, settings, time.monotonic_ns, time.time_ns, self._network.is_read
        )
        self.refuse = self._exchange.refuse
        self.receive_query, self.receive_reply = self._exchange.reply, self._exchange.receive_reply
        if self.keeper is not None:
            self.keeper.restore(store, self._exchange.refuse)
        self._hello_s = _HEARTBEAT_S  # from one greeting to the next, which doubles
        self._stop = threading.Event()
        self._replied = threading.Event()
        self._readings = -1  # of the board, at the last look for slots that are read
        self._look_s = 0.0  # the time of the next look
        self._leaves = matcher(settings.leave)
        self._hosts: tuple[str, ...] | None = None  # as published
        self._offered: set[str] = set()  # slots whose groups were offered when they changed first
        self._begun: dict[str, None] = {}  # groups that other hosts have begun to read
        self._network.join(self)
        if self.settings.eager:
            self._network.receive({EVERY_GROUP})

    def run(self, publish: Callable[[MirrorStatus], None] = lambda _: None) -> None:
        """Mirror until stopped or the board is removed; pass a status to `publish` each second."""
        heartbeat = status = hello = 0.0  # the times of the next ones
        while not self._stop.is_set() and self.board.alive:
            now = time.monotonic()
            if now >= heartbeat:
                heartbeat = now + _HEARTBEAT_S
                self._send_heartbeats()
                self._send_queries()
            if now >= hello or hello > now + self._hello_s:
                self._network.send_hello()
                hello = now + self._hello_s
                self._hello_s *= 2
            if now >= status:
                status = now + _STATUS_S
                self._send(self._exchange.ends())
                self._offered.intersection_update(self.board.living())
                publish(self._exchange.status())
            self._exchange.enter_held()
            next_s = min(heartbeat, max(self._look_s, now + _TICK_S)) - time.monotonic()
            changed = self._watch(self._until_due(max(0, next_s)))
            while self._begun:
                self._exchange.begin_sending(self._begun.popitem()[0])
            if not self._offered.issuperset(changed):
                self._offer(changed)
            has_sent = self._send(self._exchange.collect(changed))
            # What other hosts wait for is sent by now: so no message is later for the rest.
            self._exchange.batches_sent()
            self._offer()
            self._keep(changed)
            self._receive_what_is_read()
            self._publish_hosts()
            if has_sent:
                time.sleep(_TICK_S)  # in a wait, a signal's handler could not call `stop`
            elif changed:  # what nobody reads, however often it changes
                time.sleep(self._until_due(_TICK_S))
        changed = self._watch(0)
        self._offer(changed)
        self._send(self._exchange.collect(changed, ignore_rates=True))
        self._exchange.batches_sent()
        self._keep(changed)
        if self.keeper is not None:
            self.keeper.finish(self._store, self._exchange.refuse)

    def stop(self) -> None:
        """Have :meth:`run` send what is left and return, soon."""
        self._stop.set()

    def close(self) -> None:
        """Leave the network; call it when :meth:`run` has returned."""
        self._network.close()

    def wait_for_reply(self, timeout_s: float) -> bool:
        """Ask all hosts until one has sent its messages; return False if none did in time."""
        end = time.monotonic() + timeout_s
        while not self._replied.is_set() and time.monotonic() < end:
            self._network.send_query(self._exchange.query_for_all())
            self._replied.wait(_ASK_S)
        return self._replied.is_set()

    def _until_due(self, most_s: float) -> float:
        """Return the seconds until something is to be sent, or `most_s` if that is later."""
        due_ns = self._exchange.due_ns()
        return most_s if due_ns is None else min(most_s, max(0, due_ns / 1e9 - time.monotonic()))

    def _receive_what_is_read(self) -> None:
        now, readings = time.monotonic(), self.board.readings
        if readings != self._readings:
            self._hosts = None  # to a new reader, they are published anew
        if readings != self._readings or now >= self._look_s:
            self._readings, self._look_s = readings, now + _READ_S
            slots = self.board.read_slots()
            self._network.hosts.look(HOSTS.name in slots)
            if not self.settings.eager:
                self._network.receive(self._exchange.read(slots))
                self._send_queries()
                if not self._exchange.interest.is_complete:
                    self._look_s = now

    def _publish_hosts(self) -> None:
        """Publish the names of the hosts that can be reached, while a process reads them."""
        hosts = self._network.hosts.names
        if hosts is not None and hosts != self._hosts:
            with suppress(WhiteboardError):  # too many, or no room: mirroring goes on without
                self.board.add_message(HOSTS, Hosts(hosts))
        self._hosts = hosts

    def _offer(self, changed: Sequence[str] = ()) -> None:
        """Offer new groups to other hosts, before any message of theirs is sent or withheld."""
        offered = self._network.offer(self._exchange.groups(changed))
        self._offered.update(changed)
        for group in offered:
            self._exchange.begin_sending(group)
        if offered:
            self._look_s = 0.0  # what is sent to a named host's own slots is read there
            self._publish_folders()

    def _publish_folders(self) -> None:
        """Publish the folders of a named host's own slots, for others that look at all of them."""
        if not self._naming.host:
            return
        with suppress(WhiteboardError):  # too many, or no room: mirroring goes on without
            names = [name for name in self.board.living() if self._leaves(name)]
            own = (self._naming.wire(name) for name in names if self._naming.is_own(name))
            folders = {wire.rpartition("/")[0] for wire in own if wire is not None}
            self.board.add_message(folders_slot(), Folders(tuple(sorted(folders))))

    def _keep(self, changed: list[str]) -> None:
        if self.keeper is not None:
            self.keeper.follow(changed, self._store, time.monotonic(), self._exchange.refuse)

    def _send(self, batches: list[Packet]) -> bool:
        for packet in batches:
            self._network.send_batch(packet)
        return bool(batches)

    def _send_heartbeats(self) -> None:
        for packet in self._exchange.heartbeats():
            self._network.send_heartbeat(packet)

    def _send_queries(self) -> None:
        for query in self._exchange.queries():
            self._network.send_query(query)

    def refusals(self) -> list[str]:
        """List the kinds of what was refused, the most frequent first."""
        return [refusal.what for refusal in self._exchange.status().refused]

    # ---- In the network's threads -----------------------------------------------------------

    def receive_link(self, to_router: bool) -> None:
        """Announce this host to one that has just connected, so that it queries this one."""
        self._stop.wait(_SETTLE_S)
        self._exchange.connect(to_router=to_router)
        self._hello_s = _HEARTBEAT_S
        self._network.send_hello()
        self._send_heartbeats()
        self._send_queries()

    def receive_foreigner(self) -> None:
        """Greet more often, so that a host with which nothing is exchanged reports the reason."""
        self._hello_s = min(self._hello_s, _FOREIGN_S)

    def receive_reader(self, group: str) -> None:
        """Handle a group's first reader; Zenoh may hold locks here, so this takes none."""
        self._begun[group] = None

    def receive(self, data: bytes, name: str, group: str, *, is_beat: bool) -> None:
        """Handle a batch or a heartbeat."""
        exchange = self._exchange
        handle = exchange.receive_heartbeat if is_beat else exchange.receive_batch
        handle(data, name, group)
        self._send_queries()

    def end_reply(self, query: Query, *, complete: bool) -> None:
        """Handle the end of a reply."""
        self._exchange.end_reply(query, complete=complete)
        if complete and query.source == EVERY_HOST:  # not only for one group
            self._replied.set()


def _wall_ns(stamp_ns: int) -> int:
    """Convert a stamp of the monotonic clock to the time since 1970; never in the future."""
    return time.time_ns() - max(0, time.monotonic_ns() - stamp_ns)
