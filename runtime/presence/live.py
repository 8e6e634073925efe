"""The live environment: a whiteboard that other processes share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from ..engine.environment import Attendant, BoardEnvironment

if TYPE_CHECKING:
    from llfsm.whiteboard import Board

    from ..engine.arrangement import Arrangement
    from ..engine.clock import Clock
    from ..journal.handover import Handover
    from .remote import Directory, RemoteMachine

__all__ = ["LiveEnvironment"]


class LiveEnvironment(BoardEnvironment):
    """A whiteboard on which other processes see the machines, control them, and run their own.

    `handover` is the journal's way to a recorder, if the machines are recorded from their start.
    """

    def __init__(
        self, whiteboard: Board, clock: Clock | None = None, *, handover: Handover | None = None
    ):
        super().__init__(whiteboard, clock)
        self._handover = handover
        self._directory: Directory | None = None

    def attend(self, arrangement: Arrangement) -> Attendant | None:
        """Return what publishes the machines' statuses; None if the whiteboard has gone."""
        if not self.alive:
            return None
        from .reporting import Presence  # here, as it brings the whiteboard's messages

        return Presence(arrangement, self.whiteboard, self._handover, self.clock)

    def elsewhere(self, name: str, known: Iterable[str]) -> RemoteMachine:
        """Return the machine of that name that another process runs on this whiteboard."""
        if self._directory is None:
            from .remote import Directory  # here, because few ask

            self._directory = Directory(self.whiteboard)
        return self._directory.find(name, known)
