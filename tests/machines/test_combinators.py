"""Machines made of machines do what their names say, in runs and in all runs that there are."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.machines import (
    Cooldown,
    Fallback,
    Parallel,
    Repeat,
    Retry,
    Sequence,
    Timeout,
    While,
)
from llfsm.runtime import (
    Arrangement,
    DefinitionError,
    ExecutionError,
    Machine,
    ManualClock,
    Sensor,
    State,
)
from llfsm.runtime.verification import (
    Property,
    always,
    leads_to,
    never,
    reachable,
    verify,
)
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool

LOG: list[str] = []
LIGHT = Slot("light", Bool)


class Go(Machine):
    """Is done after some turns."""

    turns: int = 2
    had: int = 0
    go, over = State(), State()

    @go.internal
    def _(self) -> None:
        self.had += 1

    go.to(over, when=lambda self: self.had >= self.turns)


class Step(Go):
    """The same, by another name."""


class Bad(Machine):
    a = State()

    @a.on_entry
    def _(self) -> None:
        raise ValueError("on purpose")


class Waits(Machine):
    a = State(final=False)


def ended(machine: type[Machine]) -> str:
    """Run a machine until it ends: the names of all that ran, in order, and how it ended."""
    names: dict[str, None] = {}
    arrangement = Arrangement([machine], clock=ManualClock(), period_us=10_000)
    try:
        for _ in range(200):
            if arrangement.finished:
                return f"{' '.join(names)}: done"
            arrangement.round()
            names |= dict.fromkeys(arrangement.states())
    except ExecutionError as error:
        cause: Any = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        return f"{' '.join(names)}: {type(cause).__name__}"
    return f"{' '.join(names)}: goes on"


@pytest.mark.parametrize(
    ("machine", "how"),
    [
        (Sequence(Go, Step), "Sequence Sequence/Go Sequence/Step: done"),
        (Sequence(Go, Bad, Step), "Sequence Sequence/Go Sequence/Bad: ValueError"),
        (Fallback(Bad, Go, Step), "Fallback Fallback/Bad Fallback/Go: done"),
        (Fallback(Bad, Bad), "Fallback Fallback/Bad Fallback/Bad.0: ValueError"),
        (Parallel(Go, Step), "Parallel Parallel/Go Parallel/Step: done"),
        (Parallel(Go, Waits), "Parallel Parallel/Go Parallel/Waits: goes on"),
        (Parallel(Waits, Bad), "Parallel Parallel/Waits Parallel/Bad: ValueError"),
        (Parallel(Go, Waits, until="any"), "Parallel Parallel/Go Parallel/Waits: done"),
        (Retry(Go), "Retry Retry/Go: done"),
        (Retry(Bad), "Retry Retry/Bad: ValueError"),
        (Timeout(Go, 100), "Timeout Timeout/Go: done"),
        (Timeout(Waits, 100), "Timeout Timeout/Waits: TookTooLongError"),
        (Repeat(Go, 3), "Repeat Repeat/Go: done"),
        (Repeat(Go), "Repeat Repeat/Go: goes on"),
        (Cooldown(Go, 100), "Cooldown Cooldown/Go: done"),
        (Fallback(Timeout(Waits, 50), Go), "Fallback Fallback/Timeout Fallback/Timeout/Waits "
         "Fallback/Go: done"),
    ],
)  # fmt: skip
def test_what_runs_and_how_it_ends(machine: type[Machine], how: str) -> None:
    assert ended(machine) == how


@pytest.mark.parametrize(("tries", "done"), [(2, False), (3, True)])
def test_a_retry_stops_at_the_first_success(tries: int, done: bool) -> None:
    class Third(Machine):
        """Fails twice."""

        which: int
        a, over = State(), State()
        a.to(over)

        @a.on_entry
        def _(self) -> None:
            if self.which < 2:
                raise ValueError("on purpose")

    machine = Retry(lambda self: Third(which=self.failures), tries)
    assert ended(machine).endswith(": done" if done else ": ValueError")


def test_while_ends_when_it_does_not_hold() -> None:
    board = Whiteboard.local()
    board.add_message(LIGHT, Bool(data=True))
    machine = While(Waits, Sensor(LIGHT, default=Bool()), lambda light: light.data)
    arrangement = Arrangement([machine], whiteboard=board, clock=ManualClock())
    for _ in range(5):
        arrangement.round()
    assert [*arrangement.states()] == ["While", "While/Waits"]
    board.add_message(LIGHT, Bool(data=False))
    for _ in range(3):
        arrangement.round()
    assert arrangement.states() == {}


# In all runs that there are: what holds for whatever they run.


def done(v: Any) -> bool:
    """True in the accepting state of the machine that all of these are called."""
    return bool(v.M.state == "DONE")


PROVED: list[tuple[type[Machine], list[Property]]] = [
    (
        Sequence(Go, Step, name="M"),
        [
            never(lambda v: v["M/Go"].loaded and v["M/Step"].loaded),
            always(lambda v: not done(v) or v["M/Step"].accepted),
            leads_to(lambda v: True, done),
        ],
    ),
    (
        Fallback(Bad, Go, name="M"),
        [
            always(lambda v: not v["M/Go"].loaded or v["M/Bad"].has_failed),
            leads_to(lambda v: True, done),
        ],
    ),
    (
        Parallel(Go, Step, name="M"),
        [
            always(lambda v: not done(v) or (v["M/Go"].accepted and v["M/Step"].accepted)),
            leads_to(lambda v: True, done),
        ],
    ),
    (
        Parallel(Go, Waits, until="any", name="M"),
        [never(lambda v: done(v) and v["M/Waits"].loaded), leads_to(lambda v: True, done)],
    ),
    (
        Retry(Go, name="M"),
        [always(lambda v: v.M.failures < 3), leads_to(lambda v: True, done)],
    ),
    (
        Fallback(Timeout(Waits, 50, name="T"), Go, name="M"),
        [
            never(lambda v: done(v) and v["M/T/Waits"].loaded),
            leads_to(lambda v: True, done, within_ms=200),
        ],
    ),
    (
        Repeat(Go, 3, name="M"),
        [always(lambda v: v.M.finished <= 3), leads_to(lambda v: True, done)],
    ),
    (
        While(Waits, Sensor(LIGHT, domain=[Bool(), Bool(data=True)], default=Bool()),
              lambda light: light.data, name="M"),
        [never(lambda v: done(v) and v["M/Waits"].loaded), reachable(done)],
    ),
    (Cooldown(Go, 30, name="M"), [never(lambda v: v.M.state == "COOL" and v["M/Go"].loaded)]),
]  # fmt: skip


@pytest.mark.parametrize(("machine", "properties"), PROVED, ids=lambda each: str(each)[:40])
def test_what_they_promise_is_proved(machine: Any, properties: Any) -> None:
    verify(machine, *properties, period_ms=10)
    verify(machine, *properties, period_ms=10, on_error="suspend")


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Sequence(),
        lambda: Fallback(),
        lambda: Parallel(),
        lambda: Parallel(Go, until="most"),
        lambda: Retry(Go, 0),
        lambda: Timeout(Go, -1),
        lambda: Repeat(Go, 0),
        lambda: Cooldown(Go, "long"),  # type: ignore[arg-type]
    ],
)
def test_what_makes_no_sense_is_refused(wrong: Any) -> None:
    with pytest.raises(DefinitionError):
        wrong()
