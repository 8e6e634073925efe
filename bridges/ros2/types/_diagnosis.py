"""Explains why bytes do not decode, or a message cannot be encoded: the field and its fault.

Compiled codecs only detect a fault. These functions walk through the fields, slowly, and stop at
the first that cannot be read or written; the error has its path, as ``poses[2].header.frame_id``.
"""

from __future__ import annotations

from struct import pack, unpack_from
from typing import Any

from llfsm.bridges.ros2.errors import CdrError
from llfsm.bridges.ros2.types._layout import HEADER, RecordField, RecordType
from llfsm.bridges.ros2.types._primitives import PRIMITIVES
from llfsm.bridges.ros2.types.definition import FieldType, Shape


class _FoundError(Exception):
    """The field and its fault."""


def why_unreadable(record: RecordType, data: bytes) -> CdrError:
    """Make the error that names the first field that does not decode."""
    if len(data) < HEADER:
        return CdrError(f"{record.name}: the header needs {HEADER} bytes, there are {len(data)}")
    if data[0] != 0 or data[1] > 1:
        return CdrError(
            f"{record.name}: the header is {data[:HEADER].hex(' ')}, not plain CDR's 00 00 or 00 01"
        )
    walk = _Walk(data)
    try:
        walk.message(record, "")
    except _FoundError as found:
        return CdrError(f"{record.name}: {found}")
    return CdrError(f"{record.name}: the bytes cannot be decoded: {data[:40].hex(' ')}")


class _Walk:
    """Go through the bytes of a message."""

    def __init__(self, data: bytes) -> None:
        self.offset = HEADER
        self._data = data
        self._order = "<" if data[1] else ">"

    def message(self, record: RecordType, path: str) -> None:
        if not record.members:
            self._take(1, 1, path or "the byte of an empty message")
        for member in record.members:
            self._member(member, f"{path}.{member.name}".lstrip("."))

    def _member(self, member: RecordField, path: str) -> None:
        kind, count = member.type, member.type.size
        if kind.shape is Shape.SINGLE:
            self._one(member, path)
            return
        if kind.shape is not Shape.ARRAY:
            count = self._length(path)
        if kind.shape is Shape.BOUNDED and count > kind.size:
            raise _FoundError(f"{path}: {count} values, at most {kind.size} are allowed")
        row = None if kind.nested else PRIMITIVES[kind.base]
        if count and row is not None and not (row.is_text or row.read):
            self._take(row.size * count, row.size, path)
            return
        for index in range(count):
            self._one(member, f"{path}[{index}]")

    def _one(self, member: RecordField, path: str) -> None:
        kind = member.type
        if member.record is not None:
            self.message(member.record, path)
        elif kind.is_text:
            self._text(kind, path)
        else:
            row = PRIMITIVES[kind.base]
            start = self._take(row.size, row.size, path)
            if row.read and self._data[start] > 1:
                raise _FoundError(f"{path}: a {kind.base} is 0 or 1, not {self._data[start]}")

    def _text(self, kind: FieldType, path: str) -> None:
        count, wide = self._length(path), kind.base == "wstring"
        start = self._take(4 * count if wide else count, 1, path)
        try:
            if wide:
                units = unpack_from(f"{self._order}{count}I", self._data, start)
                text = b"".join(unit.to_bytes(2, "little") for unit in units).decode("utf-16-le")
            else:
                raw = self._data[start : self.offset]
                if raw[-1:] not in (b"", b"\0"):
                    raise _FoundError(f"{path}: the text does not end in a NUL")
                text = raw[:-1].decode()
        except (UnicodeError, OverflowError) as error:
            encoding = "UTF-16" if wide else "UTF-8"
            raise _FoundError(f"{path}: is not valid {encoding}: {error}") from None
        if 0 < kind.bound < len(text):
            raise _FoundError(f"{path}: {len(text)} characters, at most {kind.bound} are allowed")

    def _length(self, path: str) -> int:
        return int(unpack_from(f"{self._order}I", self._data, self._take(4, 4, path))[0])

    def _take(self, size: int, align: int, path: str) -> int:
        start = self.offset + (HEADER - self.offset) % align
        left = max(0, len(self._data) - start)
        if size > left:
            raise _FoundError(f"{path}: needs {size} bytes at offset {start}, {left} are left")
        self.offset = start + size
        return start


def why_unwritable(record: RecordType, message: Any, error: Exception) -> CdrError:
    """Make the error that names the first value that cannot be encoded."""
    try:
        _check_message(record, message, "")
    except _FoundError as found:
        return CdrError(f"{record.name}: {found}")
    return CdrError(f"{record.name}: {type(error).__name__}: {error}")


def _check_message(record: RecordType, message: Any, path: str) -> None:
    for member in record.members:
        where = f"{path}.{member.name}".lstrip(".")
        if not hasattr(message, member.name):
            raise _FoundError(f"{where}: a {type(message).__qualname__} has no such field")
        _check(member, getattr(message, member.name), where)


def _check(member: RecordField, value: Any, path: str) -> None:
    kind = member.type
    if kind.shape is Shape.SINGLE:
        _check_one(member, value, path)
        return
    python = bytes if kind.is_bytes else tuple
    if type(value) is not python:
        raise _FoundError(f"{path}: {python.__name__} is needed, not {type(value).__name__}")
    if kind.shape is Shape.ARRAY and len(value) != kind.size:
        raise _FoundError(f"{path}: {len(value)} values, exactly {kind.size} are needed")
    if kind.shape is Shape.BOUNDED and len(value) > kind.size:
        raise _FoundError(f"{path}: {len(value)} values, at most {kind.size} are allowed")
    for index, one in enumerate(value):
        _check_one(member, one, f"{path}[{index}]")


def _check_one(member: RecordField, value: Any, path: str) -> None:
    kind = member.type
    if member.record is not None:
        _check_message(member.record, value, path)
        return
    if kind.is_text:
        _check_text(kind, value, path)
        return
    row = PRIMITIVES[kind.base]
    try:
        pack(f"<{row.code}", row.write(value) if row.write else value)
    except Exception:  # whatever a value that is not a number raises
        raise _FoundError(f"{path}: {value!r} is not of type {row.name}{row.limits}") from None


def _check_text(kind: FieldType, value: Any, path: str) -> None:
    if not isinstance(value, str):
        raise _FoundError(f"{path}: a str is needed, not {value!r}")
    if 0 < kind.bound < len(value):
        raise _FoundError(f"{path}: {len(value)} characters, at most {kind.bound} are allowed")
    try:
        value.encode(PRIMITIVES[kind.base].encoding)
    except UnicodeEncodeError as error:
        raise _FoundError(f"{path}: half a character cannot be encoded: {error}") from None
