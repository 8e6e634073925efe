"""Messages of other hosts on their way to the board: checked, held to their rate, and added.

A message passes these gates, in order: it can be decoded; its slot has a name here (see
:mod:`.naming`); its sender may add to that (`access`); the slot has a route, by which messages
enter, and the sender's type of it is the board's; its version is not too far ahead of the clock;
its slot is not over its rate; the slot holds it; it is newer than the board's. One that fails is
refused alone, counted under its kind, and logged once for each kind.

A last will is a message whose values a guard of this host posts one day, to slots that it names. So
it passes the same gates for each of them: what its sender may not post itself is taken out. And a
request to override a sensor feeds a machine a message for a slot that this host does not know: only
who may add to all slots may send it.

A slot that the board does not have is made from its declaration, which a sender adds to the first
message; if that batch was lost, the slot is `unknown` until a query is answered, with declarations.

Nothing a sender does may cost this host more than the sender's quota: a message is charged before
it is looked at, a declaration by its length, a new slot by its memory, and what could not be used
before is not tried again. The route of a slot is looked up by its name once, and then kept: names,
directions, rates.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Iterator, Set
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import msgspec
from msgspec.structs import replace

from llfsm.whiteboard.errors import BoardClosedError, WhiteboardError
from llfsm.whiteboard.messages.llfsm import BELL, REQUESTS, WILLS, Bell, LastWill, MachineRequest
from llfsm.whiteboard.mirror.batches import (
    Declaration,
    ReceivedBatch,
    Value,
    Version,
    decoder,
    footprint,
)
from llfsm.whiteboard.mirror.groups import ENDED, EVERY_GROUP, group_of
from llfsm.whiteboard.mirror.naming import Naming
from llfsm.whiteboard.mirror.peers import Peers, Source
from llfsm.whiteboard.mirror.quotas import Gone, Quotas, RateLimit, Refusals, Refused
from llfsm.whiteboard.mirror.settings import Settings, matcher
from llfsm.whiteboard.mirror.store import Cell, Outcome, Store
from llfsm.whiteboard.slot_names import OWN, is_own

T = TypeVar("T")
_VALUES = decoder(Value)
_DECLARATIONS = decoder(Declaration)
_WILL = msgspec.msgpack.Decoder(LastWill)
_REQUEST = msgspec.msgpack.Decoder(MachineRequest)
_ANY_SLOT = secrets.token_hex()  # which stands for those that nobody has made yet
_EARLY_NS = 5_000_000  # by which a message may pass before its time, for jitter
_BURST = 2  # arrivals may come at this multiple of the slot's rate; more are held back
_MAX_UNKNOWN = 4096  # types of senders to keep track of
_MAX_DECLARATION = 1 << 20  # bytes, as of a schema on a board
_BYTES_OF_TIME = 64  # of a declaration cost as much time as a message, at least
_MAX_REASON = 1000  # characters kept of why a slot cannot be used
_NAMES_NS = 50_000_000  # between two looks for an unknown name: each reads the whole board
_NOTHING = matcher(())
_DAY_NS = 86_400 * 10**9


class Route:
    """The way of a slot's messages between the board and other hosts: directions and rates."""

    __slots__ = ("arrivals", "cell", "departures", "enters", "group", "leaves", "sent", "wire")

    def __init__(self, cell: Cell, wire: str, leaves: bool, enters: bool, period_ns: int) -> None:
        self.cell = cell
        self.wire = wire
        """The slot's name for other hosts."""
        self.group = group_of(wire)
        self.leaves = leaves
        self.enters = enters
        self.departures = RateLimit(period_ns, min(_EARLY_NS, period_ns))
        often_ns = period_ns // _BURST
        self.arrivals = RateLimit(often_ns, min(_EARLY_NS, often_ns))
        self.sent: Version | None = None
        """Of the message that has left last."""


