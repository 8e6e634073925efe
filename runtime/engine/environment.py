"""The environment of an arrangement: the one door through which machines learn and act.

The clock, reading a sensor, posting by an actuator, machines of other processes, requests from
outside and the news that ends an idle sleep: all of it passes here and nowhere else. The ringlet,
the seat and the schedule know only this interface, so the code that is recorded, rerun and tested
is the code that runs.

`Environment` is a world without a whiteboard and the base of all others; `BoardEnvironment` reads
and posts on one. An environment that records, reruns or scripts replaces or wraps these.

*News* ends an idle sleep: a message in a slot that one of the machines reads, added since their
last round began. What they post themselves does not count: else a machine that posts at every turn
what another one reads would never let the arrangement sleep. So each machine posts by a handle of
its own, and what that has added is taken as seen.

*Time.* Machines whose turns have a time live in the schedule's: what they see in a turn is when it
was due, so the time in a state is a whole number of periods in every run, as it is in a proof. All
else is by the clock: what is late, deadlines, leases, stamps and how long a stop may take.

*Ages.* The host's monotonic clock is that of the messages' stamps. With any other clock, a message
of a board in this process is as old as the time since it was added, exactly; one that another
process has added is as old as the time since the sensor first found it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

from llfsm.errors import LlfsmError
from llfsm.runtime.engine.clock import Clock, ManualClock, MonotonicClock
from llfsm.runtime.engine.errors import LoadError, UnknownMachineError

if TYPE_CHECKING:
    from llfsm.runtime.engine.events import Status
    from llfsm.runtime.engine.ports import Actuator, Sensor
    from llfsm.whiteboard import Board, BoundSlot, Sample, Slot


class News:
    """Sleep until there is news; `clock` is that of the host, or a simulated one.

    A simulated clock ends the sleep each time it is set, and how long that takes nobody knows.
    """

    def __init__(self, board: Board, clock: Clock):
        self._waiter = board.waiter()
        self._clock = clock
        clock.listen(self._waiter.wake)
        self._readers: dict[str, dict[str, BoundSlot[Any]]] = {}  # by machine, by name of the slot
        self._publishers: dict[str, list[tuple[str, BoundSlot[Any]]]] = {}
        self._heeded: set[BoundSlot[Any]] = set()
        self._seen: dict[BoundSlot[Any], int] = {}  # all of these slots, and what is no news there
        self._own: list[tuple[BoundSlot[Any], BoundSlot[Any]]] = []  # reader and publisher of one
        self._left: dict[str, int] = {}  # by slot, the last message of those that were retired
        self._is_current = True  # whether the last two are those of the machines
        self._woken = False

    def reads(self, machine: str, slot: str, reader: BoundSlot[Any]) -> None:
        """Note that a machine reads a slot."""
        self._readers.setdefault(machine, {})[slot] = reader
        self._seen.setdefault(reader, reader.count)
        self._is_current = False

    def posts(self, machine: str, slot: str, publisher: BoundSlot[Any]) -> None:
        """Note that a machine posts to a slot, by a handle of its own."""
        self._publishers.setdefault(machine, []).append((slot, publisher))
        self._is_current = False

    def last_post(self, slot: str) -> int:
        """Return the count of the last message that a machine has posted to a slot; 0 if none."""
        publishers = chain.from_iterable(self._publishers.values())
        counts = (publisher.added for name, publisher in publishers if name == slot)
        return max((self._left.get(slot, 0), *counts))

    def heed(self, slot: BoundSlot[Any]) -> None:
        """Return early for a message in that slot, too, which is no news by itself."""
        self._heeded.add(slot)
        self._seen.setdefault(slot, slot.count)

    def retire(self, machine: str) -> None:
        """Forget what a machine reads, and retire its handles."""
        self._readers.pop(machine, None)
        for slot, publisher in self._publishers.pop(machine, ()):
            self._left[slot] = max(self._left.get(slot, 0), publisher.added)
            publisher.retire()
        self._is_current = False

    def sleep_until_ns(self, deadline_ns: int, *, heeds_own: bool = False) -> bool:
        """Sleep until then or until there is news or a `wake`, and return whether there was.

        The end of the board is news, but ends no sleep. What machines have posted since the last
        sleep is none, unless `heeds_own`.
        """
        if not self._is_current:
            self._update()
        seen = self._seen
        for reader, publisher in self._own if not heeds_own else ():
            seen[reader] = max(seen[reader], publisher.added)
        left_s = max(deadline_ns - self._clock.now_ns(), 0) / 1e9
        if self._clock.nap_s is not None and left_s:
            left_s = self._clock.nap_s
        try:
            newer = self._waiter.wait(seen, left_s)
        except LlfsmError as error:
            from llfsm.whiteboard.errors import BoardClosedError  # here, as it costs much to import

            if not isinstance(error, BoardClosedError):
                raise
            self._clock.sleep_until_ns(deadline_ns)
            return True  # the arrangement stops, when it looks
        woken, self._woken = self._woken, False
        return woken or not self._heeded.issuperset(newer)

    def doze(
        self, duration_ns: int, until_ns: int, otherwise: Callable[[int], bool]
    ) -> Callable[[], bool]:
        """Make the function that sleeps again and again, as `Environment.doze` says."""
        if not self._is_current:
            self._update()
        own = tuple(self._own)
        return self._waiter.doze(self._seen, own, duration_ns, until_ns, otherwise)

    def wake(self) -> None:
        """End the sleep, or the next one; from any thread, and from a signal's handler."""
        self._woken = True
        self._waiter.wake()

    def _update(self) -> None:
        """Find the slots again after machines have come or gone."""
        self._is_current = True
        readers = {(name, slot) for each in self._readers.values() for name, slot in each.items()}
        slots = {*self._heeded, *(slot for _, slot in readers)}
        self._seen = {slot: count for slot, count in self._seen.items() if slot in slots}
        by_name: dict[str, list[BoundSlot[Any]]] = {}
        for name, reader in readers:
            by_name.setdefault(name, []).append(reader)
        self._own = [
            (reader, publisher)
            for publishers in self._publishers.values()
            for name, publisher in publishers
            for reader in by_name.get(name, ())
        ]


