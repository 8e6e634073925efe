"""Run machines again on what they learnt in a recording, and compare what they do.

The clock returns the recorded readings. If the machines read it more often than they did then, it
stands still until their next event, so that another number of readings makes no difference.
Their events, without times, and the messages that they post are compared.

An environment in which machines learn what a journal recorded.

A journal is cut into segments, each ended by an event. Whatever a machine reads or asks while it
runs is answered from the segment that its next event will end.

What machines do differently when they run again, and how closely that is looked at.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeAlias

import msgspec

from llfsm.bridges.recording.errors import (
    NoEventsError,
    OtherMachinesError,
    RecordingFileError,
    RerunError,
)
from llfsm.bridges.recording.reader import RecordedJournal, Recording
from llfsm.runtime import Arrangement, ArrangementEndedError, ExecutionError, ManualClock, Reason
from llfsm.runtime.engine.environment import AgedRead, BoardEnvironment, Post, Read
from llfsm.runtime.engine.errors import OptionError, UnknownMachineError
from llfsm.runtime.engine.events import IdleSleep, Status
from llfsm.runtime.engine.kernel import Loadable
from llfsm.runtime.journal.entries import FIELDS, Entry, Journal, as_entry
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.whiteboard import Board, Whiteboard, WhiteboardError

if TYPE_CHECKING:
    from llfsm.runtime import Actuator, Sensor
    from llfsm.whiteboard import Slot


class Segment:
    """What machines learnt and posted between two events, and the event that ended it."""

    def __init__(self) -> None:
        self.reads: list[int] = []
        self.sensed: dict[tuple[str, str], Entry] = {}
        self.ages: deque[int | None] = deque()
        self.answers: deque[Any] = deque()
        self.asked: deque[Entry] = deque()
        self.posts: deque[Entry] = deque()
        self.behind_ns: int | None = None  # how far the clock is behind the host's, from now on
        self.event: Entry | None = None  # None for the last one, of a recording cut short
        self.lost = False


def segments_of(entries: Iterable[Entry], ends: Container[str]) -> Iterator[Segment]:
    """Return a journal's segments, which end with events of the kinds in `ends`.

    The last one, often empty, ends with no event. It is also the one in which entries were lost, as
    nothing is known of what came after.
    """
    segment, in_round = Segment(), False
    for entry in entries:
        kind = entry["event"]
        if kind == "Sensed":
            segment.sensed[entry["machine"], entry["sensor"]] = entry
        elif kind == "Aged":
            segment.ages.append(entry["age_ns"])
        elif kind == "Answered":
            segment.answers.append(entry["answer"])
        elif kind == "Asked":
            segment.asked.append(entry)
        elif kind == "Posted":
            segment.posts.append(entry)
        elif kind == "Behind":
            segment.behind_ns = entry["behind_ns"]
        elif "reads" in entry:
            segment.reads += [*entry["reads"], entry["time_ns"]]
            in_round = kind == "RoundBegin" or (in_round and kind not in ("RoundEnd", "End"))
            if kind == "IdleSleep" and in_round:
                continue  # that of a timetable, which belongs to the turn after it
            if kind not in ends:
                continue
            segment.event = entry
            yield segment
            segment = Segment()
        elif kind == "Lost":
            segment.lost = True
            break
    yield segment


class _Clock(ManualClock):
    """A clock that returns the recorded readings, one at a time."""

    def __init__(self, on_sleep: Callable[[], None]):
        super().__init__()
        self._ahead: deque[int] = deque()
        self._on_sleep = on_sleep

    def expect(self, now_ns: int, reads: Iterable[int]) -> None:
        """Move to `now_ns`, and return `reads` from now on; then stand still."""
        self._now_ns = now_ns
        self._ahead = deque(reads)

    def now_ns(self) -> int:
        """Return the recorded reading."""
        if self._ahead:
            self._now_ns = self._ahead.popleft()
        return self._now_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at once: the recording holds how long it took."""
        self._on_sleep()


