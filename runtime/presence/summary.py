"""A host's summary, for those who look at all hosts of a fleet: what it is up to, in a few lines.

Whoever looks at a hundred hosts receives one message per second from each, however many machines
and slots these have.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from llfsm.whiteboard import Board, Sample, Slot, WhiteboardError
from llfsm.whiteboard.messages.fleet import HostSummary, MachineTrouble, summary_slot
from llfsm.whiteboard.messages.llfsm import MACHINES, MachineStatus, MirrorStatus, status_slot
from llfsm.whiteboard.mirror.naming import Naming

from .remote import condition_of, is_live

__all__ = ["summary_publisher"]

_MOST = 16  # machines in trouble that are named
_LONGEST = 300  # characters of an error
_TROUBLE = ("failed", "hung", "silent")


def summary_publisher(board: Board, *, died_s: float = 3600.0) -> Callable[[MirrorStatus], None]:
    """Return a function that publishes the summary of a named host, to be called once a second.

    It takes the status of the host's daemon. A machine that has died, or whose failure has ended
    its process, is reported for `died_s` seconds, or until it runs again.
    """
    slots: dict[str, Slot[MachineStatus]] = {}

    def publish(status: MirrorStatus) -> None:
        if not status.name:  # others would not know whose it is
            return
        with suppress(WhiteboardError):  # mirroring goes on without
            _look(board, Naming(status.name, status.fleet), slots)
            board.add_message(summary_slot(), _summary(board, status, slots, died_s))

    return publish


def _look(board: Board, naming: Naming, slots: dict[str, Slot[MachineStatus]]) -> None:
    """Find the statuses of the host's own machines; those of others may not be read here."""
    listed = {info.name for info in board.slots() if info.name.startswith(MACHINES)}
    for name in slots.keys() - listed:
        board.forget(slots.pop(name))
    for name in sorted(listed - slots.keys()):
        if naming.is_own(name):
            slots[name] = status_slot(name.removeprefix(MACHINES))


def _summary(
    board: Board, status: MirrorStatus, slots: dict[str, Slot[MachineStatus]], died_s: float
) -> HostSummary:
    samples = dict(_samples(board, slots, died_s))
    troubles = [each for name, sample in samples.items() for each in _troubles(name, sample)]
    return HostSummary(
        system=socket.gethostname()[:255],
        sent_ns=time.time_ns(),
        leave_rate=status.leave_rate,
        enter_rate=status.enter_rate,
        sent_rate=status.sent_rate,
        received_rate=status.received_rate,
        refused=sum(each.count for each in status.refused),
        machines=len(samples),
        troubled=len(troubles),
        troubles=tuple(troubles[:_MOST]),
    )


def _samples(
    board: Board, slots: dict[str, Slot[MachineStatus]], died_s: float
) -> Iterator[tuple[str, Sample[MachineStatus]]]:
    for name, slot in slots.items():
        with suppress(WhiteboardError):  # not a machine's status, whatever its name
            sample = board[slot].sample()
            if sample is None or not (sample.message.loaded or sample.message.failed):
                continue
            if not _is_over(sample, died_s):
                yield name.removeprefix(MACHINES), sample


def _is_over(sample: Sample[MachineStatus], before_s: float) -> bool:
    """Return whether a machine has died or failed, and published nothing for so long."""
    return time.monotonic_ns() - sample.stamp_ns > before_s * 1e9 and not is_live(sample)


def _troubles(machine: str, sample: Sample[MachineStatus]) -> Iterator[MachineTrouble]:
    status = sample.message
    if not status.loaded:
        yield MachineTrouble(machine, "failed", status.error[:_LONGEST])
        return
    if not is_live(sample):
        yield MachineTrouble(machine, "died", f"its process {status.pid} has not ended it")
        return
    condition = condition_of(status, (time.monotonic_ns() - sample.stamp_ns) / 1e9)
    if condition in _TROUBLE:
        yield MachineTrouble(machine, condition, status.error[:_LONGEST])
