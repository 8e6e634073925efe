"""What runs: the twins in C of the ringlet and the rotation or, without the extension, these."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .binding import Running
    from .seat import Seat

__all__ = ["Rotation", "SeatFields", "StateFields", "ringlet", "running"]

try:
    from ._ringlet import Rotation, SeatFields, StateFields, ringlet, running
except ImportError:
    from .ringlet import ringlet
    from .rotation import Rotation  # type: ignore[assignment]

    class SeatFields:  # type: ignore[no-redef]
        """The attributes of a seat that a ringlet uses; for its twin, a C structure."""

        __slots__ = (
            "current",
            "entered_ns",
            "machine",
            "notifies",
            "now",
            "previous",
            "request",
            "sensors",
            "source",
            "suspension",
        )

    class StateFields:  # type: ignore[no-redef]
        """The same of a loaded machine's state."""

        __slots__ = ("internal", "on_entry", "on_exit", "on_resume", "on_suspend", "transitions")

    def running(seat: Seat, /) -> Running | None:
        """Return None: of the definition, the ringlet's frame shows what runs."""
        return None
