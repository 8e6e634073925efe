"""Who watches an arrangement: observers, and the one that records all that it sees."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from .errors import ObserverError
from .events import Event, Observer, Section

if TYPE_CHECKING:
    from .environment import Read
    from .errors import ExecutionError
    from .seat import Seat

__all__ = ["Instrument", "Observers", "Trace"]


class Instrument(Protocol):
    """What a debugger adds to an arrangement, where observing every event would cost too much."""

    def bound(self, seat: Seat) -> None:
        """Wrap what is of interest of a machine's table, which has just been bound."""
        ...

    def reading(self, seat: Seat, slot: str, read: Read) -> Read:
        """Return what reads a sensor of `slot`, in place of `read`."""
        ...

    def look(self) -> None:
        """Do what is due; called several times a second where requests come from outside."""
        ...

    def end_lease(self, machine: str, slot: str) -> None:
        """End the lease of what was overridden before: it does not end the override after it."""
        ...

    def left_s(self, machine: str, sensor: str) -> float | None:
        """Return how long a sensor stays overridden; None if only a release ends that."""
        ...

    def pause_left_s(self) -> float | None:
        """Return the seconds until a pause ends, unless renewed; None if only a request does."""
        ...

    def failed(self, seat: Seat, error: ExecutionError) -> None:
        """Note that code of a machine has raised; what comes of that waits for the return."""
        ...


class Observers(list[Observer]):
    """The observers of an arrangement, in the order in which they are called."""

    def emit(self, event: Event) -> None:
        """Call each with an event; raise `ObserverError` if one of them raises."""
        for observer in tuple(self):
            try:
                observer(event)
            except Exception as error:
                raise ObserverError(
                    f"observer {observer!r} raised {type(error).__name__}: {error}"
                ) from error


class Trace(list[Event]):
    """Record every event: an observer that is the list of what it saw."""

    def __call__(self, event: Event) -> None:
        """Append `event`."""
        self.append(event)

    def sections(self) -> list[tuple[int, str, str, str]]:
        """Return the order alone: (round, machine, section, state) of each section run."""
        return [(e.round, e.machine, e.section, e.state) for e in self if isinstance(e, Section)]
