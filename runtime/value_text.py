"""Values as texts for people: the cost is bounded, however much a value holds."""

from __future__ import annotations

import builtins
import reprlib
from typing import Any

import msgspec


class ValueText(reprlib.Repr):
    """Write values in at most `most` characters; of an image, look at its first bytes only."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.maxlevel = 4
        self._most = self.maxstring = self.maxother = most

    def text(self, value: object) -> str:
        """Return a value as in Python, but for what is left out; this never raises."""
        try:
            text = self.repr(value)
            text.encode()
        except Exception as error:  # of a class of the machine's own
            text = f"({type(error).__name__} while it was described)"
        return text if len(text) <= self._most else f"{text[: self._most - 1]}…"

    def repr_float(self, value: float, level: int) -> str:
        """Return six digits within other values, whose rest more of them would hide."""
        return f"{value:.6g}" if level < self.maxlevel else builtins.repr(value)

    def repr_int(self, value: int, level: int) -> str:
        """Return the number, or the size of one that Python may refuse to write."""
        bits = value.bit_length()
        return super().repr_int(value, level) if bits < 2000 else f"<an int of {bits} bits>"

    def repr_bytes(self, value: bytes, level: int) -> str:
        """Return the first bytes, and how many there are."""
        text = builtins.repr(value[: self.maxlist])
        return text if len(value) <= self.maxlist else f"{text}… {len(value)} bytes"

    repr_bytearray = repr_bytes

    def repr_instance(self, value: Any, level: int) -> str:
        """Return a message by its fields, each within its bounds."""
        if not isinstance(value, msgspec.Struct):
            return super().repr_instance(value, level)
        fields = value.__struct_fields__ if level > 0 else ()
        parts = [f"{name}={self.repr1(getattr(value, name), level - 1)}" for name in fields]
        return f"{type(value).__name__}({', '.join(parts) if level > 0 else '...'})"
