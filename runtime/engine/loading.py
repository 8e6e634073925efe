"""What can be loaded, and how: machines from classes, instances and names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

from .errors import LoadError, UnknownMachineError
from .machine import Machine
from .roster import Roster
from .seat import Seat

if TYPE_CHECKING:
    from .arrangement import Arrangement

__all__ = ["Factory", "Library", "LoadOptions", "Loadable", "Loader"]

Factory: TypeAlias = Callable[[], Machine]
"""What makes a machine to load: a machine class is one."""
Library: TypeAlias = Mapping[str, Factory] | Callable[[str], Factory | None]
"""Where machines are found by name: a mapping, or a function that returns None for no machine."""
Loadable: TypeAlias = str | type[Machine] | Machine


class LoadOptions(TypedDict, total=False):
    """How a machine is loaded.

    It is called `name` (default: its class's name), or `name.0`, `name.1` … if that is taken.
    `variables` replaces defaults; `slots` gives the machine's slots other names on the board, as
    in `{"turtle1/pose": "bob/pose"}`. `path` decides which holes it may fill (default: its
    class's module and name).
    """

    name: str | None
    variables: Mapping[str, Any] | None
    slots: Mapping[str, str] | None
    path: str | None


class Loader:
    """Put machines into seats of `arrangement`; names are looked up in the `library`.

    A class that was loaded once can be loaded by its name, too.
    """

    def __init__(self, arrangement: Arrangement, roster: Roster, library: Library | None):
        self._arrangement = arrangement
        self._roster = roster
        self._library = {} if library is None else library
        self.classes: dict[str, type[Machine]] = {}
        """Of the machines loaded so far, by name."""
        self._reloaded: dict[str, type[Machine]] = {}  # the latest of each path

    def load(
        self,
        loadable: Loadable,
        *,
        name: str | None = None,
        variables: Mapping[str, Any] | None = None,
        slots: Mapping[str, str] | None = None,
        path: str | None = None,
    ) -> Seat:
        """Load a machine as described by `LoadOptions` and return its seat.

        Of a class that was reloaded, load the latest. Raise `LoadError` or `UnknownMachineError`.
        """
        machine = self._make(loadable, variables)
        cls, roster = type(machine), self._roster
        path = path or cls.table.path
        name = roster.free_name(name or cls.__name__)
        timetable = self._arrangement.timetable
        if timetable is not None and name not in timetable.machines:
            raise LoadError(
                f"{name} has no slot in the timetable; it has slots for: "
                f"{', '.join(timetable.machines)}; add a [[machine]] for it to the "
                f"arrangement file, with preload = true and a period_us"
            )
        index = roster.free_index(path)
        seat = Seat(machine, self._arrangement, index, name, path, slots or {}, variables or {})
        seat.connect(self._arrangement.environment)
        seat.claim(self._arrangement.environment)
        machine._seat = seat
        self.classes[cls.__name__] = cls
        self._arrangement.bind(seat)
        roster.add(seat)
        machine.stopping = self._arrangement.stopping  # last, as any thread may stop all
        self._arrangement.environment.loaded(name, path)
        return seat

    def reload(self, seat: Seat, cls: type[Machine]) -> None:
        """Give a seat to another definition of its machine; raise as `Arrangement.reload`."""
        arrangement, sensors = self._arrangement, type(seat.machine).table.sensors
        held = [seat.slot_of(sensors[each]) for each in arrangement.overridden(seat.name)]
        machine = cls(**seat.variables)
        seat.reload(machine)
        machine._seat = seat
        self.classes[cls.__name__] = self._reloaded[cls.table.path] = cls
        for slot in held:  # nobody knows whether the override still makes sense
            arrangement.environment.release(seat.name, slot)
            seat.read_again(slot.name)
        arrangement.bind(seat)
        machine.stopping = seat.stopping or arrangement.stopping

    def _make(self, machine: Loadable, variables: Mapping[str, Any] | None) -> Machine:
        made: object = self._look_up(machine) if isinstance(machine, str) else machine
        if isinstance(made, type) and issubclass(made, Machine):
            made = self._reloaded.get(made.table.path, made)
            made, variables = made(**(variables or {})), None
        elif isinstance(machine, str) and callable(made):
            made = made()
        if not isinstance(made, Machine):
            raise LoadError(f"{machine!r} is not a machine, a machine class or the name of one")
        if not hasattr(made, "_seat"):
            raise LoadError(f"{type(made).__qualname__}.__init__ must call super().__init__()")
        if variables:
            raise LoadError(f"{made.name} is made already: give its variables to the class")
        if made._seat.taken:
            raise LoadError(f"{made.name} is loaded already: make another instance")
        return made

    def _look_up(self, name: str) -> Factory:
        if isinstance(self._library, Mapping):
            factory, known = self._library.get(name), set(self._library)
        else:
            factory, known = self._library(name), set()
        factory = factory or self.classes.get(name)
        if factory is None:
            raise UnknownMachineError(name, sorted(known | set(self.classes)), "loadable")
        return factory
