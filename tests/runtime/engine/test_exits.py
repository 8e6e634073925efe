"""Code of a machine that exits ends that machine alone, where each fails alone."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from llfsm.runtime import Arrangement, Machine, ManualClock, Reason, State, Trace, define
from llfsm.runtime.engine.events import Failed

EXITS = [SystemExit, KeyboardInterrupt]


class Counter(Machine):
    """A machine that has work for ten rounds."""

    rounds: int = 0

    work, done = State(), State()

    @work.internal
    def _(self) -> None:
        self.rounds += 1

    work.to(done, when=lambda m: m.rounds == 10)


def exiting(error: type[BaseException], section: str) -> type[Machine]:
    def leave(machine: Machine) -> bool:
        if error is SystemExit:
            sys.exit(3)
        raise error

    a, b = State("a"), State("b")
    if section == "guard":
        a.to(b, when=leave)
    else:
        getattr(a, section)(leave)
        a.to(b, when=lambda m: False)
    return define("M", [a, b])


@pytest.mark.parametrize("observed", [False, True])
@pytest.mark.parametrize("error", EXITS)
@pytest.mark.parametrize("section", ["guard", "on_entry", "internal"])
def test_a_machine_that_exits_fails_alone_if_each_does(
    error: type[BaseException], section: str, observed: bool
) -> None:
    trace = Trace()
    arrangement = Arrangement(
        [exiting(error, section), Counter],
        on_error="suspend",
        clock=ManualClock(),
        observers=[trace] if observed else [],
    )
    counter = arrangement.machine("Counter")
    assert isinstance(counter, Counter)
    assert arrangement.run() is Reason.FAILED
    assert counter.rounds == 10
    failed = arrangement.roster.find("M").failure
    assert error.__name__ in str(failed)
    assert [event.machine for event in trace if isinstance(event, Failed)] == ["M"] * observed


@pytest.mark.parametrize("error", EXITS)
def test_it_ends_all_if_an_error_does(error: type[BaseException]) -> None:
    arrangement = Arrangement([exiting(error, "guard"), Counter], clock=ManualClock())
    with pytest.raises(error):
        arrangement.run()
    assert arrangement.reason is Reason.INTERRUPTED


@pytest.mark.parametrize("error", EXITS)
def test_it_ends_a_loop_of_ones_own_whose_ctrl_c_it_may_be(error: type[BaseException]) -> None:
    machines = [exiting(error, "guard"), Counter]
    with pytest.raises(error), Arrangement(machines, on_error="suspend") as arrangement:
        arrangement.round()
    assert arrangement.reason is Reason.INTERRUPTED


def test_a_second_ctrl_c_in_its_code_interrupts_it_all() -> None:
    def interrupt(machine: Machine) -> bool:
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGINT)
        return False

    a, b = State("a"), State("b")
    a.to(b, when=interrupt)
    arrangement = Arrangement([define("M", [a, b]), Counter], on_error="suspend")
    with pytest.raises(KeyboardInterrupt):
        arrangement.run()
    assert arrangement.reason is Reason.INTERRUPTED
