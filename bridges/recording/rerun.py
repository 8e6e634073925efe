"""Rerun machines on what they learnt in a recording, and find the first thing they do differently.

Machines learn from outside by a few ways only, all of which lead through their environment: what
sensors find and how old it is, readings of the clock, answers of machines elsewhere, counts of
posted messages, and requests. A journal has all of these. Given the same, the same machines do the
same; so whatever differs is due to their code.

The journal is cut into segments, each ended by an event. Whatever a machine reads or asks while it
runs is answered from the segment that its next event will end (:class:`RecordedInputs`). When that
event has come and is as recorded, the next segment begins. There is no other order to keep: within
a segment each sensor, and each kind of question, is answered in its own.

What is compared is what machines do: their events, without times, and the messages they post, in
one sequence. A comparison of "states" or "posts" leaves events out, and their segments are joined,
so that machines may evaluate other guards on the way. The clock returns the recorded readings. If
machines read it more often than they did then, it stands still until their next event, so that
another number of readings makes no difference.

A rerun ends at the first difference: what machines learn afterwards was not meant for what they do.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeAlias

import msgspec

from llfsm.bridges.recording.errors import RecordingError, RecordingFileError, RerunError
from llfsm.bridges.recording.reader import RecordedJournal, Recording
from llfsm.runtime import Arrangement, ArrangementEndedError, ExecutionError, ManualClock, Reason
from llfsm.runtime.engine.environment import AgedRead, BoardEnvironment, Post, Read
from llfsm.runtime.engine.errors import KeepError, OptionError, UnknownMachineError
from llfsm.runtime.engine.events import IdleSleep, Status
from llfsm.runtime.engine.kernel import Loadable
from llfsm.runtime.journal.entries import FIELDS, Entry, Journal, as_entry
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.keeping import go_on
from llfsm.whiteboard import Board, Whiteboard, WhiteboardError

if TYPE_CHECKING:
    from llfsm.runtime import Actuator, Sensor
    from llfsm.whiteboard import Slot


class Segment:
    """The part of a journal between two events, and the event that ended it."""

    def __init__(self) -> None:
        self.reads: list[int] = []
        self.sensed: dict[tuple[str, str], Entry] = {}
        self.ages: deque[int | None] = deque()
        self.answers: deque[Any] = deque()
        self.asked: deque[Entry] = deque()
        self.posts: deque[Entry] = deque()
        self.due_ns: int | None = None  # when the turns after the event were due
        self.behind_ns: int | None = None  # how far the clock is behind the host's, from now on
        self.event: Entry | None = None  # None for the last one, of a recording cut short
        self.lost = False


def segments_of(entries: Iterable[Entry], ends: Container[str]) -> Iterator[Segment]:
    """Yield a journal's segments, which end with events of the kinds in `ends`.

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
        elif kind == "Due":
            segment.due_ns = entry["due_ns"]
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


class RecordedInputs:
    """The segments of a journal, from which machines learn; `segment` is where they are."""

    def __init__(self, entries: Iterable[Entry], ends: Container[str]):
        self.clock = _Clock(lambda: self.ask())
        self.error: RecordingFileError | None = None
        """The reason why machines cannot learn what the journal says."""
        self.arrangement: Arrangement | None = None
        self.behind_ns = 0
        """Nanoseconds by which the clock of the latest event is behind the host's."""
        self.due_ns: int | None = None
        """When the turn under way was due; None if turns had no time of their own."""
        self._segments = segments_of(entries, ends)
        self.segment = Segment()
        self.advance(0)

    def advance(self, now_ns: int) -> None:
        """Go on to the next segment: the event that ends this one has come, at `now_ns`."""
        if self.segment.behind_ns is not None:
            self.behind_ns = self.segment.behind_ns
        if self.segment.due_ns is not None:
            self.due_ns = self.segment.due_ns
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

    def answer(self) -> Any:
        """Take the answer of a machine elsewhere; None if it was not there or not asked then."""
        return self.segment.answers.popleft() if self.segment.answers else None


