"""A typed whiteboard: any number of processes add messages to it and read the latest ones.

Read in this order: :mod:`.message` and :mod:`.schema` (what a message is), :mod:`.slots`
(a name with a message type), :mod:`.board` (the interface), then its implementations,
:mod:`.shared` and :mod:`.local`.
"""

from llfsm.whiteboard.board import Board, BoundSlot, SlotInfo
from llfsm.whiteboard.errors import (
    BoardClosedError,
    BoardCorruptError,
    BoardError,
    BoardFullError,
    BoardMirroredError,
    BoardNotFoundError,
    BoardPermissionError,
    BoardVersionError,
    MessageError,
    MessageFieldError,
    MessageTooLargeError,
    MessageTypeError,
    MessageUnreadableError,
    NetworkError,
    SharedMemoryUnavailableError,
    SlotError,
    SlotNameError,
    SlotNotFoundError,
    SlotRetiredError,
    SlotTypeError,
    WhiteboardError,
)
from llfsm.whiteboard.message import Message
from llfsm.whiteboard.shared import Whiteboard
from llfsm.whiteboard.slots import Sample, Slot

__all__ = [
    "Board",
    "BoardClosedError",
    "BoardCorruptError",
    "BoardError",
    "BoardFullError",
    "BoardMirroredError",
    "BoardNotFoundError",
    "BoardPermissionError",
    "BoardVersionError",
    "BoundSlot",
    "Message",
    "MessageError",
    "MessageFieldError",
    "MessageTooLargeError",
    "MessageTypeError",
    "MessageUnreadableError",
    "NetworkError",
    "Sample",
    "SharedMemoryUnavailableError",
    "Slot",
    "SlotError",
    "SlotInfo",
    "SlotNameError",
    "SlotNotFoundError",
    "SlotRetiredError",
    "SlotTypeError",
    "Whiteboard",
    "WhiteboardError",
]
