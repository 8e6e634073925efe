"""What a program shows of a board while it runs: all there is, or what a host of a fleet has."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from llfsm.whiteboard import Board, Slot, WhiteboardError
from llfsm.whiteboard.messages.debugging import WHYS
from llfsm.whiteboard.messages.llfsm import DEFINITIONS, MACHINES, VARIABLES, Viewer

from .hosts import FleetReader, HostNames, keep_read
from .remote import Directory

__all__ = ["Shown"]

_LOOK_S = 0.25  # between two looks for what hosts have announced
_BESIDE_STATUSES = (DEFINITIONS, VARIABLES, WHYS)


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
        self._directory = Directory(board)
        self._read: dict[str, Slot[Any]] = {}

    def look(self) -> None:
        """Read what hosts have announced; a few times a second, however often it is called."""
        now_s = time.monotonic()
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            if self.fleet is not None:
                self.fleet.look()
            else:
                self._read_machines()

    def _read_machines(self) -> None:
        """Read all that machines of other hosts publish whose statuses are on the board.

        For an arrangement that looks at one, these alone are read.
        """
        names = HostNames(self._board)
        if not names.is_mirrored:
            return
        with suppress(WhiteboardError):  # no room: then what is there is all
            hosts = {names.of_machine(each.name) for each in self._directory.machines()}
            for host in hosts - {"", names.own}:
                for kind in _BESIDE_STATUSES:
                    keep_read(self._board, kind + host, self._read)

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