class RecordedEnvironment(BoardEnvironment):
    """An environment in which machines learn from recorded inputs; they post to `whiteboard`."""

    def __init__(self, whiteboard: Board, inputs: RecordedInputs):
        super().__init__(whiteboard, inputs.clock)
        self._inputs = inputs
        self._latest: dict[tuple[str, str], object] = {}  # also if a sensor is connected again

    @property
    def due_ns(self) -> int | None:  # type: ignore[override]  # a property here
        """When the turn under way was due then."""
        return self._inputs.due_ns

    def is_due(self, due_ns: int) -> None:
        """Leave it at when turns were due then."""

    def enter(self, arrangement: Arrangement) -> None:
        """Have the arrangement obey the requests that were recorded."""
        self._inputs.arrangement = arrangement

    def read(self, machine: str, name: str, sensor: Sensor[Any, Any], slot: Slot[Any]) -> Read:
        """Return a function that finds what the sensor found then."""
        inputs, latest = self._inputs, self._latest
        key = machine, name

        def find() -> object:
            sensed = inputs.segment.sensed.pop(key, None)
            if sensed is None:
                return latest.get(key)
            if sensed["error"] is not None:
                raise WhiteboardError(sensed["error"])
            try:
                data = sensed["message"]
                latest[key] = None if data is None else slot.decoder.decode(data)
            except ValueError as error:
                inputs.error = RecordingFileError(
                    f"{machine} cannot read what its sensor {name!r} found then: {error}"
                )
                raise
            return latest[key]

        return find

    def read_aged(
        self,
        machine: str,
        name: str,
        sensor: Sensor[Any, Any],
        slot: Slot[Any],
        start_count: int | None = None,
    ) -> AgedRead:
        """Return a reader of what the sensor found then, with the ages of then."""
        return _RecordedAgedRead(self.read(machine, name, sensor, slot), self._inputs)

    def post(self, machine: str, name: str, actuator: Actuator[Any], slot: Slot[Any]) -> Post:
        """Return a function that posts and returns the count that the message got then."""
        inputs, add = self._inputs, super().post(machine, name, actuator, slot)

        def post(message: Any) -> int:
            count, posts = add(message), inputs.segment.posts
            return int(posts[0]["count"]) if posts else count  # else none was posted then

        return post

    def override(self, machine: str, slot: Slot[Any], message: Any) -> None:
        """Raise `OptionError`: machines learn from the recording only."""
        raise OptionError(f"{machine} reads {slot.name!r} as it was recorded, always")

    def unloaded(self, machine: str) -> None:
        """Forget what a machine has found: another one may get its name."""
        super().unloaded(machine)
        for key in [key for key in self._latest if key[0] == machine]:
            del self._latest[key]

    def elsewhere(self, name: str, known: Iterable[str]) -> _RecordedMachine:
        """Return a machine of another process, if it was there then."""
        answers = self._inputs.segment.answers
        if not answers or answers[0] is None:
            self._inputs.answer()
            raise UnknownMachineError(name, known)
        return _RecordedMachine(self._inputs)


@dataclass
class _RecordedAgedRead:
    """A reader that returns the messages and ages of then."""

    read: Read
    inputs: RecordedInputs
    start_count = 0

    def __call__(self) -> object:
        return self.read()

    def age_ns(self) -> int | None:
        ages = self.inputs.segment.ages
        return ages.popleft() if ages else None  # else it was not asked for then


@dataclass
class _RecordedMachine:
    """A machine of another process, with its answers of then."""

    inputs: RecordedInputs

    @property
    def state(self) -> str:
        return str(self.inputs.answer())

    @property
    def suspended(self) -> bool:
        return bool(self.inputs.answer())

    def request(self, action: str) -> Status:
        return Status(self.inputs.answer())


Comparison: TypeAlias = Literal["all", "states", "posts"]
"""Compare every event and posted message, states and posted messages, or the messages alone."""

