"""Machines that learn what a journal says that they learnt.

A journal is cut into segments, each ended by an event. Whatever a machine asks for while it runs is
answered by the segment that its next event will end.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any

from llfsm.runtime import Arrangement, ManualClock
from llfsm.runtime.engine.errors import UnknownMachineError
from llfsm.runtime.engine.events import Status
from llfsm.runtime.engine.roster import Loadable
from llfsm.runtime.engine.seat import Seat
from llfsm.runtime.journal.entries import Entry, Journal
from llfsm.runtime.journal.journalled import JournalledArrangement
from llfsm.runtime.presence.remote import RemoteMachine
from llfsm.whiteboard import WhiteboardError

from .errors import RecordingFileError

__all__ = ["Memory", "RecalledArrangement", "Segment", "segments_of"]


class Segment:
    """What machines learnt between two events, what they posted, and the event that ended it."""

    def __init__(self) -> None:
        self.reads: list[int] = []
        self.sensed: dict[tuple[str, str], Entry] = {}
        self.answers: deque[Any] = deque()
        self.asked: deque[Entry] = deque()
        self.posts: deque[Entry] = deque()
        self.event: Entry | None = None  # None for the last one, of a recording cut short
        self.lost = False


def segments_of(entries: Iterable[Entry]) -> Iterator[Segment]:
    """Return a journal's segments; the last one, often empty, ends with no event.

    It is also the one in which entries were lost, as nothing is known of what came after.
    """
    segment, in_round = Segment(), False
    for entry in entries:
        kind = entry["event"]
        if kind == "Sensed":
            segment.sensed[entry["machine"], entry["sensor"]] = entry
        elif kind == "Answered":
            segment.answers.append(entry["answer"])
        elif kind == "Asked":
            segment.asked.append(entry)
        elif kind == "Posted":
            segment.posts.append(entry)
        elif "reads" in entry:
            segment.reads += [*entry["reads"], entry["time_ns"]]
            in_round = kind == "RoundBegin" or (in_round and kind not in ("RoundEnd", "End"))
            if kind == "IdleSleep" and in_round:
                continue  # that of a timetable, which belongs to the turn after it
            segment.event = entry
            yield segment
            segment = Segment()
        elif kind == "Lost":
            segment.lost = True
            break
    yield segment


class _Clock(ManualClock):
    """A manual clock that is moved by what was read then, one reading at a time."""

    def __init__(self, on_sleep: Callable[[], None]):
        super().__init__()
        self._ahead: deque[int] = deque()
        self._on_sleep = on_sleep

    def expect(self, now_ns: int, reads: Iterable[int]) -> None:
        """Be at `now_ns`, and tell `reads` from now on; then stand still."""
        self._now_ns = now_ns
        self._ahead = deque(reads)

    def now_ns(self) -> int:
        """Return what was read then."""
        if self._ahead:
            self._now_ns = self._ahead.popleft()
        return self._now_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at once: it is the recording that says how long it took."""
        self._on_sleep()


class Memory:
    """What machines learnt, segment by segment: `segment` is the one that they are in."""

    def __init__(self, entries: Iterable[Entry]):
        self.clock = _Clock(lambda: self.ask())
        self.error: RecordingFileError | None = None
        """Why the machines cannot learn what they did."""
        self.arrangement: RecalledArrangement | None = None
        self._segments = segments_of(entries)
        self.advance(0)

    def advance(self, now_ns: int) -> None:
        """Go on to the next segment: the event that ends this one, at `now_ns`, has come."""
        self.segment = next(self._segments)
        self.clock.expect(now_ns, self.segment.reads)

    def ask(self) -> None:
        """Do what was asked from outside before the next event."""
        while self.segment.asked and self.arrangement is not None:
            asked = self.segment.asked.popleft()
            self.arrangement.obey(asked["action"], asked["machine"])

    def sensed(self, machine: str, sensor: str) -> Entry | None:
        """Return what a sensor finds, if it is something else than before."""
        return self.segment.sensed.pop((machine, sensor), None)

    def knows(self) -> bool:
        """Tell whether the machine of another process that is asked next was there."""
        return bool(self.segment.answers) and self.segment.answers[0] is not None

    def answer(self) -> Any:
        """Return what it answers; None if it was not there, or was not asked then."""
        return self.segment.answers.popleft() if self.segment.answers else None

    def counted(self, count: int) -> int:
        """Return the count that a message got; `count` if none was posted then."""
        posts = self.segment.posts
        return int(posts[0]["count"]) if posts else count


class RecalledArrangement(JournalledArrangement):
    """An arrangement whose machines learn what a journal says."""

    def __init__(
        self, machines: Iterable[Loadable], *, memory: Memory, journal: Journal, **options: Any
    ):
        self._memory = memory
        memory.arrangement = self
        super().__init__(machines, journal=journal, clock=memory.clock, **options)

    def obey(self, action: str, name: str | None) -> None:
        """Do what was asked from outside; what cannot be done will be seen in the events."""
        if name is None:
            Arrangement.stop(self)  # at once, as the journal says
            return
        with suppress(UnknownMachineError):
            getattr(self, action)(name)

    def _tap(self, seat: Seat) -> None:
        seat.sensors = tuple(
            (name, self._recalling(seat, name, type(seat.machine).table.sensors[name]))
            for name, _ in seat.sensors
        )
        for name in type(seat.machine).table.actuators:
            setattr(seat.machine, name, self._counting(getattr(seat.machine, name)))
        super()._tap(seat)

    def _recalling(self, seat: Seat, name: str, sensor: Any) -> Callable[[], object]:
        memory, machine, latest = self._memory, seat.name, sensor.default

        def read() -> object:
            nonlocal latest
            sensed = memory.sensed(machine, name)
            if sensed is None:
                return latest
            if sensed["error"] is not None:
                raise WhiteboardError(sensed["error"])
            try:
                data = sensed["message"]
                latest = sensor.default if data is None else sensor.slot.decoder.decode(data)
            except ValueError as error:
                memory.error = RecordingFileError(
                    f"{machine} cannot read what its sensor {name!r} found then: {error}"
                )
                raise
            return latest

        return read

    def _counting(self, add: Callable[[Any], int]) -> Callable[[Any], int]:
        memory = self._memory
        return lambda message: memory.counted(add(message))

    def _elsewhere(self, name: str) -> RemoteMachine:
        if not self._memory.knows():
            self._memory.answer()
            raise UnknownMachineError(name, self._named)
        return _Elsewhere(name, self._memory)


class _Elsewhere(RemoteMachine):
    """A machine of another process, which answers what it answered then."""

    def __init__(self, name: str, memory: Memory):
        self.name = name
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
        """Return what it was before."""
        return Status(self._memory.answer())
