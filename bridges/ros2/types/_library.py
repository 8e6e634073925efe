"""Any ROS type: its Message class, its codec, its hash.

Each is made when it is first asked for, and kept. Most of the types that a bridge knows it only
publishes, or only receives: so each direction of a codec is compiled by who asks for it, which
endpoints do when they are created and not at their first message.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, NamedTuple, cast

from llfsm.bridges.ros2.errors import DefinitionSyntaxError, TypeMismatchError, UnknownTypeError
from llfsm.bridges.ros2.types._cdr import compile_decoder, compile_encoder
from llfsm.bridges.ros2.types._diagnosis import why_unreadable, why_unwritable
from llfsm.bridges.ros2.types._hashing import describe as describe_type
from llfsm.bridges.ros2.types._hashing import rihs01
from llfsm.bridges.ros2.types._layout import RecordType
from llfsm.bridges.ros2.types._search_path import SearchPath
from llfsm.bridges.ros2.types.definition import Definition, Shape, TypeSource
from llfsm.bridges.ros2.types.message_classes import make_class, shipped_class
from llfsm.whiteboard import Message
from llfsm.whiteboard.message import M, plain
from llfsm.whiteboard.schema import describe, differences


class RosMessage(Generic[M]):
    """One message type; requests, responses, goals and so on are message types, too.

    Its codec raises :class:`.CdrError` that names the field, for any wrong bytes or values.
    """

    def __init__(
        self, definition: Definition, message: type[M], find: Callable[[str], Definition]
    ) -> None:
        self.name = definition.name
        """As ``geometry_msgs/msg/Twist`` or ``turtlesim/srv/Spawn_Request``."""
        self.message = message
        """Has the fields' ROS names (a Python keyword with an underscore behind it)."""
        self._definition = definition
        self._find = find

    def __repr__(self) -> str:
        return f"RosMessage({self.name})"

    @cached_property
    def encode(self) -> Callable[[M], bytes]:
        """Turns a message into bytes: CDR, little-endian, header included.

        A float32 is rounded to the nearest; NaN and infinities are kept. Lists, arrays of numpy and
        other buffers are taken for sequences.
        """

        def otherwise(message: M, error: Exception) -> bytes:
            problem = why_unwritable(self._record, message, error)
            try:
                made = plain(message)
            except (TypeError, ValueError, OverflowError):  # of msgspec
                raise problem from None
            return self._encode_plain(made)

        return compile_encoder(self._record, otherwise)

    @cached_property
    def _encode_plain(self) -> Callable[[M], bytes]:
        def refuse(message: M, error: Exception) -> bytes:
            raise why_unwritable(self._record, message, error) from None

        return compile_encoder(self._record, refuse)

    @cached_property
    def decode(self) -> Callable[[bytes | memoryview], M]:
        """Turns bytes of either order into a message; what follows it is left alone."""
        decode = compile_decoder(self._record, "<", lambda d: self._big_endian(d), self._explain)
        return cast("Callable[[bytes | memoryview], M]", decode)

    @cached_property
    def dds_name(self) -> str:
        """The name in DDS, as ``geometry_msgs::msg::dds_::Twist_``."""
        return _dds_name(self.name)

    @cached_property
    def type_hash(self) -> str:
        """The hash by which ROS compares types: ``RIHS01_`` and 64 digits."""
        return rihs01(self._definition, self._find)

    @cached_property
    def _record(self) -> RecordType:
        return RecordType.of(self.name, self.message, self._find)

    def _explain(self, data: bytes) -> Exception:
        return why_unreadable(self._record, data)

    @cached_property
    def _big_endian(self) -> Callable[[bytes], M]:
        def refuse(data: bytes) -> M:
            raise self._explain(data)

        return compile_decoder(self._record, ">", refuse, self._explain)


@dataclass(frozen=True)
class RosService:
    """A service type: its request and its response."""

    name: str
    dds_name: str
    type_hash: str
    request: RosMessage[Any]
    response: RosMessage[Any]


@dataclass(frozen=True)
class RosAction:
    """An action type. All actions cancel by action_msgs/srv/CancelGoal, and share their status."""

    name: str
    dds_name: str
    type_hash: str
    goal: RosMessage[Any]
    result: RosMessage[Any]
    feedback: RosMessage[Any]
    send_goal: RosService
    get_result: RosService
    feedback_message: RosMessage[Any]


_DEEPEST = 64
"""Messages in messages; those of ROS have five."""
_MOST_FIELDS, _MOST_VALUES = 20_000, 1_000_000
"""Of a type with all types inside; the largest of ROS's common packages have some hundred."""
_BYTES = 16  # that weigh as much as a value


class _TypeSize(NamedTuple):
    fields: int
    values: int
    """Of a message that nobody filled in."""


