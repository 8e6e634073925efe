"""Run an arrangement under a manual clock until something is the case."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from ..engine.arrangement import Arrangement
from ..engine.clock import ManualClock
from ..engine.errors import OptionError
from ..engine.machine import Machine
from .errors import NotReachedError
from .standing import name_of, standing

__all__ = ["Condition", "run_until"]

Condition: TypeAlias = str | Callable[[Arrangement], bool]
"""``"Machine.STATE"``, or a function of the arrangement."""

# A round in which a transition fires is followed by the next one at once. It takes some time
# all the same, or machines that fire for ever would keep the clock from ever moving.
_ROUND_NS = 10_000


def run_until(arrangement: Arrangement, condition: Condition, *, within_ms: float) -> float:
    """Run rounds until `condition` holds after one; return how many milliseconds that took.

    The clock, a `ManualClock`, moves as it would in `Arrangement.run`: by the period, or by the
    idle time after a round in which nothing fired, else by 10 µs. Raise `NotReachedError` when
    `within_ms` have passed or the arrangement is over, and `OptionError` for another clock or
    a condition that no loaded machine can meet.
    """
    clock = arrangement.clock
    if not isinstance(clock, ManualClock):
        raise OptionError(
            f"run_until moves the clock, but this is a {type(clock).__name__}: "
            f"give the Arrangement clock=ManualClock()"
        )
    holds = _in_state(arrangement, condition) if isinstance(condition, str) else condition
    what = condition if isinstance(condition, str) else name_of(condition, "the condition")
    machines = list(arrangement.machines)
    begin_ns, begin_round = clock.now_ns(), arrangement.rounds
    end_ns = begin_ns + round(within_ms * 1e6)
    while True:
        round_ns = clock.now_ns()
        fired = (arrangement.due_ns or 0) <= end_ns and arrangement.round()
        machines += [machine for machine in arrangement.machines if machine not in machines]
        if holds(arrangement):
            return (clock.now_ns() - begin_ns) / 1e6
        over = arrangement.reason is not None or arrangement.finished
        passed_ns = clock.now_ns() - begin_ns
        if over or begin_ns + passed_ns >= end_ns:
            why = f"over after {passed_ns / 1e6:g} ms" if over else f"not in {within_ms:g} ms"
            rounds = arrangement.rounds - begin_round
            raise NotReachedError(
                f"waited for {what}: {why}, {rounds} rounds{standing(arrangement, machines)}"
            )
        next_ns = arrangement.due_ns or round_ns + _pause_ns(arrangement, fired)
        clock.sleep_until_ns(min(next_ns, end_ns))


def _pause_ns(arrangement: Arrangement, fired: bool) -> int:
    return _ROUND_NS if fired else max(arrangement.idle_us * 1_000, _ROUND_NS)


def _in_state(arrangement: Arrangement, place: str) -> Callable[[Arrangement], bool]:
    """Return the condition that a machine is in a state; a machine may still be to come."""
    name, dot, state = place.rpartition(".")
    if not dot:
        raise OptionError(f'{place!r} names no state: it must be "Machine.STATE"')

    def find(now: Arrangement) -> Machine | None:
        return next((machine for machine in now.machines if machine.name == name), None)

    machine = find(arrangement)
    if machine is not None:
        states = [*machine._seat.states, machine._seat.suspension.name]
        if state not in states:
            names = ", ".join(dict.fromkeys(states))
            raise OptionError(f"{place!r}: {name} has no state {state!r}; it has: {names}")

    def holds(now: Arrangement) -> bool:
        machine = find(now)
        return machine is not None and machine.state_name == state

    return holds
