"""Machines under a period or a timetable: for ever at work, and two that have nothing to do."""

from __future__ import annotations

from typing import Any

from llfsm.runtime import Machine, ManualClock, State, define

Log = list[tuple[str, int]]
"""Which machine began a turn, and when in microseconds."""


def worker(name: str, clock: ManualClock, log: Log, costs_us: list[int] | None = None) -> Any:
    """Return a machine for ever at work: its n-th turn takes costs_us[n], later ones nothing."""
    costs = iter(costs_us or [])
    work, never = State("WORK"), State("NEVER")

    def turn(machine: Machine) -> None:
        log.append((name, clock.now_ns() // 1_000))
        clock.advance(us=next(costs, 0))

    work.internal(turn)
    work.to(never, when=lambda machine: False)
    return define(name, [work, never])


class Waiting(Machine):
    """Accept when asked to stop."""

    waiting = State()
    done = State()
    waiting.to(done, when=lambda m: m.stopping)


class Stubborn(Machine):
    a = State()
    b = State()
    a.to(b, when=lambda m: False)