Read: TypeAlias = Callable[[], object]
"""Return a sensor's latest message, None before the first: the ringlet puts in the default."""
Post: TypeAlias = Callable[[Any], int]
"""Post a message and return the slot's count after it."""


class Elsewhere(Protocol):
    """A machine that another process runs."""

    @property
    def state(self) -> str:
        """The name of its state."""

    @property
    def suspended(self) -> bool:
        """True if it is in its suspend state."""

    def request(self, action: Literal["suspend", "resume", "restart"]) -> Status:
        """Send it a request for its next turn and return its status before."""


class Attendant(Protocol):
    """Attend to a run between its rounds: obey requests, publish statuses."""

    @property
    def reachable(self) -> bool:
        """True if another process can resume a machine that has failed."""

    @property
    def due_ns(self) -> int:
        """When there is something to publish again, if nothing happens before."""

    def obey(self) -> bool:
        """Obey the requests that have come, and return whether any may have."""

    def look(self, *, idle: bool) -> None:
        """Obey requests and publish what has changed, if there is time (`idle`) or it is due."""

    def beat(self) -> None:
        """Obey requests and publish all statuses, though time may stand still."""

    def publish_hang(self, name: str) -> None:
        """Publish that code of a machine hangs; called by another thread."""

    def end(self) -> None:
        """Publish that the machines are gone."""


class AgedRead(Protocol):
    """Read a sensor, and know the age of the message that was read."""

    start_count: int
    """The slot's count when the machine was loaded."""

    def __call__(self) -> object:
        """Return the latest message; None if there is none or it is too old."""

    def age_ns(self) -> int | None:
        """Return the age of the message that was read last, in nanoseconds; None without one."""


class OverriddenSlot:
    """A slot as a machine reads it for which it is overridden: its message is new at each look.

    `message` is None if there is to be none; `count` is the slot's own, from which it counts on.
    """

    def __init__(self, message: Any, count: int):
        self._message = message
        self.count = count

    def get(self) -> Any:
        """Return the message."""
        return self._message

    def sample(self) -> Sample[Any] | None:
        """Return the message with the stamp of this moment."""
        from llfsm.whiteboard import Sample  # here, as few override

        if self._message is None:
            return None
        self.count += 1
        return Sample(self._message, self.count, MonotonicClock().now_ns(), 0)

    def on_add(self, callback: Callable[[int], None]) -> None:
        """Call nothing: no message is added here."""


