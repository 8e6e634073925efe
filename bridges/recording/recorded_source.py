"""A recording as a page's source: the state of everything at the moment that the slider shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import cast

from llfsm.runtime import Clock, MonotonicClock
from llfsm.whiteboard import Message, Sample
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.llfsm import MachineStatus

from ..view.notes import Note
from ..view.page_source import Change, PageSource, Player, Snapshot
from .bags import BagTopics
from .explaining import Explainer
from .reader import Recording
from .recorded_history import SILENT_NS, RecordedHistory
from .shown_causes import ShownCauses

__all__ = ["RecordedPlayer", "RecordedSource"]


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

    Why machines are in their states it knows from their journals, and better by an `explainer`.
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
        """Return whether a machine was loaded and its latest status was recent."""
        return sample.message.loaded and self._now_ns - sample.stamp_ns <= SILENT_NS

    def history(self) -> Mapping[str, Sequence[Change]]:
        """Read on, and return the states of each machine as far as they are read."""
        changes = self._past.read()
        self.player.known_ns = self._past.known_ns
        return changes

    def notes(self) -> Sequence[Note]:
        """Return what else has happened to machines, as far as it is read."""
        return self._past.notes.all

    def close(self) -> None:
        """End the explainer; the file is open only while it is read."""
        self._causes.close()


def _first_sight_ns(recording: Recording) -> int:
    """Return when there is something to see: a machine that runs, else a message."""
    statuses = [name for name, each in recording.slots.items() if each.slot.type is MachineStatus]
    for slot, recorded in recording.messages(statuses):
        with suppress(ValueError):
            status = cast("Sample[MachineStatus]", slot.sample(recorded)).message
            if status.loaded and recorded.seen_ns - recorded.stamp_ns <= SILENT_NS:
                return recorded.seen_ns
    return next((recorded.seen_ns for _, recorded in recording.messages()), recording.span_ns[0])
