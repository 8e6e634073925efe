"""Play a script to machines, on an arrangement as any other under a manual clock.

`play` checks an invariant after every ringlet, for tests. A `ScriptRun` is the part of it that
counterexamples and recordings share: machines loaded to do a script, which may be journalled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeAlias

from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.errors import ExecutionError, ObserverError
from llfsm.runtime.engine.events import Event, RoundEnd, Turn
from llfsm.runtime.engine.kernel import Control, Factory, OnError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.schedule import Timetable
from llfsm.runtime.journal.entries import Entry, Journal, entries_of
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.testing.errors import InvariantError, ScriptError
from llfsm.runtime.testing.scripted import ScriptedEnvironment, Step
from llfsm.runtime.testing.waiting import current_states, name_of

Invariant: TypeAlias = Callable[[Arrangement], object]
"""A check after a ringlet: it fails by returning False or raising `AssertionError`."""


class Loading(Protocol):
    """A machine and how it is loaded, such as `llfsm.runtime.verification.Member`."""

    def load(self, control: Control) -> None:
        """Load a new machine into the arrangement of `control`."""


def play(
    machines: Factory | Iterable[Factory | Loading],
    script: Iterable[Step],
    *,
    invariant: Invariant,
    unload_accepting: bool = False,
    on_error: OnError = "stop",
    timetable: Timetable | None = None,
    to_end: bool = False,
) -> Arrangement:
    """Play `script` to new machines on a new board; check `invariant` after every ringlet.

    `machines` are classes, or functions that return machines. Accepting machines stay loaded, so
    that the invariant can examine them, unless `unload_accepting`; `on_error` and `timetable` are
    as for `Arrangement`. When all machines accept or are suspended, the rest of the script is
    skipped unless it is played `to_end`, as if others might still resume one. If `invariant` has a
    method `begin`, that is called before the first ringlet.

    Return the arrangement, which has ended. Raise `InvariantError` or any other error of the
    invariant, `ExecutionError` for one of a machine's code, and `ScriptError` for a wrong script.
    """
    environment = ScriptedEnvironment()
    arrangement = Arrangement(
        environment=environment,
        unload_accepting=unload_accepting,
        on_error=on_error,
        timetable=timetable,
    )
    for each in factories(machines):
        if callable(each):
            arrangement.load(_make(each))
        else:
            each.load(arrangement.control)
    watch = _Watch(arrangement, invariant)
    arrangement.attach(watch)
    begin: Invariant | None = getattr(invariant, "begin", None)
    if begin is not None and begin(arrangement) is False:
        what = name_of(invariant, "the invariant")
        raise InvariantError(f"{what} does not hold at the beginning")
    with arrangement:
        try:
            for step in environment.play(arrangement, script):
                if step.after:
                    watch.look_again()
                if arrangement.finished and not to_end:
                    break
        except ObserverError as error:
            own = error.__cause__ or error  # what the invariant raised
            raise own from own.__cause__
    return arrangement


def factories(machines: Factory | Iterable[Factory | Loading]) -> list[Factory | Loading]:
    """List `machines`; raise `ScriptError` for anything that makes no machine."""
    if isinstance(machines, Machine):
        machines = [machines]
    found: list[Factory | Loading] = [machines] if callable(machines) else [*machines]
    for factory in found:
        if isinstance(factory, Machine) or not (callable(factory) or hasattr(factory, "load")):
            what = factory.name if isinstance(factory, Machine) else repr(factory)
            raise ScriptError(
                f"{what} is neither a machine class nor a function that returns a machine; every "
                f"play needs new machines: give the class, or lambda: Class(variable=value)"
            )
    return found


def _make(factory: Factory) -> Machine:
    made: object = factory()
    if not isinstance(made, Machine):
        raise ScriptError(
            f"{name_of(factory, 'the function')} returned {made!r}, which is not a machine"
        )
    return made


class _Watch:
    """Check the invariant after each ringlet: at the next turn, or at the end of the round."""

    def __init__(self, arrangement: Arrangement, invariant: Invariant):
        self._arrangement = arrangement
        self._invariant = invariant
        self._turn: Turn | None = None
        self._last: Turn | None = None

    def __call__(self, event: Event) -> None:
        if isinstance(event, Turn | RoundEnd):
            if self._turn is not None:
                self._last = self._turn
                self._check(self._turn)
            self._turn = event if isinstance(event, Turn) else None

    def look_again(self) -> None:
        """Check the invariant again after requests that followed the round: machines may end."""
        if self._last is not None:
            self._check(self._last)

    def _check(self, turn: Turn) -> None:
        arrangement = self._arrangement
        cause: AssertionError | None = None
        try:
            result = self._invariant(arrangement)
            if result is None or result:
                return
        except AssertionError as error:
            cause = error
        why = f": {cause}" if cause is not None and str(cause) else ""
        raise InvariantError(
            f"{name_of(self._invariant, 'the invariant')} does not hold in round {turn.round}, at "
            f"{turn.time_ns / 1e6:g} ms, after the ringlet of {turn.machine} in {turn.state}{why}"
            f"{current_states(arrangement, arrangement.machines)}"
        ) from cause


class ScriptRun:
    """Machines loaded to do a script; the manual clock begins at `start_ns`.

    With a `journal`, all that they do is written to it; without one, nothing observes them.
    """

    def __init__(
        self,
        members: Iterable[Loading],
        *,
        unload_accepting: bool = True,
        on_error: OnError = "stop",
        timetable: Timetable | None = None,
        journal: Journal | None = None,
        start_ns: int = 0,
    ):
        self.error: ExecutionError | None = None
        """The error of a machine's code that has ended the run."""
        self.scripted = ScriptedEnvironment(start_ns)
        environment: Environment = self.scripted
        if journal is not None:
            environment = JournalledEnvironment(environment, journal)
            self.scripted.asking = journal.asking
        self.arrangement = Arrangement(
            environment=environment,
            unload_accepting=unload_accepting,
            on_error=on_error,
            timetable=timetable,
        )
        for member in members:
            member.load(self.arrangement.control)

    def play(self, script: Iterable[Step]) -> Iterator[Step]:
        """Do a script, and yield each step when its rounds are over; end at an error of code."""
        try:
            yield from self.scripted.play(self.arrangement, script)
        except ExecutionError as error:
            self.error = error


def journal_of(
    members: Iterable[Loading],
    script: Iterable[Step],
    *,
    unload_accepting: bool = True,
    on_error: OnError = "stop",
    timetable: Timetable | None = None,
) -> tuple[ScriptRun, list[Entry]]:
    """Do `script`, and return the run with the entries of its journal."""
    written: list[bytes] = []
    journal = Journal(written.append)
    run = ScriptRun(
        members,
        unload_accepting=unload_accepting,
        on_error=on_error,
        timetable=timetable,
        journal=journal,
    )
    for _ in run.play(script):
        pass
    journal.flush()
    return run, [entry for data in written for entry in entries_of(data)]
