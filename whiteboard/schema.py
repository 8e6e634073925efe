"""Message types as JSON schemas, and messages as JSON.

A slot carries its type's schema, so that tools can show a message without its Python class, and two
processes notice that their classes of one name differ. A type that has no schema here is not
immutable (or not portable), and so cannot be part of a message: making the schema is the check.

The schema is a pure function of the class, with nested messages inline and keys in a fixed order:
equal types have equal texts, of which a slot's fingerprint is the hash. Schemas of other processes
are data of strangers: they are bounded (:func:`excess`) before anything recurses over them, and
their patterns are never run.
"""

from __future__ import annotations

import binascii
import math
from collections.abc import Iterator
from typing import Any

import msgspec
from msgspec import inspect as mi

from llfsm.errors import did_you_mean
from llfsm.whiteboard.errors import MessageTypeError

Schema = dict[str, Any]

MADE_FROM = "__made_from__"
"""The attribute of a class made from a schema, in which that schema is."""

_SCHEMA = "__schema__"  # the attribute that keeps a class's schema: it takes 0.5 ms to make

_MUTABLE = {
    mi.ListType: "a list is mutable; use tuple[X, ...]",
    mi.DictType: "a dict is mutable; use a tuple of pairs, or a Message of its own",
    mi.SetType: "a set is mutable; use frozenset[X]",
    mi.ByteArrayType: "a bytearray is mutable; use bytes",
    mi.MemoryViewType: "a memoryview is mutable; use bytes",
    mi.AnyType: "Any permits mutable values; name the types",
    mi.DataclassType: "use a Message instead of a dataclass",
    mi.TypedDictType: "a dict is mutable; use a Message",
}

# Of a foreign schema; a field of a message in a message adds two levels. Deep ones exhaust the
# stack of whatever follows them, and large ones the time of whoever lists slots.
_DEEPEST = 64
_MOST_MEMBERS = 20_000

# The limits of msgspec's types, by their names in JSON schema.
_OF_NUMBERS = {
    "minimum": "ge",
    "exclusiveMinimum": "gt",
    "maximum": "le",
    "exclusiveMaximum": "lt",
    "multipleOf": "multiple_of",
}
_OF_TEXTS = {"minLength": "min_length", "maxLength": "max_length", "pattern": "pattern"}
_OF_ARRAYS = {"minItems": "min_length", "maxItems": "max_length"}


def describe(cls: type) -> Schema:
    """Return the JSON schema (2020-12) of a Message class, with nested messages inline.

    Raise :class:`.MessageTypeError` naming the first field that is not deeply immutable, and
    ``NameError`` while an annotation refers to a name that is not defined yet.
    """
    found: Schema | None = vars(cls).get(_SCHEMA)
    if found is None:
        found = _checked(cls)
        setattr(cls, _SCHEMA, found)
    return found


def _checked(cls: type) -> Schema:
    for field in msgspec.structs.fields(cls):
        try:
            msgspec.msgpack.Decoder(field.type)
        except TypeError as error:  # a union whose members a decoder cannot distinguish
            raise MessageTypeError(f"{cls.__qualname__}.{field.name}: {error}") from error
    made_from: Schema | None = vars(cls).get(MADE_FROM)
    if made_from is not None:
        return made_from
    return _schema(mi.type_info(cls), cls.__qualname__, ())


