"""The seats of an arrangement, by index and by name."""

from __future__ import annotations

from collections.abc import Iterator, Set
from typing import Generic, Protocol, TypeVar

from llfsm.runtime.engine.errors import UnknownMachineError
from llfsm.runtime.engine.events import Standing
from llfsm.runtime.engine.ringlet import BoundState
from llfsm.runtime.engine.table import numbered_names


class Seated(Protocol):
    """A seat, as the roster knows it."""

    index: int
    name: str
    path: str
    current: BoundState

    @property
    def failure(self) -> object | None:
        """The failure of its machine's code; None if there is none."""

    @property
    def slots_read(self) -> Set[str]:
        """The names of the slots that its machine reads, on the board."""

    def standing(self) -> Standing:
        """Return the machine's standing."""


S = TypeVar("S", bound=Seated)


class Roster(Generic[S]):
    """The seats of an arrangement in order, and by name.

    Unloading leaves a hole, so that no index shifts; a hole is filled again only by a machine of
    the same path.
    """

    def __init__(self) -> None:
        self.seats: list[S | None] = []
        """In order of index, with None for each hole. It grows and gets holes during a round."""
        self.named: dict[str, S] = {}
        self._holes: dict[int, str] = {}  # index -> path of the machine that left it

    def __iter__(self) -> Iterator[S]:
        """Return the seats that are taken, in order."""
        return (seat for seat in self.seats if seat is not None)

    def standings(self) -> tuple[Standing | None, ...]:
        """Return the machines' standings, in order of index, with None for each hole."""
        return tuple(None if seat is None else seat.standing() for seat in self.seats)

    def states(self) -> dict[str, str]:
        """Return the name of each machine's current state, by machine."""
        return {name: seat.current.name for name, seat in self.named.items()}

    @property
    def failed(self) -> list[str]:
        """The names of the machines whose code has raised, and that were not resumed since."""
        return [seat.name for seat in self if seat.failure is not None]

    @property
    def slots_read(self) -> set[str]:
        """The names of the slots that machines read, on the board."""
        return {slot for seat in self for slot in seat.slots_read}

    def find(self, name: str) -> S:
        """Return a machine's seat; raise `UnknownMachineError` if there is none of that name."""
        try:
            return self.named[name]
        except KeyError:
            raise UnknownMachineError(name, self.named) from None

    def at(self, index: int) -> S:
        """Return the seat at `index`; raise `UnknownMachineError` if none is there."""
        seat = self.seats[index] if 0 <= index < len(self.seats) else None
        if seat is None:
            raise UnknownMachineError(index, self.named)
        return seat

    def free_index(self, path: str) -> int:
        """Return the index for the next machine of that path."""
        holes = (index for index, left in sorted(self._holes.items()) if left == path)
        return next(holes, len(self.seats))

    def free_name(self, name: str) -> str:
        """Return the first of the names for machines called `name` that is not taken."""
        return next(free for free in numbered_names(name) if free not in self.named)

    def add(self, seat: S) -> None:
        """Put a seat at its index, which `free_index` has returned."""
        self.named[seat.name] = seat
        if self._holes.pop(seat.index, None) is None:
            self.seats.append(seat)
        else:
            self.seats[seat.index] = seat
            self.named = {each.name: each for each in self}

    def remove(self, seat: S) -> bool:
        """Leave a hole in place of a seat; return False if it has gone before."""
        if self.seats[seat.index] is not seat:
            return False
        self.seats[seat.index] = None
        self._holes[seat.index] = seat.path
        del self.named[seat.name]
        return True
