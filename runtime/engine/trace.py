"""A record of all that happened, to compare and to replay."""

from __future__ import annotations

from .events import Event, Section

__all__ = ["Trace"]


class Trace(list[Event]):
    """Record every event: an observer that is the list of what it saw."""

    def __call__(self, event: Event) -> None:
        """Append `event`."""
        self.append(event)

    def sections(self) -> list[tuple[int, str, str, str]]:
        """Return the order alone: (round, machine, section, state) of each section run."""
        return [(e.round, e.machine, e.section, e.state) for e in self if isinstance(e, Section)]
