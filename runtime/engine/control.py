"""What may be asked of loaded machines: requests, which change them, and questions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .clock import Clock
from .environment import Environment
from .events import Request, Standing, Status
from .machine import Machine
from .roster import Roster
from .seat import Arrival, Failure, Seat
from .twin import running

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, Message, Slot

    from .binding import Running

__all__ = ["Control"]


class Control:
    """Requests and questions by name, from machines' own code and from outside alike.

    A request replaces an earlier one and takes effect at the machine's next turn. Every call that
    takes a name raises `UnknownMachineError` if there is no such machine; suspend, resume, restart
    and questions also reach machines that other processes run in the same environment.
    """

    def __init__(self, environment: Environment):
        self.environment = environment
        self._roster = Roster()
        self._stopped: list[tuple[int, Seat]] = []  # asked to stop alone, and when

    @property
    def whiteboard(self) -> Board | None:
        """Where sensors read and actuators post."""
        return self.environment.whiteboard

    @property
    def clock(self) -> Clock:
        """The only source of time."""
        return self.environment.clock

    # Requests

    def suspend(self, name: str) -> Status:
        """Have a machine suspended; return its status before."""
        return self._ask(name, Request.SUSPEND)

    def resume(self, name: str) -> Status:
        """Have a machine resumed; return its status before, or ERROR if a restart is pending."""
        return self._ask(name, Request.RESUME)

    def restart(self, name: str) -> Status:
        """Have a machine restarted; return its status before."""
        return self._ask(name, Request.RESTART)

    def hold(self, name: str) -> None:
        """Have a machine suspended from outside: until it is resumed the execution goes on."""
        self.environment.requested("hold", name)
        seat = self._roster.find(name)
        seat.held = True
        seat.schedule(Request.SUSPEND)

    def suspend_all(self, caller: Seat | None = None) -> None:
        """Have every machine suspended but the one in seat `caller`."""
        for seat in self._roster.named.values():
            if seat is not caller:
                self.environment.requested("suspend", seat.name)
                seat.schedule(Request.SUSPEND)

    def stop_machine(self, name: str) -> None:
        """Ask one machine to reach an accepting state; `run` unloads it after the grace period."""
        self.environment.requested("stop_machine", name)
        seat = self._roster.find(name)
        if not seat.stopping:
            seat.stopping = seat.machine.stopping = True
            self._stopped.append((self.clock.now_ns(), seat))

    # Questions

    def status(self, name: str) -> Status:
        """Return whether a machine runs or is suspended."""
        return Status.SUSPENDED if self.is_suspended(name) else Status.RUNNING

    def is_suspended(self, name: str) -> bool:
        """Return whether a machine is in its suspend state."""
        seat = self._roster.named.get(name)
        if seat is None:
            return self.environment.elsewhere(name, self._roster.named).suspended
        return seat.suspended

    def is_running(self, name: str) -> bool:
        """Return whether a machine is not suspended."""
        return not self.is_suspended(name)

    def index_of(self, name: str) -> int:
        """Return the place of a machine in the order, from 0."""
        return self._roster.find(name).index

    def name_of(self, index: int) -> str:
        """Return the name of the machine at `index`."""
        return self._roster.at(index).name

    def state_name_of(self, name: str) -> str:
        """Return the name of a machine's current state."""
        seat = self._roster.named.get(name)
        if seat is None:
            return self.environment.elsewhere(name, self._roster.named).state
        return seat.current.name

    def standings(self) -> tuple[Standing | None, ...]:
        """Return where each machine stands, in order of index, with None for each hole."""
        return tuple(None if seat is None else seat.standing() for seat in self._roster.seats)

    def marks(self) -> dict[str, tuple[object, ...]]:
        """Return by name what other processes learn of each machine; equal as long as it is."""
        return {
            name: (
                seat.current,
                seat.previous,
                seat.request,
                seat.entered_ns,
                seat.failure,
                seat.hang,
            )
            for name, seat in self._roster.named.items()
        }

    def standing(self, name: str) -> Standing:
        """Return where a machine stands."""
        return self._roster.find(name).standing()

    def arrival(self, name: str) -> Arrival:
        """Return how a machine has come into its state."""
        return self._roster.find(name).arrival()

    def failure(self, name: str) -> Failure | None:
        """Return what a machine's code has raised; None if it has not, or was resumed since."""
        return self._roster.find(name).failure

    @property
    def failed_machines(self) -> list[str]:
        """The names of the loaded machines that have a `failure`, in order."""
        return [seat.name for seat in self._roster if seat.failure is not None]

    def hang(self, name: str) -> str:
        """Return where code of a machine hangs, as a watchdog has found; "" if it does not."""
        return self._roster.find(name).hang

    def safe_values(self, name: str) -> list[tuple[Slot[Any], Message]]:
        """Return what is posted when code of a machine fails: slots of the board, and messages."""
        return self._roster.find(name).safe_values()

    def running(self) -> tuple[Seat, Running] | None:
        """Return in which seat the twin of the ringlet is running, and what; for other threads."""
        for seat in tuple(self._roster):
            now = running(seat)
            if now is not None:
                return seat, now
        return None

    def machine(self, name: str) -> Machine:
        """Return the machine of that name."""
        return self._roster.find(name).machine

    @property
    def machines(self) -> tuple[Machine, ...]:
        """The loaded machines in order."""
        return tuple(seat.machine for seat in self._roster)

    @property
    def number_of_machines(self) -> int:
        """The number of indices in use, holes included."""
        return len(self._roster.seats)

    def _ask(self, name: str, request: Request) -> Status:
        self.environment.requested(request.value, name)
        seat = self._roster.named.get(name)
        if seat is None:
            return self.environment.elsewhere(name, self._roster.named).request(request.value)
        return seat.schedule(request)
