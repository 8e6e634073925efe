"""What a hostile host sends: messages of the mirror whose parts are valid, wrong, huge or many.

Importable from every test: `from hostile_peer import Hostile`.
"""

from __future__ import annotations

import random
import time
from typing import Any

import msgspec

from llfsm.whiteboard import Message, Slot

__all__ = ["Hostile"]

_INTEGERS = (0, 1, -1, 2**31, 2**62 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
_NAMES = ("", "x", "llfsm/mirror", "llfsm/bell", "a/" * 120, "é" * 100, "n\0l", "*", "../x")


class Number(Message, type_name="test/Number"):
    """The type of the slots that exist."""

    value: int = 0
    text: str = ""


_SLOT = Slot("slot", Number)
_FINGERPRINT = _SLOT.fingerprint
_MANY = {f"f{n}": {"type": "integer"} for n in range(3000)}


class Hostile:
    """A source of messages, by a seed.

    Args:
        seed: of the random numbers.
        prefix: of the names of most slots, where it is allowed to add.

    """

    def __init__(self, seed: int, prefix: str) -> None:
        self.random = random.Random(seed)
        self._prefix = prefix
        self._number = 0

    def batch(self) -> bytes:
        """Return a batch, or what resembles one."""
        choose = self.random
        kind = choose.choice(("many", "new", "unknown", "large", "odd", "odd", "bytes"))
        if kind == "bytes":
            return choose.randbytes(choose.choice((0, 1, 40, 5000)))
        if kind == "large":
            slots = [(self._prefix + "large", b"\x92\x01\xc6" + (1 << 20).to_bytes(4, "big"))]
            values = [
                [name, self._kind(), self._version(), p + bytes(1 << 20)] for name, p in slots
            ]
            return self._encode([*self._head(), values, []])
        count = (
            choose.choice((1, 10, 500, 4096, 4097)) if kind == "many" else choose.randrange(1, 20)
        )
        bits = 4 if kind == "many" else 40  # names that are known, or new ones
        names = [self._prefix + str(choose.getrandbits(bits)) for _ in range(min(count, 40))]
        values = [[name, self._kind(), self._version(), self._payload()] for name in names]
        values = (values * (1 + count // len(values)))[:count]  # making each would take the time
        declared = names[:0] if kind == "unknown" else names[:20]
        declarations = [self._declared(name) for name in declared]
        data = [*self._head(), values, declarations]
        return self._encode(self._spoil(data) if kind == "odd" else data)

    def heartbeat(self) -> bytes:
        """Return a heartbeat: of a host that was not heard of, has restarted or misses much."""
        data = [*self._head(), "n" * self.random.choice((0, 255, 256))]
        return self._encode(self._spoil(data) if self.random.random() < 0.2 else data)

    def query(self) -> bytes:
        """Return a query for all there is, for nothing, or in bad form."""
        known = [[name, self._version()] for name in _NAMES[1:4]]
        data: Any = [self.random.choice(([], known, known * 1500))]
        return self._encode(self._spoil(data) if self.random.random() < 0.2 else data)

    def _head(self) -> list[Any]:
        self._number += self.random.choice((1, 1, 1, 2, 1000))
        sender = self.random.choice((7, 7, 7, self.random.getrandbits(62)))
        born = self.random.choice((1, 1, self.random.getrandbits(61)))
        return [sender, born, self._number, time.time_ns()]

    def _version(self) -> list[int]:
        now_ns = time.time_ns()
        near = now_ns + self.random.choice((0, -(10**9), 10**9, 3600 * 10**9))
        return [near if self.random.random() < 0.8 else self.random.choice(_INTEGERS), 7]

    def _kind(self) -> int:
        return _FINGERPRINT if self.random.random() < 0.7 else self.random.getrandbits(63)

    def _payload(self) -> bytes:
        choose = self.random
        good = msgspec.msgpack.encode(Number(choose.getrandbits(30), "x" * choose.randrange(50)))
        return good if choose.random() < 0.8 else choose.randbytes(choose.randrange(60))

    def _declared(self, name: str) -> list[Any]:
        choose = self.random
        schema: dict[str, Any] = dict(_SLOT.schema)
        if choose.random() < 0.1:
            match choose.randrange(5):
                case 0:
                    schema = {}
                case 1:
                    schema = {"title": "X", "type": "object", "properties": 3}
                case 2:
                    schema["properties"] = self._nested(choose.randrange(60))
                case 3:
                    schema["description"] = "d" * choose.choice((10, 100_000, 2_000_000))
                case 4:
                    schema["properties"] = _MANY
        return [name, choose.choice((1, 64, 1 << 16, 1 << 26, 1 << 30, 1 << 40)), schema]

    def _nested(self, depth: int) -> Any:
        inner: Any = {"type": "integer"}
        for _ in range(depth):
            inner = {"type": "array", "items": inner}
        return {"value": inner}

    def _spoil(self, data: Any) -> Any:
        """Return a value with one part, somewhere, exchanged for something else."""
        if isinstance(data, list) and data and self.random.random() < 0.8:
            at = self.random.randrange(len(data))
            return [*data[:at], self._spoil(data[at]), *data[at + 1 :]]
        choices = (None, True, 1.5, "", b"", [], {}, *_INTEGERS[:-1], *_NAMES, [[]] * 100)
        return self.random.choice(choices)

    def _encode(self, data: Any) -> bytes:
        encoded = msgspec.msgpack.encode(data)
        if self.random.random() < 0.05:  # cut off, or changed
            at = self.random.randrange(len(encoded))
            return encoded[:at] + self.random.randbytes(self.random.randrange(3))
        return encoded
