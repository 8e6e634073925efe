"""Machines that code loads, in an exploration: each has a place of its own, as inner ones have.

In a run a machine is made when it is loaded. Its index, and so its turn, is the first one that was
never used, or one that a machine of its path has left. Here each has a place from the start, but is
not there; to load it gives it the variables of one that is made then. Its name and index depend on
what was loaded before, so all machines are noted when one is loaded. If there is no place yet, the
exploration begins again with one (`UnknownLoadingError`).

An index here counts outermost machines only: inner ones have indices, too, but none of these loads
or finds any by them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import FunctionType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self, cast

from llfsm.runtime.engine.errors import UnknownMachineError
from llfsm.runtime.engine.kernel import Loader
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.seat import Seat
from llfsm.runtime.expressions.reads import LOADING, names_in
from llfsm.runtime.verification.domains import Member
from llfsm.runtime.verification.errors import UnsupportedError
from llfsm.runtime.verification.inner import InnerLoader, Made, blank

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import Control, Loadable
    from llfsm.runtime.verification.environment import ExploredEnvironment

_MOST: Final = 30
"""Machines that code may load; who loads as many loads more and more."""


@dataclass(frozen=True, order=True)
class Loading:
    """A machine that code loads: its index among the outermost ones, and how it is loaded."""

    index: int
    name: str
    cls: type[Machine]
    path: str
    slots: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, index: int, seat: Seat) -> Self:
        """Describe how a machine was loaded."""
        slots = tuple(sorted(seat.renamed.items()))
        return cls(index, seat.name, type(seat.machine), seat.path, slots)

    @classmethod
    def of_member(cls, member: Member) -> Self:
        """Describe a machine that may be loaded so, at any index."""
        made = member.machine
        kind = cast("type[Machine]", made) if isinstance(made, type) else type(made())
        slots = tuple(sorted(member.slots.items()))
        return cls(0, member.name or kind.__name__, kind, kind.table.path, slots)

    def member(self) -> Member:
        """Return it as one may load it."""
        name = None if self.name == self.cls.__name__ else self.name
        return Member(self.cls, name, slots=dict(self.slots))

    def seat(self, control: Control) -> Seat:
        """Make its seat, as one that was never loaded."""
        seat = Seat(blank(self.cls), control, self.name, self.path, dict(self.slots), {})
        seat.left = True
        return seat


class Found(NamedTuple):
    """The machines that need a place, as runs make them: what states run, and what code loads."""

    inner: Made
    loaded: list[Loading]


class UnknownLoadingError(UnsupportedError):
    """Code loads a machine for which there is no place."""

    def __init__(self, loading: Loading):
        super().__init__(f"{loading.cls.__qualname__} is loaded, for which there is no place")
        self.loading = loading


class ExploredLoader(InnerLoader):
    """Load machines at first, and then into the places that there are for them.

    `found` has those that are not there at the start; the last `watchers` of the members are
    monitors, which come after them.
    """

    def __init__(
        self, control: Control, environment: ExploredEnvironment, found: Found, watchers: int
    ):
        super().__init__(control, environment, found.inner)
        self._by_name = dict(control.loader.classes)  # as code may load them
        seats: list[Seat] = [*control.roster]
        self.members = len(seats) - watchers
        """The number of machines that are there at the start, but inner ones and monitors."""
        there = {Loading.of(n, seat): seat for n, seat in enumerate(seats[: self.members])}
        self._loaded = {each: self._place_of(each) for each in sorted(found.loaded)}
        every = (there | self._loaded).items()
        self._seats = dict(sorted(every, key=lambda item: item[0].index))
        self.outermost = [*self._seats.values(), *seats[self.members :]]
        """The seats of all machines but inner ones, in the order of their turns."""

    def _place_of(self, loading: Loading) -> Seat:
        return Loader.put(self, loading.seat(self._control))

    def with_inner(self, seats: Iterable[Seat]) -> tuple[Seat, ...]:
        """List seats with inner ones; those of what is not there at the start are free."""
        found = super().with_inner(seats)
        for seat in self._loaded.values():
            self._control.roster.remove(seat)
            seat.taken = False
        self.is_open |= any(_may_load(type(seat.machine)) for seat in found)
        return found

    def load(
        self,
        loadable: Loadable,
        *,
        name: str | None = None,
        variables: Mapping[str, Any] | None = None,
        slots: Mapping[str, str] | None = None,
        path: str | None = None,
    ) -> Seat:
        """Load a machine at the start; later, let one be there that has a place."""
        if not self.ports:
            return super().load(loadable, name=name, variables=variables, slots=slots, path=path)
        roster = self._control.roster
        machine = self._make_fresh(loadable, variables)
        cls = type(machine)
        path = path or cls.table.path
        name = roster.free_name(name or cls.__name__)
        if self._control.kernel.timetable is not None:
            self._control.kernel.timetable.check_has(name)
        given = tuple(sorted((slots or {}).items()))
        seat = self._seat_of(Loading(self._free_index(path), name, cls, path, given))
        self._begin_anew(seat)
        vars(seat.machine).update(vars(machine))
        return self.put(seat)

    def _make_fresh(self, loadable: Loadable, variables: Mapping[str, Any] | None) -> Machine:
        if isinstance(loadable, Machine):
            self._environment.refuse(
                f"loads a {type(loadable).__name__} as a machine that is made already: this "
                f"cannot be explored; load its class, with name and variables"
            )
        if isinstance(loadable, str):
            if loadable not in self._by_name:
                self._environment.refuse(
                    f"loads {loadable!r}, which is the name of none of the machines at the start: "
                    f"this cannot be explored; load its class"
                )
            loadable = self._by_name[loadable]
        return self._make(loadable, variables)

    def _seat_of(self, loading: Loading) -> Seat:
        if loading in self._seats:
            return self._seats[loading]
        if any(each.name == loading.name for each in self._seats):
            self._environment.refuse(
                f"loads {loading.name}, and what is called so has another index, class, path or "
                f"slots at other times: this cannot be explored; give each a name of its own"
            )
        if len(self._loaded) >= _MOST:
            self._environment.refuse(
                f"loads more and more machines, such as {loading.name}: this cannot be explored"
            )
        self._environment.refusal = UnknownLoadingError(loading)
        raise self._environment.refusal

    def _free_index(self, path: str) -> int:
        """Find the index for a machine of a path, as `Roster.free_index` does."""
        taken = {each.index for each, seat in self._seats.items() if seat.taken}
        holes = {index for index, left in self._used.items() if left == path} - taken
        return min(holes, default=len(self._used))

    @property
    def _used(self) -> dict[int, str]:
        """The path of each index that was ever used."""
        return {each.index: each.path for each, seat in self._seats.items() if not seat.left}

    @property
    def used(self) -> int:
        """The number of indices that were ever used."""
        return len(self._used)

    def index_of(self, seat: Seat) -> int:
        """Return the index of an outermost machine that is no monitor."""
        return next(each.index for each, other in self._seats.items() if other is seat)

    def at(self, index: int) -> Seat:
        """Return the seat at an index; raise `UnknownMachineError` if none is there."""
        for each, seat in self._seats.items():
            if seat.taken and each.index == index:
                return seat
        raise UnknownMachineError(index, self._control.roster.named)


def absent_seats(
    control: Control, loaded: Iterable[Loading], there: Iterable[str]
) -> Iterator[Seat]:
    """Make a seat for each machine that code may load and whose name is not `there`."""
    names = {*there}
    return (each.seat(control) for each in loaded if each.name not in names)


def _may_load(cls: type[Machine]) -> bool:
    """Check for a class whose functions, or those that they name, name what loads machines."""
    states, bases = cls.table.states, cls.__mro__[: cls.__mro__.index(Machine)]
    todo: list[Any] = [each for state in states for each in state.sections.values()]
    todo += [way.guard for state in states for way in state.transitions]
    todo += [each for base in bases for each in vars(base).values()]
    followed: set[FunctionType] = set()
    while todo:
        code = todo.pop()
        if isinstance(code, FunctionType) and code not in followed:
            followed.add(code)
            names = names_in(code.__code__)
            if not names.isdisjoint(LOADING):
                return True
            todo += [code.__globals__.get(name) for name in names]
    return False
