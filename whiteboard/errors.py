"""The errors of whiteboards.

::

    WhiteboardError
    ├── BoardError                    a board as a whole
    │   ├── SharedMemoryUnavailableError   no extension, or not Linux: use Whiteboard.local()
    │   ├── BoardNotFoundError             the board does not exist
    │   ├── BoardPermissionError           another user's file, or not a whiteboard
    │   ├── BoardVersionError              made by another version: remove it
    │   ├── BoardCorruptError              damaged: remove it
    │   ├── BoardFullError                 no memory, or no room for a slot or a writer
    │   ├── BoardClosedError               closed by this process, or removed during a wait
    │   ├── BoardMirroredError             another daemon mirrors it
    │   └── NetworkError                   no Zenoh, or an unusable endpoint
    ├── SlotError                     one slot of a board
    │   ├── SlotNotFoundError              no slot of that name
    │   ├── SlotNameError                  an invalid name
    │   ├── SlotRetiredError               a handle that adds no more
    │   └── SlotTypeError                  the slot holds messages of another type
    └── MessageError                  one message or its class
        ├── MessageTypeError               a class with a field that is not immutable
        ├── MessageFieldError              a field's value is not of the declared type
        ├── MessageTooLargeError           longer than the slot's capacity
        └── MessageUnreadableError         the slot's data is not a message of its type
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from typing import NoReturn

from llfsm.errors import LlfsmError, did_you_mean, listed
from llfsm.whiteboard.slot_names import is_users


class WhiteboardError(LlfsmError):
    """Base of all errors of whiteboards."""


class BoardError(WhiteboardError):
    """A board as a whole cannot be used."""


class SharedMemoryUnavailableError(BoardError):
    """Boards in shared memory do not exist on this installation or system."""


class BoardNotFoundError(BoardError):
    """The board does not exist, and was not to be made."""


class BoardPermissionError(BoardError):
    """The file belongs to another user, is protected, or is not a whiteboard."""


class BoardVersionError(BoardError):
    """The board was made by another version or on another kind of machine."""


class BoardCorruptError(BoardError):
    """The board's file is damaged."""


class BoardFullError(BoardError):
    """The memory, the table of slots or the table of writers is full."""


class BoardClosedError(BoardError):
    """The board was closed by this process, or removed during a wait."""


class BoardMirroredError(BoardError):
    """Another daemon mirrors the board."""


class NetworkError(BoardError):
    """A board cannot be mirrored or reached; the text gives the reason.

    `setting` is the path of the wrong one in the settings, as ("listen", 0), or empty.
    """

    def __init__(self, what: str, setting: tuple[str | int, ...] = ()):
        self.setting = setting
        super().__init__(what)


class SlotError(WhiteboardError):
    """A slot cannot be used as requested."""


class SlotNotFoundError(SlotError):
    """The board has no slot of that name; the message lists those it has, without llfsm's own."""

    def __init__(self, board: str, name: str, slots: Iterable[str]):
        known = list(filter(is_users, slots))
        super().__init__(
            f"board {board!r} has no slot {name!r}; its slots: {listed(known)}"
            f"{did_you_mean(name, known)}"
        )


class SlotNameError(SlotError, ValueError):
    """The name of a slot or a board is invalid."""


class SlotRetiredError(SlotError):
    """The handle was retired: its owner has ended and adds no more."""


class SlotTypeError(SlotError, TypeError):
    """The slot holds messages of another type; the text describes the difference."""


class SchemaClash(Exception):  # noqa: N818  not for users: converted to a SlotTypeError
    """A slot was opened with another schema than the board's, which this carries as JSON."""

    def __init__(self, schema: bytes) -> None:
        super().__init__(schema)
        self.schema = schema


class MessageError(WhiteboardError):
    """A message, or its class, cannot be used."""


class MessageTypeError(MessageError, TypeError):
    """A field of a Message class is not of an immutable type; the text names it."""


class MessageFieldError(MessageError, TypeError):
    """A field's value is not of the declared type; nothing was added."""


class MessageTooLargeError(MessageError, ValueError):
    """An encoded message exceeds its slot's capacity; nothing was added."""


class MessageUnreadableError(MessageError):
    """A slot's latest message, number ``count``, cannot be decoded; the text names its writer."""

    def __init__(self, text: str, *, count: int) -> None:
        super().__init__(text)
        self.count = count


# What follows makes errors in one wording for boards in shared memory and in one process.


def too_large(slot: str, length: int, capacity: int) -> MessageTooLargeError:
    """Make the error for a message of `length` bytes that does not fit."""
    return MessageTooLargeError(
        f"slot {slot!r}: the message takes {length} bytes, the slot holds {capacity}; "
        f"give the Slot a larger capacity where the board is first used"
    )


