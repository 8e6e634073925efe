"""A host in virtual time and without a network, and what another one sends to it."""

from __future__ import annotations

from typing import Any

import msgspec

from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.mirror.batches import Batch, Declaration, Value, Version
from llfsm.whiteboard.mirror.exchange import Exchange
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.store import Store, VersionLog


class Number(Message, type_name="test/Number"):
    value: int = 0
    text: str = ""


class Text(Message, type_name="test/Text"):
    text: str = ""


NUMBER = Slot("number", Number, capacity=64)


class Part:
    """A host in a test."""

    def __init__(self, host: int = 1, versions: VersionLog | None = None, **settings: Any) -> None:
        self.now_ns = 10**12
        self.board = LocalBoard("board", now_ns=lambda: self.now_ns)
        self.watch = self.board.watcher()
        self.set_ns = 0  # by how much its clock was set
        chosen = msgspec.convert(settings, Settings)
        wall_ns = lambda: self.now_ns + self.set_ns  # noqa: E731
        self.store = Store(
            self.board,
            host,
            lambda stamp_ns: stamp_ns + self.set_ns,
            versions or VersionLog(),
            lambda: wall_ns() + chosen.ahead_ns,
        )
        self.exchange = Exchange(self.store, chosen, lambda: self.now_ns, wall_ns)

    def collect(self) -> list[bytes]:
        return [packet.data for packet in self.exchange.collect(self.watch(0))]

    def get(self, slot: Slot[Any] = NUMBER) -> Any:
        return self.board.get_message(slot)

    def refused(self) -> dict[str, int]:
        return {refusal.what: refusal.count for refusal in self.exchange.status().refused}


def batch(
    number: int = 1,
    slot: Slot[Any] = NUMBER,
    message: Message | bytes | None = None,
    *,
    time: int = 10**12,
    host: int = 2,
    declare: bool = True,
) -> bytes:
    """Make a batch as another host sends it."""
    payload = (
        message if isinstance(message, bytes) else msgspec.msgpack.encode(message or slot.type())
    )
    declaration = Declaration(slot.name, slot.capacity, slot.schema)
    value = Value(slot.name, slot.fingerprint, Version(time, host), payload)
    return msgspec.msgpack.encode(
        Batch(host, 1, number, time, (value,), (declaration,) if declare else ())
    )
