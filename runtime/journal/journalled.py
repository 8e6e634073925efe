"""An arrangement that keeps a journal of what its machines learn and do.

Machines learn from their sensors, the clock, machines of other processes and what is asked of
them from outside: each of these is tapped where the arrangement gets hold of it, so that turns
are given, and cost, as ever, but for the journal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, TypeVar, Unpack

from ..engine.arrangement import Arrangement
from ..engine.clock import Clock, MonotonicClock
from ..engine.errors import UnknownMachineError
from ..engine.events import Observer, Status
from ..engine.roster import Loadable, LoadOptions
from ..presence.remote import RemoteMachine
from .entries import Journal

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot
    from llfsm.whiteboard.messages.llfsm import Action

    from ..engine.ports import Sensor
    from ..engine.seat import Read, Seat

__all__ = ["JournalledArrangement"]

A = TypeVar("A")


class JournalledArrangement(Arrangement):
    """An arrangement that keeps a `journal`; all else is as for `Arrangement`.

    A stop that is asked for while code of a machine runs is seen by the machines from the next
    round on, or after the next sleep, so that all code of a ringlet sees the same.
    """

    def __init__(
        self,
        machines: Iterable[Loadable] = (),
        *,
        journal: Journal,
        clock: Clock | None = None,
        **options: Any,
    ):
        self.journal = journal
        self._deferred: str | None = None  # why a stop was asked for
        self._taps = True
        self._told = _Clock(clock or MonotonicClock(), journal)
        super().__init__(machines, clock=self._told, **options)
        journal.between = self._stop_deferred
        self.attach(journal)

    def detach(self, observer: Observer) -> None:
        """Tell `observer` nothing more; if that is the journal, none is kept from now on."""
        if observer is self.journal:
            self.journal.close()
            self._told.close()
            self._taps = False
            for seat in self._named.values():
                seat.connect(self.whiteboard)
                seat.now = self.clock.now_ns if seat.first_round else seat.now
        super().detach(observer)

    def stop(self, cause: str = "stop() was called") -> None:
        """Ask the machines to reach accepting states; may be called from any thread."""
        if not self.journal.outside:
            self._deferred = cause
        elif not self.stopping:
            self.journal.add(("Asked", "stop", None))
            super().stop(cause)

    def stop_machine(self, name: str) -> None:
        """Ask one machine to reach an accepting state."""
        self._asked("stop_machine", name)
        super().stop_machine(name)

    def hold(self, name: str) -> None:
        """Have a machine suspended from outside."""
        self._asked("hold", name)
        super().hold(name)

    def suspend(self, name: str) -> Status:
        """Have a machine suspended; return its status before."""
        self._asked("suspend", name)
        return super().suspend(name)

    def resume(self, name: str) -> Status:
        """Have a machine resumed; return its status before, or ERROR if a restart is pending."""
        self._asked("resume", name)
        return super().resume(name)

    def restart(self, name: str) -> Status:
        """Have a machine restarted; return its status before."""
        self._asked("restart", name)
        return super().restart(name)

    def _stop_deferred(self) -> None:
        if self._deferred is not None:
            self.stop(self._deferred)
            self._deferred = None

    def _asked(self, action: str, name: str) -> None:
        if self.journal.outside:  # else the code of a machine asks, and will again
            self.journal.add(("Asked", action, name))

    def _seat_at(self, loadable: Loadable, **how: Unpack[LoadOptions]) -> Seat:
        seat = super()._seat_at(loadable, **how)
        if self.journal.outside:
            self.journal.add(("Loaded", seat.name, seat.path))
        if self._taps:
            self._tap(seat)
        return seat

    def _tap(self, seat: Seat) -> None:
        """Have the journal told of all that the machine reads and posts."""
        table = type(seat.machine).table
        seat.sensors = tuple(
            (name, self._sensing(seat, name, table.sensors[name], read))
            for name, read in seat.sensors
        )
        for name, actuator in table.actuators.items():
            post = self._posting(seat, name, actuator.slot, getattr(seat.machine, name))
            setattr(seat.machine, name, post)

    def _sensing(self, seat: Seat, name: str, sensor: Sensor[Any, Any], read: Read) -> Read:
        add, encode, default = self.journal.add, sensor.slot.encoder.encode, sensor.default
        machine, slot = seat.name, seat.renamed.get(sensor.slot.name, sensor.slot.name)
        latest: object = default

        def sense() -> object:
            nonlocal latest
            try:
                message = read()
            except Exception as error:
                add(("Sensed", machine, name, slot, None, str(error)))
                raise
            if message is not latest:
                latest = message
                data = None if message is default else encode(message)
                add(("Sensed", machine, name, slot, data, None))
            return message

        return sense

    def _posting(
        self, seat: Seat, name: str, slot: Slot[Any], add: Callable[[Any], int]
    ) -> Callable[[Any], int]:
        journal, encode, machine = self.journal, slot.encoder.encode, seat.name
        called = seat.renamed.get(slot.name, slot.name)

        def post(message: Any) -> int:
            count = add(message)
            journal.add(("Posted", machine, name, called, encode(message), count))
            return count

        return post

    def _vacate(self, seat: Seat) -> None:
        self._asked("unload", seat.name)
        super()._vacate(seat)

    def _elsewhere(self, name: str) -> RemoteMachine:
        try:
            machine = super()._elsewhere(name)
            return _Elsewhere(machine, self.journal) if self._taps else machine
        except UnknownMachineError:
            self.journal.add(("Answered", name, None))
            raise


class _Clock:
    """A clock whose journal knows all that it told."""

    def __init__(self, clock: Clock, journal: Journal):
        now_ns, told = clock.now_ns, journal.reads.append
        self.sleep_until_ns = clock.sleep_until_ns

        def read() -> int:
            value = now_ns()
            told(value)
            return value

        def close() -> None:
            nonlocal told
            told, self.now_ns = _forget, now_ns  # some keep `read`

        self.now_ns = read
        self.close = close


def _forget(_: int) -> None:
    pass


class _Elsewhere(RemoteMachine):
    """A machine of another process, whose answers stand in the journal."""

    def __init__(self, machine: RemoteMachine, journal: Journal):
        self.name = machine.name
        self._machine = machine
        self._journal = journal

    @property
    def state(self) -> str:
        """The name of its state."""
        return self._answered(self._machine.state)

    @property
    def suspended(self) -> bool:
        """Whether it is in its suspend state."""
        return self._answered(self._machine.suspended)

    def request(self, action: Action) -> Status:
        """Ask it for something."""
        return self._answered(self._machine.request(action))

    def _answered(self, answer: A) -> A:
        self._journal.add(("Answered", self.name, answer))
        return answer
