"""A ROS definition as data: from the text of .msg, .srv and .action files.

It is parsed as ROS 2's own tools do (``rosidl_adapter``, Jazzy): defaults, constants, bounds,
arrays. A line is a field, a constant or a comment, so a regular expression for each part of a line
is the whole grammar; a fault is reported with its line. rosbags' parser is not used: it loses
defaults, and reads neither services nor wstring.

Services and actions are definitions, too, as in ROS's type descriptions (REP 2011); their fields
are their parts. A service is a request, a response and, for introspection, an event. An action is a
goal, a result and a feedback, two services and a message that carries the feedback.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from llfsm.bridges.ros2.errors import DefinitionSyntaxError
from llfsm.bridges.ros2.types._primitives import PRIMITIVES

Value = bool | int | float | str | bytes | tuple["Value", ...]

# The field that stands for all of a message without fields: in its hash, and as a byte on the wire.
EMPTY_MEMBER = "structure_needs_at_least_one_member"


class Shape(Enum):
    """The number of values of a field; ROS adds the enum's value to the type id in the hash."""

    SINGLE = 0
    ARRAY = 48  # exactly so many
    BOUNDED = 96  # at most so many
    SEQUENCE = 144


@dataclass(frozen=True)
class FieldType:
    """The type of a field: a primitive's name or ``package/msg/Name``, and how many there are.

    ``size`` is the number of values of an array or the bound of a sequence, ``bound`` that of a
    text in characters; 0 is none.
    """

    base: str
    shape: Shape = Shape.SINGLE
    size: int = 0
    bound: int = 0

    @property
    def nested(self) -> bool:
        """True if the values are messages."""
        return "/" in self.base

    @property
    def is_text(self) -> bool:
        """True if the values are texts."""
        return not self.nested and PRIMITIVES[self.base].is_text

    @property
    def is_bytes(self) -> bool:
        """True if the field is ``bytes`` in Python: several unsigned values of eight bits."""
        several = self.shape is not Shape.SINGLE and not self.nested
        return several and PRIMITIVES[self.base].is_byte


@dataclass(frozen=True)
class Field:
    """A field; ``default`` is None if the definition names none."""

    name: str
    type: FieldType
    default: Value | None = None

    @property
    def attribute(self) -> str:
        """Its name in Python: an underscore is added to a keyword, as no ROS name ends in one."""
        return f"{self.name}_" if keyword.iskeyword(self.name) else self.name


@dataclass(frozen=True)
class Constant:
    """A constant of a message, and the primitive type that it has there."""

    name: str
    value: Value
    type: str


@dataclass(frozen=True)
class Definition:
    """A message, service or action (its ``kind``), under its full name."""

    name: str
    fields: tuple[Field, ...] = ()
    constants: tuple[Constant, ...] = ()
    kind: str = "message"


_Body = tuple[tuple[Field, ...], tuple[Constant, ...]]


def _fields(**types: str | FieldType) -> tuple[Field, ...]:
    return tuple(
        Field(name, FieldType(of) if isinstance(of, str) else of) for name, of in types.items()
    )


_GOAL_ID = _fields(goal_id="unique_identifier_msgs/msg/UUID")


def service_definitions(name: str, request: _Body, response: _Body) -> list[Definition]:
    """Make a service's definitions: itself, its request, response and event."""
    asked, answered, event = (f"{name}_{part}" for part in ("Request", "Response", "Event"))
    of_event = _fields(
        info="service_msgs/msg/ServiceEventInfo",
        request=FieldType(asked, Shape.BOUNDED, 1),
        response=FieldType(answered, Shape.BOUNDED, 1),
    )
    whole = _fields(request_message=asked, response_message=answered, event_message=event)
    return [
        Definition(asked, *request),
        Definition(answered, *response),
        Definition(event, of_event),
        Definition(name, whole, kind="service"),
    ]


