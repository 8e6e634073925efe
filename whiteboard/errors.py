"""What can go wrong with a whiteboard.

::

    WhiteboardError
    ├── BoardError                    the board as a whole
    │   ├── SharedMemoryUnavailableError   no extension, or no Linux: use Whiteboard.local()
    │   ├── BoardNotFoundError             nobody has made it
    │   ├── BoardPermissionError           somebody else's, or a file that is no whiteboard
    │   ├── BoardVersionError              made by another version: remove it
    │   ├── BoardCorruptError              damaged: remove it
    │   ├── BoardFullError                 no memory, or no room for a slot or a writer
    │   ├── BoardClosedError               closed by this process, or removed under a wait
    │   ├── BoardMirroredError             another daemon mirrors it
    │   └── NetworkError                   no Zenoh, or an endpoint that cannot be used
    ├── SlotError                     one slot of it
    │   ├── SlotNotFoundError              no slot of that name
    │   ├── SlotNameError                  not a possible name
    │   └── SlotTypeError                  the slot holds messages of another type
    └── MessageError                  one message or its class
        ├── MessageTypeError               a class with a field that is not immutable
        ├── MessageFieldError              a field's value is not of the declared type
        ├── MessageTooLargeError           longer than the slot's capacity
        └── MessageUnreadableError         what the slot holds is no message of its type
"""

from __future__ import annotations

import os
import re
from typing import NoReturn

from llfsm.errors import LlfsmError

__all__ = [
    "BoardClosedError",
    "BoardCorruptError",
    "BoardError",
    "BoardFullError",
    "BoardMirroredError",
    "BoardNotFoundError",
    "BoardPermissionError",
    "BoardVersionError",
    "MessageError",
    "MessageFieldError",
    "MessageTooLargeError",
    "MessageTypeError",
    "MessageUnreadableError",
    "NetworkError",
    "SharedMemoryUnavailableError",
    "SlotError",
    "SlotNameError",
    "SlotNotFoundError",
    "SlotTypeError",
    "WhiteboardError",
]


class WhiteboardError(LlfsmError):
    """Stand for every error of the whiteboard."""


class BoardError(WhiteboardError):
    """Tell that the board as a whole cannot be used."""


class SharedMemoryUnavailableError(BoardError):
    """Tell that this installation or system has no shared-memory board."""


class BoardNotFoundError(BoardError):
    """Tell that there is no board of that name, and it was not to be made."""


class BoardPermissionError(BoardError):
    """Tell that the file belongs to somebody else, is protected, or is no whiteboard."""


class BoardVersionError(BoardError):
    """Tell that the board was made by another version or on another kind of machine."""


class BoardCorruptError(BoardError):
    """Tell that the board's file is damaged."""


class BoardFullError(BoardError):
    """Tell that memory, the table of slots or the places of writers are used up."""


class BoardClosedError(BoardError):
    """Tell that this process has closed the board, or that it was removed under a wait."""


class BoardMirroredError(BoardError):
    """Tell that another daemon mirrors the board."""


class NetworkError(BoardError):
    """Tell that a board cannot be mirrored or reached as asked, and why."""


class SlotError(WhiteboardError):
    """Tell that a slot cannot be used as asked."""


class SlotNotFoundError(SlotError):
    """Tell that the board has no slot of that name."""


class SlotNameError(SlotError, ValueError):
    """Tell that a text cannot name a slot or a board."""


class SlotTypeError(SlotError, TypeError):
    """Tell that the slot holds messages of another type, and how the two differ."""


class SchemaClash(Exception):  # noqa: N818  not for users: the board makes a SlotTypeError of it
    """Carry the schema, as JSON, that the board has for a slot opened with another."""

    def __init__(self, schema: bytes) -> None:
        super().__init__(schema)
        self.schema = schema


class MessageError(WhiteboardError):
    """Tell that a message, or its class, cannot be used."""


class MessageTypeError(MessageError, TypeError):
    """Tell which field of a Message class is not of an immutable type."""


class MessageFieldError(MessageError, TypeError):
    """Tell which field's value is not of the declared type; nothing was added."""


class MessageTooLargeError(MessageError, ValueError):
    """Tell that an encoded message exceeds its slot's capacity; nothing was added."""


class MessageUnreadableError(MessageError):
    """Tell that a slot's latest message, number ``count``, does not decode, and who wrote it."""

    def __init__(self, text: str, *, count: int) -> None:
        super().__init__(text)
        self.count = count


