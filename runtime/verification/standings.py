"""Where machines stand, what a ringlet is given and what it does: as small tuples."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Self

from ..engine.clock import NEVER
from ..engine.events import Request

if TYPE_CHECKING:
    from ..engine.seat import Seat

__all__ = ["ControlState", "Given", "RingletOutcome", "UnknownStandingError"]


class UnknownStandingError(Exception):
    """A ringlet asked for the standing of machines that was not given."""

    def __init__(self, touched: set[int]):
        self.touched = touched


class ControlState(NamedTuple):
    """Where a machine stands, apart from its variables and the time."""

    current: str
    previous: str | None
    remembered: str
    request: Request | None
    accepted: bool
    loaded: bool
    begun: bool
    """Whether it has had a turn."""

    @classmethod
    def of(cls, seat: Seat) -> Self:
        """Return where the machine in a seat stands."""
        return cls(
            seat.current.name,
            None if seat.previous is None else seat.previous.name,
            seat.remembered.name,
            seat.request,
            seat.accepted,
            seat.taken,
            seat.entered_ns != NEVER,
        )

    def withdrawn_by(self, request: Request | None) -> bool:
        """Return whether a restart is pending that `request` replaces only after a suspend."""
        return request is Request.RESUME and self.request is Request.RESTART

    @property
    def entered(self) -> bool:
        """Whether it has had a turn in its state, so that the state's clock runs."""
        return self.current == self.previous and self.loaded


class Given(NamedTuple):
    """All that a ringlet can depend on: a machine's place, and the rest by its numbers.

    `contents` are the slots that it reads, `others` the machines whose control states it asks for
    or changes. `request` comes from outside before the turn, and `stopping` is whether a stop has.
    """

    place: int
    control: int
    variables: int
    elapsed_ns: int
    contents: tuple[tuple[str, int], ...]
    others: tuple[tuple[int, int], ...]
    request: Request | None
    stopping: bool


class RingletOutcome(NamedTuple):
    """What a ringlet did, by numbers.

    It does the same for all times in the state above `low_ns`, up to `high_ns`, if the machines of
    `asked` stand like that.
    """

    low_ns: float
    high_ns: float
    asked: tuple[tuple[int, int], ...]
    control: int
    variables: int
    restarted: bool
    """Whether its state's clock was started, or will be in its next turn."""
    posts: tuple[tuple[str, int], ...]
    others: tuple[tuple[int, int], ...]
    """The machines whose standing it changed, and the new one."""
    limits: tuple[tuple[str, int], ...]
    """The times that it compared with the time in a state, with that state, in order."""
    fired: tuple[str, int] | None
    """The state and the number of the transition that fired."""
    error: int
    """The number of what its code has raised; 0 if it has not."""
