"""Changes to sound data that keep most of its structure."""

from __future__ import annotations

import re
from collections.abc import Sequence
from random import Random

__all__ = ["damaged", "damaged_text"]

_NUMBERS = (0, 1, 7, 127, 128, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1)
_TOKENS = ("", "0", "-1", "1e400", "9" * 5000, "nan", "[", "]", "{", "}", '"', "'", "=", ",", "\n",
           "\0", "\ud7ff", "é", "true", "null", "[" * 200, "/", "..", "*", "#", " ")  # fmt: skip
_WORD = re.compile(r"\w+|\s+|[^\w\s]")


def damaged(choose: Random, data: bytes, places: Sequence[int] = ()) -> bytes:
    """Return data with a few changes: numbers at `places`, or anywhere; pieces cut, or twice."""
    changed = bytearray(data)
    for _ in range(choose.choice((1, 1, 1, 2, 3, 8))):
        at = (
            choose.choice(places)
            if places and choose.random() < 0.7
            else choose.randrange(len(changed) + 1)
        )
        size = choose.choice((1, 2, 4, 8))
        match choose.randrange(6):
            case 0 | 1 | 2:
                number = choose.choice((*_NUMBERS, choose.getrandbits(64))) % (1 << 8 * size)
                piece = number.to_bytes(size, "little")
                changed[at : at + size] = piece
            case 3:
                near = int.from_bytes(changed[at : at + size], "little") + choose.randrange(-3, 4)
                changed[at : at + size] = (near % (1 << 8 * size)).to_bytes(size, "little")
            case 4:
                end = at + choose.choice((1, 8, 100, len(changed)))
                del changed[at:end]
            case 5:
                changed[at:at] = changed[at : at + choose.choice((1, 8, 200))]
    return bytes(changed)


def damaged_text(choose: Random, text: str) -> str:
    """Return a text with a few of its words and signs exchanged, dropped or doubled."""
    words = _WORD.findall(text)
    for _ in range(choose.choice((1, 1, 2, 3, 8))):
        at = choose.randrange(len(words) + 1)
        other = choose.choice((*_TOKENS, *words[:200]))
        words[at : at + choose.choice((0, 1, 1, 3))] = [other] * choose.choice((0, 1, 1, 2))
    return "".join(words)