class TypeLibrary:
    """Finds ROS types by name, and makes their classes and codecs.

    ``texts`` are definitions of messages by name, ``share`` folders of packages, packages or files,
    searched before all others (see :mod:`.search_path`). Raise :class:`.DefinitionPathError` if one
    is not there. All methods raise :class:`.UnknownTypeError` and :class:`.DefinitionSyntaxError`.
    """

    def __init__(
        self, *, share: Iterable[Path] = (), texts: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._places = SearchPath(share, texts)
        self._classes: dict[str, type[Message]] = {}
        self._making: list[str] = []
        self._sizes: dict[str, _TypeSize] = {}
        self._messages: dict[type[Message], RosMessage[Any]] = {}
        self._services: dict[str, RosService] = {}
        self._actions: dict[str, RosAction] = {}
        self._hashes: dict[str, str] = {}

    def message(self, name: str) -> RosMessage[Any]:
        """Find a message type, or the part of a service or an action, by its full name."""
        self._check_kind(name, "message")
        return self._made(self._class(name), name)

    def message_names(self) -> list[str]:
        """List the names of all messages that can be found, but for parts of services."""
        return [name for name in self._places.names() if name.split("/")[1] == "msg"]

    def service(self, name: str) -> RosService:
        """Find a service type by its full name, as ``std_srvs/srv/Trigger``."""
        if name not in self._services:
            self._check_kind(name, "service")
            self._services[name] = RosService(
                name,
                _dds_name(name),
                self._hash(name),
                self.message(f"{name}_Request"),
                self.message(f"{name}_Response"),
            )
        return self._services[name]

    def action(self, name: str) -> RosAction:
        """Find an action type by its full name, as ``turtlesim/action/RotateAbsolute``."""
        if name not in self._actions:
            self._check_kind(name, "action")
            self._actions[name] = RosAction(
                name,
                _dds_name(name),
                self._hash(name),
                self.message(f"{name}_Goal"),
                self.message(f"{name}_Result"),
                self.message(f"{name}_Feedback"),
                self.service(f"{name}_SendGoal"),
                self.service(f"{name}_GetResult"),
                self.message(f"{name}_FeedbackMessage"),
            )
        return self._actions[name]

    def describe(self, name: str) -> tuple[dict[str, Any], str]:
        """Describe a type of any kind, as it is hashed; return its hash, too.

        The description is a type_description_interfaces/msg/TypeDescription as plain data.
        """
        return describe_type(self._places.find(name), self._places.find), self._hash(name)

    def sources(self, name: str) -> list[TypeSource]:
        """Find the sources of a type and of all types that it refers to, itself first."""
        description, _ = self.describe(name)
        names = [each["type_name"] for each in description["referenced_type_descriptions"]]
        return [TypeSource(each, *self._places.source(each)) for each in (name, *names)]

    def used_with_hash(self, type_hash: str) -> str | None:
        """Find the type, of those asked for so far, that has a hash; return its name or None."""
        used = (*self._classes, *self._services, *self._actions)
        return next((name for name in used if self._hash(name) == type_hash), None)

    def of(self, cls: type[M]) -> RosMessage[M]:
        """Find the type of a class with a ROS name, to encode from it and decode into it.

        Raise :class:`.TypeMismatchError` if its fields are not those of the definition.
        """
        name: str = cls.__type_name__  # type: ignore[attr-defined]
        self._check_kind(name, "message")
        ours, theirs = describe(self._class(name)), describe(cls)
        if ours != theirs:
            found = "; ".join(differences(ours, theirs))
            found = found.replace("on the board", "in ROS").replace("the board", "ROS")
            raise TypeMismatchError(f"{cls.__qualname__} is not {name}: {found}")
        return self._made(cls, name)

    def _made(self, cls: type[M], name: str) -> RosMessage[M]:
        if cls not in self._messages:
            self._messages[cls] = RosMessage(self._places.find(name), cls, self._places.find)
        return self._messages[cls]

    def _class(self, name: str) -> type[Message]:
        if name in self._making:
            raise DefinitionSyntaxError(f"{' > '.join([*self._making, name])}: contains itself")
        if name not in self._classes:
            try:
                definition = self._places.find(name)
            except UnknownTypeError as error:
                if not self._making:
                    raise
                raise UnknownTypeError(f"{self._making[-1]} has a field of type {error}") from None
            self._making.append(name)
            try:
                self._measure(definition)
                made = make_class(definition, self._class)
            finally:
                self._making.pop()
            self._classes[name] = shipped_class(made, name) or made
        return self._classes[name]

    def _measure(self, definition: Definition) -> None:
        """Refuse a type, which may come from a bag or a peer, whose class would fill the memory."""
        name, fields, values = definition.name, 0, 0
        if len(self._making) > _DEEPEST:
            raise DefinitionSyntaxError(f"{name}: messages in messages, more than {_DEEPEST} deep")
        for field in definition.fields:
            kind = field.type
            if kind.nested:
                self._class(kind.base)
            inner = self._sizes[kind.base] if kind.nested else _TypeSize(1, 1)
            count = kind.size if kind.shape is Shape.ARRAY else 1
            fields += inner.fields
            values += count * inner.values // (_BYTES if kind.is_bytes else 1)
        if fields > _MOST_FIELDS or values > _MOST_VALUES:
            raise DefinitionSyntaxError(
                f"{name} is too large: it has {fields:,} fields (at most {_MOST_FIELDS:,}) and "
                f"{values:,} values by default (at most {_MOST_VALUES:,}), with those inside"
            )
        self._sizes[name] = _TypeSize(fields, values)

    def _hash(self, name: str) -> str:
        if name not in self._hashes:
            self._hashes[name] = rihs01(self._places.find(name), self._places.find)
        return self._hashes[name]

    def _check_kind(self, name: str, wanted: str) -> None:
        kind = self._places.find(name).kind
        if kind != wanted:
            raise UnknownTypeError(f"{name} is a type of {kind}s, not of {wanted}s")


def _dds_name(name: str) -> str:
    package, kind, base = name.split("/")
    return f"{package}::{kind}::dds_::{base}_"