_TIMES: Final = {"reads", "time_ns", "duration_ns"}
_MARKS: Final = {"Overridden", "Released", "Plan", "Lost"}
_INPUTS: Final = {"Due", "Sensed", "Aged", "Answered", "Asked", "Loaded", "Restored"}


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
    """The first event or message that differs; None where one of the two runs has none."""

    number: int
    """Its number among the recording's events and posts that are compared, from 1."""
    after_s: float
    """Seconds since the first event."""
    recorded: Entry | None
    found: Entry | None
    saw: Mapping[str, object] = {}
    """The findings of its machine's sensors, by name."""

    def __str__(self) -> str:
        """Say what differs; show both runs, with stars where they do, and what the machine saw."""
        both = [_shown(self.recorded), _shown(self.found)]
        names = dict.fromkeys(name for each in both for name in each)
        rows = [("", "recorded", "now")]
        for name in names:
            before, now = (each.get(name, "") for each in both)
            rows.append((f"{' ' if before == now else '*'} {name}", before, now))
        widths = [max(len(row[column]) for row in rows) for column in range(2)]
        lines = [f"{self._in_words()}event {self.number} differs, after {self.after_s:.6f} s:"]
        lines += [f"{a:{widths[0]}}  {b:{widths[1]}}  {c}".rstrip() for a, b, c in rows]
        machine = (self.recorded or self.found or {}).get("machine")
        lines += [f"{machine} saw {name} = {value!r}" for name, value in self.saw.items()]
        return "\n".join(lines)

    def _in_words(self) -> str:
        """Say in a line what the machine does otherwise; "" if it is no post, guard or state."""
        before, now = self.recorded or {"event": ""}, self.found or {"event": ""}
        machine = (now if self.found else before).get("machine")
        kinds, at = (before["event"], now["event"]), f"at {self.after_s:.3f} s"
        if kinds[1] == "Posted":
            posts = f"{machine} now posts {_post(now)} {at}"
            same = kinds[0] == "Posted" and before["machine"] == machine
            return f"{posts}, where it posted {_post(before) if same else 'nothing'}\n"
        if kinds[0] == "Posted":
            return f"{before['machine']} no longer posts {_post(before)} {at}\n"
        if kinds == ("Eval", "Eval") and before["value"] != now["value"]:
            arrow = f"{now['state']} -> {now['target']}"
            was, value = str(before["value"]).lower(), str(now["value"]).lower()
            return f"{machine}: {arrow} is now {value} {at}, where it was {was}\n"
        if kinds == ("Turn", "Turn") and before["machine"] == machine:
            return f"{machine} is now in {now['state']} {at}, where it was in {before['state']}\n"
        return ""


def _post(entry: Entry) -> str:
    values = msgspec.msgpack.decode(entry["message"])
    return f"{entry['slot']} = {values[0] if len(values) == 1 else values!r}"


def _shown(entry: Entry | None) -> dict[str, str]:
    if entry is None:
        return {"event": "nothing"}
    shown = {name: entry[name] for name in _without_times(entry["event"])}
    if entry["event"] == "Posted":
        shown["message"] = msgspec.msgpack.decode(shown["message"])
    return {"event": entry["event"], **{name: repr(value) for name, value in shown.items()}}


