"""The live environment: a whiteboard that other processes share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from llfsm.runtime.engine.environment import Attendant, BoardEnvironment
from llfsm.runtime.engine.errors import OptionError, UnknownMachineError
from llfsm.runtime.log import logger

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.clock import Clock
    from llfsm.runtime.engine.environment import Elsewhere
    from llfsm.runtime.journal.handover import Handover
    from llfsm.runtime.presence.remote import Directory
    from llfsm.runtime.presence.slot_ownership import Claims
    from llfsm.runtime.presence.status_publisher import StatusPublisher
    from llfsm.whiteboard import Board, Slot


class LiveEnvironment(BoardEnvironment):
    """A whiteboard on which other processes see the machines, control them, and run their own.

    `handover` is the journal's way to a recorder, if the machines are recorded from their start.
    Guards execute the last wills of the machines if the process dies; with `will_after_ms` also if
    it publishes no status for so long, as when it is stopped or hangs. The least is 500, as
    statuses are published four times a second.
    """

    def __init__(
        self,
        whiteboard: Board,
        clock: Clock | None = None,
        *,
        handover: Handover | None = None,
        will_after_ms: int | None = None,
    ):
        if will_after_ms is not None and will_after_ms < 500:
            raise OptionError(f"will_after_ms is {will_after_ms}; it must be 500 or more")
        super().__init__(whiteboard, clock)
        self._handover = handover
        self._will_after_ms = will_after_ms or 0
        self._presence: StatusPublisher | None = None
        self._directory: Directory | None = None
        self._claims: Claims | None = None
        self._releases: dict[str, Callable[[], None]] = {}  # of each machine's claims

    def attend(self, arrangement: Arrangement) -> Attendant | None:
        """Make the publisher of the machines' statuses; None if the board has gone, or is full."""
        if not self.alive:
            return None
        from llfsm.runtime.presence.status_publisher import StatusPublisher
        from llfsm.whiteboard.errors import BoardFullError  # here, as few need the messages
        from llfsm.whiteboard.messages.llfsm import BELL, RECORDER, VIEWER

        try:
            self._presence = StatusPublisher(
                arrangement,
                self.whiteboard,
                self._handover,
                self.clock,
                self._will_after_ms,
                self._claimed(),
            )
            for slot in (BELL, VIEWER, RECORDER):
                self.news.heed(self.whiteboard[slot])
        except BoardFullError as error:  # not even what all machines share has room
            logger().warning("machines cannot be published on the whiteboard: %s", error)
        return self._presence

    def loaded(self, machine: str, path: str) -> None:
        """Leave the machine's last will before its first turn."""
        if self._presence is not None:
            self._presence.add(machine)

    def claim(self, machine: str, slots: Mapping[Slot[Any], bool]) -> None:
        """Claim the slots on the whiteboard, for other processes to see."""
        self._releases[machine] = self._claimed().take(machine, slots)

    def retire(self, machine: str) -> None:
        """Retire the machine's handles, and give back the slots that it claimed."""
        super().retire(machine)
        release = self._releases.pop(machine, None)
        if release is not None:
            release()

    def _claimed(self) -> Claims:
        if self._claims is None:
            # here, as it brings the whiteboard's messages
            from llfsm.runtime.presence.slot_ownership import Claims

            self._claims = Claims(self.whiteboard)
        return self._claims

    def elsewhere(self, name: str, known: Iterable[str]) -> Elsewhere:
        """Return the machine of that name that another process runs on this whiteboard.

        One of this arrangement's that has just left is still published, but is none.
        """
        if self._presence is not None and self._presence.publishes(name):
            raise UnknownMachineError(name, known)
        if self._directory is None:
            from llfsm.runtime.presence.remote import Directory  # here, because few ask

            self._directory = Directory(self.whiteboard)
        return self._directory.find(name, known)