def too_large(slot: str, length: int, capacity: int) -> MessageTooLargeError:
    """Describe a message that does not fit."""
    return MessageTooLargeError(
        f"slot {slot!r}: the message takes {length} bytes, the slot holds {capacity}; "
        f"give the Slot a larger capacity where the board is first used"
    )


def wrong_type(slot: str, wanted: type, message: object) -> SlotTypeError:
    """Describe a message of a class that the slot does not take."""
    return SlotTypeError(
        f"slot {slot!r} takes {wanted.__qualname__} messages, not {type(message).__qualname__}"
    )


def wrong_field(slot: str, kind: type, cause: object) -> MessageFieldError:
    """Describe a message with a wrong value in a field."""
    return MessageFieldError(
        f"slot {slot!r}: the {kind.__qualname__} was not added: {name_fields(kind, cause)}"
    )


def name_fields(kind: type, cause: object) -> str:
    """Put field names in place of the array indices by which the decoder tells a place."""
    from msgspec import inspect as mi

    def names(match: re.Match[str]) -> str:
        path, node = "", mi.type_info(kind)
        for index in map(int, re.findall(r"\d+", match[0])):
            if isinstance(node, mi.StructType):
                path, node = f"{path}.{node.fields[index].name}", node.fields[index].type
            else:  # within a tuple; what is deeper is not named
                path, node = f"{path}[{index}]", mi.AnyType()
        return f"`{path.lstrip('.')}`"

    return re.sub(r"`\$((\[\d+\])+)`", names, str(cause))


_FULL = {
    6: "no space left in the file system of the board; remove boards with "
    "`llfsm whiteboard rm`, or use smaller capacities",
    7: "the board has no room for another slot (4096 at most)",
    8: "too many processes write to the board at the same time (256 at most)",
}


def raise_status(status: int, number: int, where: str | None, detail: object) -> NoReturn:
    """Raise the error for a status of the C protocol (``enum lwb_status``) or of the extension.

    ``number`` is the C ``errno`` then, ``where`` the board's path or the slot's name.
    """
    match status, detail:
        case -1, _:
            raise BoardClosedError(f"{where}: this whiteboard was closed")
        case -5, _:
            raise BoardClosedError(f"{where}: this whiteboard was removed")
        case -2, (type() as wanted, message):
            raise wrong_type(str(where), wanted, message)
        case -3, (type() as kind, BaseException() as cause):
            raise wrong_field(str(where), kind, cause) from cause
        case -4, (type() as kind, BaseException() as cause, int(process), int(count)):
            raise MessageUnreadableError(
                f"slot {where!r}: what process {process} wrote is no {kind.__qualname__}: "
                f"{name_fields(kind, cause)}",
                count=count,
            ) from cause
        case 3, _:
            raise BoardNotFoundError(
                f"{where}: no such whiteboard; start what makes it, or see `llfsm whiteboard list`"
            )
        case 5, bytes(schema):
            raise SchemaClash(schema)
        case 4, (int(length), int(capacity)):
            raise too_large(str(where), length, capacity)
        case ((6 | 7 | 8), _):
            raise BoardFullError(f"{where}: {_FULL[status]}")
        case 9, _:
            raise BoardPermissionError(
                f"{where}: no whiteboard of yours: another user's file, a link or another kind "
                f"of file; choose another board name"
            )
        case 10, _:
            raise BoardVersionError(
                f"{where}: made by another version of llfsm or on another kind of machine; "
                f"end its processes and remove it with `llfsm whiteboard rm`"
            )
        case 11, _:
            raise BoardCorruptError(
                f"{where}: damaged; end its processes and remove it with `llfsm whiteboard rm`"
            )
        case 12, _:
            raise SlotNameError(
                f"{where!r}: names take 1 to 255 bytes, capacities 1 byte to 1 GiB, "
                f"schemas 1 MiB at most"
            )
    raise from_errno(number, str(where))


def from_errno(number: int, where: str) -> BoardError:
    """Describe a system call on a board's file that failed."""
    text = f"{where}: {os.strerror(number)}"
    match OSError(number, ""):
        case PermissionError():
            return BoardPermissionError(f"{text}; it belongs to somebody else or is protected")
        case FileNotFoundError() | NotADirectoryError():
            return BoardNotFoundError(f"{text}; the folder for whiteboards must exist")
        case _:
            return BoardError(text)
