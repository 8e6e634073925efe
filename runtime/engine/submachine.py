"""A machine that another one has called: its status and its results."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

if TYPE_CHECKING:
    from .machine import Machine
    from .seat import Seat

    M_co = TypeVar("M_co", bound=Machine, covariant=True)
else:
    M_co = TypeVar("M_co", covariant=True)

__all__ = ["Submachine"]


class Submachine(Generic[M_co]):
    """A called machine. It takes its turns like all others; its caller polls its status.

    Nothing waits: guard a transition with `done`. It stays loaded if its caller is unloaded.
    """

    def __init__(self, seat: Seat, caller: Seat | None):
        self._seat = seat
        seat.called, seat.caller = True, caller

    def __repr__(self) -> str:
        how = "done" if self.done else "failed" if self.failed else f"in {self.machine.state_name}"
        return f"<Submachine {self.name}: {how}>"

    @property
    def name(self) -> str:
        """The name under which it was loaded."""
        return self._seat.name

    @property
    def machine(self) -> M_co:
        """The machine: its variables are the results, once it is done."""
        machine: Any = self._seat.machine
        return cast("M_co", machine)

    @property
    def done(self) -> bool:
        """Whether it has accepted."""
        return self._seat.accepted

    @property
    def failed(self) -> bool:
        """Whether its code has raised, or it was unloaded without having accepted."""
        seat = self._seat
        return seat.failure is not None or not (seat.taken or seat.accepted)

    def cancel(self) -> None:
        """Unload it if it is still loaded."""
        if self._seat.taken:
            self._seat.arrangement.unload(self._seat.name)
