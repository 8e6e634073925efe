"""Machines of several processes that have one name on a board: each is logged, once."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

from llfsm.whiteboard.liveness import is_local, process_text
from llfsm.whiteboard.messages.llfsm import BELL, MACHINES, Bell, MachineStatus, status_slot

from ..engine.failure import logger
from .remote import Directory

if TYPE_CHECKING:
    from collections.abc import Iterable

    from llfsm.whiteboard import Board

    from .commanders import Claims
    from .published import PublishedMachine

__all__ = ["Namesakes"]


class Namesakes:
    """The names under which an arrangement's machines are published, where those are others."""

    def __init__(self, board: Board, claims: Claims):
        self._board = board
        self._claims = claims
        self._published: dict[str, str] = {}  # names that were logged, by machine
        self._logged: set[tuple[str, int]] = set()  # names and processes of others' namesakes

    def forget(self, machine: str) -> None:
        """Note that a machine is gone."""
        self._published.pop(machine, None)

    def look_at(self, entry: PublishedMachine) -> None:
        """Log that a machine has another name on the board, and let the namesake look for it."""
        if entry.published_name == self._published.get(entry.name, entry.name):
            return
        self._published[entry.name] = entry.published_name
        if entry.namesake is not None:
            logger().warning(
                "%s runs a machine %s on this whiteboard, too; this one is published as %s",
                _process(entry.namesake),
                entry.name,
                entry.published_name,
            )
        self._claims.rename(entry.name, entry.published_name)
        self._board.add_message(BELL, Bell(entry.name))

    def report(self, ours: Iterable[str]) -> None:
        """Log, once each, machines of other processes that have the name of one of these."""
        names = {status_slot(each).name.removeprefix(MACHINES) for each in ours}
        for machine in Directory(self._board).machines():
            status = machine.status
            own = status.pid == os.getpid() and is_local(status)
            number = re.search(r"\.\d+$", machine.name)
            if own or number is None or (machine.name, status.pid) in self._logged:
                continue
            name = machine.name[: number.start()]
            if name in names:
                self._logged.add((machine.name, status.pid))
                logger().warning(
                    "%s runs a machine %s on this whiteboard, too; it is published as %s",
                    _process(status),
                    name,
                    machine.name,
                )


def _process(status: MachineStatus) -> str:
    return process_text(status, "process")
