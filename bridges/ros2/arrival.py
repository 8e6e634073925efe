"""An arrival whose bytes are here already."""

from __future__ import annotations

from llfsm.whiteboard.message import M

from .transport import Arrival, MessageInfo
from .types import RosMessage

__all__ = ["ArrivedBytes"]


class ArrivedBytes(Arrival[M]):
    """A message as the bytes of it that the middleware handed over."""

    __slots__ = ("_data", "_info", "_of")

    def __init__(self, data: bytes, info: MessageInfo, of: RosMessage[M]) -> None:
        self._data = data
        self._info = info
        self._of = of

    @property
    def data(self) -> bytes:
        """What was published."""
        return self._data

    @property
    def info(self) -> MessageInfo:
        """By whom and when."""
        return self._info

    def decode(self) -> M:
        """Return the message."""
        return self._of.decode(self._data)
