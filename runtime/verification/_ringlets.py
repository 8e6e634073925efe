"""Run one ringlet of one machine from any control state, on an arrangement made for this.

The ringlet, the seats and the requests are the engine's own; only the environment is another one.
So what is explored is the code that runs. A ringlet is run in four steps: all machines that it may
touch are put into their control states, its variables are set to copies, it has its turn, and what
has changed since is read back. Control states, variables, messages and errors are numbered in the
order in which they are found, so that a ringlet's effects are a small tuple.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping
from copy import deepcopy
from math import inf
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar, Unpack, cast

from llfsm.runtime._values import (
    PLAIN,
    Codes,
    UnknownValueError,
    Variables,
    freeze,
    other_copy,
    own_copy,
)
from llfsm.runtime.engine.clock import NEVER
from llfsm.runtime.engine.errors import ExecutionError
from llfsm.runtime.engine.events import Request
from llfsm.runtime.engine.kernel import Control, Kernel, Loadable, LoadOptions
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.ringlet import defined_ringlet
from llfsm.runtime.engine.seat import Failure, Seat
from llfsm.runtime.expressions.reads import CLOCK, may_use
from llfsm.runtime.verification._memory import is_memory_short
from llfsm.runtime.verification.domains import Member, require_explorable
from llfsm.runtime.verification.environment import (
    ControlState,
    ExploredEnvironment,
    Given,
    RingletOutcome,
    UnansweredError,
    Unknown,
    UnknownControlError,
)
from llfsm.runtime.verification.errors import UnsupportedError
from llfsm.runtime.verification.loaded import ExploredLoader, Found

if TYPE_CHECKING:
    from llfsm.runtime.engine.events import Status
    from llfsm.runtime.engine.kernel import OnError
    from llfsm.runtime.engine.ringlet import BoundState
    from llfsm.runtime.engine.submachine import Submachine
    from llfsm.runtime.verification.environment import Since


M = TypeVar("M", bound=Machine)
Abstraction: TypeAlias = Mapping[str, Callable[[Any], Any]]
"""By "Machine.variable", functions that replace its value after each turn."""


GiveTurns: TypeAlias = Callable[[Iterable[Seat]], bool]
"""Gives seats their turns; True if a transition fired in any."""
_Standing: TypeAlias = tuple[Any, ...]
"""A control state with the bound states themselves: where a seat stands."""


class TimeUpError(Exception):
    """The time to explore is over."""


ENDINGS = (KeyboardInterrupt, MemoryError, TimeUpError)
"""The exceptions that end an exploration: a property that is not decided by then is undecided."""
_LOOK_S: Final = 0.1  # from one look at the memory to the next


class Deadline:
    """A time after which no more ringlets are run; none at first."""

    def __init__(self) -> None:
        self.at_s = inf
        """By `time.monotonic()`."""
        self._look_s = -inf

    def check(self) -> None:
        """Raise `TimeUpError` if it has passed, and `MemoryError` if little memory is left."""
        now_s = time.monotonic()
        if now_s >= self.at_s:
            raise TimeUpError
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            if is_memory_short():
                raise MemoryError


class _ExploredKernel(Kernel):
    """Turns of machines whose failures are kept."""

    environment: ExploredEnvironment
    unobserved = staticmethod(defined_ringlet)  # its twin in C knows no opaque time
    error: ExecutionError | None = None
    """The error that a machine's code raised in the latest turn, if all ends with that."""
    raised_in: BoundState | None = None
    """The state in which it was, if its machine was suspended for that."""

    @property
    def contains_exits(self) -> bool:
        """True: code that exits has failed, as it must not end the program that explores it."""
        return True

    def fail(self, seat: Seat, error: ExecutionError) -> None:
        """Keep what a machine's code raised, with which all ends; or suspend the machine."""
        if isinstance(error.__cause__, KeyboardInterrupt):  # which is not the code's
            raise error.__cause__
        if (self.on_error == "stop" and seat.caller is None) or (
            seat.name in self.environment.watchers
        ):
            self.error = error
            return
        self.raised_in = seat.previous
        seat.fail(Failure(error, NEVER))
        self.set_aside(seat)


