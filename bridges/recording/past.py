"""The states that machines were in, all through a recording, read a little at a time.

The events of machines tell each of their states, however short; where there are none, their
statuses tell those that were seen.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, cast

from llfsm.runtime.presence.remote import SILENT_S
from llfsm.whiteboard import Sample
from llfsm.whiteboard.messages.llfsm import MACHINES, MachineStatus, status_slot

from ..view.history import Track
from ..view.source import Change
from .errors import RecordingFileError
from .reader import Moment, RecordedJournal, Recording

__all__ = ["SILENT_NS", "Past"]

SILENT_NS: Final = round(SILENT_S * 1e9)
_READ_NS: Final = 10_000_000  # for which is read at a time, or longer for one chunk
_MOST: Final = 50_000  # changes of a machine that are kept
_TELLING: Final = (b'"event":"RoundEnd"', b'"event":"Eval"', b'"event":"End"', b'"event":"Lost"')
_BEGINNING: Final = 24  # bytes of an entry that say what it is


class _PastTrack(Track):
    """The states of one machine, by its events while there are any."""

    def __init__(self) -> None:
        super().__init__()
        self.process = 0
        self.told_ns = 0
        self.fired = "", 0

    def add(self, change: Change) -> None:
        """Add a change, unless there are too many: then nothing is known any more."""
        if len(self.changes) < _MOST:
            super().add(change)
        elif self.changes[-1].state:
            super().add(Change(change.stamp_ns, "", False))

    def status(self, sample: Sample[MachineStatus], *, by_events: bool) -> None:
        """Add what a status says, unless events do."""
        status = sample.message
        if by_events and status.loaded:
            self.told_ns, self.process = sample.stamp_ns, status.pid
            return
        if self.told_ns and sample.stamp_ns - self.told_ns > SILENT_NS:
            self.lose(self.told_ns + SILENT_NS)
        self.told_ns, self.process = sample.stamp_ns, status.pid
        if status.loaded:
            self.tell(sample)
        else:
            self.lose(sample.stamp_ns)

    def stand(self, now_ns: int, state: str, suspended: bool) -> None:
        """Add what an event says."""
        self.told_ns = max(self.told_ns, now_ns)
        source, number = self.fired if not suspended else ("", 0)
        self.fired = "", 0
        last = self.changes[-1] if self.changes else Change(0, "", False)
        if (state, suspended) != (last.state, last.suspended):
            self.add(Change(now_ns, state, suspended, source, number))


class Past:
    """Read what each machine was in; each `read` goes on a little, up to the end."""

    def __init__(self, recording: Recording):
        self.changes: dict[str, Sequence[Change]] = {}
        self._recording = recording
        self._tracks: dict[str, _PastTrack] = {}
        self._journals = {journal.channel: journal for journal in recording.journals}
        # Since when the events of a process are known.
        self._telling = {each.process: each.begin_ns for each in reversed(recording.journals)}
        self._slots = [n for n, each in recording.slots.items() if each.slot.type is MachineStatus]
        self._found: dict[tuple[int, str], _PastTrack] = {}
        self._next = 0
        self.known_ns = recording.span_ns[0]
        """Up to when it is known."""

    def read(self) -> Mapping[str, Sequence[Change]]:
        """Read on for a moment, and return what is known."""
        until_ns = time.monotonic_ns() + _READ_NS
        while self._next < len(self._recording.chunks):
            for moment in self._recording.history(self._next, self._slots):
                self.known_ns = max(self.known_ns, moment.now_ns)
                self._take(moment)
            self._next += 1
            if self._next == len(self._recording.chunks):
                self._end()
            if time.monotonic_ns() > until_ns:
                break
        return self.changes

    def _end(self) -> None:
        self.known_ns = end_ns = self._recording.span_ns[1]
        for track in self._tracks.values():
            if end_ns - track.told_ns > SILENT_NS:
                track.lose(track.told_ns + SILENT_NS)

    def _take(self, moment: Moment) -> None:
        if moment.entry is not None:
            begins = moment.entry.data[:_BEGINNING]
            if any(each in begins for each in _TELLING):
                journal = self._journals[moment.entry.channel]
                self._telling.setdefault(journal.process, journal.begin_ns)
                with suppress(RecordingFileError, ValueError, TypeError, LookupError):
                    self._hear(journal, moment.now_ns, self._recording.entry(moment.entry))
        elif moment.slot is not None and moment.recorded is not None:
            with suppress(ValueError):
                sample = cast("Sample[MachineStatus]", moment.slot.sample(moment.recorded))
                begun_ns = self._telling.get(sample.message.pid)
                track = self._track(moment.slot.slot.name.removeprefix(MACHINES))
                by_events = begun_ns is not None and begun_ns <= sample.stamp_ns
                track.status(sample, by_events=by_events)

    def _hear(self, journal: RecordedJournal, now_ns: int, entry: Mapping[str, Any]) -> None:
        match entry:
            case {"event": "Eval", "value": True, "machine": machine}:
                track = self._of(journal, machine)
                track.fired = entry["state"], entry["transition"]
                if not track.changes:  # it has left its first state before its first round was over
                    track.add(Change(now_ns, entry["state"], False))
            case {"event": "RoundEnd", "machines": news}:
                for name, *standing in news:
                    track = self._of(journal, name)
                    if standing:
                        track.stand(now_ns, standing[1], bool(standing[2]))
                    else:
                        track.lose(now_ns)
            case {"event": "End" | "Lost"}:
                self._telling.pop(journal.process, None)

    def _of(self, journal: RecordedJournal, machine: str) -> _PastTrack:
        """Return the track of a machine that events tell of; its slot may have another number."""
        key = journal.process, machine
        if key not in self._found:
            name = status_slot(machine).name.removeprefix(MACHINES)
            own = [n for n, each in self._tracks.items() if each.process == journal.process]
            numbered = (n for n in own if n.startswith(f"{name}."))
            track = self._track(name if name in own else next(numbered, name))
            track.process = journal.process
            self._found[key] = track
        return self._found[key]

    def _track(self, name: str) -> _PastTrack:
        track = self._tracks.get(name)
        if track is None:
            track = self._tracks[name] = _PastTrack()
            self.changes[name] = track.changes
        return track
