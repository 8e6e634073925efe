"""Topic to one slot for each key: what many publishers of one topic send does not get lost."""

from __future__ import annotations

from functools import partial
from typing import Any

from llfsm.whiteboard import Board, Slot, WhiteboardError
from llfsm.whiteboard.errors import BoardClosedError

from ..errors import CdrError, KeyPathError
from ..timer_thread import TimerThread
from ..transport import SerializedMessage
from .key_path import KeyPath
from .link import BridgeLink, LinkFaults
from .relay_settings import RelaySettings
from .relays import FromRos

__all__ = ["KeyedFromRos"]


class KeyedFromRos:
    """Adds what is received to the slots ``PREFIX/KEY``; :meth:`arrived` is a callback.

    A slash before a key, as before a frame's name, is removed. The settings, such as the rate, are
    those of each slot.
    """

    def __init__(
        self,
        board: Board,
        slot: Slot[Any],
        keys: KeyPath,
        link: BridgeLink,
        faults: LinkFaults,
        timer: TimerThread,
        settings: RelaySettings,
    ) -> None:
        """``slot`` is that of the prefix; the others have its type and capacity."""
        self._board = board
        self._slot = slot
        self._keys = keys
        self._link = link
        self._faults = faults
        self._relay = partial(FromRos, link=link, faults=faults, timer=timer, settings=settings)
        self._relays: dict[str, FromRos[Any]] = {}

    def arrived(self, arrival: SerializedMessage[Any]) -> None:
        """Add the messages of each key."""
        try:
            message = arrival.decode()
        except CdrError as error:  # the next may be right
            self._faults.count(self._link, error)
            return
        for key, part in self._keys.split(message):
            try:
                relay = self._relays.get(key) or self._add_relay(key)
            except BoardClosedError:
                return  # the bridge ends
            except (KeyPathError, WhiteboardError) as error:  # the next key may be right
                self._faults.count(self._link, error)
            else:
                relay.take(part)

    def _add_relay(self, key: str) -> FromRos[Any]:
        if not key:
            raise KeyPathError("a message has an empty key")
        slot = Slot(f"{self._slot.name}/{key}", self._slot.type, self._slot.capacity)
        relay = self._relays[key] = self._relay(self._board[slot])
        return relay
