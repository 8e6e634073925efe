"""Compiles the functions that encode and decode a message: Python source, made for each type.

A walk over the fields for each message would ask again what the type has settled: which field
comes next, its format, its padding. A compiled function holds only what depends on the message.
Consecutive numbers become one struct, also across nested messages. Where an offset is known only at
run time (see :mod:`.layout`) there are eight structs, chosen by its remainder modulo 8.

* No variable is assigned twice, so a single expression at the end builds the decoded message, and a
  value may be read long before it is used.
* Messages in sequences are read and written by functions of their own, unless their layout is the
  same wherever they start: then a whole row is unpacked at once.
* Encoding makes a row of chunks, each an expression, that are joined at the end. It is
  little-endian; data in the other order are decoded by a second function.
* Compiled code sees the names of :mod:`.primitives`, and its own: constants, as ``g12``.
* There are no error messages here. What could be written without an error and be wrong is checked
  (sizes, bounds, bools, that rows are tuples or bytes), and :mod:`.diagnosis` walks through what
  failed again.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct, error
from typing import Any

from llfsm.bridges.ros2.types import _primitives as primitives
from llfsm.bridges.ros2.types._layout import (
    HEADER,
    At,
    Item,
    RecordField,
    RecordType,
    fixed_items,
    formats,
    padded,
)
from llfsm.bridges.ros2.types._primitives import PRIMITIVES
from llfsm.bridges.ros2.types.definition import FieldType, Shape


class GeneratedFunction:
    """The lines of a function that is compiled, and its globals."""

    def __init__(self, names: dict[str, Any], functions: dict[RecordType, str], at: At) -> None:
        self.lines: list[str] = []
        self.count = 0
        """Variables named so far."""
        self._names = names  # the globals of the compiled code
        self._functions = functions  # those made for messages in sequences
        self._at = at  # the offset reached, as far as it is known
        self._batch: list[Item] = []  # values of the next struct

    def new(self) -> str:
        """Name a new variable."""
        self.count += 1
        return f"v{self.count}"

    def assign(self, expression: str) -> str:
        """Assign an expression to a new variable, and return its name."""
        target = self.new()
        self.lines.append(f"{target} = {expression}")
        return target

    def named(self, value: Any) -> str:
        """Name a new global with that value."""
        name = f"g{len(self._names)}"
        self._names[name] = value
        return name


def compile_encoder(
    record: RecordType, otherwise: Callable[[Any, Exception], bytes]
) -> Callable[[Any], bytes]:
    """Compile the function that encodes a message, header included.

    ``otherwise`` encodes one that is not as its class declares it, or raises, of that message and
    the exception of its encoding.
    """
    values = KeyError, TypeError, AttributeError, OverflowError, UnicodeError
    names: dict[str, Any] = {
        **vars(primitives),
        **{f"write_{row.name}": row.write for row in PRIMITIVES.values() if row.write},
        "otherwise": otherwise,
        "Failed": (error, *values, primitives.UnwritableError),
    }
    code = _EncodingFunction(names, {}, [], At(8, 0))
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
        "  return otherwise(m, error)",
    ]
    exec("\n".join(lines), names)
    encode: Callable[[Any], bytes] = names["encode"]
    return encode


class _EncodingFunction(GeneratedFunction):
    """The lines of one function: of the message, or of one that stands in a sequence."""

    def __init__(
        self, names: dict[str, Any], functions: dict[RecordType, str], offset: list[str], at: At
    ) -> None:
        super().__init__(names, functions, at)
        self.chunks: list[str] = []  # not yet put
        self.puts = False  # whether chunks go to a list, as those of a loop must
        self._offset = offset  # the terms of the offset reached
        self._values: list[str] = []

    @property
    def offset(self) -> str:
        """The expression for the offset reached."""
        return " + ".join(self._offset) or "0"

    def add(self, item: Item, value: str) -> None:
        """Write a value next."""
        self._batch.append(item)
        self._values.append(value)

    def flush(self) -> None:
        """Write the values added since the last time, as one struct."""
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
        """Append the chunks to the list."""
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
        self.lines.append(f"if type({value}) is not {python}{size}: raise UnwritableError")
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
            self.lines.append(f"if len({value}) > {kind.bound}: raise UnwritableError")
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
        row = PRIMITIVES[kind.base]
        code, size = row.code, row.size
        if row.write:  # to a byte each
            self._row(kind, value, f"bytes(map(write_{row.name}, {value}))", 1, 1)
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
        self.lines.append(
            f"for {one} in {value}: {end} = {self._function(record)}({one}, {end}, put)"
        )
        self._offset, self._at = [end], At()

    def _row(self, kind: FieldType, value: str, row: str, size: int, align: int) -> None:
        """Write values of a size, with the padding before them."""
        padding = self._at.padding(align)
        if padding is None:
            row = f"bytes(4 - ({self._here()}) & {align - 1}) + {row}"
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
        """Compile the function that writes such a message at any offset, once; return its name."""
        if record not in self._functions:
            name = self._functions[record] = f"write_{len(self._functions)}"
            code = _EncodingFunction(self._names, self._functions, ["at"], At())
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
        """Put the offset reached into a variable, unless it is a number already; return it."""
        if len(self._offset) > 1:
            self._offset = [self.assign(self.offset)]
        return self.offset


def _checked(kind: FieldType, value: str) -> str:
    """Make the expression of a value, checked where struct would take wrong ones."""
    if kind.is_bytes:
        return f"exact({value}, {kind.size})"
    return f"write_{kind.base}({value})" if PRIMITIVES[kind.base].write else value


def _values(record: RecordType, variable: str) -> list[str]:
    """List the expressions of all values of a message of fixed size."""
    found: list[str] = []
    for member in record.members:
        value = f"{variable}.{member.name}"
        if member.record is not None:
            found += _values(member.record, value)
        else:
            found.append(_checked(member.type, value))
    return found


def compile_decoder(
    record: RecordType,
    order: str,
    otherwise: Callable[[bytes], Any],
    explain: Callable[[bytes], Any],
) -> Callable[[bytes], Any]:
    """Compile the function that decodes a message, header included, in struct's byte ``order``.

    Bytes after the message are left alone, as ROS 2 leaves them: RTPS pads to multiples of 4, and
    rmw_serialize reserves 4 bytes too many for each empty sequence of numbers of 8 bytes.
    ``otherwise`` decodes data whose header is another one; ``explain`` makes the error to raise of
    data that is no message.
    """
    names: dict[str, Any] = {
        **vars(primitives),
        **{f"read_{row.name}": row.read for row in PRIMITIVES.values() if row.read},
        "length": Struct(f"{order}I").unpack_from,
        "otherwise": otherwise,
        "explain": explain,
        "Failed": (error, IndexError, UnicodeError, primitives.UnreadableError),
    }
    functions: dict[RecordType, str] = {}
    code = _DecodingFunction(names, functions, order, "", 0, At(8, 0))
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
        f"  return {message}",
        " except Failed: pass",
        " raise explain(data)",
    ]
    exec("\n".join(lines), names)
    decode: Callable[[bytes], Any] = names["decode"]
    return decode


class _DecodingFunction(GeneratedFunction):
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
        super().__init__(names, functions, at)
        self._order = order
        self._base = base  # the variable with the last offset worked out
        self._distance = distance  # from there
        self._targets: list[str] = []

    @property
    def offset(self) -> str:
        """The expression for the offset reached."""
        if not self._base:
            return str(self._distance)
        return f"{self._base} + {self._distance}" if self._distance else self._base

    def add(self, item: Item) -> str:
        """Read a value next; return the variable that will hold it."""
        target = self.new()
        self._batch.append(item)
        self._targets.append(target)
        return target

    def flush(self) -> None:
        """Read the values added since the last time, as one struct."""
        if not self._batch:
            return
        found, end = formats(self._batch, self._at)
        structs = [Struct(self._order + codes) for codes, _ in found]
        targets = "".join(f"{target}, " for target in self._targets)
        if len(structs) == 1:
            call = f"{self.named(structs[0].unpack_from)}(data, {self.offset})"
            self.lines.append(f"{targets}= {call}" if targets else call)
            self._distance += structs[0].size
        else:
            layout = self.assign(f"{self.named(structs)}[{self.offset} & 7]")
            call = f"{layout}.unpack_from(data, {self.offset})"
            self.lines.append(f"{targets}= {call}" if targets else call)
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
            return f"read_{kind.base}({value})" if PRIMITIVES[kind.base].read else value
        if kind.shape is Shape.ARRAY:
            if kind.is_bytes:
                return self.add(Item(f"{kind.size}s", kind.size, 1))
            self.flush()
            count = str(kind.size)
        else:
            count = self.add(Item("I", 4, 4))
            self.flush()
            if kind.size:
                self.lines.append(f"if {count} > {kind.size}: raise UnreadableError")
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
            self.lines.append(f"if data[{end} - 1]: raise UnreadableError")
            self._reach(end)
            self._at = At()
            value = f"data[{start}:{end} - 1].decode()"
        if kind.bound:
            value = self.assign(value)
            self.lines.append(f"if len({value}) > {kind.bound}: raise UnreadableError")
        return value

    def _texts(self, kind: FieldType, count: str) -> str:
        wide = kind.base == "wstring"
        reader, how = ("read_wide_texts", repr(self._order)) if wide else ("read_texts", "length")
        value, end = self.new(), self.new()
        call = f"{reader}(data, {self.offset}, {count}, {kind.bound}, {how})"
        self.lines.append(f"{value}, {end} = {call}")
        self._reach(end)
        self._at = At(4, 0) if wide else At()
        return value

    def _numbers(self, kind: FieldType, count: str) -> str:
        row = PRIMITIVES[kind.base]
        code, size = row.code, row.size
        start, end = self._row(count, size, size)
        if kind.is_bytes:
            return f"data[{start}:{end}]"
        if row.read:  # from a byte each
            return self.assign(f"tuple(map(read_{row.name}, data[{start}:{end}]))")
        if count.isdigit():
            reader = self.named(Struct(f"{self._order}{count}{code}").unpack_from)
            return self.assign(f"{reader}(data, {start})")
        return self.assign(f'unpack_from(f"{self._order}{{{count}}}{code}", data, {start})')

    def _messages(self, record: RecordType, count: str) -> str:
        items = fixed_items(record)
        if items is not None:
            codes, size = padded(items, HEADER)
            start, end = self._row(count, size, max(item.align for item in items))
            inner = _DecodingFunction(
                self._names, self._functions, self._order, "", HEADER, At(8, HEADER)
            )
            inner.count = self.count
            value = inner.message(record)
            targets = "".join(f"{target}, " for target in inner._targets) or "_"
            row = self.named(Struct(self._order + codes).iter_unpack)
            return self.assign(f"tuple([{value} for {targets} in {row}(data[{start}:{end}])])")
        one, found, end = self.new(), self.assign("[]"), self.assign(self.offset)
        self.lines.append(f"for _ in range({count}):")
        self.lines.append(f" {one}, {end} = {self._function(record)}(data, {end}, size)")
        self.lines.append(f" {found}.append({one})")
        self._reach(end)
        self._at = At()
        return f"tuple({found})"

    def _row(self, count: str, size: int, align: int) -> tuple[str, str]:
        """Check that ``count`` values of a size are there; return where they start and end."""
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
        self.lines.append(f"if {end} > size: raise UnreadableError")
        self._reach(end)
        return start, end

    def _function(self, record: RecordType) -> str:
        """Compile the function that reads such a message at any offset, once; return its name."""
        if record not in self._functions:
            name = self._functions[record] = f"read_{len(self._functions)}"
            code = _DecodingFunction(self._names, self._functions, self._order, "at", 0, At())
            message = code.message(record)
            code.flush()
            lines = [f"def {name}(data, at, size):", *(f" {line}" for line in code.lines)]
            exec("\n".join([*lines, f" return {message}, {code.offset}"]), self._names)
        return self._functions[record]

    def _reach(self, variable: str) -> None:
        """Go on at the offset in a variable."""
        self._base, self._distance = variable, 0


def _rows(at: At, size: int) -> At:
    """Move on by any number of values of a size."""
    return at.either(at.after(size))