class Memory:
    """A journal's segments; `segment` is the one in which the machines are."""

    def __init__(self, entries: Iterable[Entry], ends: Container[str]):
        self.clock = _Clock(lambda: self.ask())
        self.error: RecordingFileError | None = None
        """Why the machines cannot learn what they learnt."""
        self.arrangement: Arrangement | None = None
        self.behind_ns = 0
        """How far the clock of the latest event is behind the host's."""
        self._segments = segments_of(entries, ends)
        self.segment = Segment()
        self.advance(0)

    def advance(self, now_ns: int) -> None:
        """Go on to the next segment: the event that ends this one has come, at `now_ns`."""
        if self.segment.behind_ns is not None:
            self.behind_ns = self.segment.behind_ns
        self.segment = next(self._segments)
        self.clock.expect(now_ns, self.segment.reads)

    def ask(self) -> None:
        """Repeat the requests that came from outside before the next event."""
        while self.segment.asked and self.arrangement is not None:
            asked = self.segment.asked.popleft()
            if asked["machine"] is None:
                self.arrangement.stop()
                continue
            with suppress(UnknownMachineError):  # the events will show what could not be done
                getattr(self.arrangement.control, asked["action"])(asked["machine"])

    def sensed(self, machine: str, sensor: str) -> Entry | None:
        """Return what a sensor finds if it differs from before, else None."""
        return self.segment.sensed.pop((machine, sensor), None)

    def knows(self) -> bool:
        """Return whether the machine of another process that is asked next was there."""
        return bool(self.segment.answers) and self.segment.answers[0] is not None

    def answer(self) -> Any:
        """Return its answer; None if it was not there, or was not asked then."""
        return self.segment.answers.popleft() if self.segment.answers else None

    def age_ns(self) -> int | None:
        """Return the age of a sensor's message; None if it was not asked for then."""
        return self.segment.ages.popleft() if self.segment.ages else None

    def counted(self, count: int) -> int:
        """Return the count that a message got; `count` if none was posted then."""
        posts = self.segment.posts
        return int(posts[0]["count"]) if posts else count


class RecalledEnvironment(BoardEnvironment):
    """An environment in which machines learn what `memory` holds; they post to `whiteboard`."""

    def __init__(self, whiteboard: Board, memory: Memory):
        super().__init__(whiteboard, memory.clock)
        self._memory = memory
        self._latest: dict[tuple[str, str], object] = {}  # also if a sensor is connected again

    def enter(self, arrangement: Arrangement) -> None:
        """Have the arrangement obey the requests that were recorded."""
        self._memory.arrangement = arrangement

    def read(self, machine: str, name: str, sensor: Sensor[Any, Any], slot: Slot[Any]) -> Read:
        """Return a function that returns what the sensor found then."""
        memory, latest = self._memory, self._latest
        key = machine, name

        def recall() -> object:
            sensed = memory.sensed(machine, name)
            if sensed is None:
                return latest.get(key)
            if sensed["error"] is not None:
                raise WhiteboardError(sensed["error"])
            try:
                data = sensed["message"]
                latest[key] = None if data is None else slot.decoder.decode(data)
            except ValueError as error:
                memory.error = RecordingFileError(
                    f"{machine} cannot read what its sensor {name!r} found then: {error}"
                )
                raise
            return latest[key]

        return recall

    def read_aged(
        self,
        machine: str,
        name: str,
        sensor: Sensor[Any, Any],
        slot: Slot[Any],
        start_count: int | None = None,
    ) -> AgedRead:
        """Return what returns what the sensor found then, and the ages."""
        return _RecalledAgedRead(self.read(machine, name, sensor, slot), self._memory)

    def post(self, machine: str, name: str, actuator: Actuator[Any], slot: Slot[Any]) -> Post:
        """Return a function that posts and returns the count that the message got then."""
        memory, add = self._memory, super().post(machine, name, actuator, slot)
        return lambda message: memory.counted(add(message))

    def override(self, machine: str, slot: Slot[Any], message: Any) -> None:
        """Raise `OptionError`: machines learn what they learnt then."""
        raise OptionError(f"{machine} reads {slot.name!r} as it was recorded, always")

    def unloaded(self, machine: str) -> None:
        """Forget what a machine has found, as another one may get its name."""
        super().unloaded(machine)
        for key in [key for key in self._latest if key[0] == machine]:
            del self._latest[key]

    def elsewhere(self, name: str, known: Iterable[str]) -> _RecalledMachine:
        """Return a machine of another process, if it was there then."""
        if not self._memory.knows():
            self._memory.answer()
            raise UnknownMachineError(name, known)
        return _RecalledMachine(self._memory)


