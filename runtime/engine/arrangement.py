"""An arrangement: machines that take turns, round after round, in one thread.

What can be loaded, and how: machines from classes, instances and names.

The tables of an arrangement's machines, bound anew when who watches them comes or goes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from threading import get_ident
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    Self,
    TypeAlias,
    TypedDict,
    TypeVar,
    Unpack,
)

from llfsm.runtime.engine.clock import Clock
from llfsm.runtime.engine.control import Control
from llfsm.runtime.engine.environment import BoardEnvironment, Environment
from llfsm.runtime.engine.errors import (
    ArrangementEndedError,
    ExecutionError,
    LoadError,
    OptionError,
    UnknownMachineError,
)
from llfsm.runtime.engine.events import (
    Accepting,
    End,
    Failed,
    Instrument,
    Observer,
    Observers,
    Reason,
    Request,
    RoundBegin,
    RoundEnd,
)
from llfsm.runtime.engine.execution import Execution
from llfsm.runtime.engine.failure import logger
from llfsm.runtime.engine.machine import Machine, Submachine
from llfsm.runtime.engine.realtime import Critical, check_real_time, stop_on_signals
from llfsm.runtime.engine.ringlet import observed_ringlet
from llfsm.runtime.engine.ringlet import ringlet as defined_ringlet
from llfsm.runtime.engine.schedule import Pacer, Timetable
from llfsm.runtime.engine.seat import Failure, Roster, Seat, bind
from llfsm.runtime.engine.statistics import Stopwatch
from llfsm.runtime.engine.twin import Rotation, ringlet
from llfsm.runtime.engine.watchdog import stop_by_signal

if TYPE_CHECKING:
    from llfsm.whiteboard import Board


Factory: TypeAlias = Callable[[], Machine]
"""What makes a machine to load: a machine class is one."""
Library: TypeAlias = Mapping[str, Factory] | Callable[[str], Factory | None]
"""Where machines are found by name: a mapping, or a function that returns None for no machine."""
Loadable: TypeAlias = str | type[Machine] | Machine
OnError: TypeAlias = Literal["stop", "suspend"]
"""What comes of code that raises: the end, or a suspension of its machine."""


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


class Observed:
    """Machines that observers and an instrument may watch, in an environment that may change."""

    unobserved = staticmethod(ringlet)
    """A turn that nobody observes: the ringlet, or its twin."""
    environment: Environment
    observers: Observers
    instrument: Instrument | None
    roster: Roster

    def move(self, environment: Environment) -> None:
        """Connect all machines with another environment, between two rounds."""
        self.environment = environment
        for seat in self.roster:
            seat.connect(environment)
        self._bind_all()

    def attach(self, observer: Observer) -> None:
        """Call `observer` with every event from now on; also while running."""
        self.observers.append(observer)
        self._bind_all()

    def detach(self, observer: Observer) -> None:
        """Call `observer` no more; also while running, and if it was not attached."""
        if observer in self.observers:
            self.observers.remove(observer)
            self._bind_all()

    def equip(self, instrument: Instrument) -> None:
        """Have `instrument` wrap what it wants of each machine's table, from now on."""
        self.instrument = instrument
        self._bind_all()

    def bind(self, seat: Seat) -> None:
        """Bind the table of a machine, for the observers that there are."""
        bind(seat, observed=bool(self.observers))
        if self.instrument is not None:
            self.instrument.bound(seat)

    def _bind_all(self) -> None:
        for seat in self.roster:
            self.bind(seat)
        self._turn: Callable[[Seat], bool] = observed_ringlet if self.observers else self.unobserved


M = TypeVar("M", bound=Machine)