def action_definitions(name: str, goal: _Body, result: _Body, feedback: _Body) -> list[Definition]:
    """Make an action's definitions: itself and all its parts, those of its services included."""
    parts = ("Goal", "Result", "Feedback", "SendGoal", "GetResult", "FeedbackMessage")
    goals, results, feedbacks, send_goal, get_result, message = (f"{name}_{p}" for p in parts)
    accepted = _fields(accepted="bool", stamp="builtin_interfaces/msg/Time")
    whole = _fields(
        goal=goals,
        result=results,
        feedback=feedbacks,
        send_goal_service=send_goal,
        get_result_service=get_result,
        feedback_message=message,
    )
    return [
        Definition(goals, *goal),
        Definition(results, *result),
        Definition(feedbacks, *feedback),
        *service_definitions(send_goal, (_GOAL_ID + _fields(goal=goals), ()), (accepted, ())),
        *service_definitions(
            get_result, (_GOAL_ID, ()), (_fields(status="int8", result=results), ())
        ),
        Definition(message, _GOAL_ID + _fields(feedback=feedbacks)),
        Definition(name, whole, kind="action"),
    ]


_LOWER = r"[a-z](?:_?[a-z0-9])*"
_UPPER = r"[A-Z][A-Za-z0-9]*"
TYPE_NAME = re.compile(rf"({_LOWER})/(msg|srv|action)/({_UPPER})((?:_{_UPPER})*)")

_LINE = re.compile(r"(?P<type>\S+)\s+(?P<name>\w+)\s*(?P<equals>=?)\s*(?P<value>.*)")
_QUOTED = r""""(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'"""
_VALUE = re.compile(rf"(\[(?:{_QUOTED}|[^]\"'#])*\]|{_QUOTED}|[^#]*?)\s*(?:#.*)?")
_ITEM = re.compile(rf"\s*({_QUOTED}|[^,\"']*?)\s*(?:,|$)")
_TYPE = re.compile(
    rf"(?:(?P<package>{_LOWER})/(?:msg/)?)?(?P<base>{_UPPER}|[a-z]+[0-9]*)"
    r"(?:<=(?P<bound>[0-9]+))?(?P<array>\[(?P<most><=)?(?P<size>[0-9]*)\])?"
)
_FIELD_NAME = re.compile(_LOWER)
_CONSTANT_NAME = re.compile(r"[A-Z](?:[A-Z0-9_]*[A-Z0-9])?")
_BUILTIN = {"time": "Time", "duration": "Duration"}  # names from ROS 1 that ROS 2 still accepts


def parse(text: str, name: str, where: str) -> dict[str, Definition]:
    """Parse a file into definitions by name.

    A message is one; a service also has those of its request, response and event; an action those
    of all its parts. ``where`` names the file in a :class:`.DefinitionSyntaxError`.
    """
    match = TYPE_NAME.fullmatch(name)
    if match is None or match[4]:
        raise DefinitionSyntaxError(f"{where}: {name!r} cannot name a definition")
    package, kind, _, _ = match.groups()
    parts = _split(text)
    expected = {"msg": 1, "srv": 2, "action": 3}[kind]
    if len(parts) != expected:
        raise DefinitionSyntaxError(
            f"{where}: a .{kind} has {expected} parts, with a line --- between them; "
            f"this one has {len(parts)}"
        )
    bodies = [_body(lines, package, where) for lines in parts]
    match kind:
        case "msg":
            made = [Definition(name, *bodies[0])]
        case "srv":
            made = service_definitions(name, *bodies)
        case _:
            made = action_definitions(name, *bodies)
    return {definition.name: definition for definition in made}


_Lines = list[tuple[int, str]]


def _split(text: str) -> list[_Lines]:
    """Split the numbered lines at those that are ``---``."""
    parts: list[_Lines] = [[]]
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() == "---":
            parts.append([])
        else:
            parts[-1].append((number, line.strip()))
    return parts


def _body(lines: _Lines, package: str, where: str) -> _Body:
    found: dict[str, Field | Constant] = {}
    for number, line in lines:
        if not line or line.startswith("#"):
            continue
        try:
            item = _item(line, package)
            if item.name in found:
                raise ValueError(f"{item.name} is defined twice")
        except ValueError as error:
            raise DefinitionSyntaxError(f"{where}:{number}: {error}: {line}") from None
        found[item.name] = item
    found.pop(EMPTY_MEMBER, None)
    return (
        tuple(item for item in found.values() if isinstance(item, Field)),
        tuple(item for item in found.values() if isinstance(item, Constant)),
    )


