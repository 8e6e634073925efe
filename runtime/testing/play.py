"""Play a script of messages to machines and check an invariant after every ringlet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

from llfsm.whiteboard import Slot, Whiteboard

from ..engine.arrangement import Arrangement
from ..engine.clock import ManualClock
from ..engine.errors import ObserverError
from ..engine.events import Event, RoundEnd, Turn
from ..engine.loading import Factory
from ..engine.machine import Machine
from .errors import InvariantError, ScriptError
from .states import current_states, name_of

__all__ = ["Invariant", "Step", "factories", "play"]

Invariant: TypeAlias = Callable[[Arrangement], object]
"""Holds after a ringlet unless it returns False or raises `AssertionError`."""


class Step(NamedTuple):
    """Let `wait_ms` pass, post `messages`, and run one round."""

    wait_ms: int = 0
    messages: Mapping[Slot[Any], Any] = MappingProxyType({})


def play(
    machines: Factory | Iterable[Factory], script: Iterable[Step], *, invariant: Invariant
) -> Arrangement:
    """Play `script` to new machines on a new board, check `invariant` after every ringlet.

    `machines` are classes, or functions that return machines. Accepting machines stay loaded, so
    that the invariant can examine them; when all machines accept or are suspended, the rest of the
    script is skipped. Return the arrangement. Raise `InvariantError` or any other error of the
    invariant, and `ExecutionError` for one of a machine's code.
    """
    clock, made = ManualClock(), [_make(factory) for factory in factories(machines)]
    board = Whiteboard.local()
    arrangement = Arrangement(made, whiteboard=board, clock=clock, unload_accepting=False)
    arrangement.attach(_Watch(arrangement, invariant))
    with arrangement:
        for wait_ms, messages in script:
            if wait_ms < 0:
                raise ScriptError(f"a step waits {wait_ms} ms; it must be 0 or more")
            clock.advance(ms=wait_ms)
            for slot, message in messages.items():
                board.add_message(slot, message)
            try:
                arrangement.round()
            except ObserverError as error:
                own = error.__cause__ or error  # what the invariant raised
                raise own from own.__cause__
            if arrangement.finished:
                break
    return arrangement


def factories(machines: Factory | Iterable[Factory]) -> list[Factory]:
    """Return `machines` as a list; raise `ScriptError` for anything that is not callable."""
    if isinstance(machines, Machine):
        machines = [machines]
    found = [machines] if callable(machines) else list(machines)
    for factory in found:
        if not callable(factory):
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

    def __call__(self, event: Event) -> None:
        if isinstance(event, Turn | RoundEnd):
            if self._turn is not None:
                self._check(self._turn)
            self._turn = event if isinstance(event, Turn) else None

    def _check(self, turn: Turn) -> None:
        arrangement = self._arrangement
        cause: AssertionError | None = None
        try:
            result = self._invariant(arrangement)
            if result is None or result:
                return
        except AssertionError as error:
            cause = error
        said = f": {cause}" if cause is not None and str(cause) else ""
        raise InvariantError(
            f"{name_of(self._invariant, 'the invariant')} does not hold in round {turn.round}, at "
            f"{turn.time_ns / 1e6:g} ms, after the ringlet of {turn.machine} in {turn.state}{said}"
            f"{current_states(arrangement, arrangement.machines)}"
        ) from cause
