"""A board's hosts as a Zenoh session reaches them: publishing, queries, and tokens of names.

For each group of slots that this host has, there are a publisher of batches, one of heartbeats, and
a queryable; for each group that is read here, a subscriber. Zenoh sends a batch only to hosts that
subscribe, and tells a publisher when the first one does. Which keys they have is in :mod:`.keys`.

Nothing here waits for another host: what cannot be sent at once is dropped, and its number will be
missing. Batches and heartbeats are handled in Zenoh's threads that have received them. A query,
whose answer takes time, and a connection are handled in two threads of ours. Zenoh holds locks of
its own during some calls (a publisher's matching, a token), so those only take a note.

A host with a name declares a token of Zenoh, which lives as long as its session: by these, hosts
find each other's names, and those that have one name by mistake.
"""

from __future__ import annotations

import logging
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from threading import Condition, Thread
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from llfsm.whiteboard.errors import BoardClosedError, NetworkError
from llfsm.whiteboard.mirror.batches import VERSION
from llfsm.whiteboard.mirror.groups import EVERY_GROUP
from llfsm.whiteboard.mirror.keys import Keys, asked_in, board_in, host_in, sender_in, version_in
from llfsm.whiteboard.mirror.peers import EVERY_HOST, Packet, Query
from llfsm.whiteboard.mirror.reconnecting import Reconnector
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.zenoh_config import (
    LEASE_MS,
    certificate_name,
    configure,
    endpoints,
    open_session,
)
from llfsm.whiteboard.mirror.zenoh_internals import (
    callback_in_receiver,
    error_text,
    limit_link,
    listeners,
    use_few_threads,
)

if TYPE_CHECKING:
    import zenoh

T = TypeVar("T")
_ALL_TIMEOUT_S = 2.0  # of those that are asked, one may be dead, and not yet known to be
_MAX_PENDING = 64  # queries that wait to be answered
_MATCHED_S = 0.2  # for which a group that is read counts as such: asking Zenoh delays a message
_OFFERED_AT_ONCE = 64  # groups; a host that makes many must not stop this one from sending
_log = logging.getLogger("llfsm.mirror")


class Receiver(Protocol):
    """Takes whatever arrives from a network, in its threads."""

    def receive_link(self, to_router: bool) -> None:
        """Handle a new connection."""

    def receive_foreigner(self) -> None:
        """Handle a host with which nothing is exchanged: let it know of this one."""

    def receive_reader(self, group: str) -> None:
        """Handle a group's first reader; Zenoh may hold locks of its own."""

    # The name of the other host is the one in its certificate; empty if that is not proven.

    def receive(self, data: bytes, name: str, group: str, *, is_beat: bool) -> None:
        """Handle a batch or a heartbeat."""

    def receive_query(self, data: bytes, name: str, group: str) -> list[bytes]:
        """Handle a query; return the reply, in parts."""

    def receive_reply(self, data: bytes, name: str, group: str) -> None:
        """Handle one part of the reply to a query of ours."""

    def end_reply(self, query: Query, *, complete: bool) -> None:
        """Handle the end of a reply; it is `complete` unless none arrived."""

    def refuse(self, what: str, why: str) -> None:
        """Count something that was refused."""


