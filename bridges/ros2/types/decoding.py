"""Compiles the function that decodes a message: Python source with its formats worked out.

Consecutive numbers become one struct, also across nested messages; where an offset is known only at
run time, a table of eight, by its remainder. No variable is assigned twice, so that one expression
at the end builds the values. The code has no error messages: :mod:`.diagnosis` reads what fails
again.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct, error, unpack_from
from typing import Any

from . import primitives
from .definition import PRIMITIVES, FieldType, Shape
from .generated_function import GeneratedFunction
from .offsets import HEADER, At, Item, fixed_items, formats, padded
from .record_type import RecordField, RecordType

__all__ = ["compile_decoder"]

_MOST_PADDING = 3  # that a sender may leave behind a message


def compile_decoder(
    record: RecordType,
    order: str,
    otherwise: Callable[[bytes], Any],
    explain: Callable[[bytes], Any],
) -> Callable[[bytes], Any]:
    """Return the function that decodes a message, header included, in a byte order of struct's.

    ``otherwise`` decodes data whose header is another one; ``explain`` returns the error to raise
    for data that is no message.
    """
    names: dict[str, Any] = {
        "unpack_from": unpack_from,
        "length": Struct(f"{order}I").unpack_from,
        "otherwise": otherwise,
        "explain": explain,
        "Failed": (error, IndexError, UnicodeError, primitives.UnreadableError),
        "UnreadableError": primitives.UnreadableError,
        "truth": primitives.FALSE_TRUE,
        "read_texts": primitives.read_texts,
        "read_wide_texts": primitives.read_wide_texts,
        "narrow": primitives.narrow,
    }
    functions: dict[RecordType, str] = {}
    code = _Function(names, functions, order, "", 0, At(8, 0))
    header = code.add(Item("H2x", HEADER, 1))
    message = code.message(record)
    code.flush()
    known = 256 if order == "<" else 0
    lines = [
        "def decode(data):",
        " if type(data) is not bytes: data = bytes(memoryview(data))",
        " try:",
        "  size = len(data)",
        f"  {code.lines[0]}",
        f"  if {header} != {known}: return otherwise(data)",
        *(f"  {line}" for line in code.lines[1:]),
        f"  if size - ({code.offset}) > {_MOST_PADDING}: raise UnreadableError",
        f"  return {message}",
        " except Failed: pass",
        " raise explain(data)",
    ]
    exec("\n".join(lines), names)
    decode: Callable[[bytes], Any] = names["decode"]
    return decode


class _Function(GeneratedFunction):
    """The lines of one function: of the message, or of one that stands in a sequence."""

    def __init__(
        self,
        names: dict[str, Any],
        functions: dict[RecordType, str],
        order: str,
        base: str,
        distance: int,
        at: At,
    ) -> None:
        super().__init__(names)
        self._functions = functions  # those made for messages in sequences
        self._order = order
        self._base = base  # the variable with the last offset worked out
        self._distance = distance  # from there
        self._at = at
        self._batch: list[Item] = []
        self._targets: list[str] = []

    @property
    def offset(self) -> str:
        """The expression for the offset that is reached."""
        if not self._base:
            return str(self._distance)
        return f"{self._base} + {self._distance}" if self._distance else self._base

    def add(self, item: Item) -> str:
        """Let a value follow; return the variable that will hold it."""
        target = self.new()
        self._batch.append(item)
        self._targets.append(target)
        return target

    def flush(self) -> None:
        """Read what was added."""
        if not self._batch:
            return
        found, end = formats(self._batch, self._at)
        structs = [Struct(self._order + codes) for codes, _ in found]
        targets = "".join(f"{target}, " for target in self._targets)
        if len(structs) == 1:
            call = f"{self.named(structs[0].unpack_from)}(data, {self.offset})"
            self.emit(f"{targets}= {call}" if targets else call)
            self._distance += structs[0].size
        else:
            layout = self.assign(f"{self.named(structs)}[{self.offset} & 7]")
            call = f"{layout}.unpack_from(data, {self.offset})"
            self.emit(f"{targets}= {call}" if targets else call)
            self._reach(self.assign(f"{self.offset} + {layout}.size"))
        self._at, self._batch, self._targets = end, [], []

    def message(self, record: RecordType) -> str:
        """Read a message; return the expression that builds it."""
        values = [self._member(member) for member in record.members]
        if not values:
            self._batch.append(Item("x", 1, 1))
        return f"{self.named(record.cls)}({', '.join(values)})"

    def _member(self, member: RecordField) -> str:
        kind, record = member.type, member.record
        if kind.shape is Shape.SINGLE:
            if record is not None:
                return self.message(record)
            if kind.is_text:
                return self._text(kind)
            value = self.add(Item.of(kind.base))
            return f"truth({value})" if kind.base == "bool" else value
        if kind.shape is Shape.ARRAY:
            if kind.is_bytes:
                return self.add(Item(f"{kind.size}s", kind.size, 1))
            self.flush()
            count = str(kind.size)
        else:
            count = self.add(Item("I", 4, 4))
            self.flush()
            if kind.size:
                self.emit(f"if {count} > {kind.size}: raise UnreadableError")
        if record is not None:
            return self._messages(record, count)
        if kind.is_text:
            return self._texts(kind, count)
        return self._numbers(kind, count)

    def _text(self, kind: FieldType) -> str:
        count = self.add(Item("I", 4, 4))
        self.flush()
        start = self.offset
        if kind.base == "wstring":
            value = self.assign(f"narrow(data, {start}, {count}, {self._order!r})")
            self._reach(self.assign(f"{start} + 4 * {count}"))
            self._at = At(4, 0)
        else:
            end = self.assign(f"{start} + {count}")
            self.emit(f"if data[{end} - 1]: raise UnreadableError")
            self._reach(end)
            self._at = At()
            value = f"data[{start}:{end} - 1].decode()"
        if kind.bound:
            value = self.assign(value)
            self.emit(f"if len({value}) > {kind.bound}: raise UnreadableError")
        return value

    def _texts(self, kind: FieldType, count: str) -> str:
        wide = kind.base == "wstring"
        reader, how = ("read_wide_texts", repr(self._order)) if wide else ("read_texts", "length")
        value, end = self.new(), self.new()
        call = f"{reader}(data, {self.offset}, {count}, {kind.bound}, {how})"
        self.emit(f"{value}, {end} = {call}")
        self._reach(end)
        self._at = At(4, 0) if wide else At()
        return value

    def _numbers(self, kind: FieldType, count: str) -> str:
        code, size, _ = PRIMITIVES[kind.base]
        start, end = self._row(count, size, size)
        if kind.is_bytes:
            return f"data[{start}:{end}]"
        if kind.base == "bool":
            return self.assign(f"tuple(map(truth, data[{start}:{end}]))")
        if count.isdigit():
            reader = self.named(Struct(f"{self._order}{count}{code}").unpack_from)
            return self.assign(f"{reader}(data, {start})")
        return self.assign(f'unpack_from(f"{self._order}{{{count}}}{code}", data, {start})')

    def _messages(self, record: RecordType, count: str) -> str:
        items = fixed_items(record)
        if items is not None:
            codes, size = padded(items, HEADER)
            start, end = self._row(count, size, max(item.align for item in items))
            inner = _Function(self._names, self._functions, self._order, "", HEADER, At(8, HEADER))
            inner.count = self.count
            value = inner.message(record)
            targets = "".join(f"{target}, " for target in inner._targets) or "_"
            row = self.named(Struct(self._order + codes).iter_unpack)
            return self.assign(f"tuple([{value} for {targets} in {row}(data[{start}:{end}])])")
        one, found, end = self.new(), self.assign("[]"), self.assign(self.offset)
        self.emit(f"for _ in range({count}):")
        self.emit(f" {one}, {end} = {self._function(record)}(data, {end}, size)")
        self.emit(f" {found}.append({one})")
        self._reach(end)
        self._at = At()
        return f"tuple({found})"

    def _row(self, count: str, size: int, align: int) -> tuple[str, str]:
        """Make sure that so many of a size are there; return where they start and end."""
        padding = self._at.padding(align)
        if padding == 0 or count.isdigit():
            start = self.offset
            if padding is None:
                start = self.assign(f"{start} + (4 - ({start}) & {align - 1})")
            elif padding:
                start = self.assign(f"{start} + {padding}")
            after = At(align, HEADER % align) if padding is None else self._at.after(padding)
            self._at = after.after(size * int(count)) if count.isdigit() else _rows(after, size)
        else:  # an empty sequence has no padding
            missing = f"(4 - ({self.offset}) & {align - 1})" if padding is None else str(padding)
            start = self.assign(f"{self.offset} + ({missing} if {count} else 0)")
            self._at = self._at.either(_rows(At(align, HEADER % align), size))
        end = self.assign(f"{start} + {count} * {size}")
        self.emit(f"if {end} > size: raise UnreadableError")
        self._reach(end)
        return start, end

    def _function(self, record: RecordType) -> str:
        """Return the name of the function that reads such a message anywhere."""
        if record not in self._functions:
            name = self._functions[record] = f"read_{len(self._functions)}"
            code = _Function(self._names, self._functions, self._order, "at", 0, At())
            message = code.message(record)
            code.flush()
            lines = [f"def {name}(data, at, size):", *(f" {line}" for line in code.lines)]
            exec("\n".join([*lines, f" return {message}, {code.offset}"]), self._names)
        return self._functions[record]

    def _reach(self, variable: str) -> None:
        self._base, self._distance = variable, 0


def _rows(at: At, size: int) -> At:
    """Return what is known behind any number of that size."""
    return at.either(at.after(size))