class Arrangement(Rotation, Observed, Control):
    """Run machines in load order, one ringlet each per round; those in `start_suspended` last.

    Leaving a `with` block ends it, like the end of `run`: the `at_end` messages are posted.

    Args:
        machines: classes, instances or names of the `library`.
        start_suspended: more of them, loaded after the others in their suspend state.
        whiteboard: where sensors read and actuators post.
        clock: the only source of time (default: a `MonotonicClock`).
        environment: what machines learn from and act on, instead of a whiteboard and a clock.
        idle_us: how long to sleep after a round in which nothing fired.
        wake: end that sleep when a machine has a new message to read (clfsm's is False).
        period_us: begin rounds at this fixed period instead, the n-th of them n periods after the
            first. Turns that end after the next round is due are counted as overruns.
        timetable: give each machine its turns at its own times instead, a cycle a round.
        timed: measure every turn for `statistics`, as with a period or a timetable anyway.
        unload_accepting: unload a machine that accepts (clfsm's -u is False).
        library: machines that code may load by name.
        on_error: when code of a machine raises, "stop" everything and raise the `ExecutionError`,
            or "suspend" the machine and log it; one that fails while suspended is unloaded.
        watchdog_ms: report code of a machine that runs for longer, and post its safe values.
        realtime: the priority (1 to 99) of `run`, as for `in_real_time`, and its core (`cpu`).
        observers: functions to be called with every event.

    """

    live: ClassVar[type[BoardEnvironment]] = BoardEnvironment
    """The environment on a whiteboard; `llfsm.runtime` puts in the one that others can see."""

    def __init__(
        self,
        machines: Iterable[Loadable] = (),
        *,
        start_suspended: Iterable[Loadable] = (),
        whiteboard: Board | None = None,
        clock: Clock | None = None,
        environment: Environment | None = None,
        idle_us: int = 10_000,
        wake: bool = True,
        period_us: int | None = None,
        timetable: Timetable | None = None,
        timed: bool = False,
        unload_accepting: bool = True,
        library: Library | None = None,
        on_error: OnError = "stop",
        watchdog_ms: float | None = None,
        realtime: int | None = None,
        cpu: int | None = None,
        observers: Iterable[Observer] = (),
    ):
        for option, value, least in (
            ("idle_us", idle_us, 0),
            ("period_us", 1 if period_us is None else period_us, 1),
            ("watchdog_ms", 1 if watchdog_ms is None else watchdog_ms, 1),
        ):
            if value < least:
                raise OptionError(f"{option} is {value}; it must be {least} or more")
        check_real_time(realtime, cpu)
        if on_error not in ("stop", "suspend"):
            raise OptionError(f'on_error is {on_error!r}; it must be "stop" or "suspend"')
        if period_us is not None and timetable is not None:
            raise OptionError("give period_us or a timetable, not both")
        if environment is None:
            environment = Environment(clock) if whiteboard is None else self.live(whiteboard, clock)
        elif whiteboard is not None or clock is not None:
            raise OptionError("give an environment, or a whiteboard and a clock, not both")
        super().__init__(environment)
        self.idle_us, self.wake = idle_us, wake
        self.timetable = timetable
        self.unload_accepting = unload_accepting
        self.on_error = on_error
        self.watchdog_ms = watchdog_ms
        self.realtime, self.cpu = realtime, cpu
        self.reason: Reason | None = None
        self.stop_cause: str | None = None
        self._loader = Loader(self, self.roster, library)
        self._leaving = []
        self._outer: list[Seat] = []  # those inside whose ringlet another one is nested
        self.observers = Observers()  # changed by `attach` and `detach`
        self.instrument: Instrument | None = None  # changed by `equip`
        self.emit = self.observers.emit
        self._execution: Execution | None = None
        self.stopwatch: Stopwatch | None = None
        self.pacer: Pacer | None = None
        """What waits until rounds are due; None if they begin when they are asked for."""
        self._gate = None
        self._critical = Critical()  # while safe values are posted
        cycle_us = period_us if timetable is None else timetable.cycle_us
        if timed or cycle_us:
            self.stopwatch = watch = Stopwatch(self.clock)
            self._gate = watch.begin
            if cycle_us:
                slots = () if timetable is None else timetable.slots
                self.pacer = Pacer(cycle_us, self.clock, watch, self._wait_for_turn, slots)
                self._gate = self.pacer.wait_for_round
        self._bind_all()
        environment.enter(self)
        for observer in observers:
            self.attach(observer)
        for machine in machines:
            self.load(machine)
        for machine in start_suspended:
            self.load_suspended(machine)

    # Loading. `caller` is the seat whose ringlet makes the call, None from outside.

    def load(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine, as `LoadOptions` says, and return its index; or raise `LoadError`."""
        return self._loader.load(machine, **how).index

    def load_suspended(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine as `load` does, but in its suspend state, to be resumed."""
        seat = self._loader.load(machine, **how)
        seat.suspend()
        return seat.index

    @property
    def classes(self) -> dict[str, type[Machine]]:
        """The machine classes that were loaded so far, by name."""
        return {**self._loader.classes}

    def call_machine(
        self, machine: type[M] | M | str, caller: Seat | None = None, **how: Unpack[LoadOptions]
    ) -> Submachine[M]:
        """Load a machine as `load` does, to wait for its end and read its results."""
        return Submachine(self._loader.load(machine, **how), caller)

    def reload(self, name: str, cls: type[Machine]) -> None:
        """Replace a machine by `cls`, another definition of it, and restart it; between two turns.

        The one that ran ends: its `at_end` messages are posted. The name, the place, and what the
        machine was loaded with stay, as does a request that is pending. Raise `LoadError`,
        `VariableError` or what a whiteboard raises, and leave the one that runs.
        """
        self.environment.requested("reload", name)
        self._loader.reload(self.roster.find(name), cls)

    def unload(self, name: str, caller: Seat | None = None) -> bool:
        """Unload a machine and return True: at once, or at the end of its ringlet if in one."""
        seat = self.roster.find(name)
        if seat is caller or seat in self._outer:
            self._leaving.append(seat)
        else:
            self._vacate(seat)
        return True

    def abandon(self, name: str, caller: Seat | None = None) -> bool:
        """Suspend a machine now, run its suspended ringlet inside this call and return True."""
        self.environment.requested("abandon", name)
        seat = self.roster.find(name)
        first_round = seat.first_round
        if caller is not None:
            self._outer.append(caller)
        # A ringlet sees one snapshot, also if another one of the same machine is nested in it.
        snapshot = [(sensor, getattr(seat.machine, sensor)) for sensor, *_ in seat.sensors]
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
        return True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        failed = kind is not None and issubclass(kind, Exception)
        raised = Reason.FAILED if failed else Reason.INTERRUPTED
        self.end(Reason.CLOSED if kind is None else raised)

    def round(self) -> bool:
        """Give every machine one turn, in order, and return whether a transition fired.

        With a period or a timetable, wait until they are due.
        """
        if self._gate is None and not self.observers:
            fired = self.give_round(self.roster.seats)  # which grow and get holes on the way
        else:
            if self._gate is not None and not self._gate():
                return False
            self.rounds += 1
            if self.observers:
                self.emit(RoundBegin(*self.stamp()))
            seats: Iterable[Seat | None] = self.roster.seats
            if self.timetable is not None and self.pacer is not None:
                seats = self.pacer.turns(self.roster.named)
            fired = self.give_turns(seats)
        if self.observers:
            self.emit(RoundEnd(*self.stamp(), fired, self.finished, self.standings()))
        return fired

    def rest(self, sleep: Callable[[], bool]) -> bool:
        """Do as `give_rounds`; with observers or a timetable, give only one round."""
        if self.observers or self.timetable is not None:
            return self.round()
        return self.give_rounds(self.roster.seats, sleep)

    def run(self, *, grace_s: float = 1.0, max_rounds: int | None = None) -> Reason:
        """Run rounds until every machine accepts or is suspended; return why it ended.

        A failed machine keeps it going if other processes can resume it; else that is the reason.
        After `stop`, SIGINT or SIGTERM (in the main thread), or when the whiteboard has gone, the
        machines see `stopping` and have `grace_s` seconds to reach accepting states. A second
        signal acts as if there were no arrangement, but keeps no safe value from being posted.
        `max_rounds` ends it after that round.
        """
        if self.reason is not None:
            self._refuse()
        reason, self._thread = Reason.INTERRUPTED, get_ident()
        with stop_on_signals(partial(stop_by_signal, self), self._critical):
            try:
                self._execution = Execution(self, grace_s, self.watchdog_ms)
                reason = self._execution.run(max_rounds)
            except Exception:
                reason = Reason.FAILED
                raise
            finally:
                self._critical.depth += 1  # no call, at which a handler might run
                self.end(reason)
        return reason

    def stop(self, cause: str = "stop() was called") -> None:
        """Ask the machines to reach accepting states; may be called from any thread."""
        if not self.stopping and self.reason is None and self.environment.may_stop(cause):
            self.stop_cause = cause
            self.stopping = True
            for seat in self.roster:
                seat.machine.stopping = True
            self.environment.wake()

    def pause(self, is_over: Callable[[], bool]) -> None:
        """Give no turn until `is_over`, which may wait, the end or a stop; obey requests."""
        with self.environment.paused():
            while not (self.stopping or self.reason is not None or is_over()):
                if self._execution is not None:
                    self._execution.beat()

    def unload_stopped(self, grace_ns: int) -> None:
        """Unload the machines that were asked to stop alone so long ago."""
        while self._stopped and self.clock.now_ns() - self._stopped[0][0] >= grace_ns:
            seat = self._stopped.pop(0)[1]
            if seat.taken:
                self._vacate(seat)

    def end(self, reason: Reason = Reason.CLOSED) -> None:
        """Run no more rounds and post the `at_end` messages; nothing if it has ended before."""
        if self.reason is not None:
            return
        self._critical.depth += 1
        self.reason = reason
        self._gate = self._refuse
        for seat in self.roster:
            seat.finish()
        if self._execution is not None:
            self._execution.end()
        if self.stopwatch is not None:
            self.stopwatch.end()
        self.emit(End(*self.stamp(), reason))

    @property
    def contains_exits(self) -> bool:
        """Whether code that exits is an error of its machine alone: no signal can be the cause."""
        return self.on_error == "suspend" and self._execution is not None and not self.stopping

    @property
    def paced(self) -> bool:
        """Whether rounds have a time at which they begin."""
        return self.pacer is not None

    @property
    def due_ns(self) -> int | None:
        """When the next round begins; None if it begins when it is asked for."""
        return None if self.pacer is None else self.pacer.next_ns

    def _refuse(self) -> bool:
        raise ArrangementEndedError(f"this arrangement has ended: {self.reason}")

    def _wait_for_turn(self, due_ns: int) -> bool:
        if self._execution is not None:
            return self._execution.sleep_to_turn(due_ns)
        self.clock.sleep_until_ns(due_ns)
        return self.reason is None

    def _accept(self, seat: Seat) -> None:
        """Unload a machine whose ringlet ended in an accepting state, unless it must stay."""
        if seat.suspended:
            action = "kept: suspended"
        elif self.unload_accepting and seat.request in (Request.SUSPEND, Request.RESTART):
            action = f"kept: scheduled for {seat.request}"
        else:
            action = "unloaded" if self.unload_accepting else "kept: -u"
            seat.accept()
            if self.unload_accepting:
                self._vacate(seat)
        if self.observers:
            self.emit(Accepting(*self.stamp(), seat.index, seat.name, action))

    def fail(self, seat: Seat, error: ExecutionError) -> None:
        """Apply `on_error` to a machine whose code raised."""
        with self._critical:
            seat.fail(Failure(error, self.clock.now_ns()))
        if self.instrument is not None:
            self.instrument.failed(seat, error)
        if self.on_error == "stop":
            self.end(Reason.FAILED)
            raise error
        logger().error("%s", error, exc_info=error)
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
            self._vacate(seat)

    def _vacate(self, seat: Seat) -> None:
        self.environment.requested("unload", seat.name)
        with self._critical:
            if self.roster.remove(seat):
                seat.finish()
        if self.stopwatch is not None:
            self.stopwatch.rest(seat.name)
