"""A slot's messages as JSON that any tool can read, and back without loss.

The JSON object follows the slot's schema: `bytes` are base64, integers keep all their digits. JSON
has no number for NaN and the infinities, which are written as null, and does not distinguish the
members of some unions. An object that would be ambiguous has an additional member `$msgpack`: the
message as on the whiteboard, MessagePack in base64. No field's name can begin with a `$`.
"""

from __future__ import annotations

from binascii import a2b_base64, b2a_base64
from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.schema import from_plain, to_plain

__all__ = ["EXACT", "Codec", "JsonCodec"]

EXACT = "$msgpack"


class Codec(Protocol):
    """Encodes and decodes the messages of one slot."""

    @property
    def encode(self) -> Callable[[Any], bytes]:
        """Return a message's bytes."""
        ...

    @property
    def decode(self) -> Callable[[bytes], Any]:
        """Return the message of bytes; raise ``ValueError`` if they are none."""
        ...


class JsonCodec:
    """Encode and decode the messages of one slot."""

    def __init__(self, slot: Slot[Any]):
        self.slot = slot
        self._ambiguous = b"anyOf" in msgspec.json.encode(slot.schema)

    def encode(self, message: Message) -> bytes:
        """Return the JSON object."""
        plain = to_plain(message)
        text = msgspec.json.encode(plain)
        if (self._ambiguous or b"null" in text) and not self._is_exact(plain, text, message):
            payload = self.slot.encoder.encode(message)
            plain[EXACT] = b2a_base64(payload, newline=False).decode()
            text = msgspec.json.encode(plain)
        return text

    def decode(self, text: bytes) -> Message:
        """Return the message; raise ``ValueError`` if the text is not a message of this slot."""
        plain = msgspec.json.decode(text)
        if not isinstance(plain, dict):
            raise ValueError("not a JSON object")
        return self.message(plain)

    def message(self, plain: dict[str, Any]) -> Message:
        """Return the message of a decoded object; raise ``ValueError`` if it is invalid."""
        if EXACT in plain:
            message = self.slot.decoder.decode(a2b_base64(plain[EXACT]))
        else:
            message = msgspec.convert(from_plain(plain, self.slot.schema), self.slot.type)
        assert isinstance(message, Message)
        return message

    def _is_exact(self, plain: Any, text: bytes, message: Message) -> bool:
        try:
            back = self.decode(text)
        except ValueError:  # for example null where a number is required
            return False
        return back == message and to_plain(back) == plain
