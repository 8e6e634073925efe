"""Tell on the whiteboard where each machine stands, for whoever watches from another process."""

from __future__ import annotations

from typing import TYPE_CHECKING

from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot

    from .roster import Roster

__all__ = ["StatusPoster"]

_PAUSE_NS = 20_000_000  # as often as anybody can look


class StatusPoster:
    """Post the status of each machine of an arrangement when it has changed.

    It is asked after every round. While round follows round without a sleep it looks only fifty
    times a second, so that a fast arrangement stays fast: the latest status is told.
    """

    def __init__(self, roster: Roster, board: Board) -> None:
        self._roster = roster
        self._board = board
        self._slots: dict[str, BoundSlot[MachineStatus]] = {}
        self._posted: dict[str, MachineStatus] = {}
        self._due_ns = roster.clock.now_ns()

    def __call__(self, fired: bool) -> None:
        """Post what has changed, after a round in which a transition `fired` or none did."""
        now_ns = self._roster.clock.now_ns()
        if not fired or now_ns >= self._due_ns:
            self._due_ns = now_ns + _PAUSE_NS
            self._post(
                {
                    machine.machine: MachineStatus(machine.state, machine.suspended)
                    for machine in self._roster.standings()
                    if machine is not None
                }
            )

    def end(self) -> None:
        """Post that the machines are gone."""
        self._post({})

    def _post(self, now: dict[str, MachineStatus]) -> None:
        gone = {
            name: MachineStatus(status.state, loaded=False)
            for name, status in self._posted.items()
            if name not in now
        }
        for name, status in (now | gone).items():
            if self._posted.get(name) != status:
                if name not in self._slots:
                    self._slots[name] = self._board[status_slot(name)]
                self._slots[name].add(status)
        self._posted = now