def _item(line: str, package: str) -> Field | Constant:
    match = _LINE.fullmatch(line)
    if match is None:
        raise ValueError("neither a field (TYPE NAME [DEFAULT]) nor a constant (TYPE NAME=VALUE)")
    kind, name = _type(match["type"], package), match["name"]
    value = _VALUE.fullmatch(match["value"])
    if value is None:
        raise ValueError("brackets or quotes that do not end")
    if match["equals"]:
        if not _CONSTANT_NAME.fullmatch(name):
            raise ValueError(f"{name!r} cannot name a constant: A-Z, 0-9 and single _")
        if kind.nested or kind.shape is not Shape.SINGLE:
            raise ValueError("a constant has a primitive type")
        return Constant(name, _value(value[1], kind), kind.base)
    if not _FIELD_NAME.fullmatch(name):
        raise ValueError(f"{name!r} cannot name a field: a-z, 0-9 and single _ between them")
    return Field(name, kind, _default(value[1], kind) if value[1] else None)


def _type(text: str, package: str) -> FieldType:
    match = _TYPE.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a type")
    base, bound = match["base"], int(match["bound"] or 0)
    if base in _BUILTIN:
        base = f"builtin_interfaces/msg/{_BUILTIN[base]}"
    elif base[0].isupper():
        base = f"{match['package'] or package}/msg/{base}"
    elif base not in PRIMITIVES or match["package"]:
        raise ValueError(f"{text!r} is not a type; the primitive ones are {', '.join(PRIMITIVES)}")
    if match["bound"] and (bound == 0 or not FieldType(base).is_text):
        raise ValueError("<= bounds a string's length, or a sequence's within the brackets")
    if not match["array"]:
        return FieldType(base, bound=bound)
    if not match["size"]:
        if match["most"]:
            raise ValueError("a bound without a number")
        return FieldType(base, Shape.SEQUENCE, bound=bound)
    size = int(match["size"])
    if not 1 <= size < 2**32:
        raise ValueError("an array's size is 1 to 2**32 - 1")
    return FieldType(base, Shape.BOUNDED if match["most"] else Shape.ARRAY, size, bound)


def _default(text: str, kind: FieldType) -> Value:
    if kind.nested:
        raise ValueError("only fields of primitive types have defaults")
    if kind.shape is Shape.SINGLE:
        return _value(text, kind)
    if not (text.startswith("[") and text.endswith("]")):
        raise ValueError("an array's default is written in brackets")
    inner, values, at = text[1:-1].strip(), [], 0
    while at < len(inner):
        match = _ITEM.match(inner, at)
        if match is None or not match[1]:
            raise ValueError("an array's default is values with commas between them")
        values.append(_value(match[1], kind))
        at = match.end()
    if (kind.shape is Shape.ARRAY and len(values) != kind.size) or 0 < kind.size < len(values):
        raise ValueError(f"{len(values)} values for an array of {kind.size}")
    return bytes(values) if kind.is_bytes else tuple(values)  # type: ignore[arg-type]


def _value(text: str, kind: FieldType) -> bool | int | float | str:
    value = PRIMITIVES[kind.base].parse(text)
    if isinstance(value, str) and 0 < kind.bound < len(value):
        raise ValueError(f"a text of more than {kind.bound} characters")
    return value


_RULE = "=" * 80


class TypeSource(NamedTuple):
    """The text that defines a type, as type_description_interfaces/msg/TypeSource."""

    type_name: str
    encoding: str
    """``msg``, ``srv`` or ``action``; ``implicit``: a part of a service or an action."""
    text: str


def bundled(sources: Sequence[TypeSource]) -> str:
    """Join the texts of a type and of all that it refers to into one, as MCAP's ``ros2msg``."""
    first, *others = sources
    parts = [first.text]
    for each in others:
        parts += [_RULE, f"MSG: {each.type_name.replace('/msg/', '/')}", each.text]
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


def unbundled(name: str, text: str) -> dict[str, str]:
    """Split a bundle into the text of each type, by full name; ``name`` is the first one's."""
    first, *others = text.replace("\r\n", "\n").split(f"{_RULE}\nMSG: ")
    found = {name: first}
    for other in others:
        title, _, body = other.partition("\n")
        package, _, base = title.strip().rpartition("/")
        found[f"{package.removesuffix('/msg')}/msg/{base}"] = body
    return found
