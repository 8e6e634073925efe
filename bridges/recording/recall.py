"""An environment in which machines learn what a journal recorded.

A journal is cut into segments, each ended by an event. Whatever a machine reads or asks while it
runs is answered from the segment that its next event will end.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from llfsm.runtime import Arrangement, ManualClock
from llfsm.runtime.engine.environment import BoardEnvironment, Post, Read
from llfsm.runtime.engine.errors import OptionError, UnknownMachineError
from llfsm.runtime.engine.events import Status
from llfsm.runtime.engine.freshness import AgedRead
from llfsm.runtime.journal.entries import Entry
from llfsm.whiteboard import Board, WhiteboardError

from .errors import RecordingFileError

if TYPE_CHECKING:
    from llfsm.runtime import Actuator, Sensor
    from llfsm.whiteboard import Slot

__all__ = ["Memory", "RecalledEnvironment", "Segment", "segments_of"]


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
                getattr(self.arrangement, asked["action"])(asked["machine"])

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
