"""A script of what happens to machines, played with an eye on an invariant."""

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
from .standing import name_of, standing

__all__ = ["Invariant", "Step", "factories", "play"]

Invariant: TypeAlias = Callable[[Arrangement], object]
"""What must hold after every ringlet: it returns False or raises `AssertionError` if not."""


class Step(NamedTuple):
    """Let `wait_ms` pass, post `messages`, and run one round."""

    wait_ms: int = 0
    messages: Mapping[Slot[Any], Any] = MappingProxyType({})


def play(
    machines: Factory | Iterable[Factory], script: Iterable[Step], *, invariant: Invariant
) -> Arrangement:
    """Play `script` to new machines on a new board, and check `invariant` after every ringlet.

    `machines` are classes, or functions that make machines. Those that accept stay loaded, so
    that the invariant can look at them; when all accept or are suspended, the rest of the script
    is left out. Return the arrangement. Raise `InvariantError`, or what else the invariant
    raises, and `ExecutionError` if a machine's code does.
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
    """Return `machines` as a list; raise `ScriptError` for what makes no new machine."""
    if isinstance(machines, Machine):
        machines = [machines]
    found = [machines] if callable(machines) else list(machines)
    for factory in found:
        if not callable(factory):
            what = factory.name if isinstance(factory, Machine) else repr(factory)
            raise ScriptError(
                f"{what} is no machine class or function that makes one; every play needs a new "
                f"machine: give the class, or lambda: Class(variable=value)"
            )
    return found


def _make(factory: Factory) -> Machine:
    made: object = factory()
    if not isinstance(made, Machine):
        raise ScriptError(f"{name_of(factory, 'the function')} made {made!r}, which is no machine")
    return made


class _Watch:
    """Check the invariant when a ringlet is over: at the next turn, or at the round's end."""

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
            f"{standing(arrangement, arrangement.machines)}"
        ) from cause