class Ringlets(Control):
    """Machines of which any may have a ringlet, from any control state.

    The last `watchers` are monitors; anybody may suspend, resume or restart those that
    `controlled` names. Of `on_error`, monitors know "stop" alone.
    """

    kernel: _ExploredKernel

    def __init__(
        self,
        members: Iterable[Member],
        *,
        watchers: int,
        unload_accepting: bool,
        on_error: OnError,
        abstract: Abstraction,
        controlled: Iterable[str],
        found: Found,
        learning: bool,
        elsewhere: Collection[str],
    ):
        self.environment = ExploredEnvironment()
        kernel = _ExploredKernel(
            self.environment, unload_accepting=unload_accepting, on_error=on_error
        )
        super().__init__(kernel)
        self._controlled = frozenset(controlled)  # by anybody
        raised: Any = Unknown(self.environment, "the error for which it was suspended")
        self._failure = Failure(raised, NEVER)  # of each: what was raised is no part of a state
        self._stood = self.environment.stood, self.environment.suspended
        self._stands = False  # whether any machine may be resumed in place
        self._complete = False
        for member in members:
            member.load(self)
        self.loader: ExploredLoader = ExploredLoader(self, self.environment, found, watchers)
        self._complete = True
        self.seats = self.loader.with_inner(self.loader.outermost)
        self.learning = self.environment.learning = learning and self.loader.is_open
        """True to find out what states run and code loads: until then names may be of that."""
        self.places = {seat.name: number for number, seat in enumerate(self.seats)}
        self.environment.members = self.places.keys()
        self.environment.outside = frozenset(elsewhere)
        self.environment.watchers = {*list(self.places)[len(self.places) - watchers :]}
        self.inner = [n for n, seat in enumerate(self.seats) if seat.caller is not None]
        """The places of what states run."""
        self.absent = [n for n, seat in enumerate(self.seats) if not seat.taken]
        """The places of machines that are not there at the start, inner ones included."""
        self.kept: set[int] = set()
        """Those whose variables matter after they have ended."""
        for seat in self.seats:
            require_explorable(type(seat.machine))
            self._stands |= any(state.resume == "in_place" for state in seat.table.states)
        self.controls = [Codes() for _ in self.seats]
        self.variables = [Codes() for _ in self.seats]
        self.messages: dict[str, Codes] = {}
        self.errors = Codes()
        self.errors.code(None, None)
        self.executed = 0
        self.deadline = Deadline()
        self._ports = [self._ports_of(seat) for seat in self.seats]
        self._actuators = [
            [(name, ports[name]) for name in type(seat.machine).table.actuators]
            for seat, ports in zip(self.seats, self._ports, strict=True)
        ]
        self.loader.ports = dict(zip(self.places, self._ports, strict=True))
        self._by_name = {seat.name: seat for seat in self.seats}
        self._states = [{each.name: each for each in seat.table.states} for seat in self.seats]
        self._no_variables = [ports.keys() | {"stopping"} for ports in self._ports]
        self._standings: list[dict[_Standing, int]] = [{} for _ in self.seats]
        """For each machine, the numbers of its control states, as a seat has them."""
        self._orders: dict[tuple[str, ...], tuple[str, ...]] = {}
        """Names of variables in the order of the alphabet."""
        self._abstract: list[dict[str, Callable[[Any], Any]]] = [{} for _ in self.seats]
        for name, function in abstract.items():
            if not (self.learning and name.rpartition(".")[0] not in self.places):
                self._add_abstraction(name, function)
        self._owners: dict[int, str] | None = {}  # of values that change, by their ids
        self.initial = [
            (self._control_of(place), self._variables_of(place)) for place in range(len(self.seats))
        ]
        self._owners = None

    def message(self, slot: str, message: Any) -> int:
        """Number a slot's message; None, for no message, is 0."""
        codes = self.messages.get(slot)
        if codes is None:
            codes = self.messages[slot] = Codes()
            codes.code(None, None)
        return 0 if message is None else codes.code(freeze(message, _ignore), message)

    def run_ringlet(
        self, given: Given, *, copied: bool = False, turns: GiveTurns | None = None
    ) -> RingletOutcome:
        """Run a ringlet and return its effects; if `copied`, it gets copies with shuffled sets.

        `turns` is called in the place of `give_turns`.

        Raise `UnsupportedError` for what cannot be explored, `UnknownControlError` if it touches a
        machine that `others` lacks, `UnansweredError` if `contents` lacks an answer to a question,
        and `TimeUpError` after the deadline.
        """
        self.deadline.check()
        place, control, _, elapsed_ns, stood_ns, contents, others, inner, request, stopping = given
        environment, seat = self.environment, self.seats[place]
        copy = other_copy if copied else deepcopy
        for other, its in others:
            self._set_control(other, its)
            if self.seats[other].entered_ns != NEVER:
                self.seats[other].entered_ns = environment.entered_elsewhere
        for other, its in inner:
            self._set_variables(other, its, copy, stopping=stopping)
        was: ControlState = self.controls[place].values[control]
        self._set_control(place, control)
        if request is not None:
            if was.withdrawn_by(request):
                seat.schedule(Request.SUSPEND)
            seat.schedule(request)
        self._set_variables(place, given.variables, copy, stopping=stopping)
        self.kernel.stopping = stopping
        for slot, content in contents:
            message = self.messages[slot].values[content]
            environment.contents[slot] = other_copy(message) if copied else message
        environment.begin(seat.name, elapsed_ns if was.entered else None, stood_ns)
        self.kernel.error = self.kernel.raised_in = None
        self.executed += 1
        fired = (turns or self.kernel.give_turns)((seat,))
        self._check_ports(place)
        error = self.kernel.error
        clock_state = self.kernel.raised_in or seat.previous
        way = _fired(seat, clock_state) if fired and clock_state is not None else None
        resumed = was.stood and seat.entered_ns is environment.stood
        stays = seat.current is clock_state and seat.taken
        goes_on = stays and (resumed or seat.entered_ns is environment.entered)
        if resumed and any(since == "its entry" for since, _ in environment.limits):
            environment.refusal = environment.refusal or UnsupportedError(
                f"{seat.name} asks for the time in OnResume, and goes on in place with another "
                f"one: this cannot be explored; ask in OnEntry or later"
            )
        if environment.unanswered:
            raise UnansweredError(environment.unanswered)
        if self.inner:
            self._forget_ended(place, environment.touched)
        asked, changed = self._touched(place, dict(others)) if environment.touched else ((), ())
        looked, parts = self._looked(place, dict(inner)) if environment.looked else ((), ())
        if environment.refusal is not None:
            raise environment.refusal
        return RingletOutcome(
            environment.low_ns,
            environment.high_ns,
            asked,
            looked,
            self._control_of(place),
            self._variables_of(place),
            not goes_on,
            goes_on and resumed,
            resumed,
            self._numbered(environment.posted) if environment.posted else (),
            self._numbered(environment.found) if environment.found else (),
            changed,
            parts,
            tuple([(_clocked(since, was, clock_state), ns) for since, ns in environment.limits])
            if environment.limits
            else (),
            way,
            0 if error is None else self.errors.code(str(error), error),
        )

    def _touched(
        self, place: int, others: Mapping[int, int]
    ) -> tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]:
        """List the other machines that were asked for or changed, and the control states of both.

        Raise `UnknownControlError` for those whose control states were not given in `others`.
        """
        known = self.environment.touched & self.places.keys()  # others are refused
        touched = sorted({self.places[name] for name in known} - {place})
        if not others.keys() >= set(touched):
            raise UnknownControlError({*touched}, set(), set())
        after = [(other, self._control_of(other)) for other in touched]
        asked = tuple((other, others[other]) for other in touched)
        return asked, tuple((other, its) for other, its in after if its != others[other])

    def _looked(
        self, place: int, inner: Mapping[int, int]
    ) -> tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]:
        """List the inner machines that were looked at or changed, and the variables of both.

        Raise `UnknownControlError` for those whose variables were not given in `inner`.
        """
        environment = self.environment
        looked = {self.places[name] for name in environment.looked}
        needed = looked - {self.places[name] for name in environment.made}
        ended = {self.places[name] for name in environment.ended}
        if not inner.keys() >= needed or ended - self.kept:
            raise UnknownControlError({*needed}, needed, ended)
        after = [(other, self._variables_of(other)) for other in sorted(looked)]
        asked = tuple([(other, inner[other]) for other in sorted(needed)])
        # Of those that were made nothing is in `asked`, so what they are now is always an effect.
        return asked, tuple([p for p in after if p[0] not in needed or inner[p[0]] != p[1]])

    def _forget_ended(self, place: int, touched: Iterable[str]) -> None:
        """Forget the inner machines that a ringlet has ended."""
        for other in {place, *(self.places[name] for name in touched if name in self.places)}:
            if self.loader.is_forgotten(self.seats[other]):
                self.loader.forget(self.seats[other], kept=other in self.kept)

    def _check_ports(self, place: int) -> None:
        """Refuse a machine that has replaced an actuator or `stopping`, which are no variables."""
        seat = self.seats[place]
        attributes = vars(seat.machine)
        wrong = "" if attributes.get("stopping") is self.kernel.stopping else "stopping"
        if seat.taken:  # else its actuators are closed
            for name, port in self._actuators[place]:
                if attributes.get(name) is not port:
                    wrong = wrong or name
        if wrong and self.environment.refusal is None:
            self.environment.refusal = UnsupportedError(
                f"{seat.name} assigns to its {wrong!r}: this cannot be explored"
            )

    def fingerprint(self, place: int) -> object:
        """Return the changes that a ringlet under way has made so far, as a comparable value."""
        posts = self._numbered(self.environment.posted)
        return self._control_of(place), self._variables_of(place), posts

    def _numbered(self, messages: Mapping[str, Any]) -> tuple[tuple[str, int], ...]:
        return tuple([(slot, self.message(slot, each)) for slot, each in messages.items()])

    def is_settled(
        self, place: int, control: int, *, stopping: bool, may_stop: bool
    ) -> tuple[bool, bool]:
        """Check two things: that a machine need not keep the execution alive; that it cannot.

        They differ where a request from outside does, if it is there when the round is over: to
        suspend one that accepts, or to resume or restart one that is suspended; a suspend also
        withdraws what would wake it. Unless a stop has come, or may at that moment, one that is
        suspended does without it, as if that was asked from outside. One that has failed keeps it
        alive, until a stop, if some other process can resume it, which is not known.
        """
        seat = self.seats[place]
        if self.waits(place, control):
            return (stopping or may_stop) and seat.entered_ns != NEVER, False
        if not seat.taken:
            return True, True
        held = seat.name in self._controlled or seat.failure is not None
        return seat.settled, seat.settled and (stopping or not held)

    def waits(self, place: int, control: int) -> bool:
        """Check that a machine is suspended, and that anybody may wake it or leave it so."""
        seat = self.seats[place]
        self._set_control(place, control)
        return seat.taken and seat.suspended and seat.name in self._controlled

    # A machine is loaded here only if its control state was given, so it is noted before anything
    # else: without it, the ringlet is run again.

    def is_suspended(self, name: str) -> bool:
        """Note the machine, and check that it is suspended."""
        self._note(name)
        return super().is_suspended(name)

    def state_name_of(self, name: str) -> str:
        """Note the machine, and return its state."""
        self._note(name)
        return super().state_name_of(name)

    def index_of(self, name: str) -> int:
        """Note the machine, and return its index; refuse one that inner machines may change."""
        self._note(name)
        seat = self.roster.find(name)
        if self.inner and not self._is_member(seat):
            self._refuse_index(f"the index of {name}")
        return self.loader.index_of(seat)

    def name_of(self, index: int) -> str:
        """Note all machines, any of which could have this index, and return the name at it."""
        self._note_all()
        if self.inner and index >= self.loader.members:
            self._refuse_index(f"the machine at index {index}")
        return self.loader.at(index).name

    @property
    def number_of_machines(self) -> int:
        """The number of indices in use; refused if there is a monitor."""
        for name in self.environment.watchers:
            self.environment.ask(name)
        if self.inner:
            self._refuse_index("the number of indices in use")
        if self.absent:  # which may have been loaded since
            self._note_all()
        return self.loader.used

    def _is_member(self, seat: Seat) -> bool:
        """Check that a machine is an outermost one that is there at the start."""
        return seat.caller is None and self.loader.index_of(seat) < self.loader.members

    def _refuse_index(self, what: str) -> None:
        self.environment.refuse(
            f"asks for {what}: machines that states run get theirs as they begin, so this cannot "
            f"be explored; ask for machines by name"
        )

    def resume(self, name: str) -> Status:
        """Resume a machine; of one that anybody may restart, its status is not known."""
        status = super().resume(name)
        if name in self._controlled:
            what = f"the status that resume({name!r}) returned, which anybody may ask to restart"
            status = cast("Status", Unknown(self.environment, what))
        return status

    def suspend_all(self, caller: Seat | None = None) -> None:
        """Note all machines, and suspend those that are loaded."""
        self._note_all()
        super().suspend_all(caller)

    def unload(self, name: str, caller: Seat | None = None) -> bool:
        """Note the machine, and unload it."""
        self._note(name)
        return super().unload(name, caller)

    def _note(self, name: str) -> None:
        if name in self.environment.outside:
            return
        if name in self.places:
            self.environment.ask(name)
        if name not in self.roster.named:
            self._note_all()  # as an error lists them

    def _note_all(self) -> None:
        self.environment.touched.update(self.places.keys() - self.environment.watchers)

    def load(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine, and note all others once the machines run."""
        self._note_loading(machine)
        return self._index_of_loaded(super().load(machine, **how), machine)

    def load_suspended(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine in its suspend state, likewise."""
        self._note_loading(machine)
        return self._index_of_loaded(super().load_suspended(machine, **how), machine)

    def call_machine(
        self,
        machine: type[M] | M | str,
        caller: Seat | None = None,
        *,
        detached: bool = False,
        **how: Unpack[LoadOptions],
    ) -> Submachine[M]:
        """Refuse to call a submachine."""
        self.environment.refuse(f"calls {machine!r} as a submachine: this cannot be explored")

    def _note_loading(self, machine: Loadable) -> None:
        if self._complete:
            kind = type(machine) if isinstance(machine, Machine) else machine
            self.environment.requested("load", getattr(kind, "__name__", str(kind)))
            self._note_all()

    def _index_of_loaded(self, number: int, machine: Loadable) -> int:
        """Return the index of a machine that was loaded, whose place in the roster is `number`."""
        if not self._complete:
            return number
        seat = self.roster.at(number)
        if self.inner and not self._is_member(seat):
            what = f"the index of {seat.name}, which inner machines may change"
            return cast("int", Unknown(self.environment, what))
        return self.loader.index_of(seat)

    def abandon(self, name: str, caller: Seat | None = None) -> bool:
        """Note the machine and its variables, and abandon it."""
        self._note(name)
        seat, environment = self.roster.named.get(name), self.environment
        if seat is None:
            return super().abandon(name, caller)  # which raises the error
        self._check_abandoned(seat)
        if seat is not caller:
            environment.look_at(name)
        for sensor in seat.table.sensors.values():  # at which no code looks
            environment.contents.setdefault(seat.slot_of(sensor).name, None)
        found = {**environment.found}
        super().abandon(name, caller)
        environment.found.clear()
        environment.found.update(found)
        if self.kernel.error is not None:
            raise self.kernel.error
        return True

    def _check_abandoned(self, seat: Seat) -> None:
        """Refuse a machine whose code could see more in its suspended ringlet than is given."""
        table = seat.table
        suspend = table.suspend
        run = [] if suspend is None else [suspend.sections.get(n) for n in ("OnEntry", "Internal")]
        if seat.current is not seat.suspension:
            run.append(seat.declared(seat.current).sections.get("OnSuspend"))
        unseen = {*table.sensors, *CLOCK}
        if (suspend is not None and suspend.transitions) or any(
            code is not None and may_use(code, type(seat.machine), unseen) for code in run
        ):
            self.environment.refuse(
                f"abandons {seat.name}, whose OnSuspend or suspend state could read sensors or "
                f"the time, or has transitions: this cannot be explored; suspend it"
            )

    # Control states and variables

    def _set_control(self, place: int, number: int) -> None:
        seat, roster = self.seats[place], self.roster
        control: ControlState = self.controls[place].values[number]
        states = seat.states
        seat.current = states.get(control.current, seat.suspension)
        previous = control.previous
        seat.previous = None if previous is None else states.get(previous, seat.suspension)
        seat.remembered = states.get(control.remembered, seat.suspension)
        seat.request = control.request
        seat.accepted = control.accepted
        seat.entered_ns = self.environment.entered if control.begun else NEVER
        seat.failure = self._failure if control.failed else None
        if self._stands:
            seat.stood = self._stood if control.stood else None
        if self.absent:
            seat.left, seat.parking, seat.children = control.left, control.parked, None
            seat.nest.restore(control.runs, self._states[place], self._by_name)
        if seat.taken is not control.loaded:
            seat.taken = control.loaded
            if control.loaded:
                roster.add(seat)
                order = sorted(roster, key=self._order)  # in which errors list them
                roster.named = {each.name: each for each in order}
                vars(seat.machine).update(self._ports[place])  # it may post when it leaves again
            else:
                roster.remove(seat)

    def _order(self, seat: Seat) -> tuple[bool, int]:
        return seat.inner, self.places[seat.name]

    def _control_of(self, place: int) -> int:
        seat = self.seats[place]
        begun = seat.entered_ns != NEVER
        standing: _Standing = (
            *(seat.current, seat.previous, seat.remembered),
            *(seat.request, seat.accepted, seat.taken, begun, seat.failure is not None),
        )
        if self.absent:
            standing = *standing, seat.left, seat.parking, seat.nest.standing
        if self._stands:
            standing = *standing, seat.stands
        number = self._standings[place].get(standing)
        if number is None:
            control = ControlState.of(seat)
            number = self._standings[place][standing] = self.controls[place].code(control, control)
        return number

    def _ports_of(self, seat: Seat) -> dict[str, Any]:
        attributes, table = vars(seat.machine), type(seat.machine).table
        return {name: attributes[name] for name in table.actuators} | dict.fromkeys(table.sensors)

    def _add_abstraction(self, name: str, function: Callable[[Any], Any]) -> None:
        machine, _, variable = name.rpartition(".")
        if machine not in self.places:
            raise UnsupportedError(
                f'abstract has {name!r}: name a variable as in "Machine.variable"; the machines '
                f"are: {', '.join(self.places)}"
            )
        self._abstract[self.places[machine]][variable] = function

    def _set_variables(
        self, place: int, number: int, copy: Callable[[Any], Any], *, stopping: bool
    ) -> None:
        attributes = vars(self.seats[place].machine)
        attributes.clear()
        attributes.update(self._ports[place])
        attributes["stopping"] = stopping
        values, has_parts = self.variables[place].values[number]
        attributes.update(copy(values) if has_parts else values)

    def _variables_of(self, place: int) -> int:
        machine, ports = self.seats[place].machine, self._no_variables[place]
        values = {name: value for name, value in vars(machine).items() if name not in ports}
        if self._abstract[place]:
            self._replace(values, machine.name, self._abstract[place])
        names = tuple(values)
        order = self._orders.get(names)
        if order is None:
            order = self._orders[names] = tuple(sorted(names))
        parts: list[Any] = []
        key: list[Hashable] = []
        for name in order:
            value = values[name]
            kind = type(value)
            if kind in PLAIN:  # as most are, and as `freeze` does it
                key.append((kind, value))
                continue
            try:
                key.append(freeze(value, parts.append))
            except (UnknownValueError, RecursionError) as error:
                raise _no_data(machine, name, error) from None
        if parts:
            self._check_apart(machine.name, parts)
        codes = self.variables[place]
        known = len(codes)
        code = codes.code((order, tuple(key)), None)
        if code == known:
            if parts:
                for name, value in values.items():
                    try:
                        values[name] = own_copy(value)
                    except UnknownValueError as error:
                        raise _no_data(machine, name, error) from None
            kept: Variables = values, bool(parts)
            codes.values[code] = kept
        return code

    def _replace(self, values: dict[str, Any], machine: str, functions: Abstraction) -> None:
        """Replace variables by what the abstractions make of them."""
        for name, function in functions.items():
            if name not in values:
                raise UnsupportedError(
                    f"abstract names {machine}.{name}, which {machine} does not have; "
                    f"its variables are: {', '.join(values) or 'none'}"
                )
            try:
                values[name] = function(values[name])
            except Exception as error:  # a function of the user's may raise anything
                raise UnsupportedError(
                    f"abstract: the function of {machine}.{name} raised "
                    f"{type(error).__name__} for {values[name]!r}: {error}"
                ) from error

    def _check_apart(self, machine: str, parts: list[Any]) -> None:
        """Refuse variables that share what can change: here each has a copy of its own."""
        changing = [id(part) for part in parts if not isinstance(part, frozenset)]
        text = "share a value that changes"
        if len(set(changing)) < len(changing):
            raise UnsupportedError(f"variables of {machine} {text}: keep a copy in each")
        owners = {} if self._owners is None else self._owners
        for part in changing:
            if (owner := owners.setdefault(part, machine)) != machine:
                raise UnsupportedError(f"{owner} and {machine} {text}: use a slot for that")


def _no_data(machine: Machine, name: str, error: Exception) -> UnsupportedError:
    what = error if isinstance(error, UnknownValueError) else "nested without end"
    return UnsupportedError(
        f"{machine.name}.{name} is {what}: only data can be explored; give "
        f'abstract={{"{machine.name}.{name}": function}} to replace it'
    )


def _clocked(since: Since, was: ControlState, entered: BoundState | None) -> str:
    """Name the state whose time was asked for, in a ringlet that has `entered` one."""
    if since == "before the suspension":
        return was.remembered
    return entered.name if since == "this turn" and entered else was.current


def _fired(seat: Seat, source: BoundState) -> tuple[str, int]:
    ways = [n for n, (*_, target) in enumerate(source.transitions) if target is seat.current]
    return source.name, ways[0] if len(ways) == 1 else seat.fired


def _ignore(_: object) -> None:
    """Note nothing: messages do not change."""
