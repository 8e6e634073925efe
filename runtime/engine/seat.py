"""A machine's seat in an arrangement: its place in the order, and where its execution stands."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from math import floor
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

from llfsm.errors import LlfsmError, did_you_mean
from llfsm.runtime.engine.clock import NEVER
from llfsm.runtime.engine.errors import (
    ExecutionError,
    GuardResultError,
    LoadError,
    ObserverError,
    SensorNameError,
)
from llfsm.runtime.engine.events import Request, Standing, Status, Turn
from llfsm.runtime.engine.nest import Nest
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.ringlet import BoundState, SeatFields, defined_ringlet
from llfsm.runtime.engine.state import State
from llfsm.runtime.log import logger

if TYPE_CHECKING:
    from llfsm.runtime.engine.environment import AgedRead, Environment, Read
    from llfsm.runtime.engine.kernel import Control
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.statistics import Meter
    from llfsm.runtime.engine.submachine import Submachine, Submachines
    from llfsm.runtime.engine.table import Table
    from llfsm.whiteboard import Board, Message, Slot


RUNTIME = os.path.dirname(os.path.dirname(__file__))
"""The folder of the runtime: code of machines is elsewhere."""
_MOST_DEEP = 32  # machines inside each other


def require_shallow(name: str, depth: int) -> None:
    """Raise `LoadError` for a machine so many machines deep that it must not run another one."""
    if depth >= _MOST_DEEP:
        raise LoadError(f"{name} is {depth} machines deep: do their states run each other?")


class Instrument(Protocol):
    """A debugger in an arrangement, where observing every event would cost too much."""

    def bound(self, seat: Seat) -> None:
        """Wrap what is of interest of a machine's table, which has just been bound."""

    def reading(self, seat: Seat, slot: str, read: Read) -> Read:
        """Wrap `read`, the reader of a sensor of `slot`, or return it as it is."""

    def look(self) -> None:
        """Do what is due; called several times a second where requests come from outside."""

    def end_lease(self, machine: str, slot: str) -> None:
        """End the lease of what was overridden before: it does not end the override after it."""

    def left_s(self, machine: str, sensor: str) -> float | None:
        """Return the seconds for which a sensor stays overridden; None until a release."""

    def pause_left_s(self) -> float | None:
        """Return the seconds until a pause ends, unless renewed; None if only a request does."""

    def failed(self, seat: Seat, error: ExecutionError) -> None:
        """Note that code of a machine has raised; what comes of that waits for the return."""


class Arrival(NamedTuple):
    """The transition by which a machine has come into its state; none if `source` is empty."""

    source: str
    transition: int
    """Its place among those of `source`, from 0."""
    entered_ns: int | None
    """When the state's clock started; None if it has had no turn there yet."""


class Failure(NamedTuple):
    """An error that code of a machine has raised, and its time by the arrangement's clock."""

    error: ExecutionError
    time_ns: int


