"""A journal: everything that the machines of an arrangement learn, and everything that they do.

It holds enough to run the machines again exactly as they ran. An entry is one of

* an event, as observers see it, with its `reads`: the clock readings since the entry before it;
* `Sensed`: a sensor has another message than before; no message means its default;
* `Overridden`: a machine reads this message from the slot from now on, whatever is there, until
  `Released`: what its sensors find is kept as ever;
* `Aged`: the age of a sensor's message was asked for, and returned in nanoseconds;
* `Posted`: an actuator was called, and the whiteboard has counted the message;
* `Asked`: a request for one machine, or for all (`stop`), came from outside the arrangement,
  between two rounds or, in a script, at the beginning of a turn;
* `Answered`: a machine of another process returned its state, or its answer to a request;
* `Loaded`: a machine was loaded from outside the arrangement;
* `Restored`, before the first event: the machines go on where a file had kept them (`--keep`);
* `Due`: the turns after the next event were due then, which is the time that machines see;
* `Behind`: the clock stood still in a pause, and is so far behind the host's from now on;
* `Plan`, at the beginning: the plan from which the arrangement was made, if there was one;
* `Lost`, written by a recorder: entries were lost on their way to it.

Clock readings between turns are left out: no machine sees them. Entries are collected in memory
and written in batches between rounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, TypeAlias, get_args

import msgspec

from llfsm.runtime.engine import events
from llfsm.runtime.engine.errors import ExecutionError
from llfsm.runtime.engine.submachine import Submachine

Entry: TypeAlias = dict[str, Any]
"""An entry by the names of its fields, as in JSON; `event` names its kind."""

_OUTSIDE: Final = (events.RoundEnd, events.IdleSleep, events.End)
"""After these no code of a machine runs before the next event."""

_WRITE_NS: Final = 20_000_000
_MOST: Final = 4096  # entries that are collected even if no round ends

FIELDS: Final[dict[str, tuple[str, ...]]] = {
    "Plan": ("plan", "folder"),
    "Lost": (),
    "Loaded": ("machine", "path"),
    "Restored": ("kept", "ahead_ns", "now_ns"),
    "Due": ("due_ns",),
    "Behind": ("behind_ns",),
    "Sensed": ("machine", "sensor", "slot", "message", "error"),
    "Overridden": ("machine", "slot", "message"),
    "Released": ("machine", "slot"),
    "Aged": ("machine", "sensor", "age_ns"),
    "Posted": ("machine", "actuator", "slot", "message", "count"),
    "Asked": ("action", "machine"),
    "Answered": ("machine", "answer"),
} | {kind.__name__: ("reads", *kind._fields) for kind in get_args(events.Event)}
"""The names of the fields of each kind of entry."""


class Journal:
    """Keep the journal of one arrangement, of which it is an observer.

    `write` is called with entries, encoded; it must neither block for long nor raise. `add` takes
    an entry: a tuple of what it is and the values of its fields.
    """

    def __init__(self, write: Callable[[bytes], None]):
        self.reads: list[int] = []
        self.outside = True
        """True while no code of a machine can be running."""
        self.ended = False
        """True once the arrangement has ended: no entry follows."""
        self.between: Callable[[], None] = lambda: None
        """Called whenever none is running any more."""
        self.closed: Callable[[], None] = lambda: None
        """Called when the journal is closed."""
        self._entries: list[tuple[Any, ...]] = []
        self.add: Callable[[tuple[Any, ...]], None] = self._entries.append
        self._write = write
        self._standings: dict[str, tuple[Any, ...]] = {}
        self._written_ns = 0

    def __call__(self, event: events.Event) -> None:
        """Take an event."""
        # A signal's handler may come anywhere, and ask for a stop: before this, or after all.
        outside, self.outside = self.outside, False
        reads = self.reads
        # The last one is the event's own time.
        inputs = () if outside or len(reads) == 1 else tuple(reads[:-1])
        reads.clear()
        kind = type(event)
        if isinstance(event, events.RoundEnd):
            self.add(("RoundEnd", inputs, *event[:-1], self._news(event)))
        else:
            self.add((kind.__name__, inputs, *event))
        if kind in _OUTSIDE:
            self.outside = True
            self._pause(event)
        elif len(self._entries) >= _MOST:
            self.flush()

    def _pause(self, event: events.Event) -> None:
        self.between()
        self.ended = isinstance(event, events.End)
        due = event.time_ns - self._written_ns >= _WRITE_NS or len(self._entries) >= _MOST
        if self.ended or due:
            self._written_ns = event.time_ns
            self.flush()

    def close(self) -> None:
        """Keep nothing more."""
        self.add = lambda _: None
        self.closed()

    @contextmanager
    def asking(self) -> Iterator[None]:
        """Keep what is asked meanwhile, at the beginning of a turn: no code of it runs yet."""
        before, self.outside = self.outside, True
        yield
        self.outside = before

    def flush(self) -> None:
        """Write what was collected."""
        entries = self._entries[:]
        if entries:
            del self._entries[: len(entries)]  # no more: a signal's handler may have added one
            self._write(_encoder.encode(entries))

    def _news(self, end: events.RoundEnd) -> list[tuple[Any, ...]]:
        """Return the machines whose standing differs from the last round's, and those gone."""
        now = {m.machine: (m.index, *m[2:-1]) for m in end.machines if m}
        if now == self._standings:
            return []
        news: list[tuple[Any, ...]] = [
            (name, *now[name]) for name in now if now[name] != self._standings.get(name)
        ]
        news += [(name,) for name in self._standings if name not in now]
        self._standings = now
        return news


def entries_of(data: bytes) -> Iterator[Entry]:
    """Return the entries of one batch that a journal has written."""
    for kind, *values in msgspec.msgpack.decode(data, type=list[list[Any]]):
        yield {"event": kind, **dict(zip(FIELDS[kind], values, strict=True))}


def as_entry(values: tuple[Any, ...]) -> Entry:
    """Return an entry as it will be read again, from what `Journal.add` is given."""
    return next(entries_of(_encoder.encode([values])))


def _describe(value: object) -> object:
    """Represent an object that is not data, by a name or a text."""
    match value:
        case ExecutionError():  # where it is in a file changes more often than what it is
            return f"{value.state}, {value.step}: {value.__cause__ or value}"
        case Exception():
            return f"{type(value).__name__}: {value}"
        case Submachine():
            return value.name
        case type():
            return value.__name__
    return type(value).__name__


_encoder: Final = msgspec.msgpack.Encoder(enc_hook=_describe)
