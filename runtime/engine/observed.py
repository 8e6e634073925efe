"""The tables of an arrangement's machines, bound anew when who watches them comes or goes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from .binding import bind
from .ringlet import observed_ringlet
from .twin import ringlet

if TYPE_CHECKING:
    from .environment import Environment
    from .events import Observer
    from .observers import Instrument, Observers
    from .roster import Roster
    from .seat import Seat

__all__ = ["Observed"]


class Observed:
    """Machines that observers and an instrument may watch, in an environment that may change."""

    unobserved = staticmethod(ringlet)
    """A turn that nobody observes: the ringlet, or its twin."""
    environment: Environment
    observers: Observers
    instrument: Instrument | None
    roster: Roster

    def move(self, environment: Environment) -> None:
        """Connect all machines with another environment, between two rounds."""
        self.environment = environment
        for seat in self.roster:
            seat.connect(environment)
        self._bind_all()

    def attach(self, observer: Observer) -> None:
        """Call `observer` with every event from now on; also while running."""
        self.observers.append(observer)
        self._bind_all()

    def detach(self, observer: Observer) -> None:
        """Call `observer` no more; also while running, and if it was not attached."""
        if observer in self.observers:
            self.observers.remove(observer)
            self._bind_all()

    def equip(self, instrument: Instrument) -> None:
        """Have `instrument` wrap what it wants of each machine's table, from now on."""
        self.instrument = instrument
        self._bind_all()

    def bind(self, seat: Seat) -> None:
        """Bind the table of a machine, for the observers that there are."""
        bind(seat, observed=bool(self.observers))
        if self.instrument is not None:
            self.instrument.bound(seat)

    def _bind_all(self) -> None:
        for seat in self.roster:
            self.bind(seat)
        self._turn: Callable[[Seat], bool] = observed_ringlet if self.observers else self.unobserved
