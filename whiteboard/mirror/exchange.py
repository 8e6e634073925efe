"""One host's part: what it sends of its board, and what it makes of what others send.

It knows no network, and no time of its own: bytes come in and go out, and time is passed in. So the
daemon, a connected process and the simulation run the same code.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import msgspec

from ..errors import BoardClosedError, WhiteboardError
from ..messages.llfsm import BELL, REQUESTS, Bell, MirrorStatus
from .merge import Version
from .peers import Peers
from .refusals import Refusals
from .settings import Settings, matcher
from .store import Outcome, Refused, Store
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
        self._changed: dict[str, None] = {}  # in the order of the changes
        self._sent: dict[str, tuple[int, Version]] = {}  # when, and what
        self._held: dict[str, tuple[int, Value]] = {}  # until when
        self._entered_ns: dict[str, int] = {}
        self._flood_ns = 0  # until when a message that enters may be held back
        self._puzzling: set[str] = set()  # slots of which a sender's type has to be asked for
        self._clashes: dict[tuple[str, int], str] = {}  # by slot and type
        self._peers = Peers()
        self._refusals = Refusals()
        self._totals = _Totals()
        self._told = _Totals(at_ns=now_ns())

    # ---- What goes out ----------------------------------------------------------------------

    def change(self, slots: list[str]) -> None:
        """Take note of slots that may have news."""
        with self._lock:
            for slot in slots:
                if self._leaves(slot) and self._store.has_news(slot):
                    self._changed[slot] = None

    def collect(self, *, all_of_it: bool = False) -> list[bytes]:
        """Return what is to be sent: of each slot that has news and may leave, the newest message.

        With `all_of_it`, also of those that have left just now.
        """
        with self._lock:
            self._changed.update(dict.fromkeys(filter(self._leaves, self._store.take_news())))
            if not self._changed:
                return []
            now_ns, values, news = self._now_ns(), [], []
            for slot in list(self._changed):
                sent_ns, sent = self._sent.get(slot, (0, None))
                if sent is not None and not all_of_it and now_ns < sent_ns + self._pause_ns(slot):
                    continue
                del self._changed[slot]
                value = self._latest(slot)
                if value is None or value.host != self._store.host or value.version == sent:
                    continue
                if sent is None:
                    news.append(self._store.declaration(slot))
                self._sent[slot] = now_ns, value.version
                values.append(value)
            self._store.take_news()  # which these are
            self._totals.left += len(values)
            return self._pack(values, news) if values else []

    def _latest(self, slot: str) -> Value | None:
        try:
            return self._store.latest(slot)
        except Refused as refused:
            self._refusals.add(f"unreadable: {slot}", str(refused))
            return None

    def _pack(
        self, values: list[Value], news: list[Declaration], *, counted: bool = True
    ) -> list[bytes]:
        packed = []
        declared = tuple(news)
        for part in batches(values):
            self._number += counted
            names = {value.slot for value in part}
            packed.append(
                encode(
                    Batch(
                        self._store.host,
                        self._born,
                        self._number,
                        self._wall_ns(),
                        tuple(part),
                        tuple(d for d in declared if d.slot in names),
                    )
                )
            )
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

    def _known(self) -> list[tuple[str, int, int]]:
        """Return the versions of what others may know of."""
        names = self._store.names()
        shared = (n for n in names if self._leaves(n) or self._enters(n))
        versions = ((n, self._version(n)) for n in shared if n not in self._puzzling)
        return [(name, *version) for name, version in versions if version is not None]

    def _version(self, slot: str) -> Version | None:
        try:
            return self._store.version(slot)
        except Refused as refused:
            self._refusals.add(f"unreadable: {slot}", str(refused))
            return None

    def answer(self, data: bytes) -> list[bytes]:
        """Return the answer to another host's question: what is newer here."""
        with self._lock:
            ask = self._read(_READ_ASK, data, "question")
            if ask is None:
                return []
            known = {slot: Version(*of) for slot, *of in ask.known}
            names = filter(self._leaves, self._store.names())
            newer = [
                name
                for name in names
                if (version := self._version(name)) is not None
                and (name not in known or version > known[name])
            ]
            values = [value for value in map(self._latest, newer) if value is not None]
            news = [self._store.declaration(value.slot) for value in values]
            return self._pack(values, news, counted=False)

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
        declared = {d.slot: d for d in batch.declarations}
        for value in batch.values:
            name = value.slot
            if not self._enters(name):
                why = "the board is read-only" if self._settings.read_only else "it is not listed"
                self._refusals.add(f"{why}: {name}", f"slot {name!r}: {why}")
                continue
            try:
                if self._meet(value, declared.get(name)):
                    self._enter(value)
                elif len(self._puzzling) < _PUZZLES:
                    self._puzzling.add(name)
                    self._peers.miss(batch.sender)
            except Refused as refused:
                self._refusals.add(f"from {batch.sender:016x}: {name}", str(refused))
            except BoardClosedError:
                return
            except WhiteboardError as error:  # no space left, say
                self._refusals.add(f"no room: {name}", str(error))

    def _meet(self, value: Value, declaration: Declaration | None) -> bool:
        """Make sure that the board has the slot, with the sender's type.

        False if the sender has to be asked what it is.
        """
        store, name = self._store, value.slot
        if declaration is not None:
            self._puzzling.discard(name)
        if not store.knows(name):
            if declaration is None:
                return False
            if not store.has(name):
                self._make(declaration)
        if store.agrees(value):
            return True
        if declaration is not None and len(self._clashes) < _PUZZLES:
            self._clashes[name, value.kind] = store.clash(declaration)
        clash = self._clashes.get((name, value.kind))
        if clash is None:
            return False
        raise Refused(clash)

    def _make(self, declaration: Declaration) -> None:
        if declaration.capacity > self._settings.largest:
            raise Refused(
                f"slot {declaration.slot!r}: its capacity is {declaration.capacity} bytes, "
                f"more than {self._settings.largest} do not enter here"
            )
        self._store.declare(declaration)

    def _enter(self, value: Value) -> None:
        """Let a message enter, or hold it back if its slot comes too often."""
        slot, now_ns = value.slot, self._now_ns()
        due_ns = self._entered_ns.get(slot, 0) + self._pause_ns(slot) // _FLOOD
        if now_ns < due_ns:
            self._totals.held_back += 1
            _, held = self._held.get(slot, (due_ns, value))
            self._held[slot] = due_ns, max(held, value, key=lambda value: value.version)
            return
        outcome = self._store.enter(value)
        if outcome is Outcome.OLDER:
            self._totals.conflicts += 1
        elif outcome is Outcome.ENTERED:
            self._entered_ns[slot] = now_ns
            self._flood_ns = max(self._flood_ns, now_ns + self._pause_ns(slot) // _FLOOD)
            self._totals.entered += 1
            if slot.startswith(REQUESTS):  # its bell is not mirrored: it might ring too early
                self._store.board.add_message(BELL, Bell())

    def enter_held(self) -> None:
        """Let those enter that were held back long enough."""
        if not self._held:
            return
        with self._lock:
            now_ns = self._now_ns()
            for slot, (due_ns, value) in list(self._held.items()):
                if due_ns <= now_ns:
                    del self._held[slot]
                    try:
                        self._enter(value)
                    except WhiteboardError as error:
                        self._refusals.add(f"no room: {slot}", str(error))

    # ---- How it is --------------------------------------------------------------------------

    def due_ns(self) -> int | None:
        """Return when something may leave or enter that may not now; None if there is nothing."""
        with self._lock:
            if not (self._changed or self._held or self._flood_ns):
                return None
            changed = (
                self._sent[slot][0] + self._pause_ns(slot) if slot in self._sent else 0
                for slot in self._changed
            )
            held = [due_ns for due_ns, _ in self._held.values()]
            if self._now_ns() < self._flood_ns:
                held.append(self._flood_ns)
            else:
                self._flood_ns = 0
            return min((*changed, *held), default=None)

    def status(self) -> MirrorStatus:
        """Describe it; rates are of the time since the last description."""
        with self._lock:
            now_ns, totals, before = self._now_ns(), self._totals, self._told
            seconds = max((now_ns - before.at_ns) / 1e9, 1e-9)
            self._told = replace(totals, at_ns=now_ns)
            return MirrorStatus(
                host=f"{self._store.host:016x}",
                pid=os.getpid(),
                slots=sum(map(self._leaves, self._store.names())),
                left=totals.left,
                entered=totals.entered,
                leave_rate=round((totals.left - before.left) / seconds, 1),
                enter_rate=round((totals.entered - before.entered) / seconds, 1),
                conflicts=totals.conflicts,
                held_back=totals.held_back,
                peers=tuple(peer.status(now_ns) for peer in self._peers)[:_TOLD],
                refused=self._refusals.report()[:_TOLD],
            )
