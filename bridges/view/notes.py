"""What happens to machines but for their states: requests, failures, pauses and overrides.

It is taken from statuses and requests as they are published, of a live board or a recording. Of
what changes between two of them, only the last is known.
"""

from __future__ import annotations

from bisect import insort
from typing import Final, NamedTuple

from llfsm.whiteboard import Sample
from llfsm.whiteboard.messages.llfsm import MachineRequest, MachineStatus

__all__ = ["Note", "Notes"]

_MOST: Final = 10_000
_SAME_NS: Final = 300_000_000  # within which all machines of a process publish the same pause


class Note(NamedTuple):
    """Something that has happened to a machine; `kind` is one word for it."""

    stamp_ns: int
    machine: str
    kind: str
    text: str


class Notes:
    """Collect what happens to machines; the oldest notes are dropped."""

    def __init__(self) -> None:
        self.all: list[Note] = []
        """Ordered by time."""
        self._statuses: dict[str, MachineStatus] = {}
        self._counts: dict[str, int] = {}
        self._pauses: dict[tuple[str, int, str], int] = {}

    def take_status(self, machine: str, sample: Sample[MachineStatus]) -> None:
        """Note what is new in a machine's status."""
        status, stamp_ns = sample.message, sample.stamp_ns
        before = self._statuses.get(machine, MachineStatus())
        if status is before:
            return
        if not status.loaded:
            self._statuses.pop(machine, None)
            return
        self._statuses[machine] = status
        if status.failed and (not before.failed or status.error != before.error):
            failed_ns = stamp_ns - round(status.error_s * 1e9)
            self._add(Note(failed_ns, machine, "failed", f"failed: {status.error}"))
        if status.hung and not before.hung:
            self._add(Note(stamp_ns, machine, "failed", f"hangs: {status.error}"))
        if status.paused != before.paused:
            text = f"paused: {status.paused}" if status.paused else "continued"
            key = status.host, status.pid, text
            if abs(stamp_ns - self._pauses.get(key, -_SAME_NS)) >= _SAME_NS:
                self._pauses[key] = stamp_ns
                self._add(Note(stamp_ns, machine, "paused", text))
        now, then = ({each.sensor for each in one.overridden} for one in (status, before))
        for sensor in sorted(now ^ then):
            what = "overridden" if sensor in now else "released"
            self._add(Note(stamp_ns, machine, "override", f"{sensor} is {what}"))
        if status.refusal and status.refusal != before.refusal:
            self._add(Note(stamp_ns, machine, "request", f"not reloaded: {status.refusal}"))

    def take_request(self, machine: str, sample: Sample[MachineRequest]) -> None:
        """Note a request, unless it is known or only renews a pause."""
        request = sample.message
        if self._counts.get(machine) == sample.count:
            return
        self._counts[machine] = sample.count
        if request.action != "renew":
            text = f"request: {request.action} {request.argument}".rstrip()
            self._add(Note(sample.stamp_ns, machine, "request", text))

    def _add(self, note: Note) -> None:
        insort(self.all, note, key=lambda each: each.stamp_ns)
        if len(self.all) > _MOST:
            del self.all[: _MOST // 2]
