"""One machine on the whiteboard: its slots, the name that it has there, and its last will."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from llfsm.whiteboard.errors import BoardFullError, MessageError, SlotError
from llfsm.whiteboard.messages.debugging import MachineWhy, why_slot
from llfsm.whiteboard.messages.llfsm import (
    MACHINES,
    MachineRequest,
    MachineStatus,
    definition_slot,
    request_slot,
    status_slot,
    variables_slot,
    will_slot,
)

from ..engine.failure import logger, one_line
from ..engine.machine import Machine
from .description import definition_of, variables_of
from .remote import is_live
from .will import Will, vacate_executed

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot, Message, Slot

    from ..engine.seat import Failure

__all__ = ["Published", "PublishedMachine", "vacate_dead"]


class Published(NamedTuple):
    """The part of a status that is posted as soon as it changes."""

    state: str
    suspended: bool
    pending: str
    obeyed: int
    entered_ns: int | None
    failure: Failure | None
    hang: str
    paused: str
    overridden: tuple[str, ...]
    caller: str
    refusal: str


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
        self._requests.reserve()  # it is read here, and only an add or this keeps the name
        self._will = self._leave_will(names)
        self.obeyed = self._requests.count  # those were for an earlier process
        self._count = 0
        self.published: Published | None = None
        self.beat_ns = 0
        self._variables = variables_slot(names)
        self._why = why_slot(names)
        self._define(names)

    def exchange(self, machine: Machine, safe_values: list[tuple[Slot[Any], Message]]) -> None:
        """Publish the definition of the machine, if it is another one, and leave its last will."""
        if machine is self._machine:
            return
        self._machine, self._safe_values = machine, safe_values
        before, self._will = self._will, self._leave_will(self.published_name)
        if before is not None:
            before.withdraw()  # which does nothing where the new one has replaced it
        self._define(self.published_name)

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
        """Post the values of the machine's variables and sensors, if it has any."""
        table = type(self._machine).table
        if table.variables or table.sensors:
            self._board[self._variables].add(variables_of(self._machine))

    def post_why(self, why: MachineWhy) -> None:
        """Post why the machine is in its state; without what was before if that is too large."""
        for each in (why, MachineWhy(why.state, ())):
            with suppress(MessageError):
                self._board[self._why].add(each)
                return

    def keep(self) -> None:
        """Keep the name, or claim another one if another process claimed it at the same moment.

        Leave the last will again if a guard has executed it.
        """
        if self._count and self._slot.count != self._count:
            sample = self._slot.sample()
            if sample is not None and is_live(sample):
                self._take()
        with suppress(BoardFullError):
            self._requests.reserve()
        if self._will is not None:
            self._will.keep()

    def post(self, published: Published, status: MachineStatus, now_ns: int) -> None:
        """Post the status."""
        self._count = self._slot.add(status)
        self.published, self._status, self.beat_ns = published, status, now_ns

    def beat(self, progress: tuple[int, int], now_ns: int) -> bool:
        """Post the status of a machine that stands as it did; False if that is to be described."""
        self.keep()
        published = self.published
        if published is None or published.hang or published.overridden or published.paused:
            return False
        before, (ringlets, overruns) = self._status, progress
        passed_s = (now_ns - self.beat_ns) / 1e9
        status = msgspec.structs.replace(
            before,
            ringlets=ringlets,
            overruns=overruns,
            in_state_s=0.0 if published.entered_ns is None else before.in_state_s + passed_s,
            error_s=before.error_s + passed_s if before.failed else 0.0,
        )
        self.post(published, status, now_ns)
        return True

    def request(self) -> MachineRequest | None:
        """Return the request that came since the last call: the latest replaces the others."""
        sample = self._requests.sample()
        if sample is None or sample.count == self.obeyed:
            return None
        self.obeyed = sample.count
        return sample.message

    def leave(self, failure: Failure | None = None) -> None:
        """Post that the machine is gone, and give up its name; the status of a failure stays."""
        if self._will is not None:
            self._will.withdraw()
        if self.published is None or self._slot.count != self._count:
            return
        status = MachineStatus(self.published.state, loaded=False)
        if failure is None:
            self._slot.add(status)
            _vacate(self._board, self.published_name)
        else:  # who looks once a second, as a host's daemon, finds it as one that has died
            error = one_line(failure.error)
            self._slot.add(msgspec.structs.replace(status, failed=True, error=error))


def vacate_dead(board: Board, *, after_s: float = 60.0) -> None:
    """Give up the names of machines whose processes died so long ago; till then they are shown."""
    listed = [info.name for info in board.slots()]
    for machine in [name.removeprefix(MACHINES) for name in listed if name.startswith(MACHINES)]:
        with suppress(SlotError, MessageError):  # not a machine's slots, whatever their names
            sample = board.publisher(status_slot(machine)).sample()
            if sample is None or time.monotonic_ns() - sample.stamp_ns < after_s * 1e9:
                continue
            if not is_live(sample):
                _vacate(board, machine)
                if will_slot(machine).name in listed:
                    vacate_executed(board, machine)


def _vacate(board: Board, machine: str) -> None:
    for slot in (status_slot, request_slot, definition_slot, variables_slot, why_slot):
        board.vacate(slot(machine))
