"""The hosts of a fleet as the source of a page."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec

from llfsm.runtime.presence.fleet_table import FleetTable, HostRow
from llfsm.whiteboard.board_files import DIRECTORY

from .frames import TimedEncoder
from .reopened_board import ReopenedBoard

__all__ = ["FleetEncoder", "FleetSnapshot", "FleetSource"]


class FleetSnapshot(NamedTuple):
    """The hosts at one moment."""

    now_ns: int
    hosts: Sequence[HostRow]
    trouble: str
    """Why there is nothing to show, in a sentence with the remedy; else empty."""


class FleetSource:
    """Reads the hosts of the fleet from the board of a name while it is asked for snapshots."""

    def __init__(self, name: str, directory: str | os.PathLike[str] = DIRECTORY) -> None:
        self.title = f"{name}, fleet"
        self._opened = ReopenedBoard(name, directory)
        self._table: FleetTable | None = None
        self._hosts: Sequence[HostRow] = ()

    def snapshot(self) -> FleetSnapshot:
        """Return the hosts; never raise because of what a board holds."""
        now_ns, trouble = time.monotonic_ns(), ""
        try:
            before, board = self._opened.board, self._opened.look(now_ns)
            if board is None:
                self._table, trouble = None, self._opened.trouble
            else:
                if board is not before or self._table is None:
                    self._table = FleetTable(board)
                self._table.look()
                self._hosts, trouble = self._table.rows(), self._table.problem()
        except Exception as error:  # also what a damaged file makes of the libraries that read it
            trouble = f"the whiteboard cannot be read: {error}; trying again"
            self.close()
        return FleetSnapshot(now_ns, self._hosts, trouble)

    def close(self) -> None:
        """Read no more of the hosts."""
        self._table, self._hosts = None, ()
        self._opened.close()  # what is bound to it is forgotten with it


class FleetEncoder(TimedEncoder):
    """Encode what a page does not know yet of the hosts.

    A frame is a JSON object. Members that are missing have not changed:

        now      seconds on the clock of all stamps; 0 is the page's first frame
        trouble  why there is nothing to show
        hosts    by name, see `_host`; null: removed
    """

    def __init__(self) -> None:
        super().__init__()
        self._trouble: str | None = None
        self._known: dict[str, HostRow] = {}

    def encode(self, snapshot: FleetSnapshot, beat: bool) -> bytes | None:
        """Return the frame for a snapshot; None if nothing has changed and no `beat` is due."""
        if self._base_ns is None:
            self._base_ns = snapshot.now_ns
        frame: dict[str, Any] = {}
        if snapshot.trouble != self._trouble:
            frame["trouble"] = self._trouble = snapshot.trouble
        rows = {row.name: row for row in snapshot.hosts}
        new: dict[str, Any] = dict.fromkeys(self._known.keys() - rows.keys())
        new |= {n: self._host(row) for n, row in rows.items() if self._known.get(n) != row}
        self._known = rows
        if new:
            frame["hosts"] = new
        return self._framed(snapshot.now_ns, frame, beat=beat)

    def _host(self, row: HostRow) -> dict[str, Any]:
        contact_ns = row.contact_ns
        return {
            "own": row.is_own,
            "there": row.is_there,
            "contact": None if contact_ns is None else self._seconds(contact_ns),
            "lead": None if row.lead_s is None else round(row.lead_s, 4),
            "trouble": row.trouble,
            "summary": None if row.summary is None else msgspec.structs.asdict(row.summary),
        }
