"""A recording as a page's source: the state of everything at the moment that the slider shows.

The states of machines throughout a recording are read a little at a time, while it is shown. Events
have each of a machine's states, however short. Where there are no events, the statuses that
machines have published show the states that were seen.

A journal has the value of each guard that was evaluated, which says why a machine is in its state.
What the guard saw is not in it: an :class:`.Explainer` reruns the machines for that.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, cast

from msgspec.structs import replace

from llfsm.bridges.recording.bags import BagTopics
from llfsm.bridges.recording.errors import RecordingFileError
from llfsm.bridges.recording.reader import RecordedJournal, Recording, TimelineItem
from llfsm.bridges.recording.reversing.explaining import Explainer
from llfsm.bridges.view.live_source import Track
from llfsm.bridges.view.page_source import Change, Note, Notes, PageSource, Player, Snapshot
from llfsm.runtime import Clock, MonotonicClock
from llfsm.runtime.presence.remote import SILENT_S
from llfsm.whiteboard import Message, Sample, Slot
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.llfsm import (
    MACHINES,
    REQUESTS,
    MachineRequest,
    MachineStatus,
    MachineWhy,
    SeenTransition,
    status_slot,
    variables_slot,
    why_slot,
)
from llfsm.whiteboard.slots import legal_name

SILENT_NS: Final = round(SILENT_S * 1e9)
_READ_NS: Final = 10_000_000  # of reading at a time, or more for one chunk
_MOST_CHANGES: Final = 50_000  # of a machine
_RELEVANT: Final = tuple(
    b'"event":"%s"' % kind for kind in (b"RoundEnd", b"Eval", b"Failed", b"End", b"Lost")
)
_MOST_ENTRIES: Final = 10_000  # that are looked at to explain states
_KIND_BYTES: Final = 24  # at the beginning of an entry: they contain its kind, undecoded


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
        """Add a change; after too many, add that the states are unknown."""
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
    """The states of each machine in a recording; each `read` continues a little, up to the end."""

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
        """Other things that have happened to the machines, as far as they are read."""
        self.known_ns = recording.span_ns[0]
        """The time up to which the states are known."""

    def read(self) -> Mapping[str, Sequence[Change]]:
        """Read on for a moment; return the changes known so far, by machine."""
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


class ShownCauses:
    """Samples that say why machines are in their states, for live ones with events."""

    def __init__(self, recording: Recording, explainer: Explainer | None):
        self._recording = recording
        self._explainer = explainer
        self._shown: dict[str, Sample[Message]] = {}
        statuses = [n for n, each in recording.slots.items() if each.slot.type is MachineStatus]
        names = [name.removeprefix(MACHINES) for name in statuses if recording.journals]
        slots: list[Slot[Any]] = [*map(why_slot, names)]
        if explainer is not None:
            known = [variables_slot(name) for name in names]
            slots += [each for each in known if each.name not in recording.slots]
        self.slots = {
            each.name: SlotInfo(each.name, each.type_name, each.schema, each.capacity)
            for each in slots
        }
        """Those of the samples."""

    def at(
        self,
        now_ns: int,
        samples: Mapping[str, Sample[Message]],
        is_live: Callable[[Sample[Any]], bool],
    ) -> dict[str, Sample[Message]]:
        """Make the samples for a moment; `samples` has the machines' statuses then."""
        living = {
            name.removeprefix(MACHINES): sample.message.pid
            for name, sample in samples.items()
            if isinstance(sample.message, MachineStatus) and is_live(sample)
        }
        found: dict[str, Sample[Message]] = {}
        for journal in self._recording.journals:
            if journal.process in living.values():
                for machine, messages in self._known(journal, now_ns).items():
                    legal = legal_name(machine)
                    for name, process in living.items():
                        is_numbered = name.startswith(f"{legal}.")  # its name was taken
                        if process == journal.process and (name == legal or is_numbered):
                            for message in messages:
                                slot = _slot_of(message, name)
                                found[slot] = self._sample(slot, message, now_ns)
        return found

    def close(self) -> None:
        """End the explainer."""
        if self._explainer is not None:
            self._explainer.close()

    def _known(self, journal: RecordedJournal, now_ns: int) -> dict[str, tuple[Message, ...]]:
        """Return the messages of each machine of a journal, by its name there."""
        causes, problem = causes_at(self._recording, journal, now_ns), ""
        found: dict[str, tuple[Message, ...]] = {}
        if self._explainer is not None and self._explainer.process == journal.process:
            found = {**self._explainer.at(now_ns)}
            problem = self._explainer.problem
        rest = {name: (replace(why, problem=problem),) for name, why in causes.items()}
        return rest | found

    def _sample(self, slot: str, message: Message, now_ns: int) -> Sample[Message]:
        before = self._shown.get(slot)
        if before is not None and before.message == message:
            return before
        count = 1 if before is None else before.count + 1
        sample: Sample[Message] = Sample(message, count, now_ns, 0)
        self._shown[slot] = sample
        return sample


def _slot_of(message: Message, machine: str) -> str:
    is_why = isinstance(message, MachineWhy)
    return (why_slot(machine) if is_why else variables_slot(machine)).name