@dataclass(eq=False)
class Network:
    """The hosts of one board, as a Zenoh session reaches them.

    Its `mode` is ``peer``, or ``client`` for a process that connects to one host and relies on it:
    this tries to for `connect_s` seconds, a peer for ever. The parts of a host's reply are awaited
    for `reply_s`. Raise :class:`.NetworkError` if Zenoh is not installed or opens no session.
    """

    board: str
    host: int
    settings: Settings
    mode: str = "peer"
    connect_s: float = 3.0
    reply_s: float = 5.0

    def __post_init__(self) -> None:
        settings, is_client = self.settings, self.mode == "client"
        use_few_threads()
        try:
            import zenoh
        except ImportError as error:
            raise NetworkError(
                "Zenoh is not installed; install llfsm with it: pip install 'llfsm[hosts]'"
            ) from error
        self._access = settings.access
        config = configure(settings, self.mode)
        self._certificate = certificate_name(config)
        self._keys = Keys(self.board, self.host, self._certificate)
        self.listens = endpoints(config, "listen")
        """The endpoints where other hosts reach this one."""
        before = listeners()
        try:
            self._session: Any = open_session(config, self.connect_s if is_client else math.inf)
        except zenoh.ZError as error:
            where = ", ".join((*self.listens, *endpoints(config, "connect")))
            raise NetworkError(f"cannot open {where}: {error_text(error)}") from error
        new = sorted(listeners() - before)
        self.listens = tuple(_with_port(endpoint, new) for endpoint in self.listens)
        # Never wait for a host that does not read: the receiver notices the missing number. Not
        # express: what several groups have at once shares buffers, of which a connection has two.
        self._outgoing: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.DROP,
            "allowed_destination": zenoh.Locality.REMOTE,
        }
        connects = endpoints(config, "connect")
        self._reconnector = (
            None
            if is_client
            else Reconnector(
                lambda: configure(settings, self.mode), self.listens, connects, self._linked
            )
        )
        self._hello = self._session.declare_publisher(self._keys.hello, **self._outgoing)
        self.hosts = HostTokens(self._session.liveliness(), self._keys, settings)
        """The names of hosts, this one's among them."""
        self._name = settings.as_
        self._batches: dict[str, Any] = {}  # publishers, by group
        self._read_until: dict[str, float] = {}
        self._heartbeats: dict[str, Any] = {}
        self._subscribers: dict[str, Any] = {}
        self._received = callback_in_receiver(self._receive)
        self._queries = _Queries()
        self._declared: list[Any] = []
        self._threads: list[Thread] = []

    def join(self, receiver: Receiver) -> None:
        """Start to receive from other hosts, and to answer them."""
        import zenoh
        from zenoh.handlers import FifoChannel

        self._receiver = receiver
        session, keys = self._session, self._keys
        hello = callback_in_receiver(self._receive_hello)
        links = session.info.declare_link_events_listener(FifoChannel(_MAX_PENDING), history=True)
        self._declared += [
            session.declare_subscriber(
                keys.all_hellos, hello, allowed_origin=zenoh.Locality.REMOTE
            ),
            self._queryable(EVERY_GROUP),
            links,
        ]
        if self._name:
            self.hosts.declare(self._name, receiver.refuse)
        self._serve(self._queries.take, self._answer)
        self._serve(links.handler.recv, self._link)

    def _queryable(self, group: str) -> Any:
        from zenoh.handlers import Callback

        queries = Callback(self._queries.put, indirect=False)
        return self._session.declare_queryable(self._keys.answered(group), queries)

    def offer(self, groups: Iterable[str]) -> list[str]:
        """Make publishers and a queryable for groups that have none; return these groups.

        A few at a time, as each takes a while: call it again for the others.
        """
        new = [group for group in groups if group not in self._batches][:_OFFERED_AT_ONCE]
        if not new:  # at almost every send, of which an import would be a large part
            return new
        from zenoh.handlers import Callback

        for group in new:
            keys, declare = self._keys, self._session.declare_publisher
            batches = declare(keys.batches(group), **self._outgoing)
            self._heartbeats[group] = declare(keys.beats(group), **self._outgoing)
            self._batches[group] = batches

            def begins(status: zenoh.MatchingStatus, group: str = group) -> None:
                if status.matching:
                    self._receiver.receive_reader(group)

            self._declared += [
                self._queryable(group),
                batches.declare_matching_listener(Callback(begins, indirect=False)),
            ]
        return new

    def receive(self, groups: set[str]) -> None:
        """Subscribe to these groups, and to no others."""
        import zenoh

        for group in self._subscribers.keys() - groups:
            self._subscribers.pop(group).undeclare()
        for group in groups - self._subscribers.keys():
            self._subscribers[group] = self._session.declare_subscriber(
                self._keys.received(group), self._received, allowed_origin=zenoh.Locality.REMOTE
            )

    def is_read(self, group: str) -> bool:
        """Check that another host reads a group that this one offers."""
        now, publisher = time.monotonic(), self._batches.get(group)
        if publisher is None or now < self._read_until.get(group, 0.0):
            return publisher is not None
        is_read = bool(publisher.matching_status.matching)
        if is_read:
            self._read_until[group] = now + _MATCHED_S
        return is_read

    def _receive(self, key: str, data: bytes) -> None:
        name, group, is_beat = sender_in(key)
        try:  # noqa: SIM105  a message waits for this, and `suppress` runs two more functions
            self._receiver.receive(data, name if self._access else "", group, is_beat=is_beat)
        except BoardClosedError:  # between the end of the board and that of the network
            pass

    def _receive_hello(self, key: str, _: bytes) -> None:
        version, board = version_in(key), board_in(key)
        if board != self.board:
            self._receiver.refuse(
                f"a host of another board, {board!r}",
                f"this one mirrors {self.board!r}; only boards of one name are mirrored",
            )
        elif version != str(VERSION):
            self._receiver.refuse(
                f"a host with version {version} of the protocol",
                f"this host has version {VERSION}; install the same llfsm on both",
            )
        else:
            return
        self._receiver.receive_foreigner()

    def _serve(self, take: Callable[[], T], handle: Callable[[T], None]) -> None:
        """Handle slow events in a thread of their own, until their source is closed."""
        import zenoh

        def run() -> None:
            while True:
                try:
                    event = take()
                except (zenoh.ZError, EOFError):
                    return
                with suppress(BoardClosedError, zenoh.ZError):  # the board or the asker is gone
                    handle(event)

        # Zenoh would start a thread, too, but the process would wait for that one when it ends.
        self._threads.append(Thread(target=run, name=f"mirror {handle.__name__}", daemon=True))
        self._threads[-1].start()

    def send_batch(self, packet: Packet) -> None:
        """Send a batch to the hosts that read its group."""
        self._batches[packet.group].put(packet.data)

    def send_heartbeat(self, packet: Packet) -> None:
        """Send a heartbeat to the hosts that read its group."""
        self._heartbeats[packet.group].put(packet.data)

    def send_hello(self) -> None:
        """Greet all hosts, also those of other versions and boards."""
        self._hello.put(b"")

    def send_query(self, query: Query) -> None:
        """Send a query to one host or to all; the receiver gets the replies."""
        from zenoh import ConsolidationMode, Locality, QueryTarget
        from zenoh.handlers import Callback

        replied, failed = False, False
        of_all = query.source.host == EVERY_HOST.host

        def receive(reply: zenoh.Reply) -> None:
            nonlocal replied, failed
            if reply.ok is None:  # for example, not all parts have arrived in time
                failed = True
            else:
                replied = True
                answered = asked_in(str(reply.ok.key_expr))
                name = answered.name if self._access and answered is not None else ""
                with suppress(BoardClosedError):
                    data = reply.ok.payload.to_bytes()
                    self._receiver.receive_reply(data, name, query.source.group)

        def end() -> None:
            with suppress(BoardClosedError):
                self._receiver.end_reply(query, complete=replied and (of_all or not failed))

        self._session.get(
            self._keys.query(query.source),
            Callback(receive, end, indirect=False),  # otherwise Zenoh starts a thread a call
            payload=query.data,
            target=QueryTarget.ALL,
            allowed_destination=Locality.REMOTE,
            timeout=_ALL_TIMEOUT_S if of_all else self.reply_s,
            consolidation=ConsolidationMode.NONE,  # otherwise only the last part arrives
        )

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            payload = query.payload
            data = b"" if payload is None else payload.to_bytes()
            asked = asked_in(str(query.key_expr))
            if asked is None:
                return
            name = asked.asker if self._access else ""
            for part in self._receiver.receive_query(data, name, asked.group):
                query.reply(self._keys.answer(asked), part)

    def _link(self, event: zenoh.LinkEvent) -> None:
        from zenoh import SampleKind

        if event.kind == SampleKind.PUT:
            if not limit_link(event.link, LEASE_MS):
                _log.debug("no socket found for %s; it keeps Zenoh's time limits", event.link)
            name = event.link.auth_identifier
            known = *self._access, self._certificate  # its own session introduces hosts
            if self._access and name not in known:
                self._receiver.refuse("a connection", f"`access` does not list {name!r}")
            if self._reconnector is not None:
                self._reconnector.add(event.link)
            self._receiver.receive_link(event.link.zid in self._session.info.routers_zid())
        elif self._reconnector is not None:
            self._reconnector.remove(event.link)

    def _linked(self) -> set[str]:
        return {str(each.zid) for each in self._session.info.links()}

    def close(self) -> None:
        """Leave the network; nothing is received any more.

        What calls back ends first, then what it uses: the session is closed when nothing runs.
        """
        for declared in (*self._declared, *self._subscribers.values()):
            declared.undeclare()
        if self._reconnector is not None:
            self._reconnector.close()
        self.hosts.close()
        self._queries.close()
        for thread in self._threads:
            thread.join()
        for publisher in (self._hello, *self._batches.values(), *self._heartbeats.values()):
            publisher.undeclare()
        self._session.close()