def _schema(node: mi.Type, path: str, outer: tuple[type, ...]) -> Schema:
    match node:
        case mi.BoolType():
            return {"type": "boolean"}
        case mi.IntType():
            return {"type": "integer", **_limits(node, _OF_NUMBERS)}
        case mi.FloatType():
            return {"type": "number", **_limits(node, _OF_NUMBERS)}
        case mi.StrType():
            return {"type": "string", **_limits(node, _OF_TEXTS)}
        case mi.BytesType():
            limits = _limits(node, _OF_TEXTS)
            return {"type": "string", "contentEncoding": "base64", **limits}
        case mi.NoneType():
            return {"type": "null"}
        case mi.EnumType(cls=cls):
            return {"enum": sorted(member.value for member in cls)}  # sorted, like a Literal's
        case mi.LiteralType(values=values):
            return {"enum": list(values)}
        case mi.VarTupleType() | mi.FrozenSetType():
            items = _schema(node.item_type, f"{path}[]", outer)
            limits = _limits(node, _OF_ARRAYS)
            unique = {"uniqueItems": True} if isinstance(node, mi.FrozenSetType) else {}
            return {"type": "array", "items": items, **limits, **unique}
        case mi.TupleType(item_types=types):
            each = [_schema(t, f"{path}[{i}]", outer) for i, t in enumerate(types)]
            return {"type": "array", "prefixItems": each, "items": False}
        case mi.UnionType(types=types):
            return {"anyOf": [_schema(t, path, outer) for t in types]}
        case mi.StructType(cls=cls, fields=fields):
            if not (cls.__struct_config__.frozen and cls.__struct_config__.array_like):
                raise MessageTypeError(
                    f"{path}: {cls.__qualname__} is not a Message, or not frozen"
                )
            if cls in outer:
                raise MessageTypeError(f"{path}: {cls.__qualname__} contains itself")
            if cls.__struct_config__.tag is not None:
                raise MessageTypeError(
                    f"{path}: {cls.__qualname__} has a tag, which a schema cannot express"
                )
            inner = (*outer, cls)
            return {
                "title": getattr(cls, "__type_name__", cls.__name__),
                "type": "object",
                "properties": {f.name: _schema(f.type, f"{path}.{f.name}", inner) for f in fields},
                "required": [f.name for f in fields],
            }
        case _:
            why = _MUTABLE.get(type(node), "only immutable, portable types can be in a message")
            raise MessageTypeError(f"{path}: {why}")


def _limits(node: mi.Type, names: dict[str, str]) -> Schema:
    found = {key: getattr(node, attribute, None) for key, attribute in names.items()}
    return {key: value for key, value in found.items() if value is not None}


def excess(schema: Schema) -> str:
    """Check that a schema of another process can be worked with; else return the reason, or "".

    It may be nested 64 deep and have 20,000 members. Without recursion, for any depth.
    """
    level: list[Any] = [schema]
    members = 0
    for _ in range(_DEEPEST):
        members += sum(map(len, level))
        if members > _MOST_MEMBERS:
            return f"its schema has more than {_MOST_MEMBERS} members"
        values = (v for each in level for v in (each.values() if isinstance(each, dict) else each))
        level = [value for value in values if isinstance(value, dict | list)]
        if not level:
            return ""
    return f"its schema is nested more than {_DEEPEST} deep"


def fingerprint(schema: Schema) -> int:
    """Hash a schema to 64 bits: equal for equal schemas, and for no two others in practice."""
    import hashlib  # here, because it takes a tenth of the time of importing the whiteboard

    digest = hashlib.blake2b(msgspec.json.encode(schema), digest_size=8).digest()
    return int.from_bytes(digest, "little")


def differences(board: Schema, ours: Schema, path: str = "") -> Iterator[str]:
    """Describe, field by field, how the board's schema and ours differ."""
    if board.get("type") == ours.get("type") == "object":
        theirs, mine = board["properties"], ours["properties"]
        for name in {**theirs, **mine}:
            where = f"{path}.{name}".lstrip(".")
            if name not in mine:
                yield f"only the board has {where} ({summarize(theirs[name])})"
            elif name not in theirs:
                yield f"only ours has {where} ({summarize(mine[name])})"
            else:
                yield from differences(theirs[name], mine[name], where)
        if theirs.keys() == mine.keys() and list(theirs) != list(mine):
            yield f"{path or 'the fields'}: the board's order is {', '.join(theirs)}"
    if board.get("title") != ours.get("title") or _bare(board) != _bare(ours):
        shown = f"{summarize(board)} on the board, {summarize(ours)} in ours"
        yield f"{path or 'the message'} is {shown}"


