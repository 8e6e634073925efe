"""One host's part: what it sends of its board, and what it makes of what others send.

It knows no network, and no time of its own: bytes come in and go out, and time is passed in. So the
daemon, a connected process and the simulation run the same code.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import msgspec

from ..errors import BoardClosedError, WhiteboardError
from ..messages.llfsm import BELL, REQUESTS, Bell, MirrorStatus
from .merge import Version
from .pace import Pace
from .peers import Peers
from .refusals import Refusals
from .settings import Settings, matcher
from .store import Cell, Outcome, Refused, Store
from .wire import Ask, Batch, Beat, Declaration, Value, batches, decoder, encode

__all__ = ["Exchange", "Question"]

T = TypeVar("T")

_READ_BATCH = decoder(Batch)
_READ_BEAT = decoder(Beat)
_READ_ASK = decoder(Ask)
_FLOOD = 2  # times the rate of a slot: what comes more often is held back
_TOLD = 50  # hosts, and kinds of refusals, in a status
_PUZZLES = 4096  # types of senders that are kept in mind


class Question(NamedTuple):
    """Something to ask of another host."""

    host: int
    gaps: int  # to be given back with the answer
    data: bytes


@dataclass
class _Totals:
    """What the status tells."""

    left: int = 0
    entered: int = 0
    conflicts: int = 0
    held_back: int = 0
    at_ns: int = 0


class _Way:
    """The way of a slot between the board and the other hosts."""

    __slots__ = ("arrivals", "cell", "departures", "enters", "leaves", "sent")

    def __init__(self, cell: Cell, leaves: bool, enters: bool, pause_ns: int) -> None:
        self.cell = cell
        self.leaves = leaves
        self.enters = enters
        self.departures = Pace(pause_ns)
        self.arrivals = Pace(pause_ns // _FLOOD)
        self.sent: Version | None = None


class _Held(NamedTuple):
    """A message that came too soon after others of its slot."""

    sender: int
    way: _Way
    value: Value


class Exchange:
    """What a board sends and takes. Threads may share it.

    Args:
        store: the board, with versions.
        settings: what leaves and enters, and how often.
        now_ns: a clock that never goes back.
        wall_ns: the time since 1970, as the host has it.

    """

    def __init__(
        self,
        store: Store,
        settings: Settings,
        now_ns: Callable[[], int],
        wall_ns: Callable[[], int],
    ) -> None:
        self._store = store
        self._settings = settings
        self._now_ns = now_ns
        self._wall_ns = wall_ns
        self._pause_ns = settings.pause_ns()
        self._leaves = matcher(settings.leave)
        self._enters = matcher(() if settings.read_only else settings.enter)
        self._lock = threading.RLock()
        self._born = wall_ns()
        self._number = 0
        self._ways: dict[str, _Way] = {}
        self._changed: dict[str, _Way] = {}  # in the order of the changes
        self._held: dict[str, _Held] = {}
        self._flood_ns = 0  # until when a message that enters may be held back
        self._puzzling: set[str] = set()  # slots of which a sender's type has to be asked for
        self._clashes: dict[tuple[str, int], str] = {}  # by slot and type
        self._peers = Peers()
        self._refusals = Refusals()
        self._totals = _Totals()
        self._told = _Totals(at_ns=now_ns())

    # ---- What goes out ----------------------------------------------------------------------

    def collect(self, slots: Iterable[str] = (), *, all_of_it: bool = False) -> list[bytes]:
        """Return what is to be sent: of each slot that has news and may leave, the newest message.

        `slots` may have news since the last call; `all_of_it` means what has left just now, too.
        """
        with self._lock:
            store, changed = self._store, self._changed
            for name in slots:
                way = self._ways.get(name) or self._way_if_usable(name)
                if way is not None and way.leaves and way.cell.bound.count != way.cell.count:
                    changed[name] = way
            if store.news:
                ways = {name: self._way(name) for name in store.news}
                changed.update((name, way) for name, way in ways.items() if way.leaves)
            now_ns, values, declarations = self._now_ns(), [], []
            for name, way in list(changed.items()):
                if now_ns < way.departures.due_ns and not all_of_it:
                    continue
                del changed[name]
                value = store.latest(way.cell)
                if value is None or value.version.host != store.host or value.version == way.sent:
                    continue
                if way.sent is None:
                    declarations.append(store.declaration(way.cell))
                way.sent = value.version
                way.departures.passed(now_ns)
                values.append(value)
            store.news.clear()  # all of it is among these, or waits
            self._totals.left += len(values)
            return self._pack(values, declarations) if values else []

    def sent(self) -> None:
        """Take note that what was collected is on its way."""
        with self._lock:
            self._store.note()

    def _way(self, name: str) -> _Way:
        """Return the way of a slot that is on the board."""
        way = self._ways.get(name)
        if way is None:
            leaves, enters, pause_ns = self._leaves(name), self._enters(name), self._pause_ns(name)
            way = self._ways[name] = _Way(self._store.cell(name), leaves, enters, pause_ns)
        return way

    def _way_if_usable(self, name: str) -> _Way | None:
        """Return the way of a slot, or None if its record on the board makes no sense."""
        try:
            return self._way(name)
        except Refused as refused:
            self._refusals.add(f"unusable: {name}", str(refused))
            return None

    def _pack(
        self, values: list[Value], declarations: list[Declaration], *, counted: bool = True
    ) -> list[bytes]:
        packed = []
        for part in batches(values):
            self._number += counted
            declared: tuple[Declaration, ...] = ()
            if declarations:
                names = {value.slot for value in part}
                declared = tuple(d for d in declarations if d.slot in names)
            head = self._store.host, self._born, self._number, self._wall_ns()
            packed.append(encode(Batch(*head, tuple(part), declared)))
        return packed

    def beat(self) -> bytes:
        """Return a sign of life."""
        with self._lock:
            name = socket.gethostname()[:255]
            return encode(Beat(self._store.host, self._born, self._number, self._wall_ns(), name))

    def questions(self) -> list[Question]:
        """Return what is to be asked now."""
        with self._lock:
            if self._settings.read_only or not self._settings.enter:
                return []
            peers = self._peers.to_ask(self._now_ns())
            data = encode(Ask(tuple(self._known()))) if peers else b""
            return [Question(peer.sender, peer.gaps, data) for peer in peers]

    def _known(self) -> list[tuple[str, Version]]:
        """Return the versions of what others may know of."""
        shared = (
            (name, self._store.version(way.cell))
            for name, way in self._all_ways()
            if (way.leaves or way.enters) and name not in self._puzzling
        )
        known = [(name, version) for name, version in shared if version is not None]
        self._store.note()
        return known

    def _all_ways(self) -> list[tuple[str, _Way]]:
        ways = ((of.name, self._way_if_usable(of.name)) for of in self._store.board.slots())
        return [(name, way) for name, way in ways if way is not None]

    def answer(self, data: bytes) -> list[bytes]:
        """Return the answer to another host's question: what is newer here."""
        with self._lock:
            ask = self._read(_READ_ASK, data, "question")
            if ask is None:
                return []
            known, store = dict(ask.known), self._store
            newer = [
                way.cell
                for name, way in self._all_ways()
                if way.leaves
                and (version := store.version(way.cell)) is not None
                and (name not in known or version > known[name])
            ]
            values = [value for value in map(store.latest, newer) if value is not None]
            store.note()
            return self._pack(values, list(map(store.declaration, newer)), counted=False)

    # ---- What comes in ----------------------------------------------------------------------

    def hear(self, data: bytes) -> None:
        """Take a batch."""
        with self._lock:
            batch = self._read(_READ_BATCH, data, "batch")
            if batch is not None and batch.sender != self._store.host:
                self._take(batch)
                self._peers.hear(batch, self._now_ns(), self._wall_ns())

    def hear_beat(self, data: bytes) -> bool:
        """Take a sign of life; True if it is the first one of that host."""
        with self._lock:
            beat = self._read(_READ_BEAT, data, "beat")
            if beat is None or beat.sender == self._store.host:
                return False
            return self._peers.hear(beat, self._now_ns(), self._wall_ns())

    def hear_answer(self, data: bytes) -> None:
        """Take a part of an answer."""
        with self._lock:
            batch = self._read(_READ_BATCH, data, "answer")
            if batch is not None:
                self._take(batch)

    def answered(self, question: Question, *, whole: bool = True) -> None:
        """Take note that all parts of an answer have come, or that none will."""
        with self._lock:
            self._peers.answered(question.host, question.gaps if whole else 0)

    def _read(self, read: msgspec.msgpack.Decoder[T], data: bytes, what: str) -> T | None:
        try:
            return read.decode(data)
        except (msgspec.DecodeError, ValueError, RecursionError) as error:
            self._refusals.add(f"malformed {what}", f"a {what} that is none: {error}")
            return None

    def _take(self, batch: Batch) -> None:
        declared = {d.slot: d for d in batch.declarations} if batch.declarations else {}
        for value in batch.values:
            name = value.slot
            try:
                way = self._ways.get(name)
                if way is None or way.cell.kind != value.kind or not way.enters:
                    way = self._meet(batch.sender, value, declared.get(name))
                if way is not None:
                    self._enter(batch.sender, way, value)
            except BoardClosedError:
                return
            except (Refused, WhiteboardError) as error:
                self._refuse(batch.sender, name, error)

    def _meet(self, sender: int, value: Value, declaration: Declaration | None) -> _Way | None:
        """Return the way of a slot, made if need be, if the sender's type is the board's.

        None if it may not enter, or the sender has to be asked what it is.
        """
        name = value.slot
        if not self._enters(name):
            why = "the board is read-only" if self._settings.read_only else "it is not listed"
            self._refusals.add(f"{why}: {name}", f"slot {name!r}: {why}")
            return None
        if declaration is not None:
            self._puzzling.discard(name)
            if not self._store.has(name):
                self._make(declaration)
        if name in self._ways or self._store.has(name):
            way = self._way(name)
            if way.cell.kind == value.kind:
                return way
            if declaration is not None and len(self._clashes) < _PUZZLES:
                self._clashes[name, value.kind] = self._store.clash(way.cell, declaration)
            clash = self._clashes.get((name, value.kind))
            if clash is not None:
                raise Refused(clash)
        if len(self._puzzling) < _PUZZLES:
            self._puzzling.add(name)
            self._peers.miss(sender)
        return None

    def _make(self, declaration: Declaration) -> None:
        if declaration.capacity > self._settings.largest:
            raise Refused(
                f"slot {declaration.slot!r}: its capacity is {declaration.capacity} bytes, "
                f"more than {self._settings.largest} do not enter here"
            )
        self._store.declare(declaration)

    def _refuse(self, sender: int, slot: str, error: Refused | WhiteboardError) -> None:
        why = f"from {sender:016x}" if isinstance(error, Refused) else "no room"
        self._refusals.add(f"{why}: {slot}", str(error))

    def _enter(self, sender: int, way: _Way, value: Value) -> None:
        """Let a message enter, or hold it back if its slot comes too often."""
        now_ns, slot = self._now_ns(), value.slot
        if now_ns < way.arrivals.due_ns:
            self._totals.held_back += 1
            held = self._held.get(slot)
            if held is None or held.value.version < value.version:
                self._held[slot] = _Held(sender, way, value)
            return
        outcome = self._store.enter(way.cell, value)
        if outcome is Outcome.OLDER:
            self._totals.conflicts += 1
        elif outcome is Outcome.ENTERED:
            way.arrivals.passed(now_ns)
            self._flood_ns = max(self._flood_ns, way.arrivals.due_ns)
            self._totals.entered += 1
            if slot.startswith(REQUESTS):  # its bell is not mirrored: it might ring too early
                self._store.board.add_message(BELL, Bell())

    def enter_held(self) -> None:
        """Let those enter that were held back long enough."""
        if not self._held:
            return
        with self._lock:
            now_ns = self._now_ns()
            for slot, held in list(self._held.items()):
                if held.way.arrivals.due_ns <= now_ns:
                    del self._held[slot]
                    try:
                        self._enter(*held)
                    except (Refused, WhiteboardError) as error:
                        self._refuse(held.sender, slot, error)

    def refuse(self, what: str, why: str) -> None:
        """Take note of something that was refused before it came here."""
        with self._lock:
            self._refusals.add(f"{what}: {why}", f"{what}: {why}")

    # ---- How it is --------------------------------------------------------------------------

    def due_ns(self) -> int | None:
        """Return when something may leave or enter that may not now; None if there is nothing."""
        with self._lock:
            if not (self._changed or self._held or self._flood_ns):
                return None
            due = [way.departures.due_ns for way in self._changed.values()]
            due += [held.way.arrivals.due_ns for held in self._held.values()]
            if self._now_ns() < self._flood_ns:
                due.append(self._flood_ns)
            else:
                self._flood_ns = 0
            return min(due, default=None)

    def status(self) -> MirrorStatus:
        """Describe it; rates are of the time since the last description."""
        with self._lock:
            now_ns, totals, before = self._now_ns(), self._totals, self._told
            seconds = max((now_ns - before.at_ns) / 1e9, 1e-9)
            self._told = replace(totals, at_ns=now_ns)
            return MirrorStatus(
                host=f"{self._store.host:016x}",
                pid=os.getpid(),
                slots=sum(way.leaves for _, way in self._all_ways()),
                left=totals.left,
                entered=totals.entered,
                leave_rate=round((totals.left - before.left) / seconds, 1),
                enter_rate=round((totals.entered - before.entered) / seconds, 1),
                conflicts=totals.conflicts,
                held_back=totals.held_back,
                peers=tuple(peer.status(now_ns) for peer in self._peers)[:_TOLD],
                refused=self._refusals.report()[:_TOLD],
            )
