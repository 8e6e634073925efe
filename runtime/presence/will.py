"""Last wills: what is posted for a machine whose process dies without shutting down.

While a machine with safe values is loaded, those for a failure stand on the board as its last will.
A machine that leaves withdraws it. If the process dies before, or falls silent, guards post them.

A safe value is posted only in place of a message of the process that has died, by a
compare-and-swap on the slot. After that the slot's latest message is another's. So, however many
guards there are, one posts it, and none does so after another process has posted. No guard waits
for another one, which may die, too.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from llfsm.errors import one_line
from llfsm.runtime.log import logger
from llfsm.whiteboard.errors import (
    BoardFullError,
    MessageError,
    MessageTooLargeError,
    WhiteboardError,
)
from llfsm.whiteboard.liveness import identity, is_alive, this_process, writer_lives
from llfsm.whiteboard.messages.llfsm import (
    MIRROR,
    WILL_BELL,
    Bell,
    LastWill,
    SafeValue,
    WillExecution,
    execution_slot,
    will_slot,
)
from llfsm.whiteboard.mirror.stand_ins import note_stand_in
from llfsm.whiteboard.slots import Sample

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot, Message, Slot


class Will:
    """The last will of a loaded machine."""

    def __init__(
        self, board: Board, machine: str, values: list[tuple[Slot[Any], Message]], silent_ms: int
    ):
        self._board = board
        self._machine = machine
        self._slot = board[will_slot(machine)]
        self._executions: BoundSlot[WillExecution] | None = None
        self._reported = 0
        self._will = LastWill(
            *this_process(),
            tuple(SafeValue(slot.name, slot.encoder.encode(message)) for slot, message in values),
            silent_ms,
        )
        self._count = 0

    def leave(self) -> None:
        """Post it. A dead predecessor's, which this replaces, is executed before."""
        with suppress(MessageError):
            old = self._slot.sample()
            if old and old.message.state == "left" and not is_alive(old.message, elsewhere=False):
                execute(self._board, old)
        try:
            self._count = self._slot.add(self._will)
        except MessageTooLargeError as error:
            logger().warning("%s has no last will: %s", self._machine, error)
        with suppress(BoardFullError):  # guards find it all the same, a second later
            self._board.add_message(WILL_BELL, Bell(self._machine))

    def keep(self) -> None:
        """Leave it again if a guard has executed it, because this process seemed dead."""
        self._report_executions()
        if not self._count or self._slot.count == self._count:
            return
        sample = self._slot.sample()
        if sample is None:
            return
        is_mine = identity(sample.message) == identity(self._will)
        if not is_mine and sample.message.state == "left":
            return  # another machine's of this name: one of both gets another one
        if is_mine and sample.message.state == "executed":
            logger().warning(
                "the last will of %s was executed by process %d, as this process was silent; "
                "it goes on",
                self._machine,
                sample.message.executor,
            )
        self.leave()

    def _report_executions(self) -> None:
        """Log that a guard of another host has executed it there."""
        if self._executions is None:
            with suppress(BoardFullError):  # only a board with a daemon needs room for it
                if self._board.publisher(MIRROR).count:
                    self._executions = self._board[execution_slot(self._machine)]
                    self._reported = self._executions.count
        if self._executions is None or self._executions.count == self._reported:
            return
        self._reported = self._executions.count
        with suppress(MessageError):
            report = self._executions.get()
            if report is not None and identity(report) == identity(self._will):
                logger().warning(
                    "the last will of %s was executed by process %d of host %s, as nothing of "
                    "this process arrived there; it goes on",
                    self._machine,
                    report.executor,
                    report.executor_host,
                )

    def withdraw(self) -> None:
        """Post that there is nothing to execute, and give up the name."""
        withdrawn = msgspec.structs.replace(self._will, values=(), state="withdrawn")
        if self._count and self._slot.add_after(withdrawn, self._count):
            self._board.vacate(will_slot(self._machine))
        if self._executions is not None:
            self._board.vacate(execution_slot(self._machine))


class Executed(NamedTuple):
    """The outcome of executing a will, by names of slots."""

    posted: list[str]
    deferred: list[str]
    """Where a message is too new for a process that is silent."""
    failed: dict[str, str]
    """Why a value cannot be posted."""


def execute(
    board: Board,
    sample: Sample[LastWill],
    *,
    silent_ns: int = 0,
    is_commanded: Callable[[str], bool] = lambda _: False,
    stands_in_for: str = "",
) -> Executed:
    """Post a will's safe values where the latest message is of the process that left it.

    If that process is only silent, not dead, its messages must be `silent_ns` old: a newer one is
    a sign of life. For a process of another host, whose messages the daemon adds like all others
    from there, `is_commanded` returns whether another process that lives commands a slot. What is
    posted for a machine that other hosts may still hear `stands_in_for` it, here only.
    """
    outcome = Executed([], [], {})
    for value in sample.message.values:
        try:
            posted = _post(board, sample, value, silent_ns, is_commanded, stands_in_for)
            if posted is None:
                outcome.deferred.append(value.slot)
            elif posted:
                outcome.posted.append(value.slot)
        except (WhiteboardError, msgspec.MsgspecError, ValueError) as error:
            outcome.failed[value.slot] = one_line(error)  # the others must go out all the same
    return outcome


def vacate_executed(board: Board, machine: str) -> None:
    """Give up the name of a will, unless a guard has still to execute it."""
    will = board.publisher(will_slot(machine)).get()
    if will is None or will.state != "left":
        board.vacate(will_slot(machine))


def reserve(board: Board, will: LastWill) -> None:
    """Reserve what executing a will takes, so that it works on a board that is full by then."""
    for value in will.values:
        with suppress(WhiteboardError):
            board[board.find(value.slot)].reserve()


def _post(
    board: Board,
    sample: Sample[LastWill],
    value: SafeValue,
    silent_ns: int,
    is_commanded: Callable[[str], bool],
    stands_in_for: str,
) -> bool | None:
    """Post a safe value; return None if the latest message is too new, False if it must not be."""
    slot = board.find(value.slot)
    bound, message = board[slot], slot.decoder.decode(value.data)
    while True:
        encoded = bound.encoded()
        if encoded is None or encoded[0] == value.data:
            return False
        latest = Sample[Any](*encoded)
        if sample.writer == sample.message.pid:
            if not _is_by(latest, sample.message):
                return False
        elif not _is_mirrored(board, latest, sample.writer) or is_commanded(value.slot):
            return False
        if time.monotonic_ns() - latest.stamp_ns < silent_ns:
            return None
        if stands_in_for:
            note_stand_in(board, value.slot, latest.count + 1, stands_in_for)
        if bound.add_after(message, latest.count):
            return True


def _is_by(latest: Sample[Any], will: LastWill) -> bool:
    """Check that a message is of the process that left the will, not of a later one."""
    if latest.writer != will.pid:
        return False
    return is_alive(will, elsewhere=True) or not writer_lives(latest, surely=True)


def _is_mirrored(board: Board, latest: Sample[Any], daemon: int) -> bool:
    """Check that a message is from another host; `daemon` has added one that was."""
    status = board[MIRROR].get()
    known = (daemon, 0 if status is None else status.pid)
    return latest.writer in known or not writer_lives(latest)
