"""Who is loaded: the machines of an arrangement by index and by name."""

from __future__ import annotations

from collections.abc import Iterator

from .errors import UnknownMachineError
from .seat import Seat

__all__ = ["Roster"]


class Roster:
    """The seats of an arrangement in order, and by name.

    Unloading leaves a hole, so that no index shifts; a hole is filled again only by a machine of
    the same path.
    """

    def __init__(self) -> None:
        self.seats: list[Seat | None] = []
        """In order of index, with None for each hole. It grows and gets holes during a round."""
        self.named: dict[str, Seat] = {}
        self._holes: dict[int, str] = {}  # index -> path of the machine that left it

    def __iter__(self) -> Iterator[Seat]:
        """Return the seats that are taken, in order."""
        return (seat for seat in self.seats if seat is not None)

    def find(self, name: str) -> Seat:
        """Return a machine's seat; raise `UnknownMachineError` if there is none of that name."""
        try:
            return self.named[name]
        except KeyError:
            raise UnknownMachineError(name, self.named) from None

    def at(self, index: int) -> Seat:
        """Return the seat at `index`; raise `UnknownMachineError` if none is there."""
        seat = self.seats[index] if 0 <= index < len(self.seats) else None
        if seat is None:
            raise UnknownMachineError(index, self.named)
        return seat

    def free_index(self, path: str) -> int:
        """Return where the next machine of that path goes."""
        holes = (index for index, left in sorted(self._holes.items()) if left == path)
        return next(holes, len(self.seats))

    def free_name(self, name: str) -> str:
        """Return `name`, or `name.0`, `name.1` … if it is taken."""
        if name not in self.named:
            return name
        number = 0
        while f"{name}.{number}" in self.named:
            number += 1
        return f"{name}.{number}"

    def add(self, seat: Seat) -> None:
        """Put a seat at its index, which `free_index` has returned."""
        self.named[seat.name] = seat
        if self._holes.pop(seat.index, None) is None:
            self.seats.append(seat)
        else:
            self.seats[seat.index] = seat

    def remove(self, seat: Seat) -> bool:
        """Leave a hole in place of a seat; return False if it has gone before."""
        if self.seats[seat.index] is not seat:
            return False
        self.seats[seat.index] = None
        self._holes[seat.index] = seat.path
        del self.named[seat.name]
        return True