def causes_at(recording: Recording, journal: RecordedJournal, now_ns: int) -> dict[str, MachineWhy]:
    """Explain the state of each machine of a journal by its last turn before that moment."""
    evaluated: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)  # the last one first
    found: dict[str, MachineWhy] = {}
    rounds = 0
    for number, record in enumerate(recording.backwards(journal, now_ns)):
        kind = record.data[:_KIND_BYTES]
        rounds += b'"RoundBegin"' in kind
        if rounds > 1 or number == _MOST_ENTRIES:  # each machine has had its turn in a whole round
            break
        if b'"Eval"' not in kind and b'"Turn"' not in kind:
            continue
        with suppress(RecordingFileError):
            entry = recording.entry(record)
            machine = entry["machine"]
            if machine in found:
                continue
            if entry["event"] == "Eval":
                evaluated[machine].append(entry)
            else:
                evaluated_s = (now_ns - recording.time_of(record)) / 1e9
                found[machine] = _why(entry["state"], evaluated[machine][::-1], evaluated_s)
    return found


def _why(state: str, evaluated: list[dict[str, Any]], evaluated_s: float) -> MachineWhy:
    seen = tuple(
        SeenTransition(each["target"], each["label"], each["value"], each["label"])
        for each in evaluated
    )
    if seen and seen[-1].value is True:
        return MachineWhy(seen[-1].target, (), state, seen)
    return MachineWhy(state, seen, evaluated_s=evaluated_s if seen else None)


class RecordedPlayer(Player):
    """The moment of a recording that is shown; it does not move until `play` is called."""

    def __init__(self, span_ns: tuple[int, int], clock: Clock):
        self.span_ns = span_ns
        self.known_ns = span_ns[0]
        self.epoch = 0
        """A new number after each seek."""
        self._clock = clock
        self._from_ns = span_ns[0]  # the moment at the latest call
        self._since_ns = clock.now_ns()

    def now_ns(self) -> int:
        """Return the moment shown; pause at the end."""
        passed_ns = self._clock.now_ns() - self._since_ns
        now_ns = self._from_ns + round(passed_ns * self.speed)
        if now_ns >= self.span_ns[1]:
            self._stay(self.span_ns[1])
            self.speed = 0.0
            return self.span_ns[1]
        return now_ns

    def seek(self, now_ns: int) -> None:
        """Go to a moment of the span."""
        self.epoch += 1
        self._stay(max(now_ns, self.span_ns[0]))

    def play(self, speed: float) -> None:
        """Play from here, or from the beginning if it is at the end."""
        if speed and self.now_ns() == self.span_ns[1]:
            self.seek(self.span_ns[0])
        self._stay(self.now_ns())
        self.speed = speed

    def _stay(self, now_ns: int) -> None:
        self._from_ns, self._since_ns = now_ns, self._clock.now_ns()


class RecordedSource(PageSource):
    """Show a recording; raise `RecordingFileError` if the file is not a valid one.

    Journals explain the states of machines, and an `explainer` does with what guards saw.
    """

    def __init__(
        self,
        path: Path,
        clock: Clock | None = None,
        topics: BagTopics | None = None,
        explainer: Explainer | None = None,
    ):
        self._recording = recording = Recording(path, topics)
        self.title = path.name
        self.player: RecordedPlayer = RecordedPlayer(recording.span_ns, clock or MonotonicClock())
        self.player.seek(_first_sight_ns(recording))
        self._samples: dict[str, Sample[Message]] = {}  # of the latest snapshot
        self._now_ns = recording.span_ns[0]
        self._past = RecordedHistory(recording)
        self._slots = {
            name: SlotInfo(name, each.slot.type_name, each.slot.schema, each.slot.capacity)
            for name, each in recording.slots.items()
        }
        self._causes = ShownCauses(recording, explainer)
        self._slots |= self._causes.slots

    def snapshot(self) -> Snapshot:
        """Return the state of everything at the moment shown."""
        self._now_ns = now_ns = self.player.now_ns()
        samples: dict[str, Sample[Message]] = {}
        problems: dict[str, str] = {}
        for name, slot in self._recording.slots.items():
            recorded, before = self._recording.latest(slot, now_ns), self._samples.get(name)
            if recorded is None:
                continue
            if before is not None and before.count == recorded.count:
                samples[name] = before
                continue
            try:
                samples[name] = slot.sample(recorded)
            except ValueError as error:
                problems[name] = f"message {recorded.count} in the file is invalid: {error}"
        self._samples = samples
        causes = self._causes.at(now_ns, samples, self.is_live)
        return Snapshot(now_ns, self.player.epoch, self._slots, samples | causes, problems)

    def is_live(self, sample: Sample[MachineStatus]) -> bool:
        """Check that a machine was loaded and its latest status was recent."""
        return sample.message.loaded and self._now_ns - sample.stamp_ns <= SILENT_NS

    def history(self) -> Mapping[str, Sequence[Change]]:
        """Read on for a moment; return the states of each machine as far as they are read."""
        changes = self._past.read()
        self.player.known_ns = self._past.known_ns
        return changes

    def notes(self) -> Sequence[Note]:
        """Return other things that have happened to machines, as far as they are read."""
        return self._past.notes.all

    def close(self) -> None:
        """End the explainer; the file is open only while it is read."""
        self._causes.close()


def _first_sight_ns(recording: Recording) -> int:
    """Return the time of the first status of a machine that runs, else of the first message."""
    statuses = [name for name, each in recording.slots.items() if each.slot.type is MachineStatus]
    for slot, recorded in recording.messages(statuses):
        with suppress(ValueError):
            status = cast("Sample[MachineStatus]", slot.sample(recorded)).message
            if status.loaded and recorded.seen_ns - recorded.stamp_ns <= SILENT_NS:
                return recorded.seen_ns
    return next((recorded.seen_ns for _, recorded in recording.messages()), recording.span_ns[0])
