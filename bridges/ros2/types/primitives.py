"""Functions that compiled codecs call: rows of texts, and texts of wide characters.

A text is a uint32 length, the UTF-8 bytes and a NUL, which counts. A length of 0 is read as an
empty text, as eProsima's CDR does. A wide text is the number of its UTF-16 units and each unit in
four bytes, as in all middlewares of ROS 2.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct, pack, unpack, unpack_from

__all__ = [
    "FALSE_TRUE",
    "ZERO_ONE",
    "UnreadableError",
    "UnwritableError",
    "exact",
    "narrow",
    "read_texts",
    "read_wide_texts",
    "widen",
    "write_texts",
    "write_wide_texts",
]


class UnreadableError(Exception):
    """The bytes do not decode; :mod:`.diagnosis` finds out why."""


class UnwritableError(Exception):
    """The message cannot be encoded; :mod:`.diagnosis` finds out why."""


FALSE_TRUE = (False, True).__getitem__  # any other byte is an IndexError
ZERO_ONE = {False: 0, True: 1}.__getitem__  # any other value is a KeyError


def exact(value: bytes, size: int) -> bytes:
    """Return the value if it has that size: struct would truncate or pad it."""
    if type(value) is not bytes or len(value) != size:
        raise UnwritableError
    return value


_LENGTHS = tuple(Struct(f"<{padding}xI").pack for padding in range(4))
_Unpack = Callable[[bytes, int], tuple[int]]


def read_texts(
    data: bytes, offset: int, count: int, bound: int, length: _Unpack
) -> tuple[tuple[str, ...], int]:
    """Return ``count`` texts and the offset after them; ``length`` unpacks a uint32."""
    texts = []
    for _ in range(count):
        offset += -offset & 3
        (size,) = length(data, offset)
        start = offset + 4
        offset = start + size
        if data[offset - 1]:
            raise UnreadableError
        texts.append(data[start : offset - 1].decode())
    if bound and any(len(text) > bound for text in texts):
        raise UnreadableError
    return tuple(texts), offset


def write_texts(texts: tuple[str, ...], offset: int, bound: int) -> bytes:
    """Return the bytes of texts that start at an offset."""
    parts: list[bytes] = []
    for text in texts:
        if 0 < bound < len(text):
            raise UnwritableError
        raw = (text + "\0").encode()
        padding = -offset & 3
        parts += (_LENGTHS[padding](len(raw)), raw)
        offset += padding + 4 + len(raw)
    return b"".join(parts)


def narrow(data: bytes, offset: int, count: int, order: str) -> str:
    """Return the wide text of ``count`` units."""
    units = unpack_from(f"{order}{count}I", data, offset)
    return pack(f"<{count}H", *units).decode("utf-16-le")


def widen(raw: bytes) -> bytes:
    """Return the bytes of a wide text from its UTF-16."""
    count = len(raw) // 2
    return pack(f"<{count}I", *unpack(f"<{count}H", raw))


def read_wide_texts(
    data: bytes, offset: int, count: int, bound: int, order: str
) -> tuple[tuple[str, ...], int]:
    """Return ``count`` wide texts and the offset after them."""
    texts = []
    offset += -offset & 3
    for _ in range(count):
        (units,) = unpack_from(f"{order}I", data, offset)
        texts.append(narrow(data, offset + 4, units, order))
        offset += 4 + 4 * units
    if bound and any(len(text) > bound for text in texts):
        raise UnreadableError
    return tuple(texts), offset


def write_wide_texts(texts: tuple[str, ...], offset: int, bound: int) -> bytes:
    """Return the bytes of wide texts that start at an offset."""
    parts = [bytes(-offset & 3)]
    for text in texts:
        if 0 < bound < len(text):
            raise UnwritableError
        raw = text.encode("utf-16-le")
        parts += (_LENGTHS[0](len(raw) // 2), widen(raw))
    return b"".join(parts)