class _RecalledAgedRead:
    """A reader that returns the messages and ages of then."""

    start_count = 0

    def __init__(self, read: Read, memory: Memory):
        self._read = read
        self._memory = memory

    def __call__(self) -> object:
        """Return what the sensor found then."""
        return self._read()

    def age_ns(self) -> int | None:
        """Return the age that was asked for then."""
        return self._memory.age_ns()


class _RecalledMachine:
    """A machine of another process, which answers what it answered then."""

    def __init__(self, memory: Memory):
        self._memory = memory

    @property
    def state(self) -> str:
        """The name of its state."""
        return str(self._memory.answer())

    @property
    def suspended(self) -> bool:
        """Whether it is in its suspend state."""
        return bool(self._memory.answer())

    def request(self, action: str) -> Status:
        """Return its status before."""
        return Status(self._memory.answer())


Comparison: TypeAlias = Literal["all", "states", "posts"]
"""What is compared: every event and posted message, the states and those, or those alone."""

_TIMES: Final = {"reads", "time_ns", "duration_ns"}
_MARKS: Final = {"Overridden", "Released", "Plan", "Lost"}
_INPUTS: Final = {"Sensed", "Aged", "Answered", "Asked", "Loaded"}


def _without_times(kind: str) -> tuple[str, ...]:
    return tuple(name for name in FIELDS[kind] if name not in _TIMES)


_ALL: Final = {kind: _without_times(kind) for kind in FIELDS if kind not in _INPUTS | _MARKS}

COMPARISONS: Final[dict[Comparison, Mapping[str, tuple[str, ...]]]] = {
    "all": _ALL,
    "states": {
        kind: fields for kind, fields in _ALL.items() if kind not in ("Section", "Eval", "Call")
    },
    "posts": {
        "RoundBegin": (),
        "Turn": ("machine",),  # at which it learns what it learnt
        "Posted": _ALL["Posted"],
        "RoundEnd": (),
        "IdleSleep": (),
        "End": (),
    },
}
"""The kinds of entries that are compared, with the fields of each."""


def compared(entry: Entry, how: Comparison) -> dict[str, Any]:
    """Return the part of an entry that is compared."""
    fields = COMPARISONS[how].get(entry["event"], ())
    return {"event": entry["event"], **{name: entry[name] for name in fields}}


class Difference(NamedTuple):
    """The first thing that machines do differently; None where one of the two does nothing."""

    number: int
    """Its number among the recording's events and posts that are compared, from 1."""
    after_s: float
    """Seconds since the first event."""
    recorded: Entry | None
    found: Entry | None
    saw: Mapping[str, object] = {}
    """What the sensors of its machine had found."""

    def __str__(self) -> str:
        """Return both side by side, with a star where they differ, and what the machine saw."""
        both = [_shown(self.recorded), _shown(self.found)]
        names = dict.fromkeys(name for each in both for name in each)
        rows = [("", "recorded", "now")]
        for name in names:
            before, now = (each.get(name, "") for each in both)
            rows.append((f"{' ' if before == now else '*'} {name}", before, now))
        widths = [max(len(row[column]) for row in rows) for column in range(2)]
        lines = [f"event {self.number} differs, after {self.after_s:.6f} s:"]
        lines += [f"{a:{widths[0]}}  {b:{widths[1]}}  {c}".rstrip() for a, b, c in rows]
        machine = (self.recorded or self.found or {}).get("machine")
        lines += [f"{machine} saw {name} = {value!r}" for name, value in self.saw.items()]
        return "\n".join(lines)


def _shown(entry: Entry | None) -> dict[str, str]:
    if entry is None:
        return {"event": "nothing"}
    shown = {name: entry[name] for name in _without_times(entry["event"])}
    if entry["event"] == "Posted":
        shown["message"] = msgspec.msgpack.decode(shown["message"])
    return {"event": entry["event"], **{name: repr(value) for name, value in shown.items()}}


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
                arrangement.kernel.emit(
                    IdleSleep(*arrangement.kernel.stamp(), event["duration_ns"])
                )
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