def _bare(schema: Schema) -> Schema:
    return {k: v for k, v in schema.items() if k not in ("properties", "required", "title")}


def summarize(schema: Schema) -> str:
    """Describe a schema in a few words: its type's name, or its keys and values."""
    if "title" in schema:
        return str(schema["title"])
    return msgspec.json.encode(schema).decode().replace('"', "").strip("{}")


def limits(schema: Schema) -> dict[str, Any]:
    """Return the limits in a foreign schema as arguments of `msgspec.Meta`, without its pattern.

    A pattern can take longer than the robot lives to match a short text.
    """
    names = _OF_NUMBERS | _OF_TEXTS | _OF_ARRAYS
    return {names[k]: value for k, value in schema.items() if k in names and k != "pattern"}


def to_plain(value: Any) -> Any:
    """Convert a message to JSON values: dicts, lists, texts (bytes as base64)."""
    if isinstance(value, msgspec.Struct):
        return {name: to_plain(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, tuple | frozenset):
        return [to_plain(item) for item in value]
    return msgspec.to_builtins(value)


def from_plain(value: Any, schema: Schema) -> Any:
    """Convert JSON values to the arrays that a message's decoder accepts.

    Omitted fields are zero, empty or false. Raise ``ValueError`` for a field that the schema does
    not have, and if the omitted ones are millions.
    """
    return _filled(value, schema, _Zeros())


class _Zeros:
    """Fills in the fields that are omitted, by 4 million values and bytes at most.

    A schema may ask for arrays of any length, so a short text could require gigabytes.
    """

    def __init__(self) -> None:
        self._left = 1 << 22

    def _take(self, number: int) -> None:
        self._left -= number
        if self._left < 0:
            raise ValueError("it leaves out millions of values, which must be there")

    def of(self, schema: Schema) -> Any:
        """Make the value of an omitted field: zero, empty or false, within its limits."""
        self._take(1)
        match schema:
            case {"anyOf": [*options]}:
                return None if {"type": "null"} in options else self.of(options[0])
            case {"enum": [first, *_]}:
                return first
            case {"prefixItems": items}:
                return [self.of(item) for item in items]
            case {"type": "array", "items": item, "minItems": number} if number:
                before, zero = self._left, self.of(item)
                self._take((before - self._left) * (number - 1))
                return [zero] * number
            case {"type": "array"}:
                return []
            case {"contentEncoding": "base64", "minLength": length}:
                self._take(length)
                return bytes(length)
            case {"type": "number" | "integer" as kind}:
                return max(schema.get("minimum", -math.inf), min(0, schema.get("maximum", 0)))
            case {"properties": fields}:
                return [self.of(field) for field in fields.values()]
            case {"contentEncoding": "base64"}:
                return b""
            case {"type": kind}:
                return {"boolean": False, "string": "", "object": {}}.get(kind)
        return None


def _filled(value: Any, schema: Schema, zeros: _Zeros) -> Any:
    """Convert a JSON value by its schema; leave to the decoder whatever does not fit."""
    match schema, value:
        case {"type": "object", "properties": fields, "title": title}, dict():
            for name in value.keys() - fields.keys():
                near = did_you_mean(name, fields)
                raise ValueError(f"{title} has no field {name!r}; it has {', '.join(fields)}{near}")
            return [
                _filled(value[name], field, zeros) if name in value else zeros.of(field)
                for name, field in fields.items()
            ]
        case {"anyOf": options}, dict() | list() | str():  # a union has at most one of each
            kind = {dict: "object", list: "array", str: "string"}[type(value)]
            for option in options:
                if option.get("type") == kind:
                    return _filled(value, option, zeros)
            return value
        case {"prefixItems": items}, list() if len(items) == len(value):
            return [_filled(v, s, zeros) for v, s in zip(value, items, strict=True)]
        case {"type": "array", "items": dict() as item}, list():
            return [_filled(v, item, zeros) for v in value]
        case {"contentEncoding": "base64"}, str():
            return binascii.a2b_base64(value, strict_mode=True)
        case _:
            return value
