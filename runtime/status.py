"""Tell on the whiteboard where each machine stands, for whoever watches from another process."""

from __future__ import annotations

from typing import TYPE_CHECKING

from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot

from .events import End, Event, RoundEnd

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot

__all__ = ["StatusPoster"]


class StatusPoster:
    """Observe an arrangement and post a machine's status at the end of a round that changed it."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._slots: dict[str, BoundSlot[MachineStatus]] = {}
        self._posted: dict[str, MachineStatus] = {}

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, RoundEnd):
            now = {
                machine.machine: MachineStatus(machine.state, machine.suspended)
                for machine in event.machines
                if machine is not None
            }
        elif isinstance(event, End):
            now = {}
        else:
            return
        for name, status in now.items():
            if self._posted.get(name) != status:
                self._post(name, status)
        for name in self._posted.keys() - now.keys():
            self._post(name, MachineStatus(self._posted.pop(name).state, loaded=False))

    def _post(self, name: str, status: MachineStatus) -> None:
        slot = self._slots.get(name)
        if slot is None:
            slot = self._slots[name] = self._board[status_slot(name)]
        slot.add(status)
        if status.loaded:
            self._posted[name] = status
