"""What runs: the twins in C of what every turn does or, without the extension, the definitions."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .seat import Running, Seat

__all__ = [
    "Histogram",
    "MeterFields",
    "Rotation",
    "SeatFields",
    "StateFields",
    "Timing",
    "ringlet",
    "running",
]

try:
    from ._ringlet import (
        Histogram,
        MeterFields,
        Rotation,
        SeatFields,
        StateFields,
        Timing,
        ringlet,
        running,
    )
except ImportError:
    from .histogram import Histogram  # type: ignore[assignment]
    from .ringlet import ringlet
    from .rotation import Rotation  # type: ignore[assignment]
    from .timing import Timing  # type: ignore[assignment]

    class SeatFields:  # type: ignore[no-redef]
        """The attributes of a seat that a ringlet uses; for its twin, a C structure."""

        __slots__ = (
            "current",
            "entered_ns",
            "failure",
            "hang",
            "machine",
            "meter",
            "notifies",
            "now",
            "previous",
            "request",
            "sensors",
            "source",
            "suspension",
            "timed",
        )

    class StateFields:  # type: ignore[no-redef]
        """The same of a loaded machine's state."""

        __slots__ = (
            "internal",
            "on_entry",
            "on_exit",
            "on_resume",
            "on_suspend",
            "spent_ns",
            "transitions",
        )

    class MeterFields:  # type: ignore[no-redef]
        """The same of a meter, in which turns are counted."""

        __slots__ = (
            "costs",
            "fired",
            "jitters",
            "late_ns",
            "overruns",
            "since_ns",
            "worst_overrun_ns",
        )

    def running(seat: Seat, /) -> Running | None:
        """Return None: of the definition, the ringlet's frame shows what runs."""
        return None