class Routes:
    """The routes of the slots that are on a board."""

    def __init__(self, store: Store, settings: Settings, refusals: Refusals) -> None:
        self.store = store
        self.settings = settings
        self.refusals = refusals
        self.naming = Naming(settings.as_, settings.fleet)
        """Converts the names of slots here into those elsewhere, and back."""
        self._period_ns = settings.period_ns()
        self.leaves = matcher(settings.leave)
        """Checks that a slot of that name may be sent to other hosts."""
        self.enters = matcher(() if settings.read_only else settings.enter)
        """Checks that other hosts may add to a slot of that name."""
        self.known: dict[str, Route] = {}
        """The routes that were asked for so far."""
        self._groups: dict[str, list[tuple[str, Route]]] = {}
        self.offered: dict[str, bool] = {}
        """The groups that have messages which may leave; True for those about machines."""

    def to_receive(self, read: Iterable[str]) -> set[str]:
        """Return the groups of slots that are read and may enter, and of a named host's own slots.

        So messages to its own slots arrive without a reader, also in slots that have none yet.
        """
        if self.naming.host:
            names = self.store.board.living()
            read = {*read, *filter(self.naming.is_own, names)}
        wires = map(self.naming.wire, filter(self.enters, read))
        return {group_of(wire) for wire in wires if wire is not None}

    def get(self, name: str) -> Route:
        """Return the route of a slot on the board; raise `Refused` if its record is unusable."""
        route = self.known.get(name)
        if route is None:
            leaves, enters = self.leaves(name), self.enters(name)
            wire = self.naming.wire(name)
            if wire is None:
                if leaves or enters:
                    self.refusals.add(f"no name for others: {name}", self.naming.why_none(name))
                wire, leaves, enters = name, False, False
            cell, period = self.store.cell(name), self._period_ns(name)
            route = self.known[name] = Route(cell, wire, leaves, enters, period)
            self._groups.setdefault(route.group, []).append((name, route))
        return route

    def take_gone(self) -> list[Route]:
        """Forget the routes of slots whose names were given up here, and return them."""
        gone = self.known.keys() - set(self.store.board.living())
        routes = [self.known[name] for name in gone]
        self.forget(gone)
        return routes

    def forget(self, names: Set[str]) -> None:
        """Forget the routes of some slots: in a life, more names come and go than fit."""
        groups = {self.known.pop(name).group for name in names if name in self.known}
        self.store.forget(names)
        for group in groups:
            left = [(name, route) for name, route in self._groups[group] if name not in names]
            self._groups[group] = left
            if not left:
                del self._groups[group]
                self.offered.pop(group, None)

    def usable(self, name: str) -> Route | None:
        """Return the route of a slot, or None, counted, if its record is unusable."""
        try:
            return self.known.get(name) or self.get(name)
        except Gone:
            return None
        except Refused as refused:
            self.refusals.add(f"unusable: {name}", str(refused))
            return None

    def offered_by(self, name: str) -> Route | None:
        """Return the route of a slot with a message, whose group is offered if it may leave."""
        route = self.known.get(name) or self.usable(name)
        if route is not None and route.leaves:
            self.offered[route.group] = name.startswith(OWN)
            self.offered[ENDED] = False
        return route

    def in_order(self, groups: Iterable[str]) -> list[str]:
        """Sort groups, those about machines first.

        A machine leaves its will before it commands anything; so it does on other hosts.
        """
        return sorted(groups, key=lambda group: not self.offered[group])

    def of(self, group: str) -> list[tuple[str, Route]]:
        """Return the usable routes of a group, with the slots' names: those asked for before."""
        if group != EVERY_GROUP:
            return list(self._groups.get(group, ()))
        routes = ((name, self.usable(name)) for name in self.store.board.living())
        return [(name, route) for name, route in routes if route is not None]


class _Held(NamedTuple):
    """A message that came too soon after the previous one of its slot."""

    source: Source
    route: Route
    value: Value


