"""Who is loaded, in which order and under which name, and the requests they make of each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict, TypeVar, Unpack

from .binding import bind
from .errors import LoadError, ObserverError, UnknownMachineError
from .events import Event, MachineStatus, Observer, Request, Status
from .machine import Machine
from .ringlet import ringlet
from .seat import Arrival, Seat
from .submachine import Submachine

if TYPE_CHECKING:
    from llfsm.whiteboard import Board

    from ..presence.remote import Directory, RemoteMachine
    from .clock import Clock

__all__ = ["Factory", "Library", "LoadOptions", "Loadable", "Roster"]

Factory: TypeAlias = Callable[[], Machine]
"""What makes a machine to load: a machine class is one."""
Library: TypeAlias = Mapping[str, Factory] | Callable[[str], Factory | None]
"""Where machines are found by name: a mapping, or a function that returns None for no machine."""
Loadable: TypeAlias = str | type[Machine] | Machine
M = TypeVar("M", bound=Machine)


class LoadOptions(TypedDict, total=False):
    """How a machine is loaded.

    It is called `name` (default: its class's name), or `name.0`, `name.1` … if that is taken.
    `variables` replaces defaults; `slots` gives the machine's slots other names on the board, as
    in `{"turtle1/pose": "bob/pose"}`. `path` tells which holes it may fill (default: its class's
    module and name).
    """

    name: str | None
    variables: Mapping[str, Any] | None
    slots: Mapping[str, str] | None
    path: str | None


class Roster:
    """The machines of an arrangement by index and by name.

    Unloading leaves a hole, so that no index shifts; a hole is filled again only by a machine of
    the same path. Every call that takes a name raises `UnknownMachineError` if there is no such
    machine; suspend, resume, restart and questions also reach machines that other processes run
    on the whiteboard. `caller` is the seat whose ringlet makes the call, None from outside.
    """

    def __init__(self, whiteboard: Board | None, clock: Clock, library: Library | None):
        self.whiteboard = whiteboard
        self.clock = clock
        self.rounds = 0
        self.stopping = False
        self._library = {} if library is None else library
        self._classes: dict[str, Factory] = {}  # of the machines loaded so far
        self._seats: list[Seat | None] = []
        self._named: dict[str, Seat] = {}
        self._holes: dict[int, str] = {}  # index -> path of the machine that left it
        self._leaving: list[Seat] = []  # to go at the end of their ringlet
        self._outer: list[Seat] = []  # those inside whose ringlet another one is nested
        self._observers: list[Observer] = []
        self._directory: Directory | None = None  # of machines that other processes run

    # Observers

    def attach(self, observer: Observer) -> None:
        """Have `observer` called with every event from now on; also while running."""
        self._observers.append(observer)
        self._bind_all()

    def detach(self, observer: Observer) -> None:
        """Tell `observer` nothing more; also while running, and if it was not attached."""
        if observer in self._observers:
            self._observers.remove(observer)
            self._bind_all()

    def emit(self, event: Event) -> None:
        """Tell the observers; raise `ObserverError` if one of them raises."""
        for observer in tuple(self._observers):
            try:
                observer(event)
            except Exception as error:
                raise ObserverError(
                    f"observer {observer!r} raised {type(error).__name__}: {error}"
                ) from error

    def stamp(self) -> tuple[int, int]:
        """Return the round and the time, with which every event begins."""
        return self.rounds, self.clock.now_ns()

    # Loading

    def load(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine and return its index.

        `machine` is a class, an instance, or the name of one in the library; see `LoadOptions`
        for the rest. Raise `LoadError` if it cannot be loaded as asked.
        """
        return self._seat_at(machine, **how).index

    def load_suspended(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine as `load` does, but in its suspend state, to be resumed."""
        seat = self._seat_at(machine, **how)
        seat.suspend()
        return seat.index

    def call_machine(self, machine: type[M] | M | str, **how: Unpack[LoadOptions]) -> Submachine[M]:
        """Load a machine as `load` does, to wait for its end and read its results."""
        return Submachine(self._seat_at(machine, **how))

    def unload(self, name: str, caller: Seat | None = None) -> bool:
        """Unload a machine and return True: at once, or at the end of its ringlet if in one."""
        seat = self._find(name)
        if seat is caller or seat in self._outer:
            self._leaving.append(seat)
        else:
            self._vacate(seat)
        return True

    # Requests: they replace an earlier one and take effect at the machine's next turn.

    def suspend(self, name: str) -> Status:
        """Have a machine suspended; return its status before."""
        return self._ask(name, Request.SUSPEND)

    def hold(self, name: str) -> None:
        """Have a machine suspended from outside: until it is resumed the execution goes on."""
        seat = self._find(name)
        seat.held = True
        self._request(seat, Request.SUSPEND)

    def resume(self, name: str) -> Status:
        """Have a machine resumed; return its status before, or ERROR if a restart is pending."""
        return self._ask(name, Request.RESUME)

    def restart(self, name: str) -> Status:
        """Have a machine restarted; return its status before."""
        return self._ask(name, Request.RESTART)

    def suspend_all(self, caller: Seat | None = None) -> None:
        """Have every machine suspended but the caller."""
        for seat in self._named.values():
            if seat is not caller:
                self._request(seat, Request.SUSPEND)

    def abandon(self, name: str, caller: Seat | None = None) -> bool:
        """Suspend a machine now, run its suspended ringlet inside this call and return True."""
        seat = self._find(name)
        first_round = seat.first_round
        if caller is not None:
            self._outer.append(caller)
        # A ringlet sees one snapshot from begin to end, also if another one of the same
        # machine is nested in it.
        snapshot = [(sensor, getattr(seat.machine, sensor)) for sensor, _ in seat.sensors]
        seat.request = None
        seat.nested += 1
        seat.suspend()
        try:
            self._nested_turn(seat)
        finally:
            if not first_round:  # those that rounds give it are still to come
                past = caller is None or caller.index > seat.index
                seat.first_round = self.rounds + past
            if seat in self._outer:
                for sensor, value in snapshot:
                    setattr(seat.machine, sensor, value)
            self._let_go()
            if caller is not None:
                self._outer.pop()
        return True

    # Questions

    def status(self, name: str) -> Status:
        """Tell whether a machine runs or is suspended."""
        return Status.SUSPENDED if self.is_suspended(name) else Status.RUNNING

    def is_suspended(self, name: str) -> bool:
        """Tell whether a machine is in its suspend state."""
        seat = self._named.get(name)
        return self._elsewhere(name).suspended if seat is None else seat.suspended

    def is_running(self, name: str) -> bool:
        """Tell whether a machine is not suspended."""
        return not self.is_suspended(name)

    def index_of(self, name: str) -> int:
        """Return the place of a machine in the order, from 0."""
        return self._find(name).index

    def name_of(self, index: int) -> str:
        """Return the name of the machine at `index`."""
        seat = self._seats[index] if 0 <= index < len(self._seats) else None
        if seat is None:
            raise UnknownMachineError(index, self._named)
        return seat.name

    def state_name_of(self, name: str) -> str:
        """Return the name of a machine's current state."""
        seat = self._named.get(name)
        return self._elsewhere(name).state if seat is None else seat.current.name

    def standings(self) -> tuple[MachineStatus | None, ...]:
        """Return where each machine stands, in order of index, with None for each hole."""
        return tuple(None if seat is None else seat.status() for seat in self._seats)

    def arrival(self, name: str) -> Arrival:
        """Tell how a machine has come into its state."""
        return self._find(name).arrival()

    def machine(self, name: str) -> Machine:
        """Return the machine of that name."""
        return self._find(name).machine

    @property
    def machines(self) -> tuple[Machine, ...]:
        """The loaded machines in order."""
        return tuple(seat.machine for seat in self._seats if seat is not None)

    @property
    def number_of_machines(self) -> int:
        """The number of indices in use, holes included."""
        return len(self._seats)

    # How it is done

    def _bind_all(self) -> None:
        for seat in self._named.values():
            bind(seat, observed=bool(self._observers))

    def _find(self, name: str) -> Seat:
        try:
            return self._named[name]
        except KeyError:
            raise UnknownMachineError(name, self._named) from None

    def _elsewhere(self, name: str) -> RemoteMachine:
        """Return the machine of that name that another process runs on this whiteboard."""
        if self.whiteboard is None:
            raise UnknownMachineError(name, self._named)
        if self._directory is None:
            from ..presence.remote import Directory  # here, because few ask

            self._directory = Directory(self.whiteboard)
        return self._directory.find(name, self._named)

    def _ask(self, name: str, request: Request) -> Status:
        seat = self._named.get(name)
        if seat is None:
            return self._elsewhere(name).request(request.value)
        return self._request(seat, request)

    def _request(self, seat: Seat, request: Request) -> Status:
        if request is Request.RESUME and seat.request is Request.RESTART:
            return Status.ERROR
        seat.request = request
        return Status.SUSPENDED if seat.suspended else Status.RUNNING

    def _make(self, machine: Loadable, variables: Mapping[str, Any] | None) -> Machine:
        made: object = self._look_up(machine) if isinstance(machine, str) else machine
        if isinstance(made, type) and issubclass(made, Machine):
            made, variables = made(**(variables or {})), None
        elif isinstance(machine, str) and callable(made):
            made = made()
        if not isinstance(made, Machine):
            raise LoadError(f"{machine!r} is no machine, machine class or name of one")
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
        factory = factory or self._classes.get(name)
        if factory is None:
            raise UnknownMachineError(name, sorted(known | set(self._classes)), "loadable")
        return factory

    def _seat_at(
        self,
        loadable: Loadable,
        *,
        name: str | None = None,
        variables: Mapping[str, Any] | None = None,
        slots: Mapping[str, str] | None = None,
        path: str | None = None,
    ) -> Seat:
        machine = self._make(loadable, variables)
        cls = type(machine)
        path = path or cls.table.path
        holes = (index for index, left in sorted(self._holes.items()) if left == path)
        index = next(holes, len(self._seats))
        name = self._free_name(name or cls.__name__)
        self._admit(name)
        seat = Seat(machine, self, index, name, path, slots or {})
        seat.connect(self.whiteboard)
        bind(seat, observed=bool(self._observers))
        machine._seat = seat
        self._classes[cls.__name__] = cls
        self._named[seat.name] = seat
        if self._holes.pop(index, None) is None:
            self._seats.append(seat)
        else:
            self._seats[index] = seat
        return seat

    def _admit(self, name: str) -> None:
        """Raise `LoadError` if there is no room for a machine of that name."""

    def _free_name(self, name: str) -> str:
        if name not in self._named:
            return name
        number = 0
        while f"{name}.{number}" in self._named:
            number += 1
        return f"{name}.{number}"

    def _nested_turn(self, seat: Seat) -> None:
        ringlet(seat)

    def _let_go(self) -> None:
        """Unload those that asked for it and whose ringlet is over."""
        for seat in [seat for seat in self._leaving if seat not in self._outer]:
            self._leaving.remove(seat)
            self._vacate(seat)

    def _vacate(self, seat: Seat) -> None:
        if self._seats[seat.index] is seat:
            self._seats[seat.index] = None
            self._holes[seat.index] = seat.path
            del self._named[seat.name]
            seat.finish()
