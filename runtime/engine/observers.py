"""Who watches an arrangement: observers, and the one that records all that it sees."""

from __future__ import annotations

from .errors import ObserverError
from .events import Event, Observer, Section

__all__ = ["Observers", "Trace"]


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