class _Queries:
    """Queues queries to be answered, one of each host: who asks often displaces nobody."""

    def __init__(self) -> None:
        self._waiting: dict[str, zenoh.Query] = {}
        self._closed = False
        self._changed = Condition()

    def put(self, query: zenoh.Query) -> None:
        """Add a query, in place of an earlier one of its host; drop it if too many hosts ask."""
        key = str(query.key_expr)
        with self._changed:
            if key in self._waiting or len(self._waiting) < _MAX_PENDING:
                self._waiting[key] = query
                self._changed.notify()

    def take(self) -> zenoh.Query:
        """Wait for a query; raise EOFError when closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed)
            if self._closed:
                raise EOFError
            return self._waiting.pop(next(iter(self._waiting)))

    def close(self) -> None:
        """Drop the queries that wait, and end the wait for one."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


def _with_port(endpoint: str, listeners: list[tuple[str, int]]) -> str:
    """Replace port 0 in an endpoint of TCP by the one that it got, taken from `listeners`."""
    locator, mark, options = endpoint.partition("?")
    protocol, _, where = locator.partition("/")
    address, _, port = where.rpartition(":")
    if protocol not in ("tcp", "tls") or port != "0" or not listeners:
        return endpoint
    same = [each for each in listeners if each[0] == address.strip("[]")]
    found = (same or listeners)[0]  # an address may be a name
    listeners.remove(found)
    return f"{protocol}/{address}:{found[1]}{mark}{options}"