class Rerun:
    """Rerun the machines of a journal, once: `arrange` them, then `compare`.

    In `environment` they learn from the journal; what they post goes nowhere. `how` is "all", or
    "states" and posted messages, or "posts" alone: then a guard that was rewritten, or a state with
    another name, is no difference. Raise `RecordingError` if nothing was recorded.
    """

    def __init__(
        self, entries: Iterable[Entry], source: str = "the recording", how: Comparison = "all"
    ):
        self._how: Comparison = how
        self._machines: list[str] = []  # that were there from the beginning
        self._restored: Entry | None = None  # where a file had kept them
        self._inputs = RecordedInputs(self._noting_machines(entries), COMPARISONS[how])
        self._journal = Journal(lambda _: None)
        self._journal.add = lambda entry: self._take(as_entry(entry))
        recorded = RecordedEnvironment(Whiteboard.local(), self._inputs)
        self.environment = JournalledEnvironment(recorded, self._journal)
        self._source = source
        first = self._inputs.segment.event
        if first is None:
            raise RecordingError(
                f"{source} holds no events of machines: record them with llfsm run --record"
            )
        self._begin_ns = first["time_ns"]
        self.difference: Difference | None = None
        """The first one, as soon as it is found."""
        self._over = False  # whether a recording that was cut short has ended
        self.events = 0
        """The number of events and posted messages that were as recorded."""

    def arrange(self, machines: Iterable[Loadable] = (), **options: Any) -> Arrangement:
        """Return an arrangement that learns from the journal, with the options of `Arrangement`."""
        return Arrangement(machines, environment=self.environment, **options)

    def compare(self) -> Difference | None:
        """Run the arrangement; return the first difference, or None if all is as recorded.

        Raise `RecordingError` if these are not the machines that were recorded, and
        `RecordingFileError` if the messages recorded are not of their sensors' types.
        """
        inputs, arrangement = self._inputs, self.arrangement
        names = [machine.name for machine in arrangement.machines]
        if names != self._machines:
            raise RecordingError(
                f"{self._source}: its machines are {', '.join(self._machines)}, "
                f"not {', '.join(names) or 'none'}; another one must have the name of the first"
            )
        if self._restored is not None:
            kept, ahead_ns, now_ns = (self._restored[name] for name in FIELDS["Restored"])
            try:
                go_on(arrangement.kernel, kept, ahead_ns, now_ns, self._source)
            except KeepError as error:
                raise RecordingError(str(error)) from None
        while self.difference is None and not self._over:
            segment = inputs.segment
            if segment.event is None:
                break
            inputs.ask()
            self._step(arrangement, segment.event)
            if inputs.error is not None:
                raise RecordingFileError(f"{self._source}: {inputs.error}")
            if inputs.segment is segment:
                self._differ(segment.event, None)
        return self.difference

    @property
    def arrangement(self) -> Arrangement:
        """The arrangement that learns from the journal."""
        assert self._inputs.arrangement is not None, "arrange() first"
        return self._inputs.arrangement

    @property
    def lost(self) -> bool:
        """True if entries were lost in the recording: all was compared up to there."""
        return self._inputs.segment.lost

    @property
    def behind_ns(self) -> int:
        """Nanoseconds by which the machines' clock was behind the host's at the latest event."""
        return self._inputs.behind_ns

    def _noting_machines(self, entries: Iterable[Entry]) -> Iterator[Entry]:
        begun = False
        for entry in entries:
            begun = begun or "reads" in entry
            if entry["event"] == "Restored":
                begun, self._restored = True, entry
            if entry["event"] == "Loaded" and not begun:
                self._machines.append(entry["machine"])
            yield entry

    def _step(self, arrangement: Arrangement, event: Entry) -> None:
        match event["event"]:
            case "RoundBegin":
                # Both errors show in the events, or in that there is none.
                with suppress(ExecutionError, ArrangementEndedError):
                    arrangement.round()
            case "IdleSleep":
                arrangement.kernel.emit(
                    IdleSleep(*arrangement.kernel.stamp(), event["duration_ns"])
                )
            case "End":
                arrangement.end(Reason(event["reason"]))

    def _take(self, found: Entry) -> None:
        """Compare an event or a post of a machine with the next one in the journal."""
        segment = self._inputs.segment
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
            self._inputs.advance(segment.event["time_ns"])
            if found["event"] == "Turn":
                with self._journal.asking():
                    self._inputs.ask()

    def _check(self, recorded: Entry, found: Entry) -> bool:
        if compared(recorded, self._how) != compared(found, self._how):
            self._differ(recorded, found)
            return False
        self.events += 1
        return True

    def _differ(self, recorded: Entry, found: Entry | None) -> None:
        if self.difference is None:
            now_ns = recorded.get("time_ns", self._inputs.clock.now_ns())
            after_s = (now_ns - self._begin_ns) / 1e9
            saw = self._seen_by(recorded.get("machine"))
            self.difference = Difference(self.events + 1, after_s, recorded, found, saw)

    def _seen_by(self, machine: str | None) -> dict[str, object]:
        """Return the latest findings of a machine's sensors, by their names."""
        arrangement = self._inputs.arrangement
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
    """Rerun machines on a recording; return the first difference, or None.

    They are the recorded ones in their order; `compare` is `how` of `Rerun`, `options` are those
    of the `Arrangement` that are not as usual, such as `unload_accepting` and `library`. Raise as
    `Rerun.compare` does.
    """
    if not isinstance(recording, Recording):
        recording = Recording(Path(recording))
    journals = whole_journals(recording)
    if len(journals) > 1:
        raise RecordingError(
            f"{recording.path} is of several arrangements: give `Rerun` the entries of one"
        )
    again = Rerun(recording.entries(journals[0]), str(recording.path), compare)
    again.arrange(machines, **options)
    return again.compare()


def assert_reruns(
    recording: Path | str | Recording, machines: Iterable[Loadable], **options: Any
) -> None:
    """Raise `RerunError` with the first difference, if `rerun` with these arguments finds one."""
    difference = rerun(recording, machines, **options)
    if difference is not None:
        raise RerunError(str(difference))


def whole_journals(recording: Recording) -> list[RecordedJournal]:
    """Return the journals that can be rerun; raise `RecordingError` if there are none."""
    journals = [journal for journal in recording.journals if journal.whole]
    if not recording.journals:
        raise RecordingError(
            f"{recording.path} holds no events of machines: record them with llfsm run --record, "
            f"or start llfsm record before the machines"
        )
    if not journals:
        raise RecordingError(f"{recording.path}: {', '.join(map(why_not, recording.journals))}")
    return journals


def why_not(journal: RecordedJournal) -> str:
    """Explain for a user that a journal without its beginning cannot be rerun."""
    return (
        f"{journal.about.get('machines', 'machines')} (process {journal.process}) ran before they "
        f"were recorded, so what they had learnt is missing: start llfsm record first, or use "
        f"llfsm run --record"
    )