class BoardAgedRead:
    """Read a sensor from a slot of a board.

    `start_count` is the slot's count when the machine was loaded; by default that is now.
    """

    def __init__(
        self,
        sensor: Sensor[Any, Any],
        slot: str,
        bound: BoundSlot[Any] | OverriddenSlot,
        environment: BoardEnvironment,
        start_count: int | None = None,
    ):
        self._slot = slot
        self.start_count = bound.count if start_count is None else start_count
        self._bound = bound
        self._first = self.start_count if sensor.since_start else 0
        limit_ms = math.inf if sensor.max_age_ms is None else sensor.max_age_ms
        self._limit_ns = limit_ms * 1e6
        clock = environment.clock.of_messages()
        self._now = clock.now_ns
        self._environment = environment
        self._stamped = clock.stamps
        self._added: tuple[int, int] | None = None  # count of the latest message, and when it came
        self._read: tuple[int, int] | None = None  # likewise, of the message that was read last
        if not self._stamped:
            self._note(bound.count)
            bound.on_add(self._note)

    def __call__(self) -> object:
        """Return the latest message; None if there is none or it is too old."""
        sample = self._bound.sample()
        if sample is None:
            return None
        if self._stamped:
            self._read = sample.count, sample.stamp_ns
        else:
            if self._added is None or self._added[0] != sample.count:  # from another process
                self._note(sample.count)
            self._read = self._added
            assert self._read is not None
        if sample.count <= self._first or self._age_of(*self._read) > self._limit_ns:
            return None
        return sample.message

    def age_ns(self) -> int | None:
        """Return the age of the message that was read last, in nanoseconds; None without one."""
        return None if self._read is None else self._age_of(*self._read)

    def _age_of(self, count: int, added_ns: int) -> int:
        """Return the age in this turn; 0 if it was added after the turn was due."""
        environment = self._environment
        if environment.due_ns is None:
            return self._now() - added_ns
        due_ns = environment.due_of_post(self._slot, count)
        if due_ns is not None:
            return environment.due_ns - due_ns
        return max(environment.due_ns + (environment.clock.behind_ns or 0) - added_ns, 0)

    def _note(self, count: int) -> None:
        self._added = count, self._now()


