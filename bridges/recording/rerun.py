"""Run machines again on what they learnt in a recording, and compare what they do.

The clock returns the recorded readings. If the machines read it more often than they did then, it
stands still until their next event, so that another number of readings makes no difference.
Their events, without times, and the messages that they post are compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from llfsm.runtime import Arrangement, ArrangementEndedError, ExecutionError, Reason
from llfsm.runtime.engine.events import IdleSleep
from llfsm.runtime.engine.loading import Loadable
from llfsm.runtime.journal.entries import Entry, Journal, as_entry
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.whiteboard import Whiteboard

from .differences import COMPARISONS, Comparison, Difference, compared
from .errors import NoEventsError, OtherMachinesError, RecordingFileError, RerunError
from .reader import RecordedJournal, Recording
from .recall import Memory, RecalledEnvironment

__all__ = ["Rerun", "assert_reruns", "rerun", "whole_journals", "why_not"]


class Rerun:
    """Run the machines of a journal again, once: `arrange` them, then `compare`.

    `environment` is where they learn what the journal holds; what they post goes nowhere. `how`
    says what is compared: "all", or "states" and posted messages, or "posts" alone, so that a
    guard that was rewritten, or a state with another name, is no difference.
    Raise `NoEventsError` if nothing was recorded.
    """

    def __init__(
        self, entries: Iterable[Entry], source: str = "the recording", how: Comparison = "all"
    ):
        self._how: Comparison = how
        self._machines: list[str] = []  # that were there from the beginning
        self._memory = Memory(self._noting_machines(entries), COMPARISONS[how])
        self._journal = Journal(lambda _: None)
        self._journal.add = lambda entry: self._take(as_entry(entry))
        recalled = RecalledEnvironment(Whiteboard.local(), self._memory)
        self.environment = JournalledEnvironment(recalled, self._journal)
        self._source = source
        first = self._memory.segment.event
        if first is None:
            raise NoEventsError(
                f"{source} holds no events of machines: record them with llfsm run --record"
            )
        self._begin_ns = first["time_ns"]
        self.difference: Difference | None = None
        """The first one, as soon as it is found."""
        self._over = False  # whether a recording that was cut short has ended
        self._number = 0

    def arrange(self, machines: Iterable[Loadable] = (), **options: Any) -> Arrangement:
        """Return an arrangement that learns from the journal, with the options of `Arrangement`."""
        return Arrangement(machines, environment=self.environment, **options)

    def compare(self) -> Difference | None:
        """Run it and return the first difference, or None if the machines do all they did.

        Raise `OtherMachinesError` if these are not the machines that were recorded, and
        `RecordingFileError` if the messages recorded are not of their sensors' types.
        """
        memory, arrangement = self._memory, self.arrangement
        names = [machine.name for machine in arrangement.machines]
        if names != self._machines:
            raise OtherMachinesError(
                f"{self._source}: its machines are {', '.join(self._machines)}, "
                f"not {', '.join(names) or 'none'}; another one must have the name of the first"
            )
        while self.difference is None and not self._over:
            segment = memory.segment
            if segment.event is None:
                break
            memory.ask()
            self._step(arrangement, segment.event)
            if memory.error is not None:
                raise RecordingFileError(f"{self._source}: {memory.error}")
            if memory.segment is segment:
                self._differ(segment.event, None)
        return self.difference

    @property
    def arrangement(self) -> Arrangement:
        """The arrangement that learns from the journal."""
        assert self._memory.arrangement is not None, "arrange() first"
        return self._memory.arrangement

    @property
    def lost(self) -> bool:
        """Whether entries were lost as they were recorded: it was compared up to there."""
        return self._memory.segment.lost

    @property
    def behind_ns(self) -> int:
        """How far the machines' clock was behind the host's at the latest event."""
        return self._memory.behind_ns

    @property
    def events(self) -> int:
        """How many events and posted messages were as recorded."""
        return self._number

    def _noting_machines(self, entries: Iterable[Entry]) -> Iterator[Entry]:
        begun = False
        for entry in entries:
            begun = begun or "reads" in entry
            if entry["event"] == "Loaded" and not begun:
                self._machines.append(entry["machine"])
            yield entry

    def _step(self, arrangement: Arrangement, event: Entry) -> None:
        match event["event"]:
            case "RoundBegin":
                # Both are seen in the events, or in that there is none.
                with suppress(ExecutionError, ArrangementEndedError):
                    arrangement.round()
            case "IdleSleep":
                arrangement.emit(IdleSleep(*arrangement.stamp(), event["duration_ns"]))
            case "End":
                arrangement.end(Reason(event["reason"]))

    def _take(self, found: Entry) -> None:
        """Compare what a machine does with what is next in the journal."""
        segment = self._memory.segment
        if self.difference is not None or self._over:
            return
        if found["event"] not in COMPARISONS[self._how]:
            return
        if segment.posts:
            self._check(segment.posts.popleft(), found)
        elif segment.event is None:
            self._over = True
        elif found["event"] == "Posted":
            self._differ(segment.event, found)
        elif self._check(segment.event, found):
            self._memory.advance(segment.event["time_ns"])
            if found["event"] == "Turn":
                with self._journal.asking():
                    self._memory.ask()

    def _check(self, recorded: Entry, found: Entry) -> bool:
        if compared(recorded, self._how) != compared(found, self._how):
            self._differ(recorded, found)
            return False
        self._number += 1
        return True

    def _differ(self, recorded: Entry, found: Entry | None) -> None:
        if self.difference is None:
            now_ns = recorded.get("time_ns", self._memory.clock.now_ns())
            after_s = (now_ns - self._begin_ns) / 1e9
            saw = self._seen_by(recorded.get("machine"))
            self.difference = Difference(self._number + 1, after_s, recorded, found, saw)

    def _seen_by(self, machine: str | None) -> dict[str, object]:
        """Return what the sensors of a machine have found, by their names."""
        arrangement = self._memory.arrangement
        for each in () if arrangement is None else arrangement.machines:
            if each.name == machine:
                return {name: getattr(each, name) for name in type(each).table.sensors}
        return {}


def rerun(
    recording: Path | str | Recording,
    machines: Iterable[Loadable],
    *,
    compare: Comparison = "all",
    **options: Any,
) -> Difference | None:
    """Run machines on what was recorded; return the first difference, or None.

    They are the recorded ones in their order; `compare` is `how` of `Rerun`, `options` are those
    of the `Arrangement` that are not as usual, such as `unload_accepting` and `library`. It raises
    what `Rerun.compare` raises.
    """
    again = _open(recording, compare)
    again.arrange(machines, **options)
    return again.compare()


def assert_reruns(
    recording: Path | str | Recording,
    machines: Iterable[Loadable],
    *,
    compare: Comparison = "all",
    **options: Any,
) -> None:
    """Raise `RerunError`, which shows the first difference, unless machines do as recorded."""
    difference = rerun(recording, machines, compare=compare, **options)
    if difference is not None:
        raise RerunError(str(difference))


def _open(recording: Path | str | Recording, how: Comparison) -> Rerun:
    if not isinstance(recording, Recording):
        recording = Recording(Path(recording))
    journals = whole_journals(recording)
    if len(journals) > 1:
        raise OtherMachinesError(
            f"{recording.path} is of several arrangements: give `Rerun` the entries of one"
        )
    return Rerun(recording.entries(journals[0]), str(recording.path), how)


def whole_journals(recording: Recording) -> list[RecordedJournal]:
    """Return the journals that can be run again, or raise `NoEventsError`."""
    journals = [journal for journal in recording.journals if journal.whole]
    if not recording.journals:
        raise NoEventsError(
            f"{recording.path} holds no events of machines: record them with llfsm run --record, "
            f"or start llfsm record before the machines"
        )
    if not journals:
        raise NoEventsError(f"{recording.path}: {', '.join(map(why_not, recording.journals))}")
    return journals


def why_not(journal: RecordedJournal) -> str:
    """Return why machines that do not have a whole journal cannot be run again."""
    return (
        f"{journal.about.get('machines', 'machines')} (process {journal.process}) ran before they "
        f"were recorded, so what they had learnt is missing: start llfsm record first, or use "
        f"llfsm run --record"
    )
