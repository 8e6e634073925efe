"""Reads the slots of a relay that is keyed by frame into a buffer."""

from __future__ import annotations

from llfsm.bridges.ros2.transforms.transform_buffer import TransformBuffer
from llfsm.whiteboard import Board, Slot
from llfsm.whiteboard.messages.geometry_msgs import TransformStamped


class TransformListener:
    """Pulls the slots ``tf/FRAME`` and ``tf_static/FRAME`` of a board into a buffer.

    A slot holds the newest transform of its frame, so between two pulls the ones before are lost:
    pull as often as you want to interpolate.
    """

    def __init__(
        self,
        board: Board,
        buffer: TransformBuffer,
        *,
        moving: str = "tf",
        static: str = "tf_static",
    ) -> None:
        self._board = board
        self._buffer = buffer
        self._changed = board.watcher()
        self._prefixes = {f"{moving}/": False, f"{static}/": True}

    def pull(self) -> None:
        """Add what is new in the slots to the buffer.

        Raise :class:`.SlotTypeError` for a slot of such a name with another type, and
        :class:`.BoardClosedError`.
        """
        for name in self._changed(0.0):
            for prefix, static in self._prefixes.items():
                if name.startswith(prefix):
                    message = self._board[Slot(name, TransformStamped)].get()
                    if message is not None:
                        self._buffer.add(message, static=static)