def wrong_type(slot: str, wanted: type, message: object) -> SlotTypeError:
    """Make the error for a message of another class."""
    return SlotTypeError(
        f"slot {slot!r} accepts {wanted.__qualname__} messages, not {type(message).__qualname__}"
    )


def wrong_field(slot: str, kind: type, cause: object) -> MessageFieldError:
    """Make the error for a message with a wrong value in a field."""
    return MessageFieldError(
        f"slot {slot!r}: the {kind.__qualname__} was not added: {name_fields(kind, cause)}"
    )


def name_fields(kind: type, cause: object) -> str:
    """Put field names in place of array indices in a decoder's error: ``$[0][2]`` is ``a.z``."""
    from msgspec import inspect as mi

    with_items = mi.StructType, mi.TupleType, mi.VarTupleType, mi.FrozenSetType

    def names(match: re.Match[str]) -> str:
        path, node = "", mi.type_info(kind)
        for index in map(int, re.findall(r"\d+", match[0])):
            if isinstance(node, mi.UnionType):  # at most one of its types has items
                node = next(each for each in node.types if isinstance(each, with_items))
            match node:
                case mi.StructType(fields=fields):
                    path, node = f"{path}.{fields[index].name}", fields[index].type
                case mi.TupleType(item_types=types):
                    path, node = f"{path}[{index}]", types[index]
                case mi.VarTupleType() | mi.FrozenSetType():
                    path, node = f"{path}[{index}]", node.item_type
        return f"`{path.lstrip('.')}`"

    return re.sub(r"`\$((\[\d+\])+)`", names, str(cause))


_PLAIN: dict[int, tuple[type[WhiteboardError], str]] = {  # of `raise_status`, by the status
    -7: (BoardCorruptError, "{}: the file of this whiteboard was truncated: what it held is lost"),
    -6: (SlotRetiredError, "slot {!r}: this handle was retired and adds no more"),
    -5: (BoardClosedError, "{}: this whiteboard was removed"),
    -1: (BoardClosedError, "{}: this whiteboard was closed"),
    3: (
        BoardNotFoundError,
        "{}: no such whiteboard; start the program that makes it, or see `llfsm whiteboard list`",
    ),
    6: (
        BoardFullError,
        "{}: no space left in the file system of the board; remove boards with "
        "`llfsm whiteboard rm`, or use smaller capacities",
    ),
    7: (BoardFullError, "{}: the board has no room for another slot (4096 at most)"),
    8: (BoardFullError, "{}: too many processes write to the board at the same time (256 at most)"),
    9: (
        BoardPermissionError,
        "{}: not a whiteboard of this user: another user's file, a link or another kind of file; "
        "choose another board name, or name the group that it is for (--group)",
    ),
    10: (
        BoardVersionError,
        "{}: made by another version of llfsm or on another kind of machine; end its processes and "
        "remove it with `llfsm whiteboard rm`",
    ),
    11: (
        BoardCorruptError,
        "{}: damaged; end its processes and remove it with `llfsm whiteboard rm`",
    ),
    12: (
        SlotNameError,
        "{!r}: names must have 1 to 255 bytes, capacities 1 byte to 1 GiB, schemas at most 1 MiB",
    ),
}


def raise_status(status: int, number: int, where: str | None, detail: object) -> NoReturn:
    """Raise the error for a status, as the extension calls it.

    ``status`` is one of the C protocol (``enum lwb_status``), or a negative one of the extension;
    ``number`` is the C ``errno``, and ``where`` the board's path or the slot's name.
    """
    match status, detail:
        case -3, (type() as kind, BaseException() as cause):
            raise wrong_field(str(where), kind, cause) from cause
        case -4, (type() as kind, BaseException() as cause, int(process), int(count)):
            raise MessageUnreadableError(
                f"slot {where!r}: the data that process {process} wrote is not a "
                f"{kind.__qualname__}: {name_fields(kind, cause)}",
                count=count,
            ) from cause
        case 4, (int(length), int(capacity)):
            raise too_large(str(where), length, capacity)
        case 5, bytes(schema):
            raise SchemaClash(schema)
        case 5, _:
            raise SlotTypeError(
                f"slot {where!r} has another type by now, as its name was given up; bind it again"
            )
    if status in _PLAIN:
        error, text = _PLAIN[status]
        raise error(text.format(where))
    raise from_errno(number, str(where))


def from_errno(number: int, where: str) -> BoardError:
    """Make the error for a failed system call on a board's file."""
    text = f"{where}: {os.strerror(number)}"
    match OSError(number, ""):
        case PermissionError():
            return BoardPermissionError(f"{text}; it belongs to another user or is protected")
        case FileNotFoundError() | NotADirectoryError():
            return BoardNotFoundError(f"{text}; the folder for whiteboards must exist")
        case _:
            return BoardError(text)
