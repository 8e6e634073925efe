"""An environment that keeps a journal of what machines learn and do in another one.

Machines learn from their sensors, the clock, machines of other processes and requests from
outside: each of these is tapped where it passes, so turns stay the same, and cost the same but
for the journal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from llfsm.runtime.engine.clock import Clock
from llfsm.runtime.engine.environment import AgedRead, Elsewhere, Environment, Post, Read
from llfsm.runtime.engine.errors import LoadError, UnknownMachineError
from llfsm.runtime.engine.events import Status
from llfsm.runtime.journal.entries import Journal

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.ports import Actuator, Sensor
    from llfsm.whiteboard import Board, Slot


A = TypeVar("A")

_NOT_KEPT = ("attend", "sleep_until_ns", "wake", "peek_ns", "overridden", "claim", "retire")
"""What the other environment does alone: machines learn nothing by it, or learn it elsewhere."""


class JournalledEnvironment(Environment):
    """Keep `journal` of one arrangement in the environment `inner`, until the journal is closed.

    A stop that is requested while code of a machine runs is seen by the machines from the next
    round on, or after the next sleep, so that all code of a ringlet sees the same.
    """

    defers_stops = True

    def __init__(self, inner: Environment, journal: Journal):
        self.clock: _JournalledClock = _JournalledClock(inner.clock, journal)
        self._inner = inner
        self.journal = journal
        self._latest: dict[tuple[str, str], list[object]] = {}  # what each sensor has found
        self._arrangement: Arrangement | None = None
        self._deferred: str | None = None  # the cause of a stop
        for name in _NOT_KEPT:
            setattr(self, name, getattr(inner, name))

    @property
    def whiteboard(self) -> Board | None:  # type: ignore[override]  # a property here
        """The other environment's whiteboard."""
        return self._inner.whiteboard

    @property
    def alive(self) -> bool:
        """True while the other environment exists."""
        return self._inner.alive

    @property
    def due_ns(self) -> int | None:  # type: ignore[override]  # a property here
        """When the turn under way was due, in the other environment."""
        return self._inner.due_ns

    def is_due(self, due_ns: int) -> None:
        """Keep when turns were due."""
        self._inner.is_due(due_ns)
        self.journal.add(("Due", due_ns))

    def enter(self, arrangement: Arrangement) -> None:
        """Observe the arrangement for the journal."""
        self._inner.enter(arrangement)
        self._arrangement = arrangement
        self.journal.between = self._stop_deferred
        self.journal.closed = self._close
        arrangement.attach(self.journal)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Keep what is requested meanwhile; a stop takes effect at once."""
        with self._inner.paused(), self.journal.asking():
            self._stop_deferred()
            yield
        if (behind_ns := self._inner.clock.behind_ns) is not None:
            self.journal.add(("Behind", behind_ns))

    def read(self, machine: str, name: str, sensor: Sensor[Any, Any], slot: Slot[Any]) -> Read:
        """Return a function that keeps each message that is another one than before."""
        return self._keeping(machine, name, slot, self._inner.read(machine, name, sensor, slot))

    def read_aged(
        self,
        machine: str,
        name: str,
        sensor: Sensor[Any, Any],
        slot: Slot[Any],
        start_count: int | None = None,
    ) -> AgedRead:
        """Keep each message that is another one than before, and each age."""
        aged = self._inner.read_aged(machine, name, sensor, slot, start_count)
        read = self._keeping(machine, name, slot, aged)
        return _JournalledAgedRead(machine, name, read, aged, self.journal)

    def _keeping(self, machine: str, name: str, slot: Slot[Any], read: Read) -> Read:
        add, encode = self.journal.add, slot.encoder.encode
        latest = self._latest.setdefault((machine, name), [None])  # also if it is connected again

        def read_and_keep() -> object:
            try:
                message = read()
            except Exception as error:
                add(("Sensed", machine, name, slot.name, None, str(error)))
                raise
            if message is not latest[0]:
                latest[0] = message
                data = None if message is None else encode(message)
                add(("Sensed", machine, name, slot.name, data, None))
            return message

        return read_and_keep

    def post(self, machine: str, name: str, actuator: Actuator[Any], slot: Slot[Any]) -> Post:
        """Return a function that keeps each message and its count."""
        post, encode = self._inner.post(machine, name, actuator, slot), slot.encoder.encode
        journal = self.journal

        def post_and_keep(message: Any) -> int:
            count = post(message)
            journal.add(("Posted", machine, name, slot.name, encode(message), count))
            return count

        return post_and_keep

    def override(self, machine: str, slot: Slot[Any], message: Any) -> None:
        """Override in the other environment, and keep it, for whom looks at the journal."""
        self._inner.override(machine, slot, message)
        data = None if message is None else slot.encoder.encode(message)
        self.journal.add(("Overridden", machine, slot.name, data))

    def release(self, machine: str, slot: Slot[Any]) -> None:
        """Release in the other environment, and keep it."""
        self._inner.release(machine, slot)
        self.journal.add(("Released", machine, slot.name))

    def elsewhere(self, name: str, known: Iterable[str]) -> Elsewhere:
        """Return a machine of another process whose answers are kept."""
        try:
            return _JournalledMachine(name, self._inner.elsewhere(name, known), self.journal)
        except UnknownMachineError:
            self.journal.add(("Answered", name, None))
            raise

    def requested(self, action: str, machine: str) -> None:
        """Keep a request from outside; what machines' own code requests, it will request again.

        Of a reload the journal could not keep the new definition, so it is a `LoadError`.
        """
        if action == "reload":
            raise LoadError(
                f"{machine} is recorded for `llfsm rerun`, which cannot follow a reload: "
                f"end the recording first"
            )
        self._inner.requested(action, machine)
        if self.journal.outside:
            self.journal.add(("Asked", action, machine))

    def loaded(self, machine: str, path: str) -> None:
        """Keep that a machine was loaded from outside."""
        self._inner.loaded(machine, path)
        if self.journal.outside:
            self.journal.add(("Loaded", machine, path))

    def restored(self, kept: bytes, ahead_ns: int, now_ns: int) -> None:
        """Keep where the machines go on."""
        self._inner.restored(kept, ahead_ns, now_ns)
        self.journal.add(("Restored", kept, ahead_ns, now_ns))

    def unloaded(self, machine: str) -> None:
        """Let nothing be posted for the machine in the other environment."""
        self._inner.unloaded(machine)
        for key in [key for key in self._latest if key[0] == machine]:
            del self._latest[key]

    def may_stop(self, cause: str) -> bool:
        """Defer a stop that comes while code of a machine may be running."""
        if not self.journal.outside:
            self._deferred = cause
            return False
        self._inner.may_stop(cause)
        self.journal.add(("Asked", "stop", None))
        return True

    def _stop_deferred(self) -> None:
        if self._deferred is not None and self._arrangement is not None:
            self._arrangement.stop(self._deferred)
            self._deferred = None

    def _close(self) -> None:
        self.clock.close()
        if self._arrangement is not None:
            self._arrangement.kernel.move(self._inner)
            self._arrangement.detach(self.journal)


class _JournalledClock(Clock):
    """A clock of which a journal keeps each reading, until it is closed."""

    def __init__(self, clock: Clock, journal: Journal):
        self.passes = clock.passes
        now_ns, keep = clock.now_ns, journal.reads.append
        self.sleep_until_ns = clock.sleep_until_ns  # type: ignore[method-assign]

        def read() -> int:
            value = now_ns()
            keep(value)
            return value

        def close() -> None:
            nonlocal keep
            keep = _forget  # some hold `read`
            self.now_ns = now_ns  # type: ignore[method-assign]

        self.now_ns = read  # type: ignore[method-assign]
        self.close = close


def _forget(_: int) -> None:
    pass


class _JournalledAgedRead:
    """A reader of which a journal keeps what it returns: the messages by `read`, and the ages."""

    def __init__(self, machine: str, name: str, read: Read, aged: AgedRead, journal: Journal):
        self.start_count = aged.start_count
        self._where = machine, name
        self._read = read
        self._aged = aged
        self._journal = journal

    def __call__(self) -> object:
        """Read and keep the message."""
        return self._read()

    def age_ns(self) -> int | None:
        """Return and keep the age."""
        age_ns = self._aged.age_ns()
        self._journal.add(("Aged", *self._where, age_ns))
        return age_ns


class _JournalledMachine:
    """A machine of another process, whose answers are kept in the journal."""

    def __init__(self, name: str, machine: Elsewhere, journal: Journal):
        self._name = name
        self._machine = machine
        self.journal = journal

    @property
    def state(self) -> str:
        """The name of its state."""
        return self._keep(self._machine.state)

    @property
    def suspended(self) -> bool:
        """True if it is in its suspend state."""
        return self._keep(self._machine.suspended)

    def request(self, action: Literal["suspend", "resume", "restart"]) -> Status:
        """Send it a request."""
        return self._keep(self._machine.request(action))

    def _keep(self, answer: A) -> A:
        self.journal.add(("Answered", self._name, answer))
        return answer