class HostTokens:
    """The tokens of the hosts of a board; others' are received while somebody looks for them.

    As many are kept as a host may make slots, because programs that show the hosts have slots for
    each: of each certificate if known, else of all.
    """

    def __init__(self, liveliness: Any, keys: Keys, settings: Settings) -> None:
        self._liveliness = liveliness
        self._keys = keys
        self._most = settings.quota.slots
        self._access = settings.access
        self._declared: list[Any] = []
        self._subscriber: Any = None
        self._tokens = defaultdict[str, set[str]](set)
        self._names: tuple[str, ...] = ()
        self._has_changed = True  # since `_names` was made
        self._has_ignored = False  # a token, as there were too many

    def declare(self, name: str, refuse: Callable[[str, str], None]) -> None:
        """Declare the name of this host, and report to `refuse` each other host that has it."""
        import zenoh

        def receive(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT and not self._keys.is_own(str(sample.key_expr)):
                refuse(
                    f"another host that is {name!r}",
                    "slots of both are mixed up; give each host a name of its own (`as`)",
                )

        self._declared += [
            self._subscribe(self._keys.named(name), receive),
            self._liveliness.declare_token(self._keys.alive(name)),
        ]

    def look(self, wanted: bool) -> None:
        """Keep `names` up to date while `wanted`; call it about once a second."""
        has_room = self._has_ignored and min(map(len, [*self._tokens.values()])) < self._most
        if self._subscriber is not None and (has_room or not wanted):
            self._subscriber.undeclare()
            self._subscriber = None
        if wanted and self._subscriber is None:
            self._receive_tokens()

    def _receive_tokens(self) -> None:
        import zenoh

        self._tokens = tokens = defaultdict[str, set[str]](set)
        self._has_changed, self._has_ignored = True, False

        def receive(sample: zenoh.Sample) -> None:
            token = str(sample.key_expr)
            of_one = tokens[host_in(token)[0] if self._access else ""]
            if sample.kind != zenoh.SampleKind.PUT:
                of_one.discard(token)
            elif len(of_one) < self._most:
                of_one.add(token)
            else:
                self._has_ignored = True
            self._has_changed = True

        self._subscriber = self._subscribe(self._keys.named("*"), receive)

    @property
    def names(self) -> tuple[str, ...] | None:
        """The names of the hosts that can be reached; None while nobody looks for them."""
        if self._subscriber is None:
            return None
        if self._has_changed:
            self._has_changed = False
            tokens = [token for of_one in [*self._tokens.values()] for token in of_one.copy()]
            self._names = tuple(sorted({host_in(token)[1] for token in tokens}))
        return self._names

    def close(self) -> None:
        """Withdraw this host's token, and receive no more."""
        self.look(False)
        for declared in self._declared:
            declared.undeclare()

    def _subscribe(self, keys: str, receive: Callable[[zenoh.Sample], None]) -> Any:
        from zenoh.handlers import Callback

        return self._liveliness.declare_subscriber(
            keys, Callback(receive, indirect=False), history=True
        )
