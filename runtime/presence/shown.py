"""What a program shows of a board while it runs: all there is, or what a host of a fleet has."""

from __future__ import annotations

import time
from collections.abc import Iterable

from llfsm.whiteboard import Board
from llfsm.whiteboard.messages.llfsm import MACHINES, Viewer

from .hosts import FleetReader, HostNames

__all__ = ["Shown"]

_LOOK_S = 0.25  # between two looks for what hosts have announced


class Shown:
    """The part of a board that a program shows; what is read for it is, until the board is closed.

    Args:
        board: of this host.
        host: show only what is of this host of the fleet; by default, what is on the board.
        fleet: read what all hosts have.

    """

    def __init__(self, board: Board, host: str = "", *, fleet: bool = False) -> None:
        self._board = board
        self._host = host
        self.fleet = FleetReader(board, host) if host or fleet else None
        """What reads other hosts, if any does."""
        self._look_s = 0.0  # when to look again

    def look(self) -> None:
        """Read what hosts have announced; a few times a second, however often it is called."""
        now_s = time.monotonic()
        if self.fleet is not None and now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            self.fleet.look()

    def has(self, slot: str) -> bool:
        """Return whether a slot on the board is shown."""
        if self.fleet is None or not self._host:
            return True
        return self.fleet.names.of_slot(slot) == self._host

    def ask(self, viewer: Viewer, slots: Iterable[str]) -> None:
        """Have the machines whose statuses are among the slots publish what a viewer shows.

        Those of this host are asked in any case, unless another one is shown.
        """
        names = HostNames(self._board)
        hosts = {self._host or names.own}
        if names.is_mirrored and not self._host:
            hosts |= {names.of_slot(each) for each in slots if each.startswith(MACHINES)}
        for host in hosts:
            names.ask(self._board, host, viewer)
