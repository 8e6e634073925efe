"""The states of machines throughout a recording, read a little at a time.

The events of machines contain each of their states, however short. Where there are no events, the
machines' published statuses contain the states that were seen.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

from llfsm.runtime.presence.remote import SILENT_S
from llfsm.whiteboard import Sample
from llfsm.whiteboard.messages.llfsm import (
    MACHINES,
    REQUESTS,
    MachineRequest,
    MachineStatus,
    status_slot,
)

from ..view.notes import Notes
from ..view.page_source import Change
from ..view.state_history import Track
from .errors import RecordingFileError
from .reader import RecordedJournal, Recording, TimelineItem

__all__ = ["SILENT_NS", "RecordedHistory"]

SILENT_NS: Final = round(SILENT_S * 1e9)
_READ_NS: Final = 10_000_000  # of reading at a time, or more for one chunk
_MOST_CHANGES: Final = 50_000  # of a machine
_RELEVANT: Final = tuple(
    b'"event":"%s"' % kind for kind in (b"RoundEnd", b"Eval", b"Failed", b"End", b"Lost")
)
_KIND_BYTES: Final = 24  # at the beginning of an entry, which contain its kind


class _RecordedTrack(Track):
    """The states of one machine, from its events while there are any."""

    def __init__(self) -> None:
        super().__init__()
        self.process = 0
        self.latest_ns = 0
        self.fired = "", 0  # the state and number of a transition since the last round
        self.changed_ns: int | None = None  # when that was; a debugger may have paused the round
        self.failed = False  # whether its code has raised and it was not resumed since

    def add(self, change: Change) -> None:
        """Add a change; after too many, the states are unknown."""
        if len(self.changes) < _MOST_CHANGES:
            super().add(change)
        elif self.changes[-1].state:
            super().add(Change(change.stamp_ns, "", False))

    def add_status(self, sample: Sample[MachineStatus], *, by_events: bool) -> None:
        """Add the state of a published status, unless events provide it."""
        status = sample.message
        if by_events and status.loaded:
            self.latest_ns, self.process = sample.stamp_ns, status.pid
            return
        if self.latest_ns and sample.stamp_ns - self.latest_ns > SILENT_NS:
            self.lose(self.latest_ns + SILENT_NS)
        self.latest_ns, self.process = sample.stamp_ns, status.pid
        if status.loaded:
            self.update(sample)
        else:
            self.lose(sample.stamp_ns)

    def enter(self, now_ns: int, state: str, suspended: bool) -> None:
        """Add the state that an event reports."""
        self.latest_ns = max(self.latest_ns, now_ns)
        source, number = self.fired if not suspended else ("", 0)
        changed_ns = now_ns if self.changed_ns is None else self.changed_ns
        self.fired, self.changed_ns = ("", 0), None
        self.failed = self.failed and suspended
        last = self.changes[-1] if self.changes else Change(0, "", False)
        if (state, suspended, self.failed) != (last.state, last.suspended, last.failed):
            stamp_ns = max(changed_ns, last.stamp_ns + 1)
            self.add(Change(stamp_ns, state, suspended, source, number, failed=self.failed))


class RecordedHistory:
    """Read the states of each machine; each `read` continues a little, up to the end."""

    def __init__(self, recording: Recording):
        self.changes: dict[str, Sequence[Change]] = {}
        self._recording = recording
        self._tracks: dict[str, _RecordedTrack] = {}
        self._journals = {journal.channel: journal for journal in recording.journals}
        # The time from which the events of a process are recorded.
        self._events_ns = {each.process: each.begin_ns for each in reversed(recording.journals)}
        kinds = MachineStatus, MachineRequest
        self._slots = [n for n, each in recording.slots.items() if each.slot.type in kinds]
        self._found: dict[tuple[int, str], _RecordedTrack] = {}
        self._next = 0
        self.notes = Notes()
        """What else has happened to the machines, as far as it is read."""
        self.known_ns = recording.span_ns[0]
        """The time up to which the states are known."""

    def read(self) -> Mapping[str, Sequence[Change]]:
        """Read on for a moment, and return the changes known so far."""
        until_ns = time.monotonic_ns() + _READ_NS
        while self._next < len(self._recording.chunks):
            for item in self._recording.history(self._next, self._slots):
                self.known_ns = max(self.known_ns, item.now_ns)
                self._take(item)
            self._next += 1
            if self._next == len(self._recording.chunks):
                self._end()
            if time.monotonic_ns() > until_ns:
                break
        return self.changes

    def _end(self) -> None:
        self.known_ns = end_ns = self._recording.span_ns[1]
        for track in self._tracks.values():
            if end_ns - track.latest_ns > SILENT_NS:
                track.lose(track.latest_ns + SILENT_NS)

    def _take(self, item: TimelineItem) -> None:
        if item.entry is not None:
            kind = item.entry.data[:_KIND_BYTES]
            if any(each in kind for each in _RELEVANT):
                journal = self._journals[item.entry.channel]
                self._events_ns.setdefault(journal.process, journal.begin_ns)
                with suppress(RecordingFileError, ValueError, TypeError, LookupError):
                    self._take_entry(journal, item.now_ns, self._recording.entry(item.entry))
        elif item.slot is not None and item.recorded is not None:
            with suppress(ValueError):
                self._take_sample(item.slot.slot.name, item.slot.sample(item.recorded))

    def _take_sample(self, slot: str, sample: Sample[Any]) -> None:
        if isinstance(sample.message, MachineRequest):
            self.notes.take_request(slot.removeprefix(REQUESTS), sample)
            return
        name = slot.removeprefix(MACHINES)
        self.notes.take_status(name, sample)
        begun_ns = self._events_ns.get(sample.message.pid)
        by_events = begun_ns is not None and begun_ns <= sample.stamp_ns
        self._track(name).add_status(sample, by_events=by_events)

    def _take_entry(self, journal: RecordedJournal, now_ns: int, entry: Mapping[str, Any]) -> None:
        match entry:
            case {"event": "Eval", "value": True, "machine": machine}:
                track = self._of(journal, machine)
                track.fired, track.changed_ns = (entry["state"], entry["transition"]), now_ns
                if not track.changes:  # it has left its first state before its first round was over
                    track.add(Change(now_ns, entry["state"], False))
            case {"event": "Failed", "machine": machine}:
                track = self._of(journal, machine)
                track.failed, track.changed_ns = True, now_ns
            case {"event": "RoundEnd", "machines": machines}:
                for name, *status in machines:
                    track = self._of(journal, name)
                    if status:
                        track.enter(now_ns, status[1], bool(status[2]))
                    else:
                        track.lose(now_ns)
            case {"event": "End" | "Lost"}:
                self._events_ns.pop(journal.process, None)

    def _of(self, journal: RecordedJournal, machine: str) -> _RecordedTrack:
        """Return the track of a machine in events; its slot's name may have a number."""
        key = journal.process, machine
        if key not in self._found:
            name = status_slot(machine).name.removeprefix(MACHINES)
            own = [n for n, each in self._tracks.items() if each.process == journal.process]
            numbered = (n for n in own if n.startswith(f"{name}."))
            track = self._track(name if name in own else next(numbered, name))
            track.process = journal.process
            self._found[key] = track
        return self._found[key]

    def _track(self, name: str) -> _RecordedTrack:
        track = self._tracks.get(name)
        if track is None:
            track = self._tracks[name] = _RecordedTrack()
            self.changes[name] = track.changes
        return track