class Environment:
    """A world without a whiteboard, and the interface of every other environment."""

    whiteboard: Board | None = None
    defers_stops: bool = False
    """True if it lets a stop come only where no code of a machine runs: see `may_stop`."""
    due_ns: int | None = None
    """When the turn under way was due, or the last one; None if turns have no time of their own."""
    _woken = False

    def __init__(self, clock: Clock | None = None):
        self.clock: Clock = clock or MonotonicClock()

    @property
    def alive(self) -> bool:
        """True while this world exists; once it does not, the arrangement stops."""
        return True

    # Subclasses say `Arrangement`; here it is Any, as that is built on environments.

    @property
    def machine_now(self) -> Callable[[], int]:
        """The function by which machines read the time: when their turn was due, or the clock."""
        return self.clock.now_ns if self.due_ns is None else self._when_due

    def _when_due(self) -> int:
        assert self.due_ns is not None
        return self.due_ns

    def seen_at(self, time_ns: int) -> int:
        """Convert `time_ns` of the clock to the time that machines read in the turn under way."""
        return time_ns if self.due_ns is None else self.due_ns

    def is_due(self, due_ns: int) -> None:
        """Let machines see this time from now on: their turns were due then."""
        self.due_ns = due_ns

    def enter(self, arrangement: Any) -> None:
        """Note the arrangement whose environment this is, before it loads machines."""

    def attend(self, arrangement: Any) -> Attendant | None:
        """Make what attends to a run of the arrangement between its rounds, if anything does."""
        return None

    def sleep_until_ns(self, deadline_ns: int) -> bool:
        """Sleep until `deadline_ns`, or until there is something new for the machines.

        Return whether there is, which only ends a sleep on a clock that passes by itself; the end
        of this world counts, too. What is new for the attendant alone, and a simulated clock, may
        end a sleep early without: look at the clock, and sleep again.
        """
        woken, self._woken = self._woken, False
        if woken and self.clock.passes:
            return True
        self.clock.sleep_until_ns(deadline_ns)
        return False

    def doze(
        self, duration_ns: int, until_ns: int, otherwise: Callable[[int], bool]
    ) -> Callable[[], bool]:
        """Make a function to call again and again, to sleep for `duration_ns` if nothing happens.

        It returns True if that was so. If not, it returns what `otherwise` does, which sleeps by
        `sleep_until_ns`: that ends at once if there is news. It gets the time at which the sleep
        was to end, 0 if none has begun; from `until_ns` on none does. What it reads must be the
        same meanwhile.
        """
        return partial(otherwise, 0)

    @property
    def may_wait(self) -> bool:
        """True if `wait_until_ns` may sleep for long: all that is new for the machines ends it."""
        return type(self.clock) is ManualClock

    def wait_until_ns(self, deadline_ns: int) -> bool:
        """Sleep as `sleep_until_ns` does, after a round in which no machine has posted anything.

        So what one posts now, as from a thread of its own, is new for the others.
        """
        return self.sleep_until_ns(deadline_ns)

    def wake(self) -> None:
        """Let the sleep end, or the next one; from any thread, and from a signal's handler."""
        self._woken = True

    def peek_ns(self) -> int:
        """Return the machines' time for whom watches: no journal keeps that."""
        return self.machine_now()

    def paused(self) -> AbstractContextManager[None]:
        """Let requests come, and a `DebugClock` stand still: a turn has begun, and waits."""
        return self.clock.stopped()

    # What machines learn and do

    def read(self, machine: str, name: str, sensor: Sensor[Any, Any], slot: Slot[Any]) -> Read:
        """Return the function that reads the sensor `name` of a machine from `slot`."""
        raise _no_whiteboard(machine, sensor.slot)

    def read_aged(
        self,
        machine: str,
        name: str,
        sensor: Sensor[Any, Any],
        slot: Slot[Any],
        start_count: int | None = None,
    ) -> AgedRead:
        """Make the reader of a sensor that knows the ages of messages; it reads as `read` does.

        `start_count` is as for `BoardAgedRead`.
        """
        raise _no_whiteboard(machine, sensor.slot)

    def post(self, machine: str, name: str, actuator: Actuator[Any], slot: Slot[Any]) -> Post:
        """Return the function by which the actuator `name` of a machine posts to `slot`."""
        raise _no_whiteboard(machine, actuator.slot)

    def claim(self, machine: str, slots: Mapping[Slot[Any], bool]) -> None:
        """Note the slots to which a machine posts, and whether each exclusively.

        They are its own until it is `unloaded`. Raise `LoadError`.
        """

    def elsewhere(self, name: str, known: Iterable[str]) -> Elsewhere:
        """Return the machine of that name that another process runs.

        `known` are the names of the arrangement's own machines. Raise `UnknownMachineError`.
        """
        raise UnknownMachineError(name, known)

    def override(self, machine: str, slot: Slot[Any], message: Any) -> None:
        """Let a machine read `message` from `slot`, None as if there was none, until `release`.

        It is always as if it had just been added. Sensors are to be connected again. Raise
        `WhiteboardError` for a message that is not of the slot's type.
        """
        raise _no_whiteboard(machine, slot)

    def release(self, machine: str, slot: Slot[Any]) -> None:
        """Let a machine read what is in `slot` again, once its sensors are connected again."""

    def overridden(self, machine: str) -> Container[str]:
        """Return the names of the slots that are overridden for a machine."""
        return ()

    # Requests from outside. The arrangement reports each before it takes effect, also those that
    # its machines' own code makes.

    def requested(self, action: str, machine: str) -> None:
        """Note a request for a machine; `action` is the name of the arrangement's method.

        Raise `LoadError` for one that cannot be carried out in this environment.
        """

    def loaded(self, machine: str, path: str) -> None:
        """Note that a machine was loaded."""

    def restored(self, kept: bytes, ahead_ns: int, now_ns: int) -> None:
        """Note that the machines go on where a file has kept them: see `llfsm.runtime.keeping`."""

    def retire(self, machine: str) -> None:
        """Retire what a machine reads and posts by, and its claims: it is to be connected anew."""

    def unloaded(self, machine: str) -> None:
        """Let nothing be posted for a machine any more: it has left its arrangement."""

    def may_stop(self, cause: str) -> bool:
        """Return True if a stop takes effect now; else the environment calls `stop` later.

        A simulated clock passes with the host's time from then on: no pause keeps a stop waiting.
        """
        self.clock.run_on()
        return True


