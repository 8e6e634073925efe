"""What both ends of an action in slots share: one thread, on which all that happens is handled."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

from llfsm.whiteboard import Board, BoundSlot, Message
from llfsm.whiteboard.errors import BoardClosedError, WhiteboardError

from ..errors import CdrError, TransportClosedError
from ..timer_thread import TimerThread
from ..transport import Node
from ..types import TypeLibrary
from .action_slots import ActionSlots
from .link import BridgeLink, LinkFaults

__all__ = ["ActionPlace", "SlotAction"]


class ActionPlace(NamedTuple):
    """What an end of an action connects."""

    board: Board
    slots: ActionSlots
    node: Node
    name: str
    """The action's name, as the node resolves it."""
    types: TypeLibrary
    timeout: float
    """How many seconds an answer may take, and a server be away."""
    link: BridgeLink
    faults: LinkFaults
    timer: TimerThread
    """Whose thread it is."""


class SlotAction:
    """An end of an action whose goals are in slots."""

    def __init__(self, place: ActionPlace) -> None:
        self._slots = place.slots
        self._timeout = place.timeout
        self._link = place.link
        self._faults = place.faults
        self._timer = place.timer
        self._subscriptions: list[Any] = []

    def finish(self) -> None:
        """Ask for the end, after what is on the slots by now."""
        for subscription in self._subscriptions:
            subscription.finish()

    def _take_from(self, slot: BoundSlot[Any], take: Callable[..., None], after: int) -> None:
        """Call `take` with what comes on the slot."""
        self._subscriptions.append(
            slot.subscribe(self._on_thread(take), after=after, on_error=self._unreadable)
        )

    def _take_no_more(self) -> None:
        for subscription in self._subscriptions:
            subscription.close()

    def _on_thread(self, do: Callable[..., None]) -> Callable[..., None]:
        def guarded(*arguments: Any) -> None:
            with suppress(BoardClosedError, TransportClosedError):  # the bridge ends
                try:
                    do(*arguments)
                except CdrError as error:  # a value that ROS cannot have
                    self._faults.count(self._link, error)

        return lambda *arguments: self._timer.call_soon(partial(guarded, *arguments))

    def _add(self, slot: BoundSlot[Any], message: Message) -> bool:
        try:
            slot.add(message)
        except BoardClosedError:
            return False  # the bridge ends
        except WhiteboardError as error:
            self._faults.count(self._link, error)
            return False
        return True

    def _unreadable(self, error: Exception) -> bool:
        self._faults.count(self._link, error)
        return True