class Seat(SeatFields):
    """One machine in one arrangement: its place in the order and where its execution stands.

    `current`, `previous` (None before the first ringlet and after a restart) and `remembered`
    (where resume leads) are what the semantics speak of; `request` is the scheduled action.
    """

    __slots__ = (
        "_aged",
        "accepted",
        "called",
        "caller",
        "control",
        "doing",
        "fired",
        "first_round",
        "held",
        "index",
        "initial",
        "kernel",
        "left",
        "name",
        "nest",
        "nested",
        "parking",
        "path",
        "remembered",
        "renamed",
        "states",
        "stood",
        "stopping",
        "taken",
        "variables",
    )

    machine: Machine
    meter: Meter | None
    failure: Failure | None

    def __init__(
        self,
        machine: Machine,
        control: Control,
        name: str,
        path: str,
        renamed: Mapping[str, str],
        variables: Mapping[str, Any],
    ):
        self.machine = machine
        self.control = control
        self.kernel = control.kernel
        self.index = 0  # given with the place
        self.name = name
        self.path = path
        self.renamed = renamed  # slots: name in the machine -> name on the board
        self.variables = variables  # with which it was loaded
        self.now = self._first_now
        self._begin()
        self.request = None
        self.first_round = 0  # in which it had its first turn, counted from 1
        self.nested = 0  # turns inside another machine's, besides those of rounds
        self.doing: str | None = None  # the state whose section runs, while observed
        self.sensors = ()
        self._aged: dict[str, AgedRead] = {}  # those of them that know the ages of messages
        self.meter = None  # of the stopwatch, if turns are timed
        self.timed = None  # the state of which it counts the time
        self.taken = False
        self.called = False  # whether somebody waits for its end
        self.caller: Seat | None = None  # the machine that does
        self.inner = False  # whether it has its turns right behind those of the caller
        self.children = None
        self.left = False  # whether it has ended because its state was left
        self.parking = False  # whether it may be returned later
        self.hang = ""  # where its code hangs, as a watchdog has found
        self.held = False  # whether it was suspended from outside, and may be resumed from there
        self.stopping = False  # whether this machine alone was asked to stop
        self.notifies = False  # whether a state has something to do when suspended or resumed

    def _begin(self) -> None:
        """Stand at the beginning of the machine's table."""
        table = self.table
        self.states = {state.name: BoundState(state.name) for state in table.states}
        self.initial = self.states[table.initial.name]
        suspend = table.suspend
        self.suspension = self.states[suspend.name] if suspend else BoundState("Suspended")
        self.nest: Nest[Seat] = Nest(self)
        self.current = self.remembered = self.initial
        self.previous = None
        self.source = None  # the state that it was in before
        self.fired = 0  # of the transitions to one state, the number of the one that fired last
        self.entered_ns = NEVER  # when the state clock started
        self.stood: tuple[int, int] | None = None  # that of the state it was suspended in, and when
        self.accepted = False  # whether it has ended a ringlet in an accepting state
        self.failure = None  # what its code has raised

    @property
    def table(self) -> Table:
        """The table of the machine's class."""
        return type(self.machine).table

    @property
    def suspended(self) -> bool:
        """True if the machine is in its suspend state."""
        return self.current is self.suspension

    @property
    def settled(self) -> bool:
        """True if the machine does not keep the execution alive.

        It accepts (and did not just get there), or is suspended with nothing pending that
        would end this. A machine without a turn yet is never settled.
        """
        if self.current is self.suspension:
            waking = self.request is Request.RESUME or self.request is Request.RESTART
            return not waking and self.entered_ns != NEVER
        if self.current is not self.previous or self.current.transitions:
            return False
        return self.accepted or not self.nest.runs(self.current)

    @property
    def ringlets(self) -> int:
        """The number of turns that the machine has had, if each round gives it one.

        It is made of the rounds, so that counting takes no time in a turn.
        """
        if self.first_round == 0:
            return self.nested
        return self.kernel.rounds - self.first_round + 1 + self.nested

    def _first_now(self) -> int:
        """Return the time as the first turn begins, and note the round: later turns pay nothing."""
        self.first_round = self.kernel.rounds
        self.now = self.kernel.environment.machine_now
        return self.now()

    def suspend(self) -> None:
        """Go to the suspend state and remember the current one; nothing if suspended."""
        if self.current is not self.suspension:
            was_entered = self.current is self.previous and self.failure is None
            self.stood = (self.entered_ns, self.now()) if was_entered else None
            self.previous = self.remembered = self.current
            self.current = self.suspension

    @property
    def waits_for(self) -> str:
        """Describe its wait in its state, in words; "" if it is polled, or not known."""
        waiting = self.current.waiting
        is_known = waiting is not None and self.current is self.previous and not waiting.polls
        return waiting.text if is_known and waiting is not None else ""

    @property
    def stands(self) -> bool:
        """True if it is suspended in a state in which it goes on in place."""
        stood = self.stood is not None and self.suspended
        return stood and self.declared(self.remembered).resume == "in_place"

    def add_call(self, called: Seat) -> None:
        """Let a machine that this one has called end with the state that it is in."""
        is_first = self.current not in self.nest.calling
        self.nest.call(self.current, called)
        if is_first:
            self.kernel.bind(self)

    @property
    def depth(self) -> int:
        """The number of machines that it is inside of."""
        return self.caller.depth + 1 if self.inner and self.caller is not None else 0

    # What its nest and that of its outer machine ask of it

    def ask_to_stop(self) -> None:
        """Let the machine see that it is to stop, and what its states run."""
        self.stopping = self.machine.stopping = True
        for child in self.children or ():
            if child is not None:
                child.ask_to_stop()

    def work(self, state: str) -> Submachine[Any] | Submachines:
        """Return the machines that a state runs, or has run last."""
        bound = self.states[state]
        return self.nest.work(self.declared(bound), bound)

    def begin(self, state: State, number: int) -> Seat:
        """Load what a state runs into a seat of its own, and return that."""
        return self.control.loader.put(self.prepare(state, number))

    def prepare(self, state: State, number: int) -> Seat:
        """Make what a state runs and its seat, which has no place yet."""
        require_shallow(self.name, self.depth)
        runs = state.runs[number]
        made = runs if isinstance(runs, str | type) else runs(self.machine)
        return self.control.loader.seat_within(self, state, number, made)

    def leave(self) -> None:
        """Unload the machine if it is loaded."""
        if self.taken:
            self.kernel.unload(self, None)

    def halt(self) -> None:
        """Suspend the machine now: OnSuspend runs, and the next turn is in the suspend state."""
        state, self.request = self.current, None
        self.suspend()
        self.previous = None  # so that the next ringlet does not run OnSuspend again
        try:
            if state.on_suspend is not None:
                state.on_suspend(self.machine)
        except BaseException as error:
            explained = self.explain(state, state.on_suspend, error)
            if not isinstance(explained, ExecutionError):
                raise
            self.kernel.fail(self, explained)

    def park(self, *, wakes: bool) -> None:
        """Suspend the machine now and take it out of the arrangement, to be returned to it."""
        if not self.suspended:
            self.halt()
        self.request = Request.RESUME if wakes else None
        self.parking = True
        self.leave()

    def unpark(self) -> None:
        """Return a machine that was parked."""
        self.parking = self.left = False
        self.control.loader.put(self)

    def perform_request(self) -> None:
        """Apply and clear the request."""
        request, self.request = self.request, None
        if request and self.caller is not None and self.caller.nest.holds(self, request):
            return
        self.held = self.held and request is Request.SUSPEND
        if request is Request.SUSPEND:
            self.suspend()
        elif request is Request.RESTART:
            self.nest.leave_all()
            if not self.suspended:
                self.post_safe("at_restart")
            self.current, self.previous = self.initial, None
            self.accepted, self.failure = False, None
        elif self.suspended and self.remembered is not self.suspension:
            self.current, self.previous = self.remembered, self.suspension
            self.failure = None

    def declared(self, state: BoundState) -> State:
        """Return the declaration of `state`, which must not be the default suspend state."""
        return next(s for s in self.table.states if s.name == state.name)

    def schedule(self, request: Request) -> Status:
        """Replace the request; return the status before, or ERROR instead of undoing a restart."""
        if request is Request.RESUME and self.request is Request.RESTART:
            return Status.ERROR
        self.request = request
        return Status.SUSPENDED if self.suspended else Status.RUNNING

    @property
    def progress(self) -> tuple[int, int]:
        """The numbers of ringlets and of overruns so far."""
        stopwatch = self.kernel.stopwatch
        return (self.ringlets, 0) if stopwatch is None else stopwatch.progress(self.name)

    @property
    def called_by(self) -> str:
        """The name of the machine that has called this one; "" if none has, or that has left."""
        caller = self.caller
        return caller.name if caller is not None and caller.taken else ""

    @property
    def overridden(self) -> tuple[str, ...]:
        """The names of the sensors that are overridden."""
        slots = self.kernel.environment.overridden(self.name)
        sensors = self.table.sensors.items() if slots else ()
        return tuple(name for name, sensor in sensors if self.slot_of(sensor).name in slots)

    def standing(self) -> Standing:
        """Return the machine's standing."""
        entered_ns = None if self.entered_ns == NEVER else self.entered_ns
        return Standing(
            self.index, self.name, self.current.name, self.suspended, self.request, entered_ns
        )

    def arrival(self) -> Arrival:
        """Find the transition by which the machine has come into its state."""
        entered = self.current is self.previous
        source = self.source if entered else self.previous
        entered_ns = self.entered_ns if entered else None
        # A request is not a transition, even where a transition connects the two states.
        asked = {source, self.current} == {self.suspension, self.remembered}
        if source is not None and not asked:
            ways = [n for n, (*_, to) in enumerate(source.transitions) if to is self.current]
            if ways:
                number = self.fired if len(ways) > 1 and self.fired in ways else ways[0]
                return Arrival(source.name, number, entered_ns)
        return Arrival("", 0, entered_ns)

    def connect(self, environment: Environment) -> None:
        """Connect the machine's sensors and actuators with `environment`."""
        table = self.table
        used = None if self.inner or not self.renamed else table.slots_within
        for slot in self.renamed:
            if used is not None and slot not in used:
                raise LoadError(
                    f"{self.name} uses no slot {slot!r}; it uses: {', '.join(used) or 'none'}"
                    f"{did_you_mean(slot, used)}"
                )
        self.sensors = tuple(
            (name, self._reader(environment, name, sensor), sensor.default)
            for name, sensor in table.sensors.items()
        )
        for name, actuator in table.actuators.items():
            post = environment.post(self.name, name, actuator, self.slot_of(actuator))
            setattr(self.machine, name, post)
        if self.first_round:
            self.now = environment.machine_now

    def take(self, index: int, name: str) -> None:
        """Sit down at a place in the order, connected with the environment."""
        self.index, self.name = index, name
        self.connect(self.kernel.environment)
        self.claim(self.kernel.environment)
        self.machine._seat = self
        self.taken = True

    def snapshot(self) -> list[tuple[str, Any]]:
        """Return the value of each sensor of the machine."""
        return [(sensor, getattr(self.machine, sensor)) for sensor, *_ in self.sensors]

    def reload(self, machine: Machine) -> None:
        """Seat another definition of the machine, at its beginning; the one before ends.

        Raise what `connect` and `claim` raise if it cannot be connected, and keep the one before.
        """
        before, aged, environment = self.machine, self._aged, self.kernel.environment
        held = [self.slot_of(self.table.sensors[name]) for name in self.overridden]
        try:
            self._exchange(machine, {})
        except LlfsmError:
            self._exchange(before, aged)
            raise
        if self.meter is not None:  # which counts the time in the states of the one before
            self.meter.unseat(environment.clock.now_ns())
            self.meter = self.timed = None
        self.nest.leave_all()
        self.post_safe("at_end", environment.whiteboard, before)
        self._close_actuators(before)
        self.held = self.held and self.request is Request.SUSPEND
        machine._seat = self
        self._begin()
        for slot in held:  # nobody knows whether the override still makes sense
            environment.release(self.name, slot)
            self.read_again(slot.name)

    def _exchange(self, machine: Machine, aged: dict[str, AgedRead]) -> None:
        environment = self.kernel.environment
        self.machine, self._aged = machine, aged
        environment.retire(self.name)
        self.connect(environment)
        self.claim(environment)

    def claim(self, environment: Environment) -> None:
        """Claim the slots to which the machine posts; raise `LoadError` if that is refused."""
        slots: dict[Slot[Any], bool] = {}
        for actuator in self.table.actuators.values():
            slot = self.slot_of(actuator)
            slots[slot] = slots.get(slot, False) or actuator.exclusive
        if slots:
            environment.claim(self.name, slots)

    def read_again(self, slot: str) -> None:
        """Connect the sensors of a slot anew, of which an instrument wants to know."""
        sensors, environment = self.table.sensors, self.kernel.environment
        self.sensors = tuple(
            (name, self._reader(environment, name, sensors[name]), default)
            if self.slot_of(sensors[name]).name == slot
            else (name, read, default)
            for name, read, default in self.sensors
        )

    def _reader(self, environment: Environment, name: str, sensor: Sensor[Any, Any]) -> Read:
        slot, before = self.slot_of(sensor), self._aged.get(name)
        instrument = self.kernel.instrument
        read: Read
        if before is None and sensor.max_age_ms is None and not sensor.since_start:
            read = environment.read(self.name, name, sensor, slot)
        else:
            start = None if before is None else before.start_count
            aged = environment.read_aged(self.name, name, sensor, slot, start)
            read = self._aged[name] = aged
        return read if instrument is None else instrument.reading(self, slot.name, read)

    def age_ns(self, name: str) -> int | None:
        """Return the age of a sensor's message in the snapshot, in nanoseconds, if there is one."""
        aged = self._aged.get(name)
        if aged is None:  # from now on the age is kept
            environment, sensor = self.kernel.environment, self.sensor(name)
            slot = self.slot_of(sensor)
            aged = self._aged[name] = environment.read_aged(self.name, name, sensor, slot)
            aged()
            self.sensors = tuple(
                (each, aged if each == name else read, default)
                for each, read, default in self.sensors
            )
        return aged.age_ns()

    def freshness_ns(self, name: str) -> int | None:
        """Return for how long a sensor's message is not too old yet; None if it never gets so."""
        limit_ms, aged = self.table.sensors[name].max_age_ms, self._aged.get(name)
        age_ns = None if limit_ms is None or aged is None else aged.age_ns()
        if limit_ms is None or age_ns is None or age_ns > limit_ms * 1e6:
            return None
        return floor(limit_ms * 1e6) - age_ns + 1

    def sensor(self, name: str) -> Sensor[Any, Any]:
        """Return the sensor of that name; raise `SensorNameError`."""
        sensors = self.table.sensors
        if name not in sensors:
            raise SensorNameError(
                f"{self.name} has no sensor {name!r}; it has: {', '.join(sensors) or 'none'}"
                f"{did_you_mean(name, sensors)}"
            )
        return sensors[name]

    @property
    def slots_read(self) -> frozenset[str]:
        """The names of the slots that the machine reads, on the board."""
        sensors = self.table.sensors.values()
        return frozenset(self.slot_of(sensor).name for sensor in sensors)

    def slot_of(self, port: Sensor[Any, Any] | Actuator[Any]) -> Slot[Any]:
        """Return the slot that the port is connected to."""
        slot = port.slot
        name = self.renamed.get(slot.name)
        return slot if name is None else type(slot)(name, slot.type, slot.capacity)

    def accept(self) -> None:
        """Note that the machine has ended a ringlet in an accepting state."""
        if not self.accepted:
            self.accepted = True
            self._wake_caller()

    def finish(self) -> None:
        """Leave the seat and post the `at_end` messages; nothing if that was done before."""
        if self.taken:
            self.taken = False
            self.nest.leave_all(keep=self.parking)
            turns = self.caller.children if self.inner and self.caller is not None else None
            if turns is not None:  # under way, it may be
                turns[:] = [None if each is self else each for each in turns]
            self._wake_caller()
            self.post_safe("at_end")
            self._close_actuators(self.machine)
            self.kernel.environment.unloaded(self.name)

    def fail(self, failure: Failure) -> None:
        """Note that code of the machine has raised, and post the `at_failure` messages."""
        self.failure = failure
        self.request = None
        self.nest.leave_all()
        self._wake_caller()
        if self.taken:  # else the values for an end were posted, and stay
            self.post_safe("at_failure")

    def _wake_caller(self) -> None:
        """Let no sleep keep a machine that has called this one from seeing how it stands."""
        if self.called:
            self.kernel.environment.wake()

    def post_safe(
        self,
        when: Literal["at_suspend", "at_restart", "at_end", "at_failure"],
        board: Board | None = None,
        machine: Machine | None = None,
    ) -> None:
        """Post the safe values of the machine's actuators for `when`, or post them to `board`.

        `machine` is the one before, if it is another one that ends.
        """
        machine = machine or self.machine
        stops = when == "at_end" and self.failure and self.kernel.on_error == "stop"
        for name, actuator in type(machine).table.actuators.items():
            message = getattr(actuator, when)
            if message is None or (stops and message is actuator.at_failure):  # just posted
                continue
            from llfsm.whiteboard import WhiteboardError

            try:
                post = getattr(machine, name)
                if board is not None:
                    post = board[self.slot_of(actuator)].add
                post(message)
            except WhiteboardError as error:  # the other messages must go out all the same
                what = "%s: the safe value of %s was not posted: %s"
                logger().warning(what, self.name, name, error)

    def safe_values(self) -> list[tuple[Slot[Any], Message]]:
        """Return the slots and the messages of the actuators that have one `at_failure`."""
        return [
            (self.slot_of(actuator), actuator.at_failure)
            for actuator in self.table.actuators.values()
            if actuator.at_failure is not None
        ]

    def _close_actuators(self, machine: Machine) -> None:
        """Let nothing be posted any more, such as by a thread that a section has started."""
        for name, actuator in type(machine).table.actuators.items():
            setattr(machine, name, actuator.closed(self.name))

    # What its code has raised: the ringlet, or its twin, asks.

    def explain(self, state: BoundState, code: object, error: BaseException) -> BaseException:
        """Describe the `error` that `code` raised in a ringlet that began in `state`.

        One that is no failure of the code, or is described already, is returned as it is.
        """
        failed = isinstance(error, Exception) or (
            isinstance(error, SystemExit | KeyboardInterrupt) and self.kernel.contains_exits
        )
        if not failed or isinstance(error, ExecutionError | ObserverError):
            return error
        where, step = self.place_of(state, code)
        filename, line = None, None
        trace = error.__traceback__
        while trace is not None:
            file = trace.tb_frame.f_code.co_filename
            if not file.startswith(RUNTIME):
                filename, line = file, trace.tb_lineno
                break
            trace = trace.tb_next
        what = f"{type(error).__name__}: {_text(str, error)}"
        explained = ExecutionError(what, self.name, where, step, filename, line)
        explained.__cause__ = error
        return explained

    def not_a_bool(self, state: BoundState, guard: object, value: object) -> GuardResultError:
        """Describe the `value`, neither True nor False, that `guard` returned."""
        where, step = self.place_of(state, guard)
        number = next(i for i, (_, bound, _) in enumerate(state.transitions) if bound is guard)
        filename, line = self.declared(state).transitions[number].location
        what = f"the guard returned {_text(repr, value)}, a {type(value).__name__}; "
        what += "it must return True or False"
        return GuardResultError(what, self.name, where, step, filename, line)

    def place_of(self, state: BoundState, code: object) -> tuple[str, str]:
        """Find the state and the section or transition that `code` is, in a ringlet of `state`.

        The ringlet keeps no record of its steps, for speed, so look for the function; one that
        serves in several places of one state gives them all.
        """
        if code is None:
            return state.name, "the snapshot"
        steps = list(self._steps(state, code))
        if steps:
            return state.name, " or ".join(steps)
        for other in self.states.values():  # only these run in the turn of another state
            if other.on_suspend is code:
                return other.name, "OnSuspend"
            if other.on_resume is code:
                return other.name, "OnResume"
        return state.name, "a section"

    def _steps(self, state: BoundState, code: object) -> Iterator[str]:
        for section in ("on_entry", "on_exit", "internal", "on_resume"):
            if getattr(state, section) is code:
                yield section.title().replace("_", "")
        for number, (_, guard, _) in enumerate(state.transitions):
            if guard is code:
                yield f"transition {self.declared(state).transitions[number].label}"


def observed_ringlet(seat: Seat) -> bool:
    """Report to the observers that a turn begins, and run it."""
    previous, kernel = None if seat.previous is None else seat.previous.name, seat.kernel
    begun = Turn(*kernel.stamp(), seat.index, seat.name, seat.current.name, previous, seat.request)
    kernel.emit(begun)
    return defined_ringlet(seat)


def _text(describe: Callable[[object], str], value: object) -> str:
    try:
        return describe(value)
    except Exception as error:  # of a class of the machine's own
        return f"({type(error).__name__} while it was described)"