class BoardEnvironment(Environment):
    """Sensors read from a whiteboard and actuators post to it."""

    whiteboard: Board

    def __init__(self, whiteboard: Board, clock: Clock | None = None):
        super().__init__(clock)
        self.whiteboard = whiteboard

        self.news = News(whiteboard, self.clock)
        self._overrides: dict[str, dict[str, Any]] = {}  # by machine, by name of the slot
        self._dated: dict[str, tuple[int, int]] = {}  # slots of whose messages the age is asked
        # With each, the last message that a machine has posted, and when its turn was due.

    @property
    def alive(self) -> bool:
        """True while the whiteboard is neither closed nor removed."""
        return self.whiteboard.alive

    def sleep_until_ns(self, deadline_ns: int) -> bool:
        """Sleep until `deadline_ns`, or until a machine has a new message to read."""
        if self.clock.passes or self.clock.nap_s is not None:
            return self.news.sleep_until_ns(deadline_ns)
        return super().sleep_until_ns(deadline_ns)

    @property
    def may_wait(self) -> bool:
        """True by the host's clock, which the board's waiter knows, and by a `ManualClock`."""
        return type(self.clock) is MonotonicClock or super().may_wait

    def wait_until_ns(self, deadline_ns: int) -> bool:
        """Sleep until `deadline_ns`, or until there is a message that no machine has read."""
        if self.clock.passes:
            return self.news.sleep_until_ns(deadline_ns, heeds_own=True)
        return super().wait_until_ns(deadline_ns)

    def doze(
        self, duration_ns: int, until_ns: int, otherwise: Callable[[int], bool]
    ) -> Callable[[], bool]:
        """Let the board sleep, where its clock is that of the machines."""
        is_hosts = self.clock.sleep_until_ns is MonotonicClock.sleep_until_ns
        if is_hosts and self.alive:
            return self.news.doze(duration_ns, until_ns, otherwise)
        return super().doze(duration_ns, until_ns, otherwise)

    def wake(self) -> None:
        """Let the sleep end, or the next one."""
        self.news.wake()

    def read(self, machine: str, name: str, sensor: Sensor[Any, Any], slot: Slot[Any]) -> Read:
        """Return the slot's own `get`."""
        return self._reader(machine, slot).get

    def read_aged(
        self,
        machine: str,
        name: str,
        sensor: Sensor[Any, Any],
        slot: Slot[Any],
        start_count: int | None = None,
    ) -> AgedRead:
        """Make the reader that compares the messages' stamps with the clock."""
        self._dated.setdefault(slot.name, (0, 0))
        return BoardAgedRead(sensor, slot.name, self._reader(machine, slot), self, start_count)

    def is_due(self, due_ns: int) -> None:
        """Note which messages the machines have posted since the turn that was due before."""
        if self._dated and self.due_ns is not None:
            self._date(self.due_ns)
        super().is_due(due_ns)

    def due_of_post(self, slot: str, count: int) -> int | None:
        """Return when the turn was due in which a machine posted a message; None if none did.

        So under a schedule, the age of what machines post to each other is that of their turns.
        """
        assert self.due_ns is not None
        self._date(self.due_ns)
        last, due_ns = self._dated[slot]
        return due_ns if count == last else None

    def _date(self, due_ns: int) -> None:
        for slot, (last, _) in self._dated.items():
            if (count := self.news.last_post(slot)) > last:
                self._dated[slot] = count, due_ns

    def post(self, machine: str, name: str, actuator: Actuator[Any], slot: Slot[Any]) -> Post:
        """Return the `add` of a handle that is the machine's own.

        What it needs is reserved now: a machine that runs must not find the whiteboard full when it
        stops the robot.
        """
        publisher = self.whiteboard.publisher(slot)
        publisher.reserve()
        self.news.posts(machine, slot.name, publisher)
        return publisher.add

    def override(self, machine: str, slot: Slot[Any], message: Any) -> None:
        """Let a machine read `message`, of which the whiteboard knows nothing."""
        if message is not None:
            from llfsm.whiteboard.local import LocalBoard  # here, as few override

            LocalBoard().add_message(slot, message)  # which checks it
        self._overrides.setdefault(machine, {})[slot.name] = message

    def release(self, machine: str, slot: Slot[Any]) -> None:
        """Let a machine read what is on the whiteboard again."""
        self._overrides.get(machine, {}).pop(slot.name, None)

    def overridden(self, machine: str) -> Container[str]:
        """Return the names of the slots that are overridden for a machine."""
        return self._overrides.get(machine, {})

    def retire(self, machine: str) -> None:
        """Retire the machine's handles, which a thread of it may still hold."""
        self.news.retire(machine)

    def unloaded(self, machine: str) -> None:
        """Retire the machine's handles, and forget what is overridden for it."""
        self.retire(machine)
        self._overrides.pop(machine, None)

    def _reader(self, machine: str, slot: Slot[Any]) -> BoundSlot[Any] | OverriddenSlot:
        reader = self.whiteboard[slot]
        self.news.reads(machine, slot.name, reader)
        overrides = self._overrides.get(machine, {})
        if slot.name not in overrides:
            return reader
        return OverriddenSlot(overrides[slot.name], reader.count)


def _no_whiteboard(machine: str, slot: Slot[Any]) -> LoadError:
    return LoadError(f"{machine} uses slot {slot.name!r}: give the Arrangement a whiteboard")