@dataclass(eq=False)
class Arrivals:
    """Adds other hosts' messages to the board, for one thread at a time.

    Of the clocks, `now_ns` is monotonic and `wall_ns` the host's: the time since 1970.
    """

    routes: Routes
    peers: Peers
    quotas: Quotas
    now_ns: Callable[[], int]
    wall_ns: Callable[[], int]

    def __post_init__(self) -> None:
        self._store, self._refusals = self.routes.store, self.routes.refusals
        self._settings = settings = self.routes.settings
        self._ahead_ns = settings.ahead_ns
        self._is_renaming = bool(self.routes.naming.host)
        self._access = {name: matcher(globs) for name, globs in settings.access.items()}
        self._held: dict[str, _Held] = {}
        self._busy_ns: float = 0  # the time until which an arriving message may be held back
        self.unknown: set[str] = set()
        """Slots whose type at a sender has to be queried."""
        self._names: set[str] = set()  # of the board's slots, as read
        self._names_ns = 0  # the time from which they may be read again
        self.entered = 0
        self.conflicts = 0
        self.held_back = 0

    def steps(self, source: Source, batch: ReceivedBatch) -> Iterator[None]:
        """Add the messages of a batch, one in each step; refuse those that cannot enter."""
        account = self.quotas.account(source.name)
        declared = {}
        for raw in batch.declarations:
            size = memoryview(raw).nbytes
            account.charge(self.now_ns(), messages=1 + size // _BYTES_OF_TIME)
            if size > _MAX_DECLARATION:
                self._refusals.add("a declaration that is too long", "a declaration is too long")
            elif (sent := self._decode(_DECLARATIONS, raw, "declaration")) is not None:
                declaration = self.routes.naming.arriving(sent)
                if declaration is not None:
                    declared[declaration.slot] = declaration
            yield
        for raw in batch.values:
            now_ns = self.now_ns()
            account.charge(now_ns, messages=1)
            value = self._decode(_VALUES, raw, "message")
            if self._is_renaming:
                value = self._here(value)
            if value is not None and (not self._access or self._may_add(source, value.slot)):
                try:
                    if value.payload:
                        self._add(source, value, declared.get(value.slot), now_ns)
                    else:
                        self._give_up(source, value)
                except BoardClosedError:
                    return
                except (Refused, WhiteboardError) as error:
                    self._refuse(source, value.slot, error)
            yield

    def _add(
        self, source: Source, value: Value, declaration: Declaration | None, now_ns: int
    ) -> None:
        end = self._store.ended.get(value.slot)
        if end is not None and value.version <= end:
            self.conflicts += 1
            return
        route = self.routes.known.get(value.slot)
        if route is None or route.cell.kind != value.kind or not route.enters:
            route = self._find_route(source, value, declaration)
        if route is not None and self._is_timely(source, value):
            if value.slot.startswith(WILLS):
                value = self._permitted(source, value)
            if value.slot.startswith(REQUESTS) and not self._may_request(source, value):
                return
            self._enter(source, route, value, now_ns)

    def _give_up(self, source: Source, value: Value) -> None:
        """Give up a name that its host has given up, unless a newer message has come since."""
        name = value.slot
        if not (self.routes.enters(name) and self._is_timely(source, value)):
            return
        self._store.note_end(name, value.version)
        held = self._held.get(name)
        if held is not None and held.value.version <= value.version:
            del self._held[name]  # it would take the name back
        route = self._existing(name)
        if route is None:
            return
        cell = route.cell
        version = self._store.version(cell)
        if version is not None and version <= value.version:
            self._store.board.vacate(cell.slot)
            self.routes.forget({name})
            self.quotas.give_back(name)

    def _may_add(self, source: Source, slot: str) -> bool:
        """Check that the sender is listed for a slot in `access`; count a refusal if not."""
        if self._access.get(source.name, _NOTHING)(slot):
            return True
        self._refusals.add(f"from {source}: {slot}", f"slot {slot!r}: {source} may not add to it")
        return False

    def _permitted(self, source: Source, value: Value) -> Value:
        """Take those values out of a last will that its sender may not post itself."""
        try:
            will = _WILL.decode(value.payload)
        except (msgspec.DecodeError, ValueError):  # nobody can execute it
            return value
        naming = self.routes.naming
        kept = []
        for each in will.values:
            local = each.slot if naming.is_own(value.slot) else naming.local(each.slot)
            if local is None or self._may_post(source, local):
                kept.append(each)  # one without a name here is for others
            else:
                what = f"last will {value.slot!r}: {source} may not add to {local!r} in it"
                self._refusals.add(f"in a last will from {source}: {local}", what)
        if len(kept) == len(will.values):
            return value
        will = replace(will, values=tuple(kept))
        return replace(value, payload=msgspec.msgpack.encode(will))

    def _may_request(self, source: Source, value: Value) -> bool:
        """Check a request that gives a machine a message; count a refusal if its sender may not."""
        try:
            if _REQUEST.decode(value.payload).action != "override":
                return True
        except (msgspec.DecodeError, ValueError):  # nobody can obey it
            return True
        for slot in (_ANY_SLOT, *self._store.board.living()):
            if not is_own(slot) and not self._may_post(source, slot):
                named = "all slots" if slot == _ANY_SLOT else repr(slot)
                what = f"request {value.slot!r}: {source} may not override, nor add to {named}"
                self._refusals.add(f"an override from {source}", what)
                return False
        return True

    def _may_post(self, source: Source, slot: str) -> bool:
        access = self._access.get(source.name, _NOTHING) if self._access else None
        return bool(self.routes.enters(slot)) and (access is None or bool(access(slot)))

    def _here(self, sent: Value | None) -> Value | None:
        """Give a message the name of its slot here; return None, counted, if it has none."""
        value = None if sent is None else self.routes.naming.arriving(sent)
        if sent is not None and value is None:
            self._refusals.add(
                "slots of no host in `fleet`",
                f"slot {sent.slot!r}: no host of `fleet` has it, so it has no name here",
            )
        return value

    def _decode(self, of: msgspec.msgpack.Decoder[T], raw: msgspec.Raw, what: str) -> T | None:
        try:
            return of.decode(raw)
        except (msgspec.DecodeError, ValueError, RecursionError) as error:
            self._refusals.add(f"malformed {what}", f"malformed {what}: {error}")
            return None

    def _find_route(
        self, source: Source, value: Value, declaration: Declaration | None
    ) -> Route | None:
        """Return the route of a slot, made if necessary; None for a message that waits or may not.

        It may not enter, or has to wait until the sender was queried for the slot's type. Raise
        `Refused` if the slot cannot be made, or the sender's type is not the board's.
        """
        name = value.slot
        if not self.routes.enters(name):
            why = "the board is read-only" if self._settings.read_only else "not listed"
            self._refusals.add(f"{why}: {name}", f"slot {name!r}: {why}")
            return None
        route = self._existing(name)
        if route is not None and route.cell.kind == value.kind:
            self.unknown.discard(name)
            return route
        if route is None and value.version.host == self._store.host:
            return None  # the name was given up here since
        failure = self.quotas.account(source.name).failure(name, value.kind)
        if failure is not None:
            raise Refused(failure)
        if declaration is None:
            if len(self.unknown) < _MAX_UNKNOWN:
                self.unknown.add(name)
                self.peers.miss(source)
            return None
        self.unknown.discard(name)
        self._make(source, value.kind, declaration, exists=route is not None)
        route = self.routes.get(name)
        if route.cell.kind != value.kind:
            raise Refused(f"slot {name!r}: the message is not of the type that its sender declares")
        return route

    def _existing(self, name: str) -> Route | None:
        """Return the route of a slot that is on the board, or None if it is not."""
        if self._exists(name):
            try:
                return self.routes.get(name)
            except Gone:
                self._names.discard(name)
        return None

    def _exists(self, name: str) -> bool:
        """Check that a slot is on the board, or was when all names were read last."""
        if name in self.routes.known or name in self._names:
            return True
        now_ns = self.now_ns()
        if now_ns >= self._names_ns:
            self._names_ns = now_ns + _NAMES_NS
            self._names = {info.name for info in self._store.board.slots()}
        return name in self._names

    def _make(self, source: Source, kind: int, declaration: Declaration, *, exists: bool) -> None:
        """Make a slot. Raise `Refused` if that fails, or if it exists with another type."""
        name = declaration.slot
        if declaration.capacity > self._settings.largest:
            raise Refused(
                f"slot {name!r}: its capacity of {declaration.capacity} bytes exceeds this host's "
                f"limit of {self._settings.largest}"
            )
        account = self.quotas.account(source.name)
        memory = 0 if exists else footprint(declaration)
        account.take_slot(name, kind, memory)
        try:
            if exists:
                raise Refused(self._store.clash(self.routes.get(name).cell, declaration))
            self._store.declare(declaration)
        except Refused as refused:
            account.fail(name, kind, memory, str(refused)[:_MAX_REASON])
            raise

    def _is_timely(self, source: Source, value: Value) -> bool:
        """Check that a message's version is at most `ahead_s` ahead of this host's clock."""
        ahead_ns = value.version.time - self.wall_ns()
        if ahead_ns <= self._ahead_ns:
            return True
        # It may be this clock that is wrong: then the message is missed once the clock is set.
        self.peers.miss_later(source, value.version.time - self._ahead_ns)
        self._refusals.add(
            f"from {source}: ahead of this host's clock",
            f"slot {value.slot!r}: its version is {ahead_ns / _DAY_NS:.1f} days ahead of this "
            f"host's clock, more than `ahead_s` permits; set the clocks of both hosts",
        )
        return False

    def _refuse(self, source: Source, slot: str, error: Refused | WhiteboardError) -> None:
        why = f"from {source}" if isinstance(error, Refused) else "no room"
        self._refusals.add(f"{why}: {slot}", str(error))

    def _enter(self, source: Source, route: Route, value: Value, now_ns: int) -> None:
        """Add a message to the board, or hold it back if its slot arrives too often."""
        slot = value.slot
        size, capacity = len(value.payload), route.cell.capacity
        if size > capacity:
            raise Refused(
                f"slot {slot!r}: the message takes {size} bytes, the slot holds {capacity} here"
            )
        if now_ns < route.arrivals.due_ns:
            self.held_back += 1
            held = self._held.get(slot)
            if held is None or held.value.version < value.version:
                self._held[slot] = _Held(source, route, value)
            return
        outcome = self._store.enter(route.cell, value)
        if outcome is Outcome.OLDER:
            self.conflicts += 1
        elif outcome is Outcome.ENTERED:
            route.arrivals.record(now_ns)
            self._busy_ns = max(self._busy_ns, route.arrivals.due_ns)
            self.entered += 1
            if slot.startswith(REQUESTS):  # bells are not mirrored: one might arrive first
                self._store.board.add_message(BELL, Bell())

    def enter_held(self) -> None:
        """Add the messages that were held back long enough."""
        now_ns = self.now_ns()
        for slot, held in list(self._held.items()):
            if held.route.arrivals.due_ns <= now_ns:
                del self._held[slot]
                try:
                    self._enter(*held, now_ns)
                except (Refused, WhiteboardError) as error:
                    self._refuse(held.source, slot, error)

    def due_ns(self) -> list[float]:
        """Return the times at which held messages may enter, or arriving ones at once again."""
        due = [held.route.arrivals.due_ns for held in self._held.values()]
        if self.now_ns() < self._busy_ns:
            due.append(self._busy_ns)
        else:
            self._busy_ns = 0
        return due
