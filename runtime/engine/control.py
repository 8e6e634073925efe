"""What may be asked of loaded machines: requests, which change them, and questions."""

from __future__ import annotations

from threading import get_ident
from typing import TYPE_CHECKING, Any

from llfsm.runtime.engine.clock import Clock
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.errors import OptionError
from llfsm.runtime.engine.events import Request, Standing, Status
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.seat import Arrival, Failure, Roster, Seat
from llfsm.runtime.engine.twin import running

if TYPE_CHECKING:
    from llfsm.runtime.engine.events import Instrument
    from llfsm.runtime.engine.seat import Running
    from llfsm.runtime.engine.statistics import MachineStatistics, Stopwatch
    from llfsm.whiteboard import Board, Message, Slot


class Control:
    """Requests and questions by name, from machines' own code and from outside alike.

    A request replaces an earlier one and takes effect at the machine's next turn. Every call that
    takes a name raises `UnknownMachineError` if there is no such machine; suspend, resume, restart
    and questions also reach machines that other processes run in the same environment.
    """

    realtime: int | None
    cpu: int | None
    instrument: Instrument | None
    stopwatch: Stopwatch | None
    """What times the turns, if anything does."""

    def __init__(self, environment: Environment):
        self.environment = environment
        self.roster = Roster()
        """Who is loaded: the seats by index and by name."""
        self._stopped: list[tuple[int, Seat]] = []  # asked to stop alone, and when
        self.rounds = 0
        self.stopping = False
        self._thread: int | None = None  # that of `run`
        self.in_real_time = False  # whether `run` has the rights for it, or had
        self.paused = ""
        """Why no machine has a turn, while a debugger has paused them."""

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
        """Suspend a machine; return its status before."""
        return self._ask(name, Request.SUSPEND)

    def resume(self, name: str) -> Status:
        """Resume a machine; return its status before, or ERROR if a restart is pending."""
        return self._ask(name, Request.RESUME)

    def restart(self, name: str) -> Status:
        """Restart a machine; return its status before."""
        return self._ask(name, Request.RESTART)

    def hold(self, name: str) -> None:
        """Suspend a machine from outside: until it is resumed the execution goes on."""
        self.environment.requested("hold", name)
        seat = self.roster.find(name)
        seat.held = True
        self._schedule(seat, Request.SUSPEND)

    def suspend_all(self, caller: Seat | None = None) -> None:
        """Have every machine suspended but the one in seat `caller`."""
        for seat in self.roster.named.values():
            if seat is not caller:
                self.environment.requested("suspend", seat.name)
                self._schedule(seat, Request.SUSPEND)

    def stop_machine(self, name: str) -> None:
        """Ask one machine to reach an accepting state; `run` unloads it after the grace period."""
        self.environment.requested("stop_machine", name)
        seat = self.roster.find(name)
        if not seat.stopping:
            seat.stopping = seat.machine.stopping = True
            self._stopped.append((self.clock.now_ns(), seat))
            self.environment.wake()

    @property
    def achieved(self) -> tuple[int | None, int | None]:
        """The priority of SCHED_FIFO that turns have in `run`, and their only core; None without.

        After the end, those that they had.
        """
        return (self.realtime, self.cpu) if self.in_real_time else (None, None)

    @property
    def asked_to_stop(self) -> bool:
        """Whether a machine was asked to stop alone, and is still there."""
        return bool(self._stopped)

    def post_safe(self, name: str) -> None:
        """Post what a machine posts when it is suspended, though it is not."""
        self.environment.requested("post_safe", name)
        self.roster.find(name).post_safe("at_suspend")

    def override(self, name: str, sensor: str, message: Message | None) -> None:
        """Let a machine read `message` instead of what is in the sensor's slot, until `release`.

        Its other sensors of this slot find it, too. None is as if there was no message. Raise
        `SensorNameError` or what a whiteboard raises for a message that is not of the slot's type.
        """
        slot = self.slot_of(name, sensor)
        self.environment.override(name, slot, message)
        if self.instrument is not None:
            self.instrument.end_lease(name, slot.name)
        self.read_again(slot.name)
        self.environment.wake()

    def release(self, name: str, sensor: str) -> None:
        """Let a machine read what is in the sensor's slot again."""
        slot = self.slot_of(name, sensor)
        self.environment.release(name, slot)
        self.read_again(slot.name)
        self.environment.wake()

    def read_again(self, slot: str) -> None:
        """Connect the sensors of a slot anew, of which an instrument wants to know."""
        for seat in self.roster:
            seat.read_again(slot)

    # Questions

    def stamp(self) -> tuple[int, int]:
        """Return the round and the time, with which every event begins."""
        return self.rounds, self.environment.clock.now_ns()

    @property
    def finished(self) -> bool:
        """Whether the execution is over: every machine left accepts or is suspended.

        One that was suspended from another process keeps it going until a stop is asked for.
        """
        for seat in self.roster.seats:
            if seat is not None and (not seat.settled or (seat.held and not self.stopping)):
                return False
        return True

    def status(self, name: str) -> Status:
        """Return whether a machine runs or is suspended."""
        return Status.SUSPENDED if self.is_suspended(name) else Status.RUNNING

    def is_suspended(self, name: str) -> bool:
        """Return whether a machine is in its suspend state."""
        seat = self.roster.named.get(name)
        if seat is None:
            return self.environment.elsewhere(name, self.roster.named).suspended
        return seat.suspended

    def is_running(self, name: str) -> bool:
        """Return whether a machine is not suspended."""
        return not self.is_suspended(name)

    def index_of(self, name: str) -> int:
        """Return the place of a machine in the order, from 0."""
        return self.roster.find(name).index

    def name_of(self, index: int) -> str:
        """Return the name of the machine at `index`."""
        return self.roster.at(index).name

    def state_name_of(self, name: str) -> str:
        """Return the name of a machine's current state."""
        seat = self.roster.named.get(name)
        if seat is None:
            return self.environment.elsewhere(name, self.roster.named).state
        return seat.current.name

    def states(self) -> dict[str, str]:
        """Return the name of each loaded machine's current state."""
        return {name: seat.current.name for name, seat in self.roster.named.items()}

    def slot_of(self, name: str, sensor: str) -> Slot[Any]:
        """Return the slot that a machine's sensor reads; raise `SensorNameError`."""
        seat = self.roster.find(name)
        return seat.slot_of(seat.sensor(sensor))

    def caller(self, name: str) -> str:
        """Return which machine has called this one; "" if none has, or that has left."""
        caller = self.roster.find(name).caller
        return caller.name if caller is not None and caller.taken else ""

    def overridden(self, name: str) -> tuple[str, ...]:
        """Return the names of a machine's sensors that are overridden."""
        slots = self.environment.overridden(name)
        if not slots:
            return ()
        seat = self.roster.find(name)
        sensors = type(seat.machine).table.sensors.items()
        return tuple(name for name, sensor in sensors if seat.slot_of(sensor).name in slots)

    @property
    def slots_read(self) -> set[str]:
        """The names of the slots that machines read, on the board."""
        return {
            seat.slot_of(sensor).name
            for seat in self.roster
            for sensor in type(seat.machine).table.sensors.values()
        }

    def standings(self) -> tuple[Standing | None, ...]:
        """Return where each machine stands, in order of index, with None for each hole."""
        return tuple(None if seat is None else seat.standing() for seat in self.roster.seats)

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
                self.paused,
                self.overridden(name),
                self.caller(name),
            )
            for name, seat in self.roster.named.items()
        }

    def standing(self, name: str) -> Standing:
        """Return where a machine stands."""
        return self.roster.find(name).standing()

    def arrival(self, name: str) -> Arrival:
        """Return how a machine has come into its state."""
        return self.roster.find(name).arrival()

    def failure(self, name: str) -> Failure | None:
        """Return what a machine's code has raised; None if it has not, or was resumed since."""
        return self.roster.find(name).failure

    @property
    def failed_machines(self) -> list[str]:
        """The names of the loaded machines that have a `failure`, in order."""
        return [seat.name for seat in self.roster if seat.failure is not None]

    def hang(self, name: str) -> str:
        """Return where code of a machine hangs, as a watchdog has found; "" if it does not."""
        return self.roster.find(name).hang

    def safe_values(self, name: str) -> list[tuple[Slot[Any], Message]]:
        """Return what is posted when code of a machine fails: slots of the board, and messages."""
        return self.roster.find(name).safe_values()

    def statistics(self) -> tuple[MachineStatistics, ...]:
        """Return what each machine did, also those that were unloaded, in order of first turns.

        Raise `OptionError` if turns are not timed.
        """
        if self.stopwatch is None:
            raise OptionError("turns are not timed: make the Arrangement with timed=True")
        priority, cpu = self.achieved
        return tuple(each._replace(realtime=priority, cpu=cpu) for each in self.stopwatch.read())

    def progress(self, name: str) -> tuple[int, int]:
        """Return the numbers of ringlets and of overruns of a loaded machine."""
        seat = self.roster.find(name)
        return (seat.ringlets, 0) if self.stopwatch is None else self.stopwatch.progress(name)

    def running(self) -> tuple[Seat, Running] | None:
        """Return in which seat the twin of the ringlet is running, and what; for other threads."""
        for seat in tuple(self.roster):
            now = running(seat)
            if now is not None:
                return seat, now
        return None

    def seat(self, name: str) -> Seat:
        """Return the seat of that machine, for who debugs it."""
        return self.roster.find(name)

    def machine(self, name: str) -> Machine:
        """Return the machine of that name."""
        return self.roster.find(name).machine

    def _repr_html_(self) -> str:
        """Return the machines with their states, as a notebook shows the arrangement."""
        from llfsm.whiteboard.message_text import html_table  # here, as few arrangements are in one

        rows = [
            (
                seat.name,
                seat.current.name,
                self.status(seat.name).name.lower(),
                seat.ringlets,
            )
            for seat in self.roster
        ]
        return html_table(("machine", "state", "status", "turns"), rows)

    @property
    def machines(self) -> tuple[Machine, ...]:
        """The loaded machines in order."""
        return tuple(seat.machine for seat in self.roster)

    @property
    def number_of_machines(self) -> int:
        """The number of indices in use, holes included."""
        return len(self.roster.seats)

    def _ask(self, name: str, request: Request) -> Status:
        self.environment.requested(request.value, name)
        seat = self.roster.named.get(name)
        if seat is None:
            return self.environment.elsewhere(name, self.roster.named).request(request.value)
        return self._schedule(seat, request)

    def _schedule(self, seat: Seat, request: Request) -> Status:
        """Schedule a request; one of another thread than that of the turns ends an idle sleep.

        One of a machine's code does not: it is for the next round, as what machines post.
        """
        status = seat.schedule(request)
        if self._thread not in (None, get_ident()):
            self.environment.wake()
        return status
