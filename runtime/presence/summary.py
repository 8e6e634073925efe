"""A host's summary, for those who look at all hosts of a fleet: what it is up to, in a few lines.

Whoever looks at a hundred hosts receives one message per second from each, however many machines
and slots these have.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from llfsm.whiteboard import Board, Sample, WhiteboardError
from llfsm.whiteboard.messages.fleet import HostSummary, MachineTrouble, summary_slot
from llfsm.whiteboard.messages.llfsm import MachineStatus, MirrorStatus
from llfsm.whiteboard.mirror.naming import Naming

from .remote import StatusSlots, condition_of, is_live

__all__ = ["summary_publisher"]

_MOST = 16  # machines in trouble that are named
_LONGEST = 300  # characters of an error
_TROUBLE = ("failed", "hung", "silent")


def summary_publisher(board: Board, *, died_s: float = 3600.0) -> Callable[[MirrorStatus], None]:
    """Return a function that publishes the summary of a named host, to be called once a second.

    It takes the status of the host's daemon. A machine that has died, or whose failure has ended
    its process, is reported for `died_s` seconds, or until it runs again.
    """
    slots = StatusSlots(board)

    def publish(status: MirrorStatus) -> None:
        if not status.name:  # others would not know whose it is
            return
        with suppress(WhiteboardError):  # mirroring goes on without
            slots.look(Naming(status.name, status.fleet).is_own)  # others may not be read here
            board.add_message(summary_slot(), _summary(status, slots, died_s))

    return publish


def _summary(status: MirrorStatus, slots: StatusSlots, died_s: float) -> HostSummary:
    samples = dict(sorted(_samples(slots, died_s)))
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


def _samples(slots: StatusSlots, died_s: float) -> Iterator[tuple[str, Sample[MachineStatus]]]:
    for name, sample in slots.samples():
        counts = sample.message.loaded or sample.message.failed
        if counts and not _is_over(sample, died_s):
            yield name, sample


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
