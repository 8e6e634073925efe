"""Compiles the function that encodes a message: the mirror of :mod:`.decoding`, little-endian.

The bytes are a row of chunks, each an expression, joined at the end. What could be written without
an error and be wrong is checked: sizes, bounds, bools, and that rows are tuples or bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct, error, pack
from typing import Any

from . import primitives
from .definition import PRIMITIVES, FieldType, Shape
from .generated_function import GeneratedFunction
from .offsets import HEADER, At, Item, fixed_items, formats, padded
from .record_type import RecordField, RecordType

__all__ = ["compile_encoder"]


def compile_encoder(
    record: RecordType, explain: Callable[[Any, Exception], Any]
) -> Callable[[Any], bytes]:
    """Return the function that encodes a message, header included.

    ``explain`` returns the error to raise for a message, given the exception of its encoding.
    """
    names: dict[str, Any] = {
        "pack": pack,
        "explain": explain,
        "Failed": (
            error,
            KeyError,
            TypeError,
            AttributeError,
            OverflowError,
            UnicodeError,
            primitives.UnwritableError,
        ),
        "UnwritableError": primitives.UnwritableError,
        "exact": primitives.exact,
        "zero_one": primitives.ZERO_ONE,
        "write_texts": primitives.write_texts,
        "write_wide_texts": primitives.write_wide_texts,
        "widen": primitives.widen,
    }
    code = _Function(names, {}, [], At(8, 0))
    code.add(Item("I", HEADER, 1), "256")  # the bytes 0, 1, 0, 0
    code.message(record, "m")
    code.flush()
    if code.puts:
        code.put()
        result = 'b"".join(out)'
    else:
        chunks = code.chunks
        result = " + ".join(chunks) if len(chunks) < 3 else f'b"".join(({", ".join(chunks)}))'
    lines = [
        "def encode(m):",
        " try:",
        *(["  out = []; put = out.append"] if code.puts else []),
        *(f"  {line}" for line in code.lines),
        f"  return {result}",
        " except Failed as error:",
        "  raise explain(m, error) from None",
    ]
    exec("\n".join(lines), names)
    encode: Callable[[Any], bytes] = names["encode"]
    return encode


class _Function(GeneratedFunction):
    """The lines of one function: of the message, or of one that stands in a sequence."""

    def __init__(
        self, names: dict[str, Any], functions: dict[RecordType, str], offset: list[str], at: At
    ) -> None:
        super().__init__(names)
        self.chunks: list[str] = []  # not yet put
        self.puts = False  # whether chunks go to a list, as those of a loop must
        self._functions = functions  # those made for messages in sequences
        self._offset = offset  # the terms of the offset that is reached
        self._at = at
        self._batch: list[Item] = []
        self._values: list[str] = []

    @property
    def offset(self) -> str:
        """The expression for the offset that is reached."""
        return " + ".join(self._offset) or "0"

    def add(self, item: Item, value: str) -> None:
        """Let a value follow."""
        self._batch.append(item)
        self._values.append(value)

    def flush(self) -> None:
        """Write what was added."""
        if not self._batch:
            return
        found, end = formats(self._batch, self._at)
        values = ", ".join(self._values)
        if len(found) == 1:
            codes, size = found[0]
            self.chunks.append(f"{self.named(Struct('<' + codes).pack)}({values})")
            self._offset.append(str(size))
        else:
            packs = self.named([Struct(f"<{codes}").pack for codes, _ in found])
            chunk = self.assign(f"{packs}[{self._here()} & 7]({values})")
            self._chunk(chunk)
        self._at, self._batch, self._values = end, [], []

    def put(self) -> None:
        """Let the chunks go to the list."""
        self.puts = True
        self.lines += [f"put({chunk})" for chunk in self.chunks]
        self.chunks = []

    def message(self, record: RecordType, variable: str) -> None:
        """Write the message in a variable."""
        for member in record.members:
            self._member(member, f"{variable}.{member.name}")
        if not record.members:
            self._batch.append(Item("x", 1, 1))

    def _member(self, member: RecordField, value: str) -> None:
        kind, record = member.type, member.record
        if kind.shape is Shape.SINGLE:
            if record is not None:
                self.message(record, self.assign(value))
            elif kind.is_text:
                self._text(kind, self.assign(value))
            else:
                self.add(Item.of(kind.base), _checked(kind, value))
            return
        if kind.shape is Shape.ARRAY and kind.is_bytes:
            self.add(Item(f"{kind.size}s", kind.size, 1), _checked(kind, value))
            return
        value = self.assign(value)
        python = "bytes" if kind.is_bytes else "tuple"
        wrong = {Shape.ARRAY: "!=", Shape.BOUNDED: ">"}.get(kind.shape)
        size = f" or len({value}) {wrong} {kind.size}" if wrong else ""
        self.emit(f"if type({value}) is not {python}{size}: raise UnwritableError")
        if kind.shape is not Shape.ARRAY:
            self.add(Item("I", 4, 4), f"len({value})")
        self.flush()
        if record is not None:
            self._messages(kind, record, value)
        elif kind.is_text:
            self._texts(kind, value)
        elif kind.is_bytes:
            self._chunk(value)
            self._at = At()
        else:
            self._numbers(kind, value)

    def _text(self, kind: FieldType, value: str) -> None:
        if kind.bound:
            self.emit(f"if len({value}) > {kind.bound}: raise UnwritableError")
        if kind.base == "wstring":
            raw = self.assign(f'{value}.encode("utf-16-le")')
            self.add(Item("I", 4, 4), f"len({raw}) // 2")
            self.flush()
            self._chunk(self.assign(f"widen({raw})"))
            self._at = At(4, 0)
        else:
            raw = self.assign(f'({value} + "\\0").encode()')
            self.add(Item("I", 4, 4), f"len({raw})")
            self.flush()
            self._chunk(raw)
            self._at = At()

    def _texts(self, kind: FieldType, value: str) -> None:
        wide = kind.base == "wstring"
        writer = "write_wide_texts" if wide else "write_texts"
        self._chunk(self.assign(f"{writer}({value}, {self._here()}, {kind.bound})"))
        self._at = At(4, 0) if wide else At()

    def _numbers(self, kind: FieldType, value: str) -> None:
        code, size, _ = PRIMITIVES[kind.base]
        if kind.base == "bool":
            self._row(kind, value, f"bytes(map(zero_one, {value}))", 1, 1)
        elif kind.shape is Shape.ARRAY:
            packs = self.named(Struct(f"<{kind.size}{code}").pack)
            self._row(kind, value, f"{packs}(*{value})", size, size)
        else:
            self._row(kind, value, f'pack(f"<{{len({value})}}{code}", *{value})', size, size)

    def _messages(self, kind: FieldType, record: RecordType, value: str) -> None:
        items = fixed_items(record)
        if items is not None:
            codes, size = padded(items, HEADER)
            packs = self.named(Struct(f"<{codes}").pack)
            one = self.new()
            row = f'b"".join([{packs}({", ".join(_values(record, one))}) for {one} in {value}])'
            self._row(kind, value, row, size, max(item.align for item in items))
            return
        self.put()
        one, end = self.new(), self.assign(self.offset)
        self.emit(f"for {one} in {value}: {end} = {self._function(record)}({one}, {end}, put)")
        self._offset, self._at = [end], At()

    def _row(self, kind: FieldType, value: str, row: str, size: int, align: int) -> None:
        """Write values of a size, with the padding before them."""
        padding = self._at.padding(align)
        if padding is None:
            row = f"bytes(4 - {self._bracketed()} & {align - 1}) + {row}"
        elif padding:
            row = f"bytes({padding}) + {row}"
        aligned = At(align, HEADER % align) if padding is None else self._at.after(padding)
        if kind.shape is Shape.ARRAY:
            at = aligned.after(size * kind.size)
        else:
            at = aligned.either(aligned.after(size))
            if padding != 0:  # an empty sequence has no padding
                row = f'{row} if {value} else b""'
                at = self._at.either(at)
        self._chunk(self.assign(row))
        self._at = at

    def _function(self, record: RecordType) -> str:
        """Return the name of the function that writes such a message anywhere."""
        if record not in self._functions:
            name = self._functions[record] = f"write_{len(self._functions)}"
            code = _Function(self._names, self._functions, ["at"], At())
            code.message(record, "m")
            code.flush()
            code.put()
            lines = [f"def {name}(m, at, put):", *(f" {line}" for line in code.lines)]
            exec("\n".join([*lines, f" return {code.offset}"]), self._names)
        return self._functions[record]

    def _chunk(self, variable: str) -> None:
        self.chunks.append(variable)
        self._offset.append(f"len({variable})")

    def _here(self) -> str:
        """Return the offset that is reached, in a variable or as a number."""
        if len(self._offset) > 1:
            self._offset = [self.assign(self.offset)]
        return self.offset

    def _bracketed(self) -> str:
        return f"({self._here()})"


def _checked(kind: FieldType, value: str) -> str:
    """Return the expression of a value, checked where struct would take what is wrong."""
    if kind.is_bytes:
        return f"exact({value}, {kind.size})"
    return f"zero_one({value})" if kind.base == "bool" else value


def _values(record: RecordType, variable: str) -> list[str]:
    """Return the expressions of all values of a message of fixed size."""
    found: list[str] = []
    for member in record.members:
        value = f"{variable}.{member.name}"
        if member.record is not None:
            found += _values(member.record, value)
        else:
            found.append(_checked(member.type, value))
    return found
