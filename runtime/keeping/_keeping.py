"""Machines that go on where they were when their process was ended and started again.

After each round that has changed anything, what is known of the machines is written to a
`KeptFile`: their states, variables, clocks, failures and requests, and the machines that their
states run. When a process starts again, each machine stands as if it had been suspended for the
time between, and were resumed now. So it is the state that decides what this means:
by default OnResume and OnEntry run, which posts again what a guard has taken back; in one that is
`resume="in_place"` the machine just goes on, and `clock="stops"` leaves the time between out.

What is not kept: a round that was under way; what sensors have read; machines that code has
loaded or called, as OnEntry calls them again; and what machines that had been asked to stop did to
end: these begin anew, as all do once the run was complete.

Times are kept by the date, so that they mean the same after a reboot. If the machines run by a
clock that another program sets, they are kept by that one.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from llfsm.runtime._values import UnknownValueError, freeze
from llfsm.runtime.engine.errors import ExecutionError, KeepError
from llfsm.runtime.engine.events import End, Event, Reason, Request, RoundEnd
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.nest import RunStanding
from llfsm.runtime.engine.seat import Failure, Seat
from llfsm.runtime.engine.submachine import Submachine, Submachines
from llfsm.runtime.engine.table import run_by
from llfsm.runtime.keeping._kept_file import KeptFile

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.kernel import Kernel
    from llfsm.runtime.engine.state import Runs
    from llfsm.runtime.engine.table import Table, Variable

T = TypeVar("T")


class KeptMachine(msgspec.Struct, frozen=True):
    """The standing of a machine, as it is kept; times are in nanoseconds, by the date."""

    name: str
    path: str
    state: str
    """Where it stands; of a suspended one, where it stood."""
    suspended: bool
    stood: tuple[int, int] | None
    """When it has entered that state, and when its clock stopped; None if it has not entered."""
    request: Request | None
    accepted: bool
    failure: tuple[str, str, str, str, str | None, int | None] | None
    """The arguments of its `ExecutionError`; None without one."""
    held: bool
    loaded: bool
    left: bool
    parking: bool
    variables: dict[str, msgspec.Raw]
    runs: tuple[RunStanding, ...]
    cls: str = ""
    """The module and the name of its class."""


class KeptMachines(msgspec.Struct, frozen=True):
    """The content of the file: the machines, each before those inside it, and who has ended."""

    machines: tuple[KeptMachine, ...] = ()
    over: tuple[str, ...] = ()


_DECODER = msgspec.msgpack.Decoder(KeptMachines)


@contextmanager
def keep_in(path: Path | str, arrangement: Arrangement) -> Iterator[bool]:
    """Keep the machines of an arrangement in a file, for the ``with`` block.

    If the file has such machines, they go on where they were, and this gives True. To be called
    before the first round. Each record is written before the next round begins, and is on the disk
    `_kept_file.SYNC_S` seconds later. Raise `KeepError` if the file is in use, damaged or has other
    machines, or if a value of a variable cannot be kept.
    """
    file = KeptFile(Path(path))
    try:
        keeping = _Keeping(arrangement, file)
        goes_on = keeping.restore()
        if not goes_on:
            keeping.keep()  # what cannot be kept is found before anything runs
        arrangement.attach(keeping)
        try:
            yield goes_on
        finally:
            arrangement.detach(keeping)
    finally:
        file.close()


class _Keeping:
    """Write what is known of machines to a file, after each round that has changed it."""

    def __init__(self, arrangement: Arrangement, file: KeptFile):
        self._kernel: Kernel = arrangement.kernel
        self._file = file
        self._roots = [seat.name for seat in self._kernel.roster]
        self._over: list[str] = []
        clock = arrangement.clock
        now_ns = self._kernel.environment.peek_ns()
        self._ahead_ns = time.time_ns() - now_ns if clock.passes else 0
        self._variables = _Variables()

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, RoundEnd):
            self.keep()
        elif isinstance(event, End) and event.reason is Reason.ACCEPTING:
            self._write(KeptMachines())

    def keep(self) -> None:
        """Write what has changed, if anything has."""
        kernel, roots = self._kernel, self._kernel.roster.named
        if not kernel.stop_is_seen:
            self._over = [name for name in self._roots if name not in roots]
        now_ns = kernel.environment.peek_ns()
        machines = [
            self._describe(seat, now_ns)
            for name in self._roots
            if name in roots
            for seat in _family(roots[name])
        ]
        self._write(KeptMachines(tuple(machines), tuple(self._over)))

    def _write(self, content: KeptMachines) -> None:
        packed = msgspec.msgpack.encode(content)
        if packed != self._file.latest:
            self._file.write(packed)

    def _describe(self, seat: Seat, now_ns: int) -> KeptMachine:
        stood, state = seat.stood, seat.remembered if seat.suspended else seat.current
        if not seat.suspended:
            stops = seat.declared(state).clock == "stops"
            is_entered = state is seat.previous
            stood = (seat.entered_ns, now_ns if stops else seat.entered_ns) if is_entered else None
        error = None if seat.failure is None else seat.failure.error
        return KeptMachine(
            seat.name,
            seat.path,
            state.name,
            seat.suspended,
            None if stood is None else (stood[0] + self._ahead_ns, stood[1] + self._ahead_ns),
            seat.request,
            seat.accepted,
            None if error is None else error.__reduce__()[1],
            seat.held,
            seat.taken,
            seat.left,
            seat.parking,
            self._variables.pack(seat),
            seat.nest.standing,
            _name_of(type(seat.machine)),
        )

    def restore(self) -> bool:
        """Let the machines go on where they were; return False if there is nothing kept."""
        kept, environment = self._file.latest, self._kernel.environment
        hint = "start the machines that it was written by, or remove it to begin anew"
        going_on = _GoingOn(self._kernel, str(self._file.path), hint)
        if kept is None or not going_on.read(kept):
            return False
        now_ns = environment.peek_ns()
        environment.restored(kept, self._ahead_ns, now_ns)
        going_on.begin(self._ahead_ns, now_ns)
        return True


def go_on(kernel: Kernel, kept: bytes, ahead_ns: int, now_ns: int, source: str) -> None:
    """Let the machines of a kernel go on where `kept` has them, as they did in a recorded run.

    Times that are kept are by `ahead_ns` ahead of the machines' clock, at which it was `now_ns`.
    Raise `KeepError` if these are not the machines, in the words of a user who knows the `source`.
    """
    going_on = _GoingOn(kernel, f"{source}: the file of --keep", "rerun the machines of then")
    going_on.read(kept)
    going_on.begin(ahead_ns, now_ns)


class _GoingOn:
    """Let machines go on where they were kept; errors name the `source`, and give a `hint`."""

    def __init__(self, kernel: Kernel, source: str, hint: str):
        self._kernel = kernel
        self._source = source
        self._hint = hint
        self._variables = _Variables()
        self._content = KeptMachines()
        self._ahead_ns = self._now_ns = 0

    def read(self, kept: bytes) -> bool:
        """Read what was kept; return False if that is a run that was complete."""
        try:
            self._content = _DECODER.decode(kept)
        except msgspec.DecodeError as error:
            raise self._other(f"was written by another version: {error}") from None
        return self._content != KeptMachines()

    def begin(self, ahead_ns: int, now_ns: int) -> None:
        """Let each machine stand where it was."""
        self._ahead_ns, self._now_ns = ahead_ns, now_ns
        content, roster = self._content, self._kernel.roster
        kept = {machine.name: machine for machine in content.machines}
        for name in [name for name in kept if "/" not in name] + [*content.over]:
            if name not in roster.named:
                raise self._other(f"has a machine {name}, which is not run")
        for name in [*roster.named]:
            if name in kept:
                self._seat(roster.named[name], kept)
            elif name in content.over:
                self._kernel.vacate(roster.named[name])  # else it has ended as it was asked to

    def _seat(
        self, seat: Seat, kept: Mapping[str, KeptMachine], *, unresumed: bool = False
    ) -> None:
        """Let a machine stand as it was kept, and those inside it.

        What is suspended or restarted in its first turn is not resumed before, nor what it runs.
        """
        machine = kept[seat.name]
        self._check(seat, machine)
        for name, value in self._unpack(seat.name, seat.table, machine):
            setattr(seat.machine, name, value)
        unresumed = unresumed or machine.request in (Request.SUSPEND, Request.RESTART)
        self._stand(seat, machine, unresumed=unresumed or machine.accepted)
        inner: dict[str, Seat] = {}
        turns: list[Seat | None] = []
        states = {state.name: state for state in seat.table.states}
        for run in machine.runs:
            for number, name in enumerate(run.seats):
                inner[name] = each = self._inner(seat, states[run.state].name, number, kept, name)
                self._seat(each, kept, unresumed=unresumed)
                if kept[name].loaded:
                    turns.append(seat.control.loader.put(each))
        if machine.runs:
            seat.nest.restore(machine.runs, states, inner)
            seat.children = turns

    def _inner(
        self, outer: Seat, state: str, number: int, kept: Mapping[str, KeptMachine], name: str
    ) -> Seat:
        """Make the seat of a machine that a state runs.

        A function would make another one now if that depends on what has changed since.
        """
        declared = outer.declared(outer.states[state])
        if name not in kept:
            raise self._other(f"lacks {name}, which {outer.name} runs")
        try:
            seat = outer.prepare(declared, number)
            why = "" if seat.name == name else f"where {outer.name} would run {seat.name}"
        except Exception as error:  # of the machine's own code
            why = f"which {outer.name} cannot run: {type(error).__name__}: {error}"
        if why:
            cls = _class_of(kept[name], declared.runs[number])
            if cls is None:
                raise self._other(f"has {name}, {why}")
            variables = dict(self._unpack(name, cls.table, kept[name]))
            seat = outer.control.loader.seat_within(outer, declared, number, cls(**variables))
        seat.left, seat.parking = kept[name].left, kept[name].parking
        return seat

    def _check(self, seat: Seat, machine: KeptMachine) -> None:
        """Check that the class is the one that was kept, or differs only in what is added."""
        if Path(seat.path).name != Path(machine.path).name:  # their folder may be another one
            raise self._other(f"has {seat.name} as {machine.path}, which is {seat.path}")
        known = {*seat.states, seat.suspension.name}
        running = {state.name for state in seat.table.states if state.runs}
        for state, needed in [
            (machine.state, known),
            *((run.state, running) for run in machine.runs),
        ]:
            if state not in needed:
                raise self._other(f"has {seat.name} in {state}, a state that it has no more")

    def _stand(self, seat: Seat, machine: KeptMachine, *, unresumed: bool) -> None:
        """Let a machine stand as if it was suspended meanwhile and resumed, or `unresumed`."""
        now_ns = self._now_ns
        state = seat.states.get(machine.state, seat.suspension)
        seat.stood = None
        if machine.stood is not None:
            entered_ns, until_ns = (min(each - self._ahead_ns, now_ns) for each in machine.stood)
            seat.stood = (entered_ns, until_ns)
        seat.accepted, seat.held, seat.request = machine.accepted, machine.held, machine.request
        if machine.failure is not None:
            seat.failure = Failure(ExecutionError(*machine.failure), now_ns)
        seat.remembered, seat.previous = state, None  # also if it was loaded suspended
        if machine.suspended:
            seat.current = seat.suspension
        elif seat.stood and unresumed:
            seat.current = seat.previous = state
            stops = seat.declared(state).clock == "stops"
            seat.entered_ns = seat.stood[0] + (now_ns - seat.stood[1] if stops else 0)
        else:  # one that has entered its state is resumed there
            seat.current = state
            seat.previous = None if machine.stood is None else seat.suspension

    def _unpack(self, name: str, table: Table, machine: KeptMachine) -> Iterator[tuple[str, Any]]:
        """Yield each variable that was kept, with its value."""
        for each, raw in machine.variables.items():
            variable = table.variables.get(each)
            if variable is None:
                raise self._other(f"has a variable {each!r}, which {name} has no more")
            if variable.kept:
                try:
                    yield each, self._variables.unpack(variable, bytes(raw))
                except msgspec.DecodeError as error:
                    raise self._other(f"has another type of {name}.{each}: {error}") from None

    def _other(self, what: str) -> KeepError:
        return KeepError(f"{self._source} {what}; {self._hint}")


def _name_of(cls: type[Machine]) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _class_of(machine: KeptMachine, runs: Runs) -> type[Machine] | None:
    """Find the class of a machine that a function has made, by its name; None if it is in none."""
    if isinstance(runs, str):
        return None
    for cls in run_by(runs):
        if _name_of(cls) == machine.cls:
            found: type[Machine] = cls
            return found
    module, _, names = machine.cls.partition(":")
    known: Any = sys.modules.get(module)
    for name in names.split("."):
        known = getattr(known, name, None)
    return known if isinstance(known, type) and issubclass(known, Machine) else None


def _family(seat: Seat) -> Iterator[Seat]:
    """Yield a machine and all that its states run, or have run last."""
    yield seat
    for run in seat.nest.standing:
        for inner in seat.nest.seats(seat.states[run.state]):
            yield from _family(inner)


class _Variables:
    """Pack the variables of machines, and check of each new value that it comes back."""

    def __init__(self) -> None:
        self._checked: dict[tuple[str, str], tuple[type, bytes]] = {}
        self._decoders: dict[tuple[type, str], msgspec.msgpack.Decoder[Any]] = {}

    def pack(self, seat: Seat) -> dict[str, msgspec.Raw]:
        """Pack what is to be kept; raise `KeepError` for what cannot be."""
        packed = {}
        for name, variable in seat.table.variables.items():
            value = getattr(seat.machine, name)
            if variable.kept and not isinstance(value, Submachine | Submachines):
                packed[name] = msgspec.Raw(self._pack(seat.name, variable, value))
        return packed

    def _pack(self, machine: str, variable: Variable, value: Any) -> bytes:
        try:
            data = msgspec.msgpack.encode(value)
            if self._checked.get((machine, variable.name)) != (type(value), data):
                if not _is_same(self.unpack(variable, data), value):
                    raise TypeError(f"it would come back as another value of {variable.type_text}")
                self._checked[machine, variable.name] = type(value), data
        except (TypeError, ValueError, OverflowError, RecursionError) as error:
            raise KeepError(
                f"{machine}.{variable.name}, a {type(value).__name__}, cannot be kept: {error}; "
                f"annotate it with its type, or leave it out by "
                f"{variable.name}: ... = variable(..., kept=False)"
            ) from None
        return data

    def unpack(self, variable: Variable, data: bytes) -> Any:
        """Return a value that was packed; raise `msgspec.DecodeError` for one of another type."""
        key = variable.owner, variable.name
        decoder = self._decoders.get(key)
        if decoder is None:
            decoder = self._decoders[key] = msgspec.msgpack.Decoder(variable.type)
        return decoder.decode(data)


def _is_same(one: Any, other: Any) -> bool:
    try:
        return freeze(one) == freeze(other)
    except UnknownValueError:
        return type(one) is type(other) and bool(one == other)
