"""The kernel of an arrangement: who is loaded, who has turns, and what may be asked of machines.

* The `Kernel` is a rotation of seats in an environment: it gives rounds, and decides what becomes
  of a machine that accepts, fails or leaves. What observers and an instrument watch is bound anew
  when they come or go; with neither, turns run unwrapped.
* `Control` is what code of machines asks, by name: requests, questions and loading. A request
  takes effect at the machine's next turn, so a machine's own code changes nothing under way.
* The `Loader` finds classes and gives them seats.

Seats and machines know their kernel and control, which know them: these three modules import each
other. All else of the engine is below them, or builds on them as `Arrangement` does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from threading import get_ident
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, TypeVar, Unpack

from llfsm.runtime.engine.binding import bind
from llfsm.runtime.engine.environment import Attendant, Environment
from llfsm.runtime.engine.errors import (
    ArrangementEndedError,
    ExecutionError,
    LoadError,
    UnknownMachineError,
)
from llfsm.runtime.engine.events import (
    Accepting,
    End,
    Failed,
    Observer,
    Observers,
    Reason,
    Request,
    RoundBegin,
    RoundEnd,
    Status,
)
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.realtime import Critical
from llfsm.runtime.engine.ringlet import Rotation, defined_ringlet, ringlet
from llfsm.runtime.engine.roster import Roster
from llfsm.runtime.engine.schedule import Pacer, Timetable
from llfsm.runtime.engine.seat import Failure, Instrument, Seat, observed_ringlet
from llfsm.runtime.engine.statistics import Stopwatch
from llfsm.runtime.engine.submachine import Submachine
from llfsm.runtime.engine.table import with_inner
from llfsm.runtime.log import logger

if TYPE_CHECKING:
    from llfsm.runtime.engine.state import State
    from llfsm.whiteboard import Message, Slot

M = TypeVar("M", bound=Machine)

Factory: TypeAlias = Callable[[], Machine]
"""What makes a machine to load: a machine class is one."""
Library: TypeAlias = Mapping[str, Factory] | Callable[[str], Factory | None]
"""Where machines are found by name: a mapping, or a function that returns None for no machine."""
Loadable: TypeAlias = str | type[Machine] | Machine
OnError: TypeAlias = Literal["stop", "suspend"]  # all, or the machine whose code raised


class LoadOptions(TypedDict, total=False):
    """Options of loading a machine.

    It is called `name` (default: its class's name), or `name.0`, `name.1` … if that is taken.
    `variables` replaces defaults; `slots` gives the machine's slots other names on the board, as
    in `{"turtle1/pose": "bob/pose"}`. `path` decides which holes it may fill (default: its
    class's module and name).
    """

    name: str | None
    variables: Mapping[str, Any] | None
    slots: Mapping[str, str] | None
    path: str | None


BOARD_GONE = "the whiteboard was closed or removed"
"""The cause of a stop where the board of the machines is not there any more."""


class Loader:
    """Put machines into seats; names are looked up in the `library`.

    A class that was loaded once can be loaded by its name, too.
    """

    def __init__(self, control: Control, library: Library | None):
        self._control = control
        self._kernel = control.kernel
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
        path = path or type(machine).table.path
        name = self._kernel.roster.free_name(name or type(machine).__name__)
        if self._kernel.timetable is not None:
            self._kernel.timetable.check_has(name)
        return self.put(Seat(machine, self._control, name, path, slots or {}, variables or {}))

    def seat_within(self, outer: Seat, state: State, number: int, made: Any) -> Seat:
        """Make the seat of what a state of the machine in `outer` runs.

        It is to have its turns behind it, and is called as in "Outer/Inner". Where slots have
        other names for the outer machine, they have for the inner one.
        """
        machine = self._make(made, None)
        name = f"{outer.name}/{outer.table.inner_name(state, number, type(machine).__name__)}"
        path = f"{outer.path}/{type(machine).table.path}"
        seat = Seat(machine, self._control, name, path, outer.renamed, {})
        seat.inner = seat.called = outer.kernel.nests = True
        seat.caller, seat.stopping = outer, outer.stopping
        return seat

    def put(self, seat: Seat) -> Seat:
        """Give a seat its place and name, connect it, and return it."""
        kernel, roster, cls = self._kernel, self._kernel.roster, type(seat.machine)
        seat.take(roster.free_index(seat.path), roster.free_name(seat.name))
        self.classes[cls.__name__] = cls
        kernel.bind(seat)
        roster.add(seat)
        seat.machine.stopping = seat.stopping or kernel.stop_is_seen  # last: any thread may stop
        kernel.environment.loaded(seat.name, seat.path)
        return seat

    def reload(self, seat: Seat, cls: type[Machine]) -> None:
        """Give a seat to another definition of its machine; raise as `Control.reload`."""
        seat.reload(machine := cls(**seat.variables))
        self.classes[cls.__name__] = cls
        self._reloaded |= with_inner(cls)
        self._kernel.bind(seat)
        machine.stopping = seat.stopping or self._kernel.stop_is_seen

    def _make(self, machine: Any, variables: Mapping[str, Any] | None) -> Machine:
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


class Kernel(Rotation[Seat]):
    """The seats of an arrangement, which get turns in their environment until it ends.

    `cycle_us` is the period of rounds, and `timetable` gives each machine turns of its own in
    them; with either, or `timed`, turns are timed.
    """

    unobserved = staticmethod(ringlet)
    """A turn that nobody observes: the ringlet, or its twin."""

    def __init__(
        self,
        environment: Environment,
        *,
        period_us: int | None = None,
        timetable: Timetable | None = None,
        timed: bool = False,
        unload_accepting: bool = True,
        on_error: OnError = "stop",
    ):
        self.environment = environment
        self.roster: Roster[Seat] = Roster()
        self.timetable = timetable
        self.unload_accepting = unload_accepting
        self.on_error = on_error
        self.rounds, self.nests = 0, False
        self.stopping = False
        """True once the machines were asked to reach accepting states."""
        self.stop_is_seen = False
        """True once they see that, which is after round `stop_round`."""
        self.stop_round = 0
        self.thread: int | None = None
        """The thread of `run`."""
        self._gives_turns = False
        self.stop_cause: str | None = None
        self.reason: Reason | None = None
        """The reason for the end; None before it."""
        self.paused = ""
        """The reason why no machine has a turn, while a debugger has paused them; else ""."""
        self.runs = False
        """True once `run` was called: then the world is watched, and exits are contained."""
        self.attendant: Attendant | None = None
        """The attendant of the run, if the environment has one."""
        self.achieved: tuple[int | None, int | None] = (None, None)
        """The priority of SCHED_FIFO that turns have, or had, in `run`, and their only core."""
        self.instrument: Instrument | None = None  # changed by `equip`
        self.observers = Observers()  # changed by `attach` and `detach`
        self.emit = self.observers.emit
        self.critical = Critical()  # while safe values are posted
        self._leaving = []
        self._outer: list[Seat] = []  # those inside whose ringlet another one is nested
        self._turn, self._gate = self.unobserved, None
        self.stopwatch: Stopwatch | None = None
        self.pacer: Pacer | None = None
        """The pacer, if rounds have a time; None if they begin when they are asked for."""
        cycle_us = period_us if timetable is None else timetable.cycle_us
        if timed or cycle_us:
            self.stopwatch = watch = Stopwatch(environment.clock)
            self._gate = watch.begin
            if cycle_us:
                slots = () if timetable is None else timetable.slots
                self.pacer = Pacer(cycle_us, environment, watch, self._sleep_to_turn, slots)
                self._gate = self.pacer.wait_for_round

    def stamp(self) -> tuple[int, int]:
        """Return the round and the time, with which every event begins."""
        return self.rounds, self.environment.clock.now_ns()

    @property
    def contains_exits(self) -> bool:
        """True if code that exits is an error of its machine alone: no signal can be the cause."""
        return self.on_error == "suspend" and self.runs and not self.stopping

    @property
    def finished(self) -> bool:
        """True if the execution is over: every machine left accepts or is suspended.

        One that was suspended from another process keeps it going until a stop is asked for.
        """
        for seat in self.roster.seats:
            if seat is not None and (not seat.settled or (seat.held and not self.stop_is_seen)):
                return False
        return True

    # Who watches

    def move(self, environment: Environment) -> None:
        """Connect all machines with another environment, between two rounds."""
        self.environment = environment
        for seat in self.roster:
            seat.connect(environment)
        self.bind_all()

    def attach(self, observer: Observer) -> None:
        """Call `observer` with every event from now on; also while running."""
        self.observers.append(observer)
        self.bind_all()
        if self.thread not in (None, get_ident()):
            self.environment.wake()  # it is to see each round

    def detach(self, observer: Observer) -> None:
        """Call `observer` no more; also while running, and if it was not attached."""
        if observer in self.observers:
            self.observers.remove(observer)
            self.bind_all()

    def equip(self, instrument: Instrument) -> None:
        """Have `instrument` wrap what it wants of each machine's table, from now on."""
        self.instrument = instrument
        self.bind_all()

    def bind(self, seat: Seat) -> None:
        """Bind the table of a machine, for the observers that there are."""
        bind(seat, observed=bool(self.observers))
        if self.instrument is not None:
            self.instrument.bound(seat)

    def bind_all(self) -> None:
        """Bind the tables of all machines, and choose the ringlet."""
        for seat in self.roster:
            self.bind(seat)
        self._turn = observed_ringlet if self.observers else self.unobserved

    def read_again(self, slot: str) -> None:
        """Connect the sensors of a slot anew, of which an instrument wants to know."""
        for seat in self.roster:
            seat.read_again(slot)

    # Turns

    def round(self) -> bool:
        """Give every machine one turn, in order; return True if a transition fired.

        With a period or a timetable, wait until they are due.
        """
        if self._gate is None and not self.observers:
            self._begin_turns()
            fired = self.give_round(self.roster.seats)  # which grow and get holes on the way
        else:
            if self._gate is not None and not self._gate():
                return False
            self._begin_turns()
            self.rounds += 1
            if self.observers:
                self.emit(RoundBegin(*self.stamp()))
            seats: Iterable[Seat | None] = self.roster.seats
            if self.timetable is not None and self.pacer is not None:
                seats = self.pacer.turns(self.roster.named)
            fired = self.give_turns(seats)
        self._gives_turns = False
        if self.observers:
            self.emit(RoundEnd(*self.stamp(), fired, self.finished, self.roster.standings()))
        return fired

    def rest(self, sleep: Callable[[], bool]) -> bool:
        """Do as `give_rounds`; with observers or a timetable, give only one round."""
        if self.observers or self.timetable is not None:
            return self.round()
        self._begin_turns()
        fired = self.give_rounds(self.roster.seats, sleep)
        self._gives_turns = False
        return fired

    def _begin_turns(self) -> None:
        self.show_stop()
        self._gives_turns = True

    def abandon(self, seat: Seat, caller: Seat | None) -> None:
        """Suspend a machine now, and run its suspended ringlet inside this call.

        `caller` is the seat whose ringlet makes the call, None from outside.
        """
        first_round = seat.first_round
        if caller is not None:
            self._outer.append(caller)
        snapshot = seat.snapshot()  # one for a ringlet, also if another one is nested in it
        seat.request = None
        seat.nested += 1
        seat.suspend()
        turn: Callable[[Seat], bool] = defined_ringlet  # which a watchdog finds on the stack
        if self.stopwatch is not None:
            turn = partial(self.stopwatch.time_nested, turn)
        try:
            turn(seat)
        except ExecutionError as error:
            self.fail(seat, error)
        finally:
            if not first_round:  # those that rounds give it are still to come
                seat.first_round = self.rounds + (caller is None or caller.index > seat.index)
            if seat in self._outer:
                for sensor, value in snapshot:
                    setattr(seat.machine, sensor, value)
            self._let_go()
            if caller is not None:
                self._outer.pop()

    def unload(self, seat: Seat, caller: Seat | None) -> None:
        """Unload a machine: at once, or at the end of its ringlet if in one."""
        if seat is caller or seat in self._outer:
            self._leaving.append(seat)
        else:
            self.vacate(seat)

    def vacate(self, seat: Seat) -> None:
        """Unload a machine that is in no ringlet."""
        self.environment.requested("unload", seat.name)
        with self.critical:
            if self.roster.remove(seat):
                seat.finish()
        if self.stopwatch is not None:
            self.stopwatch.rest(seat.name)

    def _accept(self, seat: Seat) -> None:
        """Unload a machine whose ringlet ended in an accepting state, unless it must stay."""
        if seat.nest.waits:
            return
        if seat.suspended:
            action = "kept: suspended"
        elif self.unload_accepting and seat.request in (Request.SUSPEND, Request.RESTART):
            action = f"kept: scheduled for {seat.request}"
        else:
            action = "unloaded" if self.unload_accepting else "kept: -u"
            seat.accept()
            if self.unload_accepting:
                self.vacate(seat)
        if self.observers:
            self.emit(Accepting(*self.stamp(), seat.index, seat.name, action))

    def fail(self, seat: Seat, error: ExecutionError) -> None:
        """Apply `on_error` to a machine whose code raised."""
        with self.critical:
            seat.fail(Failure(error, self.environment.clock.now_ns()))
        if self.instrument is not None:
            self.instrument.failed(seat, error)
        if self.on_error == "stop" and not seat.inner:  # else its outer machine decides
            self.end(Reason.FAILED)
            raise error
        log = logger().info if seat.inner else partial(logger().error, exc_info=error)
        log("%s", error)
        self.set_aside(seat)
        if self.observers:
            self.emit(Failed(*self.stamp(), seat.index, seat.name, error))

    def set_aside(self, seat: Seat) -> None:
        """Suspend a machine that has failed; unload it if it is suspended."""
        if seat.suspended:
            self._leaving.append(seat)
            self._let_go()
        else:
            seat.suspend()

    def _let_go(self) -> None:
        """Unload those that asked for it and whose ringlet is over."""
        for seat in [seat for seat in self._leaving if seat not in self._outer]:
            self._leaving.remove(seat)
            self.vacate(seat)

    # The end

    def stop(self, cause: str) -> None:
        """Ask the machines to reach accepting states; may be called from any thread.

        They see it between two rounds, so that all code of a ringlet sees the same.
        """
        if not self.stopping and self.reason is None and self.environment.may_stop(cause):
            self.stop_cause = cause
            self.stopping = True
            here = self.thread in (None, get_ident())
            if self.environment.defers_stops or (here and not self._gives_turns):
                self.show_stop()
            self.environment.wake()

    def show_stop(self) -> None:
        """Let the machines see it, if they are to stop and no code of theirs runs."""
        if self.stopping and not self.stop_is_seen:
            self.stop_is_seen, self.stop_round = True, self.rounds
            for seat in self.roster:
                seat.machine.stopping = True

    def look_at_world(self) -> None:
        """Stop if the environment does not exist any more."""
        if not self.environment.alive:
            self.stop(BOARD_GONE)

    def pause(self, is_over: Callable[[], bool]) -> None:
        """Give no turn until `is_over`, which may wait, the end or a stop; obey requests."""
        gives_turns, self._gives_turns = self._gives_turns, False
        with self.environment.paused():
            while not (self.stopping or self.reason is not None or is_over()):
                if self.runs:
                    self.look_at_world()
                if self.attendant is not None:
                    self.attendant.beat()
        self.show_stop()
        self._gives_turns = gives_turns

    def end(self, reason: Reason) -> None:
        """Run no more rounds and post the `at_end` messages; nothing if it has ended before."""
        if self.reason is not None:
            return
        self.critical.depth += 1
        self.reason, self._gate = reason, self.refuse
        for seat in self.roster:
            seat.finish()
        if self.attendant is not None:
            self.attendant.end()
        if self.stopwatch is not None:
            self.stopwatch.end()
        self.emit(End(*self.stamp(), reason))

    def refuse(self) -> bool:
        """Raise `ArrangementEndedError`."""
        raise ArrangementEndedError(f"this arrangement has ended: {self.reason}")

    def _sleep_to_turn(self, due_ns: int) -> bool:
        """Sleep until a turn is due, outside of `run`, which looks after more meanwhile."""
        self.environment.clock.sleep_until_ns(due_ns)
        return self.reason is None


class Control:
    """Requests, questions and loading by name, for machines' own code and from outside alike.

    A request replaces an earlier one and takes effect at the machine's next turn. Every call that
    takes a name raises `UnknownMachineError` if there is no such machine; suspend, resume, restart
    and questions also reach machines that other processes run in the same environment. `caller`
    is the seat whose ringlet makes a call, None from outside.
    """

    def __init__(self, kernel: Kernel, library: Library | None = None):
        self.kernel = kernel
        self.roster = kernel.roster
        self.loader = Loader(self, library)
        self._stopped: list[tuple[int, Seat]] = []  # asked to stop alone, and when

    # Loading

    def load(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine, as `LoadOptions` says, and return its index; or raise `LoadError`."""
        return self.loader.load(machine, **how).index

    def load_suspended(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine as `load` does, but in its suspend state, to be resumed."""
        seat = self.loader.load(machine, **how)
        seat.suspend()
        return seat.index

    def call_machine(
        self,
        machine: type[M] | M | str,
        caller: Seat | None = None,
        *,
        detached: bool = False,
        **how: Unpack[LoadOptions],
    ) -> Submachine[M]:
        """Load a machine as `load` does, to wait for its end and read its results.

        It ends when its caller leaves the state that it is in, unless it is `detached`.
        """
        seat = self.loader.load(machine, **how)
        seat.called, seat.caller = True, caller
        if caller is not None and not detached:
            caller.add_call(seat)
        return Submachine(seat)

    def reload(self, name: str, cls: type[Machine]) -> None:
        """Replace a machine by `cls`, another definition of it, and restart it; between two turns.

        The one that ran ends: its `at_end` messages are posted. The name, the place, and what the
        machine was loaded with stay, as does a request that is pending. Raise `LoadError`,
        `VariableError` or what a whiteboard raises, and leave the one that runs.
        """
        self.kernel.environment.requested("reload", name)
        self.loader.reload(self.roster.find(name), cls)

    def unload(self, name: str, caller: Seat | None = None) -> bool:
        """Unload a machine and return True: at once, or at the end of its ringlet if in one."""
        self.kernel.unload(self.roster.find(name), caller)
        return True

    def abandon(self, name: str, caller: Seat | None = None) -> bool:
        """Suspend a machine now, run its suspended ringlet inside this call and return True."""
        self.kernel.environment.requested("abandon", name)
        self.kernel.abandon(self.roster.find(name), caller)
        return True

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
        self.kernel.environment.requested("hold", name)
        seat = self.roster.find(name)
        seat.held = True
        self._schedule(seat, Request.SUSPEND)

    def suspend_all(self, caller: Seat | None = None) -> None:
        """Have every machine suspended but the one in seat `caller`."""
        for seat in self.roster.named.values():
            if seat is not caller:
                self.kernel.environment.requested("suspend", seat.name)
                self._schedule(seat, Request.SUSPEND)

    def stop_machine(self, name: str) -> None:
        """Ask one machine to reach an accepting state; `run` unloads it after the grace period."""
        self.kernel.environment.requested("stop_machine", name)
        seat = self.roster.find(name)
        if not seat.stopping:
            seat.ask_to_stop()
            self._stopped.append((self.kernel.environment.clock.now_ns(), seat))
            self.kernel.environment.wake()

    @property
    def asked_to_stop(self) -> bool:
        """True if a machine was asked to stop alone, and is still there."""
        return bool(self._stopped)

    def unload_stopped(self, grace_ns: int) -> None:
        """Unload the machines that were asked to stop alone so long ago."""
        while (
            self._stopped
            and self.kernel.environment.clock.now_ns() - self._stopped[0][0] >= grace_ns
        ):
            seat = self._stopped.pop(0)[1]
            if seat.taken:
                self.kernel.vacate(seat)

    def post_safe(self, name: str) -> None:
        """Post what a machine posts when it is suspended, though it is not."""
        self.kernel.environment.requested("post_safe", name)
        self.roster.find(name).post_safe("at_suspend")

    def override(self, name: str, sensor: str, message: Message | None) -> None:
        """Let a machine read `message` instead of what is in the sensor's slot, until `release`.

        Its other sensors of this slot find it, too. None is as if there was no message. Raise
        `SensorNameError` or what a whiteboard raises for a message that is not of the slot's type.
        """
        slot = self.slot_of(name, sensor)
        self.kernel.environment.override(name, slot, message)
        if self.kernel.instrument is not None:
            self.kernel.instrument.end_lease(name, slot.name)
        self.kernel.read_again(slot.name)
        self.kernel.environment.wake()

    def release(self, name: str, sensor: str) -> None:
        """Let a machine read what is in the sensor's slot again."""
        slot = self.slot_of(name, sensor)
        self.kernel.environment.release(name, slot)
        self.kernel.read_again(slot.name)
        self.kernel.environment.wake()

    # Questions

    def slot_of(self, name: str, sensor: str) -> Slot[Any]:
        """Return the slot that a machine's sensor reads; raise `SensorNameError`."""
        seat = self.roster.find(name)
        return seat.slot_of(seat.sensor(sensor))

    def status(self, name: str) -> Status:
        """Return `Status.RUNNING` or `Status.SUSPENDED`."""
        return Status.SUSPENDED if self.is_suspended(name) else Status.RUNNING

    def is_suspended(self, name: str) -> bool:
        """Return True if a machine is in its suspend state."""
        seat = self.roster.named.get(name)
        if seat is None:
            return self.kernel.environment.elsewhere(name, self.roster.named).suspended
        return seat.suspended

    def is_running(self, name: str) -> bool:
        """Return True if a machine is not suspended."""
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
            return self.kernel.environment.elsewhere(name, self.roster.named).state
        return seat.current.name

    @property
    def number_of_machines(self) -> int:
        """The number of indices in use, holes included."""
        return len(self.roster.seats)

    def _ask(self, name: str, request: Request) -> Status:
        self.kernel.environment.requested(request.value, name)
        seat = self.roster.named.get(name)
        if seat is None:
            return self.kernel.environment.elsewhere(name, self.roster.named).request(request.value)
        return self._schedule(seat, request)

    def _schedule(self, seat: Seat, request: Request) -> Status:
        """Schedule a request; one of another thread than that of the turns ends an idle sleep.

        One of a machine's code does not: it is for the next round, as what machines post.
        """
        status = seat.schedule(request)
        if self.kernel.thread not in (None, get_ident()):
            self.kernel.environment.wake()
        return status
