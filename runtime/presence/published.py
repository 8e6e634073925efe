"""One machine on the whiteboard: its slots, the name that it has there, and its last will."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from llfsm.whiteboard.errors import BoardFullError, MessageError
from llfsm.whiteboard.messages.llfsm import (
    MachineRequest,
    MachineStatus,
    definition_slot,
    request_slot,
    status_slot,
    variables_slot,
)

from ..engine.failure import logger
from ..engine.machine import Machine
from .description import definition_of, variables_of
from .remote import is_live
from .will import Will

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot, Message, Slot

    from ..engine.seat import Failure

__all__ = ["Published", "PublishedMachine"]


class Published(NamedTuple):
    """The part of a status that is posted as soon as it changes."""

    state: str
    suspended: bool
    pending: str
    obeyed: int
    entered_ns: int | None
    failure: Failure | None
    hang: str


class PublishedMachine:
    """The slots of one machine. The machine of another process may have its name there."""

    def __init__(
        self,
        board: Board,
        name: str,
        machine: Machine,
        safe_values: list[tuple[Slot[Any], Message]],
        silent_ms: int,
    ):
        self._board = board
        self._machine = machine
        self._safe_values = safe_values
        self._silent_ms = silent_ms
        self.name = self.published_name = name
        self.namesake: MachineStatus | None = None  # of the live machine that has the name
        self._will: Will | None = None
        self._take()

    def _take(self) -> None:
        """Claim a name that no live machine has: `P`, else `P.0`, `P.1` …, as in an arrangement."""
        names, number = self.name, -1
        while True:
            self._slot = self._board[status_slot(names)]
            sample = self._slot.sample()
            if sample is None or not is_live(sample):
                break
            self.namesake = self.namesake or sample.message
            number += 1
            names = f"{self.name}.{number}"
        self.published_name = names
        if self._will is not None:  # under the name that another process has claimed, too
            self._will.withdraw()
            self._will = None
        self._requests: BoundSlot[MachineRequest] = self._board[request_slot(names)]
        self._will = self._leave_will(names)
        self.obeyed = self._requests.count  # those were for an earlier process
        self._count = 0
        self.published: Published | None = None
        self.beat_ns = 0
        self._variables = variables_slot(names)
        self._define(names)

    def _leave_will(self, names: str) -> Will | None:
        if not self._safe_values:
            return None
        try:
            will = Will(self._board, names, self._safe_values, self._silent_ms)
            will.leave()
        except BoardFullError as error:
            logger().warning("%s has no last will: %s", names, error)
            return None
        return will

    def _define(self, names: str) -> None:
        """Post the definition; without code if that is too large or not text."""
        for sections in (True, False):
            definition = definition_of(type(self._machine).table, sections=sections)
            with suppress(MessageError):
                try:
                    self._board[definition_slot(names)].add(definition)
                except BoardFullError as error:
                    logger().warning("%s is published without its diagram: %s", names, error)
                return

    def post_variables(self) -> None:
        """Post the machine's variables, if it has any."""
        if type(self._machine).table.variables:
            self._board[self._variables].add(variables_of(self._machine))

    def keep(self) -> None:
        """Keep the name, or claim another one if another process claimed it at the same moment.

        Leave the last will again if a guard has executed it.
        """
        if self._count and self._slot.count != self._count:
            sample = self._slot.sample()
            if sample is not None and is_live(sample):
                self._take()
        if self._will is not None:
            self._will.keep()

    def post(self, published: Published, status: MachineStatus, now_ns: int) -> None:
        """Post the status."""
        self._count = self._slot.add(status)
        self.published, self.beat_ns = published, now_ns

    def request(self) -> str | None:
        """Return the request that came since the last call: the latest replaces the others."""
        sample = self._requests.sample()
        if sample is None or sample.count == self.obeyed:
            return None
        self.obeyed = sample.count
        return sample.message.action

    def leave(self) -> None:
        """Post that the machine is gone."""
        if self._will is not None:
            self._will.withdraw()
        if self.published is not None and self._slot.count == self._count:
            self._slot.add(MachineStatus(self.published.state, loaded=False))
